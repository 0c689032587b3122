"""A fleet: n cars, each in a street of its own, as arrays. The single environment is a fleet of one.

World number i is row i of every array and has two random streams of its own, one for its streets and one for its
sonars; so it says the same alone as among a thousand.
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
from sonar_gym.parking.step_kernel import Rules, Worlds
from sonar_gym.parking.street import (
    BEHIND,
    Goal,
    Street,
    StreetSettings,
    arc_table,
    draw_street,
    street_of,
    street_settings,
)
from sonar_gym.parking.vehicle import CarSettings
from sonar_gym.parking.world import World
from sonar_gym.sensing.mounts import Layout, layout, mount_arrays, timing_array
from sonar_gym.sensing.odometry import Odometer, OdometryChoice
from sonar_gym.sensing.odometry import odometry as odometry_settings
from sonar_gym.sensing.scene import EMPTY_M
from sonar_gym.sensing.sonar import Sonar, SonarChoice, resolve, sonar_spaces

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Observation = dict[str, NDArray[np.float32]]
STEP_S = 0.1  # s; the SRF08 ranges in 65 ms, all of them at once after a general call (Devantech)
MAX_RANGE = 3.01  # m; SRF08 with range register 69: (69 + 1) * 43 mm
MAX_STEPS = 400  # of an episode, by the time limit that `gymnasium.make` and `make_vec` set
ODOMETRY_SPAN = (10.0, 2.0)  # m; odometry along and across the start's heading is given as shares of these
PARKED_ANGLE = np.radians(10.0)
PARKED_SPEED = 0.03  # m/s
PARKED_OVERHANG = 0.02  # m; how far a parked body may stand out over the strip's line
THREAD_ROWS = 64  # worlds below which a thread costs more than it brings
EGO = 7  # numbers in `ego`
TERMS = ("progress", "time", "parked", "crashed")
HEARD = ("ranges", "credence", "echo", "age")
OPTIONS = ("difficulty", "street", "boxes", "start")


@dataclass(frozen=True)
class RewardWeights:
    """What each term of the reward is worth.

    Attributes:
        progress: per metre by which the cost to go along a reference path falls.
        time: per step.
        parked: once, for standing in the gap.
        crashed: once, for touching anything or leaving the street.
        off_path: price of a metre off the reference path, in metres of cost to go.
        off_heading: price of a radian off its heading, in metres of cost to go.
    """

    progress: float = 1.0
    time: float = -0.01
    parked: float = 10.0
    crashed: float = -10.0
    off_path: float = 3.0
    off_heading: float = 0.5


def given_or(cls: type, given: Any) -> Any:
    """Return settings as they are, from a mapping of fields, or with their defaults."""
    if given is None:
        return cls()
    return cls(**given) if isinstance(given, Mapping) else given


def _faces(n: int, faces: int) -> dict[str, Any]:
    """Return room for so many faces in each of n streets."""
    return {
        "segments": np.zeros((n, faces, 4)),
        "surface": np.zeros((n, faces, 2)),
        "owner": np.zeros((n, faces), dtype=np.int64),
    }


class Fleet:
    """n worlds.

    Args:
        count: of worlds.
        sonar: name, path or model, shared by all.
        sonar_layout: mounts on each car.
        difficulty: name of a level of `street.LEVELS`.
        street: what each episode's street is drawn from; a mapping replaces fields of the level's.
        car, reward: settings, or mappings of their fields.
        odometry: how far off the cars' knowledge of their way is.
        threads: that share the work.
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
        self.car_settings: CarSettings = given_or(CarSettings, car)
        self.reward_weights: RewardWeights = given_or(RewardWeights, reward)
        model = resolve(sonar)
        tables = street_credence(model, self.street_settings, self.car_settings, self.mounts, MAX_RANGE)
        self.sonar = Sonar(model, len(self.mounts), MAX_RANGE, tables=tables, copies=count)
        self.odometer = Odometer(odometry_settings(odometry), count)
        named = isinstance(sonar, (str, os.PathLike))
        self.sonar_name = Path(str(sonar)).name if named else type(model).__name__
        parallel = threads > 1 and (count == 1 or self.sonar.at_once)
        self._pool = ThreadPoolExecutor(threads) if parallel else None
        self._threads = threads if parallel else 1
        self._make_arrays(count, len(self.mounts))
        self.rules = self._rules()

    def _make_arrays(self, n: int, s: int) -> None:
        self.streets: list[Street | None] = [None] * n
        singles: dict[str, Any] = {name: np.zeros((n, s), dtype=np.float32) for name in HEARD}
        self.worlds = Worlds(
            steps=np.full(n, -1, dtype=np.int64),
            car=np.zeros((n, 5)),
            kept=self.odometer.kept,
            task=np.zeros((n, step_kernel.TASK)),
            counts=np.zeros(n, dtype=np.int64),
            **_faces(n, 4 * (self.street_settings.decoys[1] + 2) + 3),
            flying=np.zeros((n, s, step_kernel.COLUMNS)),
            fired=np.zeros((n, s), dtype=np.bool_),
            in_flight=np.zeros((n, s), dtype=np.bool_),
            shown=np.zeros((n, s, step_kernel.COLUMNS)),
            terms=np.zeros((n, len(TERMS))),
            ended=np.zeros((n, 3), dtype=np.bool_),
            ego=np.zeros((n, EGO), dtype=np.float32),
            cause=np.zeros((n, s), dtype=np.int64),
            **singles,
        )

    def _make_room(self, faces: int) -> None:
        """Make room for so many faces in each street, and keep those that are there."""
        wider = _faces(self.count, faces)
        for name, new in wider.items():
            old = getattr(self.worlds, name)
            new[:, : old.shape[1]] = old
        self.worlds = self.worlds._replace(**wider)

    def _rules(self) -> Rules:
        car, (mounts, half) = self.car_settings, mount_arrays(self.mounts)
        return Rules(
            measures=car.dynamics,
            body=car.body,
            mounts=mounts,
            half=half,
            timing=timing_array(self.mounts, STEP_S),
            arc=arc_table(car),
            weights=np.array(astuple(self.reward_weights)),
            share=np.array([car.max_speed, car.max_steering, *ODOMETRY_SPAN, MAX_STEPS]),
            limits=np.array([PARKED_SPEED, PARKED_ANGLE, PARKED_OVERHANG, -BEHIND]),
            edges=self.sonar.edges,
            tables=self.sonar.tables,
            dt=STEP_S,
            far=MAX_RANGE,
        )

    @property
    def observation_space(self) -> spaces.Dict:
        """Of one world."""
        n = len(self.mounts)
        own = {"age": spaces.Box(0.0, 1.0, (n,), np.float32), "ego": spaces.Box(-1.0, 1.0, (EGO,), np.float32)}
        return spaces.Dict({**sonar_spaces(n), **own})

    @property
    def action_space(self) -> spaces.Box:
        """Of one world."""
        return spaces.Box(-1.0, 1.0, (2,), np.float32)

    @property
    def causes(self) -> tuple[str, ...]:
        """Names of the causes of readings, by number."""
        return (*step_kernel.CAUSES, *self.sonar.causes)

    # ---- what happens ------------------------------------------------------------------------------------------------

    def seed(self, seed: int, row: int = 0) -> None:
        """Start the streams of a world's sonars and odometer anew; that of its streets is the caller's."""
        self.sonar.seed(seed, row)
        self.odometer.seed(seed, row)

    def reset(self, rows: Ints, rngs: Sequence[np.random.Generator], options: Mapping[str, Any] | None = None) -> None:
        """Begin new episodes in some worlds: draw a street from each one's generator, stand at its beginning, listen.

        Args:
            rows: which worlds.
            rngs: one for each of them.
            options: of `street_for`.
        """
        for row, rng in zip(rows, rngs, strict=True):
            self._lay(int(row), self.street_for(rng, options))
        self.sonar.forget(rows)
        self.odometer.begin(rows)
        step_kernel.begin(rows, self.worlds, self.rules)
        self._hear(rows)

    def step(self, rows: Ints, wanted: Floats) -> None:
        """Drive some worlds' cars for 0.1 s, then listen.

        Args:
            rows: which worlds, increasing, (r,).
            wanted: steering and speed as shares of the greatest, within -1..1, (r, 2).
        """
        self.odometer.slip(rows)
        if self._pool is None or len(rows) < THREAD_ROWS * self._threads:
            self._step(rows, wanted)
        else:
            parts = np.array_split(rows, self._threads), np.array_split(wanted, self._threads)
            list(self._pool.map(self._step, *parts))

    def _step(self, rows: Ints, wanted: Floats) -> None:
        step_kernel.advance(rows, wanted, self.worlds, self.rules)
        self._hear(rows)

    def _hear(self, rows: Ints) -> None:
        """Draw what the sonars say that have fired, and show what has come in."""
        fired, s = self.worlds.fired[rows], len(self.mounts)
        if fired.all():
            run = rows[-1] - rows[0] + 1 == len(rows)
            place = slice(rows[0] * s, (rows[-1] + 1) * s) if run else (rows[:, None] * s + np.arange(s)).ravel()
            self._draw(rows, [s] * len(rows), place)
        elif fired.any():
            self._draw(rows, fired.sum(axis=1).tolist(), (rows[:, None] * s + np.arange(s))[fired])
        step_kernel.tell(rows, self.worlds, self.rules)

    def _draw(self, rows: Ints, each: Sequence[int], place: slice | Ints) -> None:
        pings = self.worlds.flying.reshape(-1, step_kernel.COLUMNS)
        met = np.ascontiguousarray(pings[place, : step_kernel.SENT + 1].T)
        seen = met[step_kernel.THING] >= 0.0
        run = np.arange(place.start, place.stop) if isinstance(place, slice) else place
        distance, angle, incidence, reflectance = met[: step_kernel.THING]
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
            rng: it is drawn from.
            options: where something is to be fixed: `difficulty`, a level's name; `street`, a mapping of fields of
                `StreetSettings`, those whole, or a `Street`; `boxes`, as of `street_of`; `start`, the car's x, y,
                heading in m, m, rad.
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

    def _lay(self, row: int, street: Street) -> None:
        """Put a street and a car at its beginning into a row."""
        scene, goal = street.scene, Goal.of(street, self.car_settings)
        faces = len(scene.segments)
        if faces > self.worlds.owner.shape[1]:
            self._make_room(faces)
        worlds, self.streets[row] = self.worlds, street
        worlds.counts[row], worlds.owner[row, :faces] = faces, scene.owner
        worlds.segments[row, :faces], worlds.surface[row, :faces] = scene.segments, scene.surface
        worlds.car[row] = (*street.start, 0.0, 0.0)
        worlds.task[row] = (*street.gap, street.line, goal.x, goal.y, goal.turn, goal.ready_x, 0.0)

    # ---- what comes out ----------------------------------------------------------------------------------------------

    def observation(self, which: int | slice | Ints) -> Observation:
        """Return what cars can know: of one world, each (s,) or (7,), or of several, each (r, s) or (r, 7)."""
        return {name: getattr(self.worlds, name)[which].copy() for name in (*HEARD, "ego")}

    def truth(self, which: int | slice | Ints) -> dict[str, Any]:
        """Return what cars cannot know, of one world or of several: of each reading shown, the ping it answers."""
        w = self.worlds
        shown, ended = w.shown[which], w.ended[which].copy()
        pings = shown.transpose(shown.ndim - 1, *range(shown.ndim - 1)).copy()
        out = {
            "is_success": ended[..., step_kernel.PARKED],
            "collision": ended[..., step_kernel.COLLISION],
            "left_street": ended[..., step_kernel.LEFT_STREET],
            "distance": pings[step_kernel.DISTANCE],
            "bearing": pings[step_kernel.BEARING],
            "incidence": pings[step_kernel.INCIDENCE],
            "reflectance": pings[step_kernel.REFLECTANCE],
            "in_cone": pings[step_kernel.THING] >= 0.0,
            "cause": w.cause[which].copy(),
            "reward_terms": dict(zip(TERMS, w.terms[which].copy().T, strict=True)),
        }
        if self.sonar.has_credence:
            out["credence_given_condition"] = pings[step_kernel.GIVEN_CONDITION]
        return out

    def close(self) -> None:
        """Let the threads go; what is asked afterwards is done without them."""
        if self._pool is not None:
            self._pool.shutdown()
            self._pool = None

    def world(self, row: int) -> World:
        """Return one world as a picture wants it."""
        return World(self, row)
