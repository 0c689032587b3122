"""Sonars for highway-env: cones cast on its vehicles and obstacles, in the frame of each sensor.

highway-env has x to the right and y *down* the picture, headings clockwise; here y is turned up, so left is left.
Its own `LidarObservation` skips things whose centre is far away, however long they are; these cones do not.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from acquisition import SettingError
from noise import CredenceTable, SonarModel
from sonar_gym.sensing import kernels
from sonar_gym.sensing.mounts import Mount, in_world, layout, mount_arrays
from sonar_gym.sensing.scene import box_faces
from sonar_gym.sensing.sonar import broad_table
from sonar_gym.sensing.timing import Met, Times
from sonar_gym.wrappers.settings import USUAL_RANGE, Hearing
from sonar_gym.wrappers.sources import Generators, Ints

Floats = NDArray[np.float64]
BASE = "base"  # where the environment's own observation goes, when it is no Dict
ROWS = ("Kinematics", "ExitObservation")  # observations whose first row is the vehicle's own
ALONE = ("KinematicsGoal", "AttributesObservation")  # those that tell of the vehicle alone
REFLECTANCE = (0.1, 0.9)  # of a thing, drawn once an episode; the range of Esmi (2016)

# Around a car 5 m long and 2 m wide, about its centre, as ultrasonic parking aids sit: four to a bumper.
ROAD_LAYOUT: tuple[Mount, ...] = (
    Mount("front left", 2.3, 0.95, 50.0),
    Mount("front centre left", 2.5, 0.4, 8.0),
    Mount("front centre right", 2.5, -0.4, -8.0),
    Mount("front right", 2.3, -0.95, -50.0),
    Mount("rear right", -2.3, -0.95, -130.0),
    Mount("rear centre right", -2.5, -0.4, -172.0),
    Mount("rear centre left", -2.5, 0.4, 172.0),
    Mount("rear left", -2.3, 0.95, 130.0),
)


def upright(thing: Any) -> Floats:
    """Return x, y, heading of a thing of highway-env with y upwards and headings anticlockwise: m, m, rad, (3,)."""
    return np.array([thing.position[0], -thing.position[1], -thing.heading], dtype=np.float64)


def is_road(base: Any) -> bool:
    """Return whether an environment is one of highway-env's."""
    return hasattr(base, "road") and hasattr(base, "vehicle")


def solid_things(road: Any, own: Any) -> list[Any]:
    """Return what can be run into on a road, the own vehicle left out."""
    return [thing for thing in [*road.vehicles, *road.objects] if thing.solid and thing is not own]


def places(things: Sequence[Any]) -> Floats:
    """Return things of highway-env as `box_faces` wants them: centre x and y, length, width, heading, (b, 5)."""
    rows = [(t.position[0], -t.position[1], t.LENGTH, t.WIDTH, -t.heading) for t in things]
    return np.array(rows, dtype=np.float64).reshape(-1, 5)


class RoadSource:
    """What can be run into on a road of highway-env.

    Args:
        base: the environment.
        space: its observation space, as far as wrappers inside have left it.
        hearing: layout, scale, range and times of the sonars, and what is kept of the observation.
    """

    def __init__(self, base: Any, space: spaces.Space[Any], hearing: Hearing) -> None:
        if isinstance(space, spaces.Tuple):
            raise SettingError("SonarObservation listens for one vehicle, and this environment observes several")
        self.base, self.scale = base, hearing.metres_per_unit
        self.max_range = hearing.max_range or USUAL_RANGE
        self.mounts = layout(ROAD_LAYOUT if hearing.sonar_layout is None else hearing.sonar_layout)
        self.count, self.step_s = len(self.mounts), hearing.step_s or 1.0 / base.config["policy_frequency"]
        period, phase, latency = np.array([[m.period_s, m.phase_s, m.latency_s] for m in self.mounts]).T
        timed = bool(period.any() or latency.any())
        self.times: Times = (period, phase, latency) if timed else hearing.times
        self._poses, self._half = mount_arrays(self.mounts)
        self._reflectance: dict[int, tuple[Any, float]] = {}  # by id; the thing is kept, so no other can take its id
        self._kept = Kept(base, space, hearing.keep)
        self.kept = self._kept.spaces

    def tables(self, model: SonarModel) -> Sequence[CredenceTable]:
        """Return the credence given a reading, where anything may be anywhere in a cone."""
        return [broad_table(model, self.max_range)] * self.count

    def begin(self, rows: Ints, observation: Any, info: Mapping[str, Any], rngs: Generators) -> None:
        """Begin an episode: things are of another material."""
        self._reflectance.clear()

    def meet(self, rows: Ints, observation: Any, info: Mapping[str, Any], rngs: Generators) -> Met:
        """Cast the cones on the road as it is now."""
        own, limit = upright(self.base.vehicle), self.max_range / self.scale
        things = solid_things(self.base.road, self.base.vehicle)
        at = places(things)
        reach = limit + np.hypot(self._poses[:, 0], self._poses[:, 1]).max() + 0.5 * np.hypot(at[:, 2], at[:, 3])
        near = np.flatnonzero(np.hypot(at[:, 0] - own[0], at[:, 1] - own[1]) <= reach)
        cones = in_world(self._poses, own), self._half
        distance, bearing, incidence, face, _ = kernels.cast_cones(*cones, box_faces(at[near]), limit)
        material = np.array([*(self._material(things[k], rngs[0]) for k in near), 0.0])
        reflectance = material[np.where(face >= 0, face // 4, -1)]
        return Met(distance[None] * self.scale, bearing[None], incidence[None], reflectance[None], (face >= 0)[None])

    def _material(self, thing: Any, rng: np.random.Generator) -> float:
        """Return a thing's reflectance: that with which it was met first in the episode."""
        if id(thing) not in self._reflectance:
            self._reflectance[id(thing)] = (thing, float(rng.uniform(*REFLECTANCE)))
        return self._reflectance[id(thing)][1]

    def rest(self, observation: Any) -> dict[str, Any]:
        """Return what is kept of the observation."""
        return self._kept.of(observation)


class Kept:
    """What a vehicle may still know of an observation, once sonars tell it where other things are.

    Of `Kinematics` and what is built on it the first row, the vehicle's own, as a vector; of `KinematicsGoal` and
    `AttributesObservation`, which tell of the vehicle alone, all; of anything else, as `LidarObservation`, nothing.

    Args:
        base: the environment.
        space: of what is observed.
        keep: "own", "all" or "nothing".
    """

    def __init__(self, base: Any, space: spaces.Space[Any], keep: str) -> None:
        kind = base.config["observation"]["type"]
        self._row = keep == "own" and kind in ROWS
        self._all = keep == "all" or (keep == "own" and kind in ALONE)
        self.spaces = self._spaces(space)

    def _spaces(self, space: spaces.Space[Any]) -> dict[str, spaces.Space[Any]]:
        if self._row and isinstance(space, spaces.Box):
            return {BASE: spaces.Box(space.low[0], space.high[0], dtype=space.dtype.type)}
        if not self._all:
            return {}
        return dict(space.spaces) if isinstance(space, spaces.Dict) else {BASE: space}

    def of(self, observation: Any) -> dict[str, Any]:
        """Return what is kept."""
        if self._row:
            return {BASE: observation[0]}
        if not self._all:
            return {}
        return dict(observation) if isinstance(observation, dict) else {BASE: observation}
