"""The parking task for RLlib on Ray. Needs the extra `ray`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.utils import RecordConstructorArgs
from numpy.typing import ArrayLike
from ray.rllib.algorithms.ppo import PPOConfig
from ray.tune.registry import register_env

import sonar_gym
from acquisition.arrays import Singles
from sonar_gym.control.memory import MemorySettings, ObservationMemory

NAME = "SonarParkingMemory-v0"
ONE = np.zeros(1, dtype=np.int64)


class MemoryObservation(gymnasium.Wrapper[Singles, Singles, dict[str, Any], Singles], RecordConstructorArgs):
    """Observes SonarParking-v0 through an agent's memory: one vector, sufficient for a network without state.

    Args:
        env: environment to wrap.
        memory: fields of `MemorySettings`.
        repeat: steps for which an action holds.
    """

    def __init__(self, env: gymnasium.Env[Any, Any], memory: Mapping[str, Any] | None = None, repeat: int = 2) -> None:
        RecordConstructorArgs.__init__(self, memory=memory, repeat=repeat)
        gymnasium.Wrapper.__init__(self, env)
        self._memory, self._repeat = ObservationMemory(1, settings=MemorySettings(**(memory or {}))), repeat
        self.observation_space = spaces.Box(-10.0, 10.0, (self._memory.size,), np.float32)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Singles, dict[str, Any]]:
        """Begin an episode with an empty memory."""
        observation, info = self.env.reset(seed=seed, options=options)
        self._memory.reset(ONE)
        return self._shown(observation), info

    def step(self, action: ArrayLike) -> tuple[Singles, float, bool, bool, dict[str, Any]]:
        """Repeat an action for `repeat` steps, or until the episode ends."""
        score = 0.0
        for _ in range(self._repeat):
            observation, reward, terminated, truncated, info = self.env.step(np.asarray(action, dtype=np.float32))
            shown, score = self._shown(observation), score + float(reward)
            if terminated or truncated:
                break
        return shown, score, terminated, truncated, info

    def _shown(self, observation: Any) -> Singles:
        self._memory.update(ONE, {name: value[None] for name, value in observation.items()})
        shown: Singles = self._memory.features(ONE)[0]
        return shown


def environment(config: Mapping[str, Any]) -> MemoryObservation:
    """Return an environment from RLlib's `env_config`: `memory`, `repeat`, and arguments of `gymnasium.make`."""
    settings = {name: value for name, value in config.items() if name not in ("memory", "repeat")}
    env = gymnasium.make(sonar_gym.ENV_ID, **settings)
    return MemoryObservation(env, config.get("memory"), config.get("repeat", 2))


def register() -> str:
    """Register the environment with RLlib; returns its name."""
    register_env(NAME, environment)
    return NAME


def ppo(sonar: str = "ideal", runners: int = 2, envs_each: int = 8, **settings: Any) -> PPOConfig:
    """Return the configuration of RLlib's PPO on this task; `.build_algo()` makes the learner.

    Args:
        sonar: name or folder of a sonar model.
        runners: number of processes that drive, on one machine or a cluster.
        envs_each: number of cars of each process.
        settings: further settings of the environment.
    """
    config = PPOConfig().environment(register(), env_config={"sonar": sonar, **settings})
    config = config.env_runners(num_env_runners=runners, num_envs_per_env_runner=envs_each)
    return config.training(gamma=0.995, lambda_=0.95, lr=3e-4, train_batch_size=4096, minibatch_size=1024, num_epochs=4)
