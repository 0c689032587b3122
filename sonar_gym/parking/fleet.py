"""A fleet: n cars as arrays, each in its own street. The single environment is a fleet of one.

World i is row i of every array. It has its own random streams for streets, sonars and odometer, so its results do not
depend on the number of worlds.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import astuple, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from acquisition import Ping, SettingError
from sonar_gym.parking import step_kernel
from sonar_gym.parking.prior import street_credence
from sonar_gym.parking.step_kernel import StepConstants, Worlds
from sonar_gym.parking.street import (
    STREET_BEHIND_M,
    Goal,
    Street,
    StreetSettings,
    arc_table,
    draw_street,
    street_of,
    street_settings,
)
from sonar_gym.parking.vehicle import CarSettings
from sonar_gym.parking.world import WorldView
from sonar_gym.sensing.mounts import Layout, layout, mount_arrays, timing_array
from sonar_gym.sensing.odometry import Odometer, OdometryChoice
from sonar_gym.sensing.odometry import odometry as odometry_settings
from sonar_gym.sensing.scene import EMPTY_M
from sonar_gym.sensing.sonar import Sonar, SonarChoice, resolve, sonar_spaces

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Observation = dict[str, NDArray[np.float32]]
STEP_S = 0.1  # s; an SRF08 ranges in 65 ms; a general call starts all of them together (Devantech)
MAX_RANGE = 3.01  # m; SRF08 with range register 69: (69 + 1) * 43 mm
MAX_STEPS = 400  # time limit of an episode in `gymnasium.make` and `make_vec`
ODOMETRY_SPAN = (10.0, 2.0)  # m; scale of the odometry along and across the initial heading
PARKED_ANGLE = np.radians(10.0)
PARKED_SPEED = 0.03  # m/s
PARKED_OVERHANG = 0.02  # m; greatest overhang of a parked car over the line of the strip
THREAD_ROWS = 64  # worlds per thread below which threads do not pay
EGO = 7  # length of `ego`
TERMS = ("progress", "time", "parked", "crashed")
SONAR_KEYS = ("ranges", "credence", "echo", "age")
OPTIONS = ("difficulty", "street", "boxes", "start")


@dataclass(frozen=True)
class RewardWeights:
    """Weights of the reward terms.

    Attributes:
        progress: reward per metre of decrease of the cost to go along the reference path.
        time: reward per step.
        parked: reward for standing in the gap, once.
        crashed: reward for a collision or for leaving the street, once.
        off_path: cost to go of a lateral distance of 1 m from the reference path, m.
        off_heading: cost to go of a heading error of 1 rad, m.
    """

    progress: float = 1.0
    time: float = -0.01
    parked: float = 10.0
    crashed: float = -10.0
    off_path: float = 3.0
    off_heading: float = 0.5


def settings_or_default(cls: type, given: Any) -> Any:
    """Return settings given as an instance, as a mapping of fields, or as None for the defaults."""
    if given is None:
        return cls()
    return cls(**given) if isinstance(given, Mapping) else given


def _faces(n: int, faces: int) -> dict[str, Any]:
    """Return empty arrays for a number of faces in each of n streets."""
    return {
        "segments": np.zeros((n, faces, 4)),
        "surface": np.zeros((n, faces, 2)),
        "owner": np.zeros((n, faces), dtype=np.int64),
    }


class Fleet:
    """n worlds that are stepped together.

    Args:
        count: number of worlds n.
        sonar: name, path or model of the sonars, shared by all worlds.
        sonar_layout: mounts on each car.
        difficulty: name of a level in `street.LEVELS`.
        street: distribution of the streets; a mapping replaces fields of the level.
        car, reward: settings, or mappings of their fields.
        odometry: errors of the odometry.
        threads: number of threads.
    """

    def __init__(
        self,
        count: int,
        sonar: SonarChoice = "ideal",
        sonar_layout: Layout = "eight",
        difficulty: str = "normal",
        street: StreetSettings | Mapping[str, Any] | None = None,
        car: CarSettings | Mapping[str, Any] | None = None,
        reward: RewardWeights | Mapping[str, Any] | None = None,
        odometry: OdometryChoice = "exact",
        threads: int = 1,
    ) -> None:
        self.count = count
        self.mounts = layout(sonar_layout)
        self.street_settings = street_settings(difficulty, street)
        self.car_settings: CarSettings = settings_or_default(CarSettings, car)
        self.reward_weights: RewardWeights = settings_or_default(RewardWeights, reward)
        model = resolve(sonar)
        tables = street_credence(model, self.street_settings, self.car_settings, self.mounts, MAX_RANGE)
        self.sonar = Sonar(model, len(self.mounts), MAX_RANGE, tables=tables, copies=count)
        self.odometer = Odometer(odometry_settings(odometry), count)
        named = isinstance(sonar, (str, os.PathLike))
        self.sonar_name = Path(str(sonar)).name if named else type(model).__name__
        parallel = threads > 1 and (count == 1 or self.sonar.batched)
        self._pool = ThreadPoolExecutor(threads) if parallel else None
        self._threads = threads if parallel else 1
        self._make_arrays(count, len(self.mounts))
        self.rules = self._rules()

    def _make_arrays(self, n: int, s: int) -> None:
        self.streets: list[Street | None] = [None] * n
        singles: dict[str, Any] = {name: np.zeros((n, s), dtype=np.float32) for name in SONAR_KEYS}
        self.worlds = Worlds(
            steps=np.full(n, -1, dtype=np.int64),
            car=np.zeros((n, 5)),
            odometry=self.odometer.state,
            task=np.zeros((n, step_kernel.TASK)),
            counts=np.zeros(n, dtype=np.int64),
            **_faces(n, 4 * (self.street_settings.decoys[1] + 2) + 3),
            last_pings=np.zeros((n, s, step_kernel.COLUMNS)),
            fired=np.zeros((n, s), dtype=np.bool_),
            in_flight=np.zeros((n, s), dtype=np.bool_),
            observed=np.zeros((n, s, step_kernel.COLUMNS)),
            terms=np.zeros((n, len(TERMS))),
            ended=np.zeros((n, 3), dtype=np.bool_),
            ego=np.zeros((n, EGO), dtype=np.float32),
            cause=np.zeros((n, s), dtype=np.int64),
            **singles,
        )

    def _make_room(self, faces: int) -> None:
        """Enlarge the arrays of faces, with the present faces copied."""
        wider = _faces(self.count, faces)
        for name, new in wider.items():
            old = getattr(self.worlds, name)
            new[:, : old.shape[1]] = old
        self.worlds = self.worlds._replace(**wider)

    def _rules(self) -> StepConstants:
        car, (mounts, half) = self.car_settings, mount_arrays(self.mounts)
        return StepConstants(
            measures=car.dynamics,
            body=car.body,
            mounts=mounts,
            half=half,
            timing=timing_array(self.mounts, STEP_S),
            arc=arc_table(car),
            weights=np.array(astuple(self.reward_weights)),
            share=np.array([car.max_speed, car.max_steering, *ODOMETRY_SPAN, MAX_STEPS]),
            limits=np.array([PARKED_SPEED, PARKED_ANGLE, PARKED_OVERHANG, -STREET_BEHIND_M]),
            edges=self.sonar.edges,
            tables=self.sonar.tables,
            dt=STEP_S,
            far=MAX_RANGE,
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
        return (*step_kernel.CAUSES, *self.sonar.causes)

    # ---- episodes ----------------------------------------------------------------------------------------------------

    def seed(self, seed: int, row: int = 0) -> None:
        """Seed the sonar and odometer streams of a world. The caller owns the stream of its streets."""
        self.sonar.seed(seed, row)
        self.odometer.seed(seed, row)

    def reset(self, rows: Ints, rngs: Sequence[np.random.Generator], options: Mapping[str, Any] | None = None) -> None:
        """Begin new episodes in some worlds: draw the streets, place the cars at their start, and take readings.

        Args:
            rows: worlds.
            rngs: generator of the street of each of these worlds.
            options: see `street_for`.
        """
        for row, rng in zip(rows, rngs, strict=True):
            self._place_street(int(row), self.street_for(rng, options))
        self.sonar.forget(rows)
        self.odometer.begin(rows)
        step_kernel.begin(rows, self.worlds, self.rules)
        self._sense(rows)

    def step(self, rows: Ints, wanted: Floats) -> None:
        """Drive the cars of some worlds for 0.1 s, then take readings.

        Args:
            rows: worlds, increasing, (r,).
            wanted: commanded steering and speed as fractions of their maximum, within -1..1, (r, 2).
        """
        self.odometer.slip(rows)
        if self._pool is None or len(rows) < THREAD_ROWS * self._threads:
            self._step(rows, wanted)
        else:
            parts = np.array_split(rows, self._threads), np.array_split(wanted, self._threads)
            list(self._pool.map(self._step, *parts))

    def _step(self, rows: Ints, wanted: Floats) -> None:
        step_kernel.advance(rows, wanted, self.worlds, self.rules)
        self._sense(rows)

    def _sense(self, rows: Ints) -> None:
        """Draw the readings of the sonars that have fired, and observe the readings that have arrived."""
        fired, s = self.worlds.fired[rows], len(self.mounts)
        if fired.all():
            run = rows[-1] - rows[0] + 1 == len(rows)
            place = slice(rows[0] * s, (rows[-1] + 1) * s) if run else (rows[:, None] * s + np.arange(s)).ravel()
            self._draw(rows, [s] * len(rows), place)
        elif fired.any():
            self._draw(rows, fired.sum(axis=1).tolist(), (rows[:, None] * s + np.arange(s))[fired])
        step_kernel.observe(rows, self.worlds, self.rules)

    def _draw(self, rows: Ints, each: Sequence[int], place: slice | Ints) -> None:
        pings = self.worlds.last_pings.reshape(-1, step_kernel.COLUMNS)
        met = np.ascontiguousarray(pings[place, : step_kernel.SENT + 1].T)
        seen = met[step_kernel.OBJECT] >= 0.0
        run = np.arange(place.start, place.stop) if isinstance(place, slice) else place
        distance, angle, incidence, reflectance = met[: step_kernel.OBJECT]
        distance = np.where(seen, distance, EMPTY_M)
        ping = Ping(distance, angle, incidence, reflectance, met[step_kernel.SENT], run)
        drawn = self.sonar.draw(ping, rows, each, place)
        pings[place, step_kernel.RANGE], pings[place, step_kernel.STATUS] = drawn.reading.range, drawn.reading.status
        if drawn.credence_given_condition is not None:
            pings[place, step_kernel.GIVEN_CONDITION] = np.where(seen, drawn.credence_given_condition, 0.0)
        if drawn.fault is not None:
            pings[place, step_kernel.FAULT] = drawn.fault

    # ---- streets -----------------------------------------------------------------------------------------------------

    def street_for(self, rng: np.random.Generator, options: Mapping[str, Any] | None = None) -> Street:
        """Return the street of a new episode.

        Args:
            rng: generator of everything that the options do not fix.
            options: `difficulty`, the name of a level; `street`, a mapping of fields of `StreetSettings`, a
                `StreetSettings` or a `Street`; `boxes`, see `street_of`; `start`, x, y, heading of the car in m, m,
                rad.
        """
        options = options or {}
        for name in options:
            if name not in OPTIONS:
                raise SettingError(f"reset option {name!r}: no such option; expected {', '.join(OPTIONS)}")
        given = options.get("street")
        street = given if isinstance(given, Street) else self._street_of(options, given, rng)
        if "start" not in options:
            return street
        start = np.array(options["start"], dtype=np.float64)
        if start.shape != (3,) or not np.all(np.isfinite(start)):
            raise SettingError(f"reset option 'start' must be x, y, heading in m, m, rad, got {options['start']}")
        return replace(street, start=start)

    def _street_of(self, options: Mapping[str, Any], given: Any, rng: np.random.Generator) -> Street:
        settings = street_settings(options["difficulty"]) if "difficulty" in options else self.street_settings
        settings = replace(settings, **given) if isinstance(given, Mapping) else (given or settings)
        return street_of(settings, options["boxes"]) if "boxes" in options else draw_street(settings, rng)

    def _place_street(self, row: int, street: Street) -> None:
        """Write a street, and a car at its start, to a row."""
        scene, goal = street.scene, Goal.of(street, self.car_settings)
        faces = len(scene.segments)
        if faces > self.worlds.owner.shape[1]:
            self._make_room(faces)
        worlds, self.streets[row] = self.worlds, street
        worlds.counts[row], worlds.owner[row, :faces] = faces, scene.owner
        worlds.segments[row, :faces], worlds.surface[row, :faces] = scene.segments, scene.surface
        worlds.car[row] = (*street.start, 0.0, 0.0)
        worlds.task[row] = (*street.gap, street.line, goal.x, goal.y, goal.turn, goal.ready_x, 0.0)

    # ---- results -----------------------------------------------------------------------------------------------------

    def observation(self, which: int | slice | Ints) -> Observation:
        """Return the observations of one world, each (s,) or (7,), or of several worlds, each (r, s) or (r, 7)."""
        return {name: getattr(self.worlds, name)[which].copy() for name in (*SONAR_KEYS, "ego")}

    def truth(self, which: int | slice | Ints) -> dict[str, Any]:
        """Return the hidden truth of one world or of several, including the conditions behind the readings."""
        w = self.worlds
        observed, ended = w.observed[which], w.ended[which].copy()
        pings = observed.transpose(observed.ndim - 1, *range(observed.ndim - 1)).copy()
        out = {
            "is_success": ended[..., step_kernel.PARKED],
            "collision": ended[..., step_kernel.COLLISION],
            "left_street": ended[..., step_kernel.LEFT_STREET],
            "distance": pings[step_kernel.DISTANCE],
            "bearing": pings[step_kernel.BEARING],
            "incidence": pings[step_kernel.INCIDENCE],
            "reflectance": pings[step_kernel.REFLECTANCE],
            "in_cone": pings[step_kernel.OBJECT] >= 0.0,
            "cause": w.cause[which].copy(),
            "reward_terms": dict(zip(TERMS, w.terms[which].copy().T, strict=True)),
        }
        if self.sonar.has_credence:
            out["credence_given_condition"] = pings[step_kernel.GIVEN_CONDITION]
        return out

    def close(self) -> None:
        """Shut the threads down. Later steps run in the calling thread."""
        if self._pool is not None:
            self._pool.shutdown()
            self._pool = None

    def view(self, row: int) -> WorldView:
        """Return a view of one world whose episode has begun."""
        street = self.streets[row]
        assert street is not None
        return WorldView(self.worlds, row, street, self.mounts, self.car_settings, self.sonar_name, self.causes)
