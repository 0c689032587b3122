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
from noise import SonarModel
from sonar_gym.sensing.crosstalk import Surroundings, add_crosstalk
from sonar_gym.sensing.detection import detection_table, has_beam, listening_table
from sonar_gym.sensing.mounts import Mount, in_world, layout, mount_arrays, times_of
from sonar_gym.sensing.paths import MAX_PATHS, N_PATH, cast_paths
from sonar_gym.sensing.records import PingArrays
from sonar_gym.sensing.scene import box_faces
from sonar_gym.sensing.sonar import broad_table
from sonar_gym.sensing.timing import Times
from sonar_gym.wrappers.settings import DEFAULT_MAX_RANGE, SonarSettings
from sonar_gym.wrappers.sources import Generators, Paths

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
        model: model of the sonars, which decides on the paths worth a law.
        settings: layout, scale, range and times of the sonars, and the part of the observation to retain.
    """

    def __init__(self, base: Any, space: spaces.Space[Any], settings: SonarSettings, model: SonarModel) -> None:
        if isinstance(space, spaces.Tuple):
            raise SettingError("SonarObservation supports one vehicle, but this environment observes several")
        self.base, self.scale = base, settings.metres_per_unit
        self.max_range = settings.max_range or DEFAULT_MAX_RANGE
        self.mounts = layout(ROAD_LAYOUT if settings.sonar_layout is None else settings.sonar_layout)
        self.names = tuple(mount.name for mount in self.mounts)
        self.step_s = settings.step_s or 1.0 / base.config["policy_frequency"]
        timed = any(mount.period_s or mount.latency_s is not None for mount in self.mounts)
        self.times: Times = times_of(self.mounts) if timed else settings.times
        self._detection = detection_table(model, self.max_range)
        self._crosstalk = settings.crosstalk and has_beam(self._detection)
        self._listening = listening_table(model) if self._crosstalk else self._detection
        self._poses, self._half = mount_arrays(self.mounts)
        self._reflectance: dict[int, tuple[Any, float]] = {}  # by id; the reference keeps the id from being reused
        self._filter = RetainedObservation(base, space, settings.keep)
        self.retained_spaces = self._filter.spaces

    def tables(self, model: SonarModel) -> Floats:
        """Return the credence given a reading under the broad prior, for each sonar, (s, BINS)."""
        return np.tile(broad_table(model, self.max_range).values, (len(self.mounts), 1))

    def begin(self, rows: Ints, observation: Any, info: Mapping[str, Any], rngs: Generators) -> None:
        """Begin an episode with new reflectances."""
        self._reflectance.clear()

    def paths(self, rows: Ints, observation: Any, info: Mapping[str, Any], rngs: Generators) -> Paths:
        """Cast the cones on the current road, in metres of the sonar."""
        ego = pose_of(self.base.vehicle)
        things = solid_things(self.base.road, self.base.vehicle)
        boxes = boxes_of(things)
        limit = self.max_range / self.scale
        reach = limit + np.hypot(self._poses[:, 0], self._poses[:, 1]).max() + 0.5 * np.hypot(boxes[:, 2], boxes[:, 3])
        near = np.flatnonzero(np.hypot(boxes[:, 0] - ego[0], boxes[:, 1] - ego[1]) <= reach)
        surface = np.array([[self._reflectance_of(things[k], rngs[0]), 0.0] for k in near]).reshape(-1, 2)
        poses = in_world(self._poses, ego) * [self.scale, self.scale, 1.0]
        out, counts = np.zeros((len(poses), MAX_PATHS, N_PATH)), np.empty(len(poses), np.int64)
        faces = self.scale * box_faces(boxes[near]), np.repeat(surface, 4, axis=0), np.repeat(near, 4)
        self._seen = poses, faces
        for i, pose in enumerate(poses):
            x, y, heading = pose
            counts[i] = cast_paths(x, y, heading, self._half[i], *faces, self.max_range, self._detection, out[i])
        return Paths(out[None], counts[None])

    def hear_others(self, pings: PingArrays) -> None:
        """Add the paths of other sonars' bursts to pings that were sent, by the faces at the last observation."""
        if self._crosstalk:
            poses, faces = self._seen
            p, around = pings, Surroundings(*faces, self.max_range, self._detection, self._listening)
            add_crosstalk(poses, p.fired[0], p.sent[0], p.before[0], around, p.paths[0], p.n_paths[0])

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
