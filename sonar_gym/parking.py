"""SonarParking-v0: a miniature car finds a space and parks in it by sonar alone (Esmi 2016, section 6.1)."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike, NDArray

from acquisition import SettingError
from sonar_gym import kernels
from sonar_gym.mounts import Layout, in_world, layout, mount_arrays
from sonar_gym.odometry import Odometer, OdometryChoice
from sonar_gym.odometry import odometry as odometry_settings
from sonar_gym.prior import street_credence
from sonar_gym.scene import Hits
from sonar_gym.sonar import Heard, Sonar, SonarChoice, resolve, sonar_spaces
from sonar_gym.street import BEHIND, Street, StreetSettings, draw_street, reference_path
from sonar_gym.vehicle import Car, CarSettings

Observation = dict[str, NDArray[np.float32]]
STEP_S = 0.1  # s; the SRF08 ranges in 65 ms, all of them at once after a general call (Devantech)
MAX_RANGE = 3.01  # m; SRF08 with range register 69: (69 + 1) * 43 mm
MAX_STEPS = 400  # of an episode, by the TimeLimit that `gymnasium.make` adds
ODOMETRY_SPAN = (10.0, 2.0)  # m; odometry along and across the start's heading is given as shares of these
PARKED_ANGLE = np.radians(10.0)
PARKED_SPEED = 0.03  # m/s
PARKED_OVERHANG = 0.02  # m; how far a parked body may stand out over the strip's line


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


def _settings(cls: type, given: Any) -> Any:
    if given is None:
        return cls()
    return cls(**given) if isinstance(given, Mapping) else given


class SonarParkingEnv(gymnasium.Env[dict[str, Any], NDArray[np.float32]]):
    """A miniature car follows its lane past boxes, finds a space wide enough, and parks sideways in it.

    ## Description

    A car at 1:10 (0.45 m long, 0.20 m wide, turning radius 0.45 m) drives along a street. Boxes of unlike reflectance
    stand on its right; most spaces between them are too short, one is wide enough. Eight sonars are all it has to see
    with. The aim is to stand still in that space, parallel to the kerb, without touching anything: the scenario of
    S. Esmi, *Sensor modeling ... using neural network* (Chalmers 2016), section 6.1.

    What the sonars say is drawn from the law of a `noise.SonarModel`, given the true distance, bearing, incidence and
    reflectance of the nearest point in each cone. The world does not depend on the model: the same seed gives the same
    street for all of them.

    ## Action Space

    `Box(-1, 1, (2,), float32)`:

    | Num | Action | -1 | 1 |
    |---|---|---|---|
    | 0 | steering angle wanted | 30 deg to the right | 30 deg to the left |
    | 1 | speed wanted | 0.5 m/s backwards | 0.5 m/s forwards |

    Servo and motor follow with lag and limited rate. Values beyond the limits are clipped; NaN and infinity are
    refused with a `SettingError`.

    ## Observation Space

    `Dict` of float32 vectors; n sonars, in the order of `sonar_layout`:

    | Key | Shape | Meaning |
    |---|---|---|
    | `ranges` | (n,) | reading over the maximum range of 3.01 m, 0 to 1; 1 without an echo |
    | `credence` | (n,) | P(reading within 10 % of the truth), given the reading alone; 0 without an echo |
    | `echo` | (n,) | 1 echo, 0 silence, -1 no answer (a dead wire) |
    | `ego` | (7,) | what wheel encoder, gyro and clock tell, see below |

    `ego`: speed and steering angle as shares of the greatest; cosine and sine of the turn since the start; metres gone
    along the first heading / 10 and across it / 2; time / 40 s.

    ## Rewards

    The sum of `info["reward_terms"]`: `progress` (metres by which the cost to go along a reference path falls),
    `time` (-0.01 a step), `parked` (+10, once), `crashed` (-10, once). Weights are `RewardWeights`.

    ## Starting State

    The car stands at the beginning of its lane, up to 30 mm and 3 deg off it. Number, length and reflectance of boxes,
    number and length of spaces are drawn anew (`StreetSettings`).

    ## Episode End

    Terminated: the car stands in the gap (`info["is_success"]`): slower than 0.03 m/s, within 10 deg of the kerb's
    direction, no more than 20 mm over the strip's line; or it touched something (`info["collision"]`), or left the
    street by the open end behind it. Truncated after 400 steps (40 s) when made by `gymnasium.make`.

    ## Arguments

    - `sonar`: "ideal" (default), "gaussian", another name of `noise.model_names()`, the path of a saved model, or a
      `SonarModel`.
    - `sonar_layout`: "eight" (default), "four", or a list of `Mount` or mappings of their fields.
    - `street`, `car`, `reward`: `StreetSettings`, `CarSettings`, `RewardWeights`, or mappings of their fields.
    - `odometry`: "exact" (default), "wheels", "worn", `OdometrySettings`, or a mapping of their fields: how far off
      what `ego` tells of the way gone is.
    - `render_mode`: None, "rgb_array" or "human".

    `info` holds what a car cannot know, each (n,): `distance` (m; 3.01 where the cone is empty), `bearing`,
    `incidence` (rad), `reflectance`, `in_cone`, and `credence_given_condition`.
    """

    metadata: dict[str, Any] = {"render_modes": ["human", "rgb_array"], "render_fps": 10}  # noqa: RUF012 - as Gymnasium

    def __init__(
        self,
        sonar: SonarChoice = "ideal",
        sonar_layout: Layout = "eight",
        street: StreetSettings | Mapping[str, Any] | None = None,
        car: CarSettings | Mapping[str, Any] | None = None,
        reward: RewardWeights | Mapping[str, Any] | None = None,
        odometry: OdometryChoice = "exact",
        render_mode: str | None = None,
    ) -> None:
        if render_mode is not None and render_mode not in self.metadata["render_modes"]:
            raise SettingError(f"render_mode {render_mode!r}: expected None, 'human' or 'rgb_array'")
        self.render_mode = render_mode
        self.mounts = layout(sonar_layout)
        self.street_settings: StreetSettings = _settings(StreetSettings, street)
        self.car_settings: CarSettings = _settings(CarSettings, car)
        self.reward_weights: RewardWeights = _settings(RewardWeights, reward)
        self.max_range = MAX_RANGE
        model = resolve(sonar)
        tables = street_credence(model, self.street_settings, self.car_settings, self.mounts, MAX_RANGE)
        self.sonar = Sonar(model, len(self.mounts), MAX_RANGE, tables=tables)
        named = isinstance(sonar, (str, os.PathLike))
        self.sonar_name = Path(str(sonar)).name if named else type(self.sonar.model).__name__
        self._poses, self._half = mount_arrays(self.mounts)
        self.odometer = Odometer(odometry_settings(odometry))
        self._streams_seeded = False
        self._renderer: Any = None
        self.steps = -1  # no episode yet
        self.action_space = spaces.Box(-1.0, 1.0, (2,), np.float32)
        ego = spaces.Box(-1.0, 1.0, (7,), np.float32)
        self.observation_space = spaces.Dict({**sonar_spaces(len(self.mounts)), "ego": ego})

    # ---- world -------------------------------------------------------------------------------------------------------

    street: Street
    car: Car
    hits: Hits
    heard: Heard

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Draw a street and put the car at its beginning; `options` is not used."""
        super().reset(seed=seed)
        self._reset_streams(seed)
        self.street = draw_street(self.street_settings, self.np_random)
        self.car = Car.at(self.car_settings, *self.street.start)
        self.odometer.begin()
        self.path = reference_path(self.street, self.car_settings)
        self.steps = 0
        self.parked, self.collision, self.left_street = False, False, False
        self._cost = self._cost_to_go()
        self._listen()
        self._show()
        return self._observation(), self._info({})

    def step(self, action: ArrayLike) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Drive for 0.1 s towards the wanted steering and speed, then listen."""
        self._check_begun("step")
        steering, speed = self._checked(action)
        before = self.car.pose
        self.car, hit = self.car.drive(steering, speed, self.street.scene.segments, STEP_S)
        self.odometer.step(before, self.car.pose)
        self.steps += 1
        self.collision = hit != kernels.NOTHING
        self.left_street = bool(self.car.state[0] < -BEHIND)
        self.parked = not self.collision and self._is_parked()
        terms = self._reward_terms()
        self._listen()
        self._show()
        terminated = self.parked or self.collision or self.left_street
        return self._observation(), float(sum(terms.values())), terminated, False, self._info(terms)

    def _reset_streams(self, seed: int | None) -> None:
        self.sonar.forget()
        if seed is not None or not self._streams_seeded:
            own = self.np_random_seed if seed is None else seed
            self.sonar.seed(own)
            self.odometer.seed(own)
            self._streams_seeded = True

    def _check_begun(self, call: str) -> None:
        if self.steps < 0:
            raise gymnasium.error.ResetNeeded(f"SonarParking-v0: {call}() before the first reset(); call reset() first")

    def _checked(self, action: ArrayLike) -> tuple[float, float]:
        value = np.asarray(action, dtype=np.float64)
        if value.shape != (2,):
            raise SettingError(f"action has shape {value.shape}, expected (2,): steering and speed")
        steering, speed = float(value[0]), float(value[1])
        if not math.isfinite(steering + speed):
            raise SettingError(f"action must be finite, got steering {steering} and speed {speed}: check the policy")
        return min(max(steering, -1.0), 1.0), min(max(speed, -1.0), 1.0)

    def _listen(self) -> None:
        poses = in_world(self._poses, self.car.pose)
        self.hits = self.street.scene.cast(poses, self._half, self.max_range)
        self.heard = self.sonar.listen(self.hits.ping(self.steps * STEP_S), self.hits.seen)

    # ---- what comes out ----------------------------------------------------------------------------------------------

    def _observation(self) -> Observation:
        return {**self.heard.observation(self.max_range), "ego": self._ego()}

    def _ego(self) -> NDArray[np.float32]:
        """Speed, steering, odometry since the start in the start's frame, time: nothing that the car cannot know."""
        x, y, turn = self.odometer.pose
        speed, steering = (
            self.car.speed / self.car_settings.max_speed,
            self.car.steering / self.car_settings.max_steering,
        )
        along, across = x / ODOMETRY_SPAN[0], y / ODOMETRY_SPAN[1]
        ego = (speed, steering, math.cos(turn), math.sin(turn), along, across, self.steps / MAX_STEPS)
        return np.minimum(np.maximum(np.array(ego, dtype=np.float32), -1.0), 1.0)

    def _info(self, terms: dict[str, float]) -> dict[str, Any]:
        return {
            "is_success": self.parked,
            "collision": self.collision,
            "left_street": self.left_street,
            "distance": self.hits.distance,
            "bearing": self.hits.bearing,
            "incidence": self.hits.incidence,
            "reflectance": self.hits.reflectance,
            "in_cone": self.hits.seen,
            "credence_given_condition": self.heard.credence_given_condition,
            "reward_terms": terms,
        }

    def _cost_to_go(self) -> float:
        weights = self.reward_weights
        return float(kernels.cost_to_go(self.car.pose, self.path, weights.off_path, weights.off_heading))

    def _reward_terms(self) -> dict[str, float]:
        before, self._cost = self._cost, self._cost_to_go()
        weights = self.reward_weights
        return {
            "progress": weights.progress * (before - self._cost),
            "time": weights.time,
            "parked": weights.parked if self.parked else 0.0,
            "crashed": weights.crashed if self.collision or self.left_street else 0.0,
        }

    def _is_parked(self) -> bool:
        if abs(self.car.speed) > PARKED_SPEED or abs(self.car.state[2]) > PARKED_ANGLE:
            return False
        corners = self.car.corners()
        between = self.street.gap[0] <= corners[:, 0].min() and corners[:, 0].max() <= self.street.gap[1]
        return bool(between and corners[:, 1].max() <= self.street.line + PARKED_OVERHANG)

    # ---- pictures ----------------------------------------------------------------------------------------------------

    def _show(self) -> None:
        if self.render_mode == "human":
            self.render()

    def render(self) -> NDArray[np.uint8] | None:
        """Draw the scene; an array (height, width, 3) of uint8 for "rgb_array", a window for "human"."""
        if self.render_mode is None:
            gymnasium.logger.warn("render() needs a render_mode: gymnasium.make(..., render_mode='rgb_array')")
            return None
        self._check_begun("render")
        if self._renderer is None:
            from sonar_gym.rendering import Renderer  # pygame is imported when it is first drawn

            self._renderer = Renderer(self.render_mode, self.metadata["render_fps"])
        picture: NDArray[np.uint8] | None = self._renderer.draw(self)
        return picture

    def close(self) -> None:
        """Close the window, where there is one."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None
