"""The vector environment for Stable-Baselines3, and features: `PPO("MultiInputPolicy", SonarVecEnv(64), ...)`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any, Unpack

import gymnasium
import numpy as np
import torch
from gymnasium import spaces
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.common.vec_env.base_vec_env import VecEnv, VecEnvIndices

from acquisition import SettingError
from acquisition.limits import SEEDS, check_value, shown
from sonar_gym.checks import check_options
from sonar_gym.parking.fleet import MAX_RANGE
from sonar_gym.parking.goal import LENGTH, relative_pose
from sonar_gym.parking.settings import FleetSettings
from sonar_gym.parking.vector import SonarParkingVectorEnv

Observations = dict[str, NDArray[np.float32]]
StepResult = tuple[Observations, NDArray[np.float32], NDArray[np.bool_], list[dict[str, Any]]]
# Attributes that take effect after the environment is made; streets with the next episode
SETTABLE = ("max_episode_steps", "pictured", "street_settings")
OUTCOMES = ("is_success", "collision", "left_street")
NEAR_M = 0.3  # m; ranges below it are resolved best
EGO_SCALE = (1.0, 1.0, 1.0, 3.0, 2.0, 4.0, 1.0)  # of the sine of the heading and of the odometry, which are small


def _check_space(name: str, space: Any, parts: Sequence[str]) -> None:
    missing = [part for part in parts if not isinstance(space, spaces.Dict) or part not in space.spaces]
    if missing:
        raise SettingError(
            f"{name}.observation_space: expected a Dict space with {', '.join(parts)}, got {shown(space)}"
        )


class SonarExtractor(BaseFeaturesExtractor):
    """Features of an observation of `SonarParkingEnv` of order 1, for `policy_kwargs` of Stable-Baselines3.

    The observation divides ranges by the maximum range, so that 5 cm, in which a car turns between two boxes, are a
    sixtieth; a network starts with weights that hardly show it. A range r becomes 2 r / (r + 0.3 m) - 1 and, where it
    is below 0.3 m, 1 - r / 0.3 m.

    Args:
        observation_space: of the environment.
    """

    ego_scale: torch.Tensor

    def __init__(self, observation_space: spaces.Dict) -> None:
        _check_space("SonarExtractor", observation_space, ("ranges", "credence", "echo", "age", "ego"))
        count = spaces.utils.flatdim(observation_space) + spaces.utils.flatdim(observation_space["ranges"])
        super().__init__(observation_space, count)
        self.register_buffer("ego_scale", torch.tensor(EGO_SCALE))

    def forward(self, observations: dict[str, torch.Tensor]) -> torch.Tensor:
        """Return the features, (n, features_dim)."""
        metres = observations["ranges"] * MAX_RANGE
        near = [2.0 * metres / (metres + NEAR_M) - 1.0, (1.0 - metres / NEAR_M).clamp(min=0.0)]
        others = [observations[name] for name in ("credence", "echo", "age")]
        return torch.cat([*near, *others, observations["ego"] * self.ego_scale], dim=1)


class GoalExtractor(BaseFeaturesExtractor):
    """Features of an observation of `SonarParkingGoalEnv`, for `policy_kwargs` of Stable-Baselines3.

    To see the goal, networks would have to subtract positions of some metres to a centimetre, and to turn the result.
    The features are those of `SonarExtractor` and the pose relative to the goal: a position p along and across as
    p / (|p| + 0.3 m) and as p / 0.3 m between -1 and 1, cosine and three times the sine of the heading, and the length
    of the space.

    Args:
        observation_space: of the environment.
    """

    def __init__(self, observation_space: spaces.Dict) -> None:
        _check_space("GoalExtractor", observation_space, ("observation", "achieved_goal", "desired_goal"))
        n = (spaces.utils.flatdim(observation_space["observation"]) - len(EGO_SCALE)) // 4
        self.sizes = {"age": n, "credence": n, "echo": n, "ego": len(EGO_SCALE), "ranges": n}  # in order
        own = spaces.Dict({name: spaces.Box(-np.inf, np.inf, (size,)) for name, size in self.sizes.items()})
        super().__init__(observation_space, 7 + 5 * n + len(EGO_SCALE))
        self.own = SonarExtractor(own)

    def forward(self, observations: dict[str, torch.Tensor]) -> torch.Tensor:
        """Return the features, (n, features_dim)."""
        parts = torch.split(observations["observation"], list(self.sizes.values()), dim=1)
        desired = observations["desired_goal"]
        along, across, cosine, sine = relative_pose(observations["achieved_goal"], desired)
        far = [one / (one.abs() + NEAR_M) for one in (along, across)]
        near = [(one / NEAR_M).clamp(-1.0, 1.0) for one in (along, across)]
        goal = torch.stack([*far, *near, cosine, EGO_SCALE[3] * sine, desired[:, LENGTH]], dim=1)
        return torch.cat([goal, self.own(dict(zip(self.sizes, parts, strict=True)))], dim=1)


class SonarVecEnv(VecEnv):
    """Stable-Baselines3 interface of n parking environments that are stepped together.

    The info of a step that ends an episode holds `terminal_observation`, `TimeLimit.truncated`, `is_success`,
    `collision` and `left_street`. All other infos are empty unless `infos` is set, because building a dictionary per
    environment and step is slow.

    Args:
        num_envs: number of environments.
        infos: whether to return the full info of `SonarParkingEnv` at every step.
        settings: keyword arguments of `SonarParkingVectorEnv`, except `autoreset_mode`.
    """

    def __init__(self, num_envs: int, infos: bool = False, **settings: Unpack[FleetSettings]) -> None:
        if "autoreset_mode" in settings:
            raise SettingError("SonarVecEnv takes no autoreset_mode: Stable-Baselines3 resets in the step that ends")
        self.envs = SonarParkingVectorEnv(num_envs, autoreset_mode=AutoresetMode.SAME_STEP, **settings)
        self.infos = infos
        super().__init__(num_envs, self.envs.single_observation_space, self.envs.single_action_space)
        self._actions = np.zeros((num_envs, 2), dtype=np.float32)

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Set the seeds of the next reset: `seed` of the first environment, from which the others count up."""
        check_value("seed", seed, Annotated[int, SEEDS] | None)
        return super().seed(seed)

    def set_options(self, options: list[dict[str, Any]] | dict[str, Any] | None = None) -> None:
        """Set the options of the next reset: one mapping for all environments, or one for each."""
        each = options if isinstance(options, list) else [options] * self.num_envs
        if len(each) != self.num_envs:
            raise SettingError(f"options: expected {self.num_envs} mappings, one per environment, got {len(each)}")
        for one in each:
            check_options(one)
        super().set_options(options)

    def reset(self) -> Observations:
        """Begin new episodes with the seeds and options set for this reset; the options must be the same for all."""
        if any(options != self._options[0] for options in self._options):
            raise SettingError("SonarVecEnv.set_options: the options must be the same for all environments")
        observations, infos = self.envs.reset(seed=self._seeds, options=self._options[0] or None)
        self.reset_infos = [env_info(infos, i) for i in range(self.num_envs)]
        self._reset_seeds()
        self._reset_options()
        return observations

    def step_async(self, actions: NDArray[Any]) -> None:
        """Store the actions, (n, 2), for `step_wait`."""
        self._actions = actions

    def step_wait(self) -> StepResult:
        """Step all environments and return observations, rewards, ends of episodes, and infos."""
        observations, rewards, terminated, truncated, infos = self.envs.step(self._actions)
        out = [env_info(infos, i) if self.infos else {} for i in range(self.num_envs)]
        done = terminated | truncated
        for i in np.flatnonzero(done).tolist():
            final = env_info(infos["final_info"], i)
            out[i] = final if self.infos else {name: final[name] for name in OUTCOMES}
            out[i]["terminal_observation"] = infos["final_obs"][i]
            out[i]["TimeLimit.truncated"] = bool(truncated[i] and not terminated[i])
            self.reset_infos[i] = env_info(infos, i)
        return observations, rewards.astype(np.float32), done, out

    def close(self) -> None:
        """Close windows and threads."""
        self.envs.close()

    def get_images(self) -> Sequence[NDArray[np.uint8] | None]:
        """Return the images of the rendered environments."""
        return self.envs.render() or ()

    # ---- access to single environments, which share one vector environment -------------------------------------------

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """Return an attribute of the vector environment once per requested environment."""
        value = getattr(self.envs, attr_name)
        return [value for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Set an attribute of the vector environment, for all environments.

        Raises:
            SettingError: only some environments are given, the attribute is none that can be set, or its value invalid.
        """
        if len(list(self._get_indices(indices))) != self.num_envs:
            raise SettingError(f"SonarVecEnv: {attr_name!r} is shared by all environments; set it without indices")
        if attr_name not in SETTABLE:
            raise SettingError(
                f"SonarVecEnv: {attr_name!r} cannot be set; expected {', '.join(SETTABLE)}: make a new environment"
            )
        setattr(self.envs, attr_name, value)

    def env_method(self, method_name: str, *method_args: Any, indices: VecEnvIndices = None, **named: Any) -> list[Any]:
        """Call a method of the vector environment once, and return its result once per requested environment."""
        result = getattr(self.envs, method_name)(*method_args, **named)
        return [result for _ in self._get_indices(indices)]

    def env_is_wrapped(self, wrapper_class: type[gymnasium.Wrapper], indices: VecEnvIndices = None) -> list[bool]:
        """Return False for each requested environment: none is wrapped."""
        return [False for _ in self._get_indices(indices)]


def env_info(infos: dict[str, Any], i: int) -> dict[str, Any]:
    """Return the info of environment i from that of a vector environment."""
    own = {name: value for name, value in infos.items() if not name.startswith(("_", "final"))}
    return {name: env_info(value, i) if isinstance(value, dict) else value[i] for name, value in own.items()}
