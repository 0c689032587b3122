"""A fleet: the arrays of n worlds, each with a car on its own street. The single environment is a fleet of one.

World i is row i of every array and has its own random streams for streets, sonars and odometry, so its results do not
depend on the number of worlds.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import astuple, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from gymnasium import spaces

from acquisition import SettingError
from acquisition.arrays import Floats, Ints, Singles
from acquisition.limits import Limit, check_value, near, shown
from noise import SonarModel
from sonar_gym.checks import settings_of
from sonar_gym.parking import step_kernel
from sonar_gym.parking.prior import street_credence
from sonar_gym.parking.step_kernel import REWARD_TERMS, RewardWeights, StepConstants, WorldArrays
from sonar_gym.parking.world import WorldView
from sonar_gym.sensing.detection import detection_table, has_beam, listening_table
from sonar_gym.sensing.mounts import Layout, heights, layout, mount_arrays, times_of
from sonar_gym.sensing.odometry import Odometer, OdometryChoice
from sonar_gym.sensing.odometry import odometry as odometry_settings
from sonar_gym.sensing.pipeline import Sensing
from sonar_gym.sensing.records import CAUSES, PingArrays
from sonar_gym.sensing.sonar import STREAM_TAG, Sonar, SonarChoice, resolve, sonar_spaces
from sonar_gym.sensing.timing import Times, timing
from sonar_gym.street.cost_to_go import PARKED_ANGLE, PARKED_OVERHANG, CostTables, Space, tabulated
from sonar_gym.street.obstacles import obstacles_of
from sonar_gym.street.randomization import LEVEL_NAMES, Randomization
from sonar_gym.street.street import (
    BEHIND,
    Goal,
    Street,
    StreetSettings,
    check_gap,
    draw_street,
    placed,
    replaced,
    start_of,
    street_of,
    street_settings,
)
from sonar_gym.street.vehicle import CarSettings

Observation = dict[str, Singles]
STEP_S = 0.1  # s; an SRF08 needs 65 ms, several at once after a general call (Devantech)
MAX_RANGE = 3.01  # m; SRF08 with range register 69: (69 + 1) * 43 mm
MAX_STEPS = 400  # steps of an episode, the time limit set by `gymnasium.make` and `make_vec`
ODOMETRY_SPAN = (10.0, 2.0)  # m; scales of the odometry along and across the initial heading
PARKED_SPEED = 0.03  # m/s
CHUNK = 64  # worlds that are stepped at a time
THREAD_ROWS = 64  # worlds per thread below which threads are slower than none
EGO = 7  # length of `ego`
OPTIONS = ("difficulty", "street", "boxes", "obstacles", "start")


def chunks(values: Any) -> list[Any]:
    """Return an array in parts of at most `CHUNK` rows."""
    return [values] if len(values) <= CHUNK else [values[k : k + CHUNK] for k in range(0, len(values), CHUNK)]


def _empty_faces(n: int, faces: int) -> dict[str, Any]:
    """Return arrays for a number of faces in each of n streets."""
    return {
        "segments": np.zeros((n, faces, 4)),
        "surface": np.zeros((n, faces, 2)),
        "owner": np.zeros((n, faces), dtype=np.int64),
        "velocity": np.zeros((n, faces, 2)),
    }


class Fleet:
    """n worlds.

    Args:
        count: number of worlds.
        sonar: name, path or model of the sonar, shared by all worlds.
        sonar_layout: sonars on each car.
        difficulty: name of a level of `street.LEVELS`.
        street: settings from which each street is drawn; a mapping replaces fields of the level's settings.
        car, reward: settings, or mappings of their fields.
        odometry: errors of the odometry.
        credence_driver: kind of driver on whose conditions credence given a reading is calibrated, see `prior.DRIVERS`.
        crosstalk: whether the sonars of a car hear each other's bursts.
        threads: number of threads.
        randomize: what each episode draws besides its street, or a mapping of its fields.

    Attributes:
        worlds: state of all worlds.
        constants: quantities that are equal in all worlds.
    """

    def __init__(
        self,
        count: int,
        sonar: SonarChoice = "ideal",
        sonar_layout: Layout = "eight",
        difficulty: str = "normal",
        street: StreetSettings | Mapping[str, object] | None = None,
        car: CarSettings | Mapping[str, object] | None = None,
        reward: RewardWeights | Mapping[str, object] | None = None,
        odometry: OdometryChoice = "exact",
        credence_driver: str | None = "agent",
        crosstalk: bool = True,
        threads: int = 1,
        randomize: Randomization | Mapping[str, object] | None = None,
    ) -> None:
        self.count = count
        check_value("crosstalk", crosstalk, bool)
        check_value("threads", threads, Annotated[int, Limit(1, 1024)])
        self.mounts = layout(sonar_layout)
        self.randomization: Randomization = settings_of(Randomization, randomize, "randomize")
        self._randomizes = self.randomization != Randomization()
        self._levels, self._costs = np.full(count, -1), CostTables()
        self.street_settings = street_settings(difficulty, street)
        self.car_settings: CarSettings = settings_of(CarSettings, car, "car")
        check_gap(self.street_settings.gap[0], self.car_settings)
        self.reward_weights: RewardWeights = settings_of(RewardWeights, reward, "reward")
        self.odometer = Odometer(odometry_settings(odometry), count)
        self._make_arrays(count)
        self._threads = threads
        self._credence_driver, self._crosstalk = credence_driver, crosstalk
        self._pool: ThreadPoolExecutor | None = None
        self.install(sonar)

    def install(
        self, sonar: SonarChoice, max_range: float = MAX_RANGE, times: Times | None = None, tag: int = STREAM_TAG
    ) -> None:
        """Replace the sonars on the cars; streets, cars and mounts stay.

        Args:
            sonar: name, path or model.
            max_range: maximum range, m.
            times: period, phase and latency, s, see `timing.timing`; None: those of the mounts.
            tag: tag of the random stream of the sonars.
        """
        model, names = resolve(sonar), [mount.name for mount in self.mounts]
        key = self.street_settings, self.car_settings, self.mounts, max_range, self._credence_driver, self._crosstalk
        tables = street_credence(model, *key)
        sonars = Sonar(model, len(names), max_range, tag, tables, self.count)
        when = timing(names, STEP_S, times_of(self.mounts) if times is None else times, max_range)
        self.sensing = Sensing(sonars, when, STEP_S, min(CHUNK, self.count))
        self._pings = [self.sensing.pings, *(self.sensing.pings.for_thread() for _ in range(self._threads - 1))]
        by_name = isinstance(sonar, (str, os.PathLike))
        self.sonar_name = Path(str(sonar)).name if by_name else type(model).__name__
        self.close()
        if self._threads > 1 and self.count > 1 and sonars.batched:
            self._pool = ThreadPoolExecutor(self._threads)
        self.constants = self._constants(model)

    @property
    def sonar(self) -> Sonar:
        """The sonars, which draw the readings."""
        return self.sensing.sonar

    def _make_arrays(self, n: int) -> None:
        self.streets: list[Street | None] = [None] * n
        self.worlds = WorldArrays(
            steps=np.full(n, -1, dtype=np.int64),
            car=np.zeros((n, 5)),
            odometry=self.odometer.state,
            task=np.zeros((n, step_kernel.N_TASK)),
            mounts=np.repeat(mount_arrays(self.mounts)[0][None], n, axis=0),
            counts=np.zeros(n, dtype=np.int64),
            **_empty_faces(n, self.street_settings.max_faces),
            moves=np.zeros(n, dtype=np.bool_),
            floor=np.zeros((n, 2)),
            terms=np.zeros((n, len(REWARD_TERMS))),
            ended=np.zeros((n, 3), dtype=np.bool_),
            ego=np.zeros((n, EGO), dtype=np.float32),
        )

    def _grow(self, faces: int) -> None:
        """Enlarge the arrays of faces and copy their contents."""
        wider = _empty_faces(self.count, faces)
        for name, new in wider.items():
            old = getattr(self.worlds, name)
            new[:, : old.shape[1]] = old
        self.worlds = self.worlds._replace(**wider)

    def _constants(self, model: SonarModel) -> StepConstants:
        car, detection = self.car_settings, detection_table(model, self.sonar.max_range)
        crosstalk = self._crosstalk and has_beam(detection)
        return StepConstants(
            dynamics=car.dynamics,
            body=car.body,
            half_angles=mount_arrays(self.mounts)[1],
            heights=heights(self.mounts),
            timing=self.sensing.timing,
            grids=self._costs.grids,
            costs=self._costs.values,
            weights=np.array(astuple(self.reward_weights), dtype=np.float64),
            scale=np.array([car.max_speed, car.max_steering, *ODOMETRY_SPAN, MAX_STEPS]),
            limits=np.array([PARKED_SPEED, PARKED_ANGLE, PARKED_OVERHANG, -BEHIND]),
            detection=detection,
            listening=listening_table(model) if crosstalk else detection,
            crosstalk=crosstalk,
            dt=STEP_S,
            max_range=self.sonar.max_range,
        )

    @property
    def observation_space(self) -> spaces.Dict:
        """Observation space of one world."""
        n = len(self.mounts)
        own = {"age": spaces.Box(0.0, 1.0, (n,), np.float32), "ego": spaces.Box(-1.0, 1.0, (EGO,), np.float32)}
        return spaces.Dict({**sonar_spaces(n), **own})

    @property
    def action_space(self) -> spaces.Box:
        """Action space of one world."""
        return spaces.Box(-1.0, 1.0, (2,), np.float32)

    @property
    def causes(self) -> tuple[str, ...]:
        """Names of the causes of readings, by number."""
        return (*CAUSES, *self.sonar.causes)

    # ---- reset and step ----------------------------------------------------------------------------------------------

    def seed(self, seed: int, row: int = 0) -> None:
        """Restart the random streams of the sonars and odometry of one world; that of the streets is the caller's."""
        self.sonar.seed(seed, row)
        self.odometer.seed(seed, row)

    def reset(self, rows: Ints, rngs: Sequence[np.random.Generator], options: Mapping[str, Any] | None = None) -> None:
        """Begin new episodes in some worlds: draw streets, place the cars, and ping with all sonars.

        Args:
            rows: numbers of the worlds.
            rngs: generator of the street for each of them.
            options: options of `street_for`.
        """
        for row, rng in zip(rows, rngs, strict=True):
            self._place_street(int(row), self.street_for(rng, self._randomized(int(row), rng, options or {})))
        self.odometer.begin(rows)
        for chunk in chunks(rows):
            self.sensing.begin(chunk)
            step_kernel.begin(chunk, self.worlds, self.constants, self.sensing.pings)
            self._update(chunk, self.sensing.pings)

    def _randomized(self, row: int, rng: np.random.Generator, options: Mapping[str, Any]) -> Mapping[str, Any]:
        """Draw what an episode randomizes, and return its options; what the options fix is not replaced."""
        level, moved = self.randomization.draw(rng, len(self.mounts))
        self.worlds.mounts[row] = mount_arrays(self.mounts)[0] + moved
        if level < 0 or "difficulty" in options or "street" in options:
            self._levels[row] = -1
            return options
        self._levels[row] = level
        return {**options, "difficulty": LEVEL_NAMES[level]}

    def step(self, rows: Ints, actions: Floats) -> None:
        """Drive the cars of some worlds for 0.1 s and update their observations.

        Args:
            rows: numbers of the worlds, increasing, (r,).
            actions: steering angle and speed relative to their maxima, within -1..1, (r, 2).
        """
        self.odometer.slip(rows)
        if self._pool is None or len(rows) < THREAD_ROWS * self._threads:
            self._step(rows, actions, self.sensing.pings)
        else:
            parts = np.array_split(rows, self._threads), np.array_split(actions, self._threads)
            list(self._pool.map(self._step, *parts, self._pings))

    def _step(self, rows: Ints, actions: Floats, pings: PingArrays) -> None:
        """Step some worlds, a few at a time, so that what their pings face stays in the processor's cache."""
        for chunk, command in zip(chunks(rows), chunks(actions), strict=True):
            step_kernel.advance(chunk, command, self.worlds, self.constants, pings)
            self._update(chunk, pings)

    def _update(self, rows: Ints, pings: PingArrays) -> None:
        now: Floats = self.worlds.steps[rows] * np.float64(STEP_S)
        self.sensing.update(rows, now, pings)

    # ---- streets -----------------------------------------------------------------------------------------------------

    def street_for(self, rng: np.random.Generator, options: Mapping[str, Any] | None = None) -> Street:
        """Return the street of a new episode.

        Args:
            rng: generator from which the street is drawn.
            options: what to fix: `difficulty`, name of a level; `street`, a mapping of fields of `StreetSettings`,
                complete settings, or a `Street`; `boxes`, see `street_of`; `obstacles`, see `obstacles_of`; `start`, x,
                y, heading of the car in m, m, rad.
        """
        options = self.checked(options)
        given = options.get("street")
        street = given if isinstance(given, Street) else self._street_of(options, given, rng)
        if "obstacles" in options:
            street = replace(street, obstacles=obstacles_of(options["obstacles"]))
        if "start" not in options:
            return street
        return placed(street, options["start"], self.car_settings)

    def checked(self, options: Mapping[str, Any] | None) -> Mapping[str, Any]:
        """Return the options of a reset; nothing is drawn.

        Raises:
            SettingError: an option is unknown or invalid.
        """
        options = {} if options is None else options
        if not isinstance(options, Mapping):
            raise SettingError(f"reset options: expected a mapping, got {shown(options)}")
        for name in options:
            if name not in OPTIONS:
                raise SettingError(
                    f"reset option {name!r}: unknown option; expected {', '.join(OPTIONS)}{near(name, OPTIONS)}"
                )
        given = options.get("street")
        if not isinstance(given, Street):
            settings = self._settings_of(options, given)
            check_gap(settings.gap[0], self.car_settings)
            if "boxes" in options:
                given = street_of(settings, options["boxes"])
                check_gap(given.gap[1] - given.gap[0], self.car_settings)
        obstacles_of(options.get("obstacles", ()))
        if "start" in options:
            start = start_of(options["start"])
            if isinstance(given, Street):
                placed(given, start, self.car_settings)
        return options

    def _settings_of(self, options: Mapping[str, Any], given: Any) -> StreetSettings:
        settings = street_settings(options["difficulty"]) if "difficulty" in options else self.street_settings
        if not (given is None or isinstance(given, (StreetSettings, Mapping))):
            raise SettingError(
                "reset option 'street' must be a Street, StreetSettings or a mapping of its fields, "
                f"got a {type(given).__name__}"
            )
        return replaced(settings, given)

    def _street_of(self, options: Mapping[str, Any], given: Any, rng: np.random.Generator) -> Street:
        settings = self._settings_of(options, given)
        return street_of(settings, options["boxes"]) if "boxes" in options else draw_street(settings, rng)

    def _place_street(self, row: int, street: Street) -> None:
        """Write a street, and a car at its start, into a row."""
        scene, goal = street.scene, Goal.of(street, self.car_settings)
        faces = len(scene.segments)
        if faces > self.worlds.owner.shape[1]:
            self._grow(faces)
        worlds, self.streets[row] = self.worlds, street
        worlds.counts[row], worlds.owner[row, :faces] = faces, scene.owner
        worlds.segments[row, :faces], worlds.surface[row, :faces] = scene.segments, scene.surface
        worlds.velocity[row, :faces], worlds.moves[row] = scene.velocity, bool(scene.velocity.any())
        worlds.floor[row] = street.settings.floor_reflectance, np.radians(street.settings.floor_texture_deg)
        worlds.car[row] = (*street.start, 0.0, 0.0)
        task = *street.gap, street.line, goal.x, goal.y, goal.turn, goal.ready_x, self._table_of(street), 0.0
        worlds.task[row] = task

    def _table_of(self, street: Street) -> int:
        """Return the number of the table of cost to go of a street, made if it is new."""
        length = tabulated(street.gap[1] - street.gap[0], street.settings.gap[0], self.car_settings)
        number = self._costs.number(Space.of(street.settings, self.car_settings, length))
        self.constants = self.constants._replace(grids=self._costs.grids, costs=self._costs.values)
        return number

    # ---- output ------------------------------------------------------------------------------------------------------

    def observation(self, which: int | slice | Ints) -> Observation:
        """Return observations: of one world, each (s,) or (7,), or of several, each (r, s) or (r, 7)."""
        return {**self.sensing.observation(which), "ego": self.worlds.ego[which].copy()}

    def truth(self, which: int | slice | Ints) -> dict[str, Any]:
        """Return the info of one world or several: true conditions of the pings shown, and state of the episode."""
        ended = self.worlds.ended[which].copy()
        drawn = {"level": self._levels, "mounts": self.worlds.mounts} if self._randomizes else {}
        return {
            **({"randomized": {name: value[which].copy() for name, value in drawn.items()}} if drawn else {}),
            "is_success": ended[..., step_kernel.PARKED],
            "collision": ended[..., step_kernel.COLLISION],
            "left_street": ended[..., step_kernel.LEFT_STREET],
            **self.sensing.truth(which),
            "reward_terms": dict(zip(REWARD_TERMS, self.worlds.terms[which].copy().T, strict=True)),
        }

    def close(self) -> None:
        """Stop the threads; later steps run without them."""
        if self._pool is not None:
            self._pool.shutdown()
            self._pool = None

    def world(self, row: int) -> WorldView:
        """Return a view of one world for display."""
        street = self.streets[row]
        assert street is not None, "world() before the first reset()"
        return WorldView(
            self.worlds, self.sensing.pings, row, street, self.car_settings, self.mounts, self.sonar_name, self.causes
        )
