"""The parking task under RLlib on Ray, for machines with more than one box. Needs the extra `ray`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.utils import RecordConstructorArgs
from numpy.typing import ArrayLike, NDArray
from ray.rllib.algorithms.ppo import PPOConfig
from ray.tune.registry import register_env

import sonar_gym
from sonar_gym.control.memory import Memory, MemorySettings

NAME = "SonarParkingRemembered-v0"
ONE = np.zeros(1, dtype=np.int64)
Singles = NDArray[np.float32]


class Remembered(
    gymnasium.Wrapper[Singles, NDArray[np.float32], dict[str, Any], NDArray[np.float32]], RecordConstructorArgs
):
    """SonarParking-v0 shown as an agent's memory: one vector, from which a network without a state can park.

    Args:
        env: to wrap.
        memory: fields of `MemorySettings`.
        repeat: steps for which an action holds.
    """

    def __init__(self, env: gymnasium.Env[Any, Any], memory: Mapping[str, Any] | None = None, repeat: int = 2) -> None:
        RecordConstructorArgs.__init__(self, memory=memory, repeat=repeat)
        gymnasium.Wrapper.__init__(self, env)
        self._memory, self._repeat = Memory(1, settings=MemorySettings(**(memory or {}))), repeat
        self.observation_space = spaces.Box(-10.0, 10.0, (self._memory.size,), np.float32)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Singles, dict[str, Any]]:
        """Begin an episode, and forget the last."""
        observation, info = self.env.reset(seed=seed, options=options)
        self._memory.forget(ONE)
        return self._shown(observation), info

    def step(self, action: ArrayLike) -> tuple[Singles, float, bool, bool, dict[str, Any]]:
        """Hold an action for some steps, or until the episode ends."""
        score = 0.0
        for _ in range(self._repeat):
            observation, reward, terminated, truncated, info = self.env.step(np.asarray(action, dtype=np.float32))
            shown, score = self._shown(observation), score + float(reward)
            if terminated or truncated:
                break
        return shown, score, terminated, truncated, info

    def _shown(self, observation: Any) -> Singles:
        self._memory.see(ONE, {name: value[None] for name, value in observation.items()})
        shown: Singles = self._memory.show(ONE)[0]
        return shown


def environment(config: Mapping[str, Any]) -> Remembered:
    """Return an environment as RLlib asks for one: `memory`, `repeat`, and what `gymnasium.make` takes."""
    rest = {name: value for name, value in config.items() if name not in ("memory", "repeat")}
    return Remembered(gymnasium.make(sonar_gym.ENV_ID, **rest), config.get("memory"), config.get("repeat", 2))


def register() -> str:
    """Make the environment known to RLlib; returns the name it is known by."""
    register_env(NAME, environment)
    return NAME


def ppo(sonar: str = "ideal", runners: int = 2, envs_each: int = 8, **world: Any) -> PPOConfig:
    """Return settings of RLlib's PPO on this task; `.build_algo()` makes the learner.

    Args:
        sonar: name or folder of a model.
        runners: processes that drive, on one machine or many.
        envs_each: cars that each of them drives.
        world: further settings of the environment.
    """
    config = PPOConfig().environment(register(), env_config={"sonar": sonar, **world})
    config = config.env_runners(num_env_runners=runners, num_envs_per_env_runner=envs_each)
    return config.training(gamma=0.995, lambda_=0.95, lr=3e-4, train_batch_size=4096, minibatch_size=1024, num_epochs=4)
