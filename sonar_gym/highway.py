"""Sonars for highway-env: cones cast on its vehicles and obstacles, in the frame of each sensor.

highway-env has x to the right and y *down* the picture, headings clockwise; here y is turned up, so left is left.
Its own `LidarObservation` skips things whose centre is far away, however long they are; these cones do not.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.utils import RecordConstructorArgs
from numpy.typing import NDArray

from acquisition import SettingError
from sonar_gym.mounts import Layout, Mount, in_world, layout, mount_arrays
from sonar_gym.scene import Box, Hits, Scene
from sonar_gym.sonar import Sonar, SonarChoice, sonar_spaces
from sonar_gym.wrappers import WRAPPER_TAG, plain

Floats = NDArray[np.float64]
BASE = "base"  # where the environment's own observation goes, when it is no Dict
ROAD_MAX_RANGE = 6.0  # m; what an SRF08 is good for
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


def solid_things(road: Any, own: Any) -> list[Any]:
    """Return what can be run into on a road, the own vehicle left out."""
    return [thing for thing in [*road.vehicles, *road.objects] if thing.solid and thing is not own]


def box_of(thing: Any, reflectance: float) -> Box:
    """Return a thing of highway-env as a box."""
    x, y, heading = upright(thing)
    return Box(float(x), float(y), float(thing.LENGTH), float(thing.WIDTH), float(heading), reflectance)


class HighwaySonar(gymnasium.Wrapper, RecordConstructorArgs):
    """Adds sonars to an environment of highway-env.

    The new observation is a `Dict`: `ranges`, `credence`, `echo` as of `SonarObservation`, and the environment's own
    observation: its keys where it is a `Dict`, else under `base`. `info["sonar"]` holds the truth of each cone.

    Args:
        env: of highway-env.
        sonar: name, path or model.
        sonar_layout: mounts about the vehicle's centre, or mappings of their fields.
        max_range: the sonars' greatest range, m.

    >>> import gymnasium, highway_env
    >>> env = HighwaySonar(gymnasium.make("parking-v0"), "gaussian")
    >>> env.reset(seed=0)[0]["ranges"].shape
    (8,)
    """

    def __init__(
        self,
        env: gymnasium.Env,
        sonar: SonarChoice = "ideal",
        *,
        sonar_layout: Layout = ROAD_LAYOUT,
        max_range: float = ROAD_MAX_RANGE,
    ) -> None:
        mounts = layout(sonar_layout)
        RecordConstructorArgs.__init__(
            self,
            _disable_deepcopy=True,
            sonar=plain(sonar),
            sonar_layout=[vars(mount) for mount in mounts],
            max_range=max_range,
        )
        gymnasium.Wrapper.__init__(self, env)
        base: Any = env.unwrapped
        if not hasattr(base, "road") or not hasattr(base, "vehicle"):
            raise SettingError(f"HighwaySonar needs an environment of highway-env, got {type(base).__name__}")
        if not max_range > 0.0:
            raise SettingError(f"HighwaySonar.max_range must be > 0 m, got {max_range:g} m")
        self.mounts, self.max_range = mounts, max_range
        self._poses, self._half = mount_arrays(mounts)
        self.sonar = Sonar(sonar, len(mounts), max_range, WRAPPER_TAG)
        inner = env.observation_space
        own = dict(inner.spaces) if isinstance(inner, spaces.Dict) else {BASE: inner}
        self.observation_space = spaces.Dict({**own, **sonar_spaces(len(mounts))})
        self._reflectance: dict[int, tuple[Any, float]] = {}  # by id; the thing is kept, so no other can take its id
        self._steps = 0

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Forget previous readings and materials, reset the environment, and listen."""
        self.sonar.forget()
        if seed is not None:
            self.sonar.seed(seed)
        self._reflectance.clear()
        self._steps = 0
        return self._with_sonar(*self.env.reset(seed=seed, options=options))

    def step(self, action: Any) -> tuple[dict[str, Any], Any, bool, bool, dict[str, Any]]:
        """Step the environment, then listen."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        self._steps += 1
        observation, info = self._with_sonar(observation, info)
        return observation, reward, terminated, truncated, info

    def look(self) -> Hits:
        """Cast the cones on the road as it is now."""
        base: Any = self.env.unwrapped
        things = solid_things(base.road, base.vehicle)
        boxes = self._boxes(things)
        return Scene(boxes).cast(in_world(self._poses, upright(base.vehicle)), self._half, self.max_range)

    def _boxes(self, things: Iterable[Any]) -> list[Box]:
        """Return things as boxes; each keeps the reflectance that it was met with first in the episode."""
        out = []
        for thing in things:
            if id(thing) not in self._reflectance:
                self._reflectance[id(thing)] = (thing, float(self.sonar.rng.uniform(*REFLECTANCE)))
            out.append(box_of(*self._reflectance[id(thing)]))
        return out

    def _with_sonar(self, observation: Any, info: dict[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
        base: Any = self.env.unwrapped
        hits = self.look()
        heard = self.sonar.listen(hits.ping(self._steps / base.config["policy_frequency"]), hits.seen)
        truth = {
            "distance": hits.distance,
            "bearing": hits.bearing,
            "incidence": hits.incidence,
            "in_cone": hits.seen,
            "credence_given_condition": heard.credence_given_condition,
        }
        own = dict(observation) if isinstance(observation, dict) else {BASE: observation}
        return {**own, **heard.observation(self.max_range)}, {**info, "sonar": truth}
