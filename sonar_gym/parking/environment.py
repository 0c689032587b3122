"""SonarParking-v0: a miniature car finds a space and parks in it with sonars only (Esmi 2016, section 6.1)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike, NDArray

from acquisition import SettingError
from acquisition.limits import SEEDS, as_numbers, check_number, shown
from sonar_gym.parking.fleet import MAX_RANGE, MAX_STEPS, ODOMETRY_SPAN, STEP_S, Fleet, Observation
from sonar_gym.parking.step_kernel import RewardWeights
from sonar_gym.parking.world import WorldView
from sonar_gym.sensing.mounts import Layout, Mount
from sonar_gym.sensing.odometry import OdometryChoice
from sonar_gym.sensing.sonar import SonarChoice
from sonar_gym.street.randomization import Randomization
from sonar_gym.street.street import Street, StreetSettings
from sonar_gym.street.vehicle import Car, CarSettings

__all__ = ["MAX_RANGE", "MAX_STEPS", "ODOMETRY_SPAN", "STEP_S", "RewardWeights", "SonarParkingEnv"]
ROW_0 = np.zeros(1, dtype=np.int64)  # the row of the single world


class SonarParkingEnv(gymnasium.Env[dict[str, Any], NDArray[np.float32]]):
    """A miniature car drives along a lane past boxes, finds a space that is wide enough, and parks in it.

    ## Description

    A car at a scale of 1:10 (0.45 m long, 0.20 m wide, turning radius 0.45 m) drives along a street. Boxes with
    different reflectances stand on its right; most spaces between them are too short, one is wide enough. Its only
    sensors for the surroundings are eight sonars. The aim is to stand still in the wide space, parallel to the kerb,
    without touching
    anything: the scenario of S. Esmi, *Sensor modeling ... using neural network* (Chalmers 2016), section 6.1.

    Readings are drawn from the laws of a `noise.SonarModel`, given distance, bearing, incidence and reflectance of the
    nearest visible point of each face in the cone; the first echo is read. Errors persist where the model states
    it, and sonars that fire together hear each other. The street does not depend on the model: the same seed gives the
    same street with every model.

    ## Action Space

    `Box(-1, 1, (2,), float32)`:

    | Num | Action | -1 | 1 |
    |---|---|---|---|
    | 0 | steering angle command | 30 deg to the right | 30 deg to the left |
    | 1 | speed command | 0.5 m/s backwards | 0.5 m/s forwards |

    Servo and motor follow with a lag and a limited rate. Values beyond the limits are clipped; NaN and infinity raise a
    `SettingError`.

    ## Observation Space

    `Dict` of float32 vectors; n sonars, in the order of `sonar_layout`:

    | Key | Shape | Meaning |
    |---|---|---|
    | `ranges` | (n,) | reading divided by the maximum range of 3.01 m, 0 to 1; 1 without an echo |
    | `credence` | (n,) | P(reading within 10 % of the truth), given the reading only; 0 without an echo |
    | `echo` | (n,) | 1 echo, 0 no echo, -1 no answer (a disconnected sensor) |
    | `age` | (n,) | time since the ping of the reading, s, at most 1 |
    | `ego` | (7,) | wheel encoder, gyro and clock, see below |

    `ego`: speed and steering angle relative to their maxima; cosine and sine of the heading since the start; odometry
    along the initial heading / 10 m and across it / 2 m; time / 40 s.

    ## Rewards

    The sum of `info["reward_terms"]`, with the weights of `RewardWeights`. The task's own reward is `time` (-0.05 per
    step), `parked` (+10, once) and `crashed` (once, -3 and -5 per metre of cost to go from the place of the crash).
    `shaping` is potential-based (Ng, Harada and Russell 1999): 5 per metre of decrease of the cost to go, the
    length of the shortest way of such a car into a space as long or up to 5 cm shorter. The potential is zero where an
    episode ends, so the sum over an episode depends on its start alone and the best policy is that of the task's own
    reward. `reward={"potential": 0.0}` turns it off.

    ## Starting State

    The car stands in its lane, with an offset of some millimetres and degrees, somewhere between the beginning of the
    street and 0.6 m before the gap (uniform; at the beginning if "hard"). Number, length, reflectance and texture of
    the boxes, and number and length of the spaces, are random (`StreetSettings`).

    ## Episode End

    Terminated: the car stands in the gap (`info["is_success"]`: slower than 0.03 m/s, within 10 deg of the direction of
    the kerb, at most 20 mm over the strip's line), touches an obstacle (`info["collision"]`), or leaves the street by
    the open end behind it (`info["left_street"]`). Truncated after 400 steps (40 s) when made by `gymnasium.make`.

    ## Information

    `info` holds what the car cannot measure. For the ping of each reading, each (n,): `distance` (m; 3.01 where the
    cone is empty), `bearing`, `incidence` (rad), `reflectance`, `in_cone`, `obstacle` and `face` (numbers) of the face
    that answered, or else of that detected most often; `second` (range of the second echo, m, 0 without one); `sent`
    (s); `cause` of the reading, an index of `env.unwrapped.causes`; `credence_given_condition`, if the model has
    probabilities. For the car: `is_success`, `collision`, `left_street`, `reward_terms`.

    ## Arguments

    ```python
    gymnasium.make("SonarParking-v0", sonar="srf08-mlp", sonar_layout="eight in turn", difficulty="hard")
    ```

    - `sonar`: "ideal" (default), "gaussian", another name of `noise.model_names()`, the path of a saved model, or a
      `SonarModel`.
    - `sonar_layout`: "eight" (default; all fire 20 ms before every observation), "eight in turn" (neighbours never fire
      together), "eight without latency", "four", or a list of `Mount` or mappings of their fields: position, cone,
      period, phase and latency.
    - `difficulty`: "easy", "normal" (default), "hard" or "manoeuvre": length of the gap, number of spaces that are too
      short, reflectance and angle of the boxes, place and offset of the start.
    - `street`, `car`, `reward`: `StreetSettings`, `CarSettings`, `RewardWeights`, or mappings of their fields; fields
      of `street` override those of the difficulty.
    - `odometry`: "exact" (default), "wheels", "worn", `OdometrySettings`, or a mapping of their fields: errors of the
      odometry in `ego`.
    - `credence_driver`: "agent" (default), "scripted" or "random": the kind of driver on whose conditions `credence` is
      calibrated.
    - `crosstalk`: whether a sonar also receives the bursts of others by way of a face (default). An ideal or Gaussian
      sonar, which has no beam, hears only itself.
    - `randomize`: what each episode draws besides its street, `Randomization` or a mapping of its fields: `street`,
      weights of difficulties, and `mounts`, the greatest displacement of each sonar, m and deg. `info["randomized"]`
      holds `level`, the number of the difficulty (-1 if the options fix it), and `mounts`, the poses of the sonars.
    - `render_mode`: None, "rgb_array" or "human".

    `reset(options=...)` fixes what is normally random: `difficulty`; `street`, a mapping of fields of `StreetSettings`
    or a `Street`; `boxes`, a list of mappings of `begin`, `length` and optionally `recess`, `reflectance`,
    `texture_deg`, `turn_deg`; `obstacles`, a list of mappings of the fields of `scene.Box`, with a `kind` of "pole",
    "hedge", "wall", "pedestrian" or "car" for size and material, and `vx`, `vy` in m/s; `start`, x, y, heading of the
    car in m, m, rad.

    ## Version History

    - v0: first version.
    """

    metadata: dict[str, Any] = {"render_modes": ["human", "rgb_array"], "render_fps": 10}  # noqa: RUF012 - as Gymnasium

    def __init__(
        self,
        sonar: SonarChoice = "ideal",
        sonar_layout: Layout = "eight",
        street: StreetSettings | Mapping[str, object] | None = None,
        car: CarSettings | Mapping[str, object] | None = None,
        reward: RewardWeights | Mapping[str, object] | None = None,
        odometry: OdometryChoice = "exact",
        render_mode: str | None = None,
        difficulty: str = "normal",
        credence_driver: str | None = "agent",
        crosstalk: bool = True,
        randomize: Randomization | Mapping[str, object] | None = None,
    ) -> None:
        check_render_mode(render_mode)
        self.render_mode = render_mode
        self.fleet = Fleet(
            1,
            sonar,
            sonar_layout,
            difficulty,
            street,
            car,
            reward,
            odometry,
            credence_driver,
            crosstalk,
            randomize=randomize,
        )
        self.max_range = MAX_RANGE
        self._streams_seeded = False
        self._renderer: Any = None
        self.action_space: spaces.Space[Any] = self.fleet.action_space
        self.observation_space = self.fleet.observation_space

    # ---- world -------------------------------------------------------------------------------------------------------

    @property
    def world(self) -> WorldView:
        """A view of the current world."""
        return self.fleet.world(0)

    @property
    def street(self) -> Street:
        """The street of this episode."""
        return self.world.street

    @property
    def causes(self) -> tuple[str, ...]:
        """Names of the causes of readings, by number: those of the scene, then the faults of the model."""
        return self.fleet.causes

    @property
    def mounts(self) -> tuple[Mount, ...]:
        """The sonars on the car."""
        return self.fleet.mounts

    @property
    def car(self) -> Car:
        """The current car; it can be replaced."""
        return Car(self.fleet.car_settings, self.fleet.worlds.car[0].copy())

    @car.setter
    def car(self, car: Car) -> None:
        self.fleet.worlds.car[0] = car.state

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Draw a street and place the car at its start; `options` fixes what is normally random."""
        self.fleet.checked(options)
        if seed is not None:
            check_number("seed", seed, SEEDS, whole=True)
        super().reset(seed=seed)
        if seed is not None or not self._streams_seeded:
            known = self.np_random_seed if seed is None else seed
            # Gymnasium's seed of a generator that the user has set is -1
            self.fleet.seed(known if known >= 0 else int(self.np_random.integers(2**63)))
            self._streams_seeded = True
        self.fleet.reset(ROW_0, [self.np_random], options)
        self._render_window()
        return self.fleet.observation(0), self._info()

    def step(self, action: ArrayLike) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Drive for 0.1 s with the given steering and speed commands."""
        self._check_reset("step")
        self.fleet.step(ROW_0, self._valid_action(action))
        self._render_window()
        reward = sum(self.fleet.worlds.terms[0].tolist())
        return self.fleet.observation(0), reward, any(self.fleet.worlds.ended[0].tolist()), False, self._info()

    def _check_reset(self, call: str) -> None:
        if self.fleet.worlds.steps[0] < 0:
            raise gymnasium.error.ResetNeeded(f"SonarParking-v0: {call}() before the first reset(); call reset() first")

    def _valid_action(self, action: ArrayLike) -> NDArray[np.float64]:
        value = as_numbers("action", action)
        if value.shape != (2,):
            raise SettingError(f"action has shape {value.shape}, expected (2,): steering and speed")
        steering, speed = value.tolist()
        if not math.isfinite(steering + speed):
            raise SettingError(f"action must be finite, got steering {steering} and speed {speed}: check the policy")
        return np.array([[min(max(steering, -1.0), 1.0), min(max(speed, -1.0), 1.0)]])

    def _info(self) -> dict[str, Any]:
        info = self.fleet.truth(0)
        for name in ("is_success", "collision", "left_street"):
            info[name] = bool(info[name])
        info["reward_terms"] = {name: float(value) for name, value in info["reward_terms"].items()}
        return info

    # ---- rendering ---------------------------------------------------------------------------------------------------

    def _render_window(self) -> None:
        if self.render_mode == "human":
            self.render()

    def render(self) -> NDArray[np.uint8] | None:
        """Draw the scene: an array (height, width, 3) of uint8 for "rgb_array", a window for "human"."""
        if self.render_mode is None:
            gymnasium.logger.warn("render() needs a render_mode: gymnasium.make(..., render_mode='rgb_array')")
            return None
        self._check_reset("render")
        if self._renderer is None:
            from sonar_gym.parking.rendering import Renderer  # imports pygame

            self._renderer = Renderer(self.render_mode, self.metadata["render_fps"])
        picture: NDArray[np.uint8] | None = self._renderer.draw(self.world)
        return picture

    def close(self) -> None:
        """Close the window, if any."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None


def check_render_mode(mode: str | None) -> None:
    """Raise SettingError for an unknown render mode."""
    if mode is not None and not (isinstance(mode, str) and mode in SonarParkingEnv.metadata["render_modes"]):
        raise SettingError(f"render_mode {shown(mode)}: expected None, 'human' or 'rgb_array'")
