"""Tuned settings of algorithms by environment, in the format of RL Baselines3 Zoo (Raffin 2020)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml
from sb3_contrib import TQC, RecurrentPPO
from stable_baselines3 import PPO, SAC, HerReplayBuffer
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback

from acquisition import SettingError
from sonar_gym.curriculum import Curriculum
from sonar_gym.sb3 import GoalExtractor, SonarExtractor

ALGORITHMS: dict[str, type[BaseAlgorithm]] = {"ppo": PPO, "ppo_lstm": RecurrentPPO, "sac": SAC, "tqc": TQC}
CLASSES = {one.__name__: one for one in (HerReplayBuffer, SonarExtractor, GoalExtractor)}  # that a file names
CALLBACKS: dict[str, type[BaseCallback]] = {"sonar_gym.curriculum.Curriculum": Curriculum}


@dataclass(frozen=True)
class Tuned:
    """Settings of an algorithm for an environment.

    Attributes:
        algorithm: name of the algorithm.
        n_envs: number of environments.
        n_timesteps: number of steps of all environments together.
        keywords: keyword arguments of the algorithm's class.
        callbacks: keyword arguments of callbacks, by their names in `CALLBACKS`.
    """

    algorithm: str
    n_envs: int
    n_timesteps: int
    keywords: dict[str, Any]
    callbacks: dict[str, dict[str, Any]]

    def make_callbacks(self) -> list[BaseCallback]:
        """Return new callbacks."""
        return [CALLBACKS[name](**keywords) for name, keywords in self.callbacks.items()]

    @property
    def algorithm_class(self) -> type[BaseAlgorithm]:
        """Class of the algorithm."""
        return ALGORITHMS[self.algorithm]


def tuned(algorithm: str, env_id: str) -> Tuned:
    """Return the tuned settings of an algorithm for an environment.

    Raises:
        SettingError: the algorithm is unknown, or has no settings for the environment.
    """
    if algorithm not in ALGORITHMS:
        raise SettingError(f"algorithm {algorithm!r}: no such algorithm; expected {', '.join(ALGORITHMS)}")
    known = yaml.safe_load((Path(__file__).parent / f"{algorithm}.yml").read_text(encoding="utf-8"))
    if env_id not in known:
        raise SettingError(f"{algorithm} has no settings for {env_id!r}; expected {', '.join(known)}")
    row = dict(known[env_id])
    callbacks = {name: given for one in row.pop("callback", ()) for name, given in one.items()}
    n_envs, n_timesteps = int(row.pop("n_envs")), int(row.pop("n_timesteps"))
    return Tuned(algorithm, n_envs, n_timesteps, _named(row), callbacks)


def _named(value: Any) -> Any:
    """Return settings with the classes that they name."""
    if isinstance(value, dict):
        return {name: _named(one) for name, one in value.items()}
    return CLASSES.get(value, value) if isinstance(value, str) else value
