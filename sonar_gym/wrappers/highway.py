"""Sonars for highway-env: cones cast on its vehicles and obstacles, in the frame of each sensor.

In highway-env y points down and headings are clockwise; here y points up, so the left of the vehicle is on the left.
Its own `LidarObservation` ignores objects whose centre is far away, even long walls; these cones do not.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium import spaces

from acquisition import SettingError
from acquisition.arrays import Floats, Ints
from noise import CredenceTable, SonarModel
from sonar_gym.sensing import kernels
from sonar_gym.sensing.mounts import Mount, in_world, layout, mount_arrays
from sonar_gym.sensing.scene import box_faces
from sonar_gym.sensing.sonar import broad_table
from sonar_gym.sensing.timing import PingConditions, Times
from sonar_gym.wrappers.settings import DEFAULT_MAX_RANGE, SonarSettings
from sonar_gym.wrappers.sources import Generators

BASE = "base"  # key of the retained observation, if it is not a Dict
EGO_FIRST_TYPES = ("Kinematics", "ExitObservation")  # observations whose first row is the controlled vehicle
EGO_ONLY_TYPES = ("KinematicsGoal", "AttributesObservation")  # observations of the controlled vehicle alone
REFLECTANCE = (0.1, 0.9)  # of an object, drawn once per episode; the range of Esmi (2016)

# Relative to the centre of a car 5 m long and 2 m wide, as ultrasonic parking aids are mounted: four per bumper.
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


def pose_of(thing: Any) -> Floats:
    """Return x, y, heading of an object of highway-env with y up and anticlockwise headings: m, m, rad, (3,)."""
    return np.array([thing.position[0], -thing.position[1], -thing.heading], dtype=np.float64)


def is_road(base: Any) -> bool:
    """Return whether an environment belongs to highway-env."""
    return hasattr(base, "road") and hasattr(base, "vehicle")


def solid_things(road: Any, ego: Any) -> list[Any]:
    """Return the solid objects on a road, without the controlled vehicle."""
    return [thing for thing in [*road.vehicles, *road.objects] if thing.solid and thing is not ego]


def boxes_of(things: Sequence[Any]) -> Floats:
    """Return objects of highway-env as input of `box_faces`: centre x and y, length, width, heading, (b, 5)."""
    rows = [(t.position[0], -t.position[1], t.LENGTH, t.WIDTH, -t.heading) for t in things]
    return np.array(rows, dtype=np.float64).reshape(-1, 5)


class RoadSource:
    """Conditions from the solid objects on a road of highway-env.

    Args:
        base: the environment.
        space: its observation space, after any inner wrappers.
        settings: layout, scale, range and times of the sonars, and the part of the observation to retain.
    """

    def __init__(self, base: Any, space: spaces.Space[Any], settings: SonarSettings) -> None:
        if isinstance(space, spaces.Tuple):
            raise SettingError("SonarObservation supports one vehicle, but this environment observes several")
        self.base, self.scale = base, settings.metres_per_unit
        self.max_range = settings.max_range or DEFAULT_MAX_RANGE
        self.mounts = layout(ROAD_LAYOUT if settings.sonar_layout is None else settings.sonar_layout)
        self.count, self.step_s = len(self.mounts), settings.step_s or 1.0 / base.config["policy_frequency"]
        period, phase, latency = np.array([[m.period_s, m.phase_s, m.latency_s] for m in self.mounts]).T
        timed = bool(period.any() or latency.any())
        self.times: Times = (period, phase, latency) if timed else settings.times
        self._poses, self._half = mount_arrays(self.mounts)
        self._reflectance: dict[int, tuple[Any, float]] = {}  # by id; the reference keeps the id from being reused
        self._filter = RetainedObservation(base, space, settings.keep)
        self.retained_spaces = self._filter.spaces

    def tables(self, model: SonarModel) -> Sequence[CredenceTable]:
        """Return the credence given a reading under the broad prior, one table per sonar."""
        return [broad_table(model, self.max_range)] * self.count

    def begin(self, rows: Ints, observation: Any, info: Mapping[str, Any], rngs: Generators) -> None:
        """Begin an episode with new reflectances."""
        self._reflectance.clear()

    def conditions(self, rows: Ints, observation: Any, info: Mapping[str, Any], rngs: Generators) -> PingConditions:
        """Cast the cones on the current road."""
        ego, limit = pose_of(self.base.vehicle), self.max_range / self.scale
        things = solid_things(self.base.road, self.base.vehicle)
        boxes = boxes_of(things)
        reach = limit + np.hypot(self._poses[:, 0], self._poses[:, 1]).max() + 0.5 * np.hypot(boxes[:, 2], boxes[:, 3])
        near = np.flatnonzero(np.hypot(boxes[:, 0] - ego[0], boxes[:, 1] - ego[1]) <= reach)
        cones = in_world(self._poses, ego), self._half
        distance, bearing, incidence, face, _ = kernels.cast_cones(*cones, box_faces(boxes[near]), limit)
        material = np.array([*(self._reflectance_of(things[k], rngs[0]) for k in near), 0.0])
        reflectance = material[np.where(face >= 0, face // 4, -1)]
        return PingConditions(
            distance[None] * self.scale, bearing[None], incidence[None], reflectance[None], (face >= 0)[None]
        )

    def _reflectance_of(self, thing: Any, rng: np.random.Generator) -> float:
        """Return the reflectance of an object, drawn at its first use in the episode."""
        if id(thing) not in self._reflectance:
            self._reflectance[id(thing)] = (thing, float(rng.uniform(*REFLECTANCE)))
        return self._reflectance[id(thing)][1]

    def retained(self, observation: Any) -> dict[str, Any]:
        """Return the retained part of the observation."""
        return self._filter.of(observation)


class RetainedObservation:
    """The part of an observation that is retained when sonars replace the knowledge of other objects.

    With `keep="own"`: of `Kinematics` and its variants the first row, which is the controlled vehicle, as a vector; of
    `KinematicsGoal` and `AttributesObservation` everything; of any other type, such as `LidarObservation`, nothing.

    Args:
        base: the environment.
        space: its observation space.
        keep: "own", "all" or "nothing".
    """

    def __init__(self, base: Any, space: spaces.Space[Any], keep: str) -> None:
        kind = base.config["observation"]["type"]
        self._first_row = keep == "own" and kind in EGO_FIRST_TYPES
        self._all = keep == "all" or (keep == "own" and kind in EGO_ONLY_TYPES)
        self.spaces = self._spaces(space)

    def _spaces(self, space: spaces.Space[Any]) -> dict[str, spaces.Space[Any]]:
        if self._first_row and isinstance(space, spaces.Box):
            return {BASE: spaces.Box(space.low[0], space.high[0], dtype=space.dtype.type)}
        if not self._all:
            return {}
        return dict(space.spaces) if isinstance(space, spaces.Dict) else {BASE: space}

    def of(self, observation: Any) -> dict[str, Any]:
        """Return the retained part of an observation."""
        if self._first_row:
            return {BASE: observation[0]}
        if not self._all:
            return {}
        return dict(observation) if isinstance(observation, dict) else {BASE: observation}
