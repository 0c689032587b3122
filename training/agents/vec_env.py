"""Vector environment of Stable-Baselines3 over several kinds of environment, observed through the agent's memory."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import product
from typing import Any, NamedTuple

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.vec_env.base_vec_env import VecEnv, VecEnvIndices

from acquisition import SettingError
from acquisition.arrays import Bits, Ints, Singles
from noise import SonarModel, load_model
from sonar_gym.control.memory import MemorySettings, ObservationMemory
from sonar_gym.sb3 import SonarVecEnv
from training.agents.sonars import with_faults

EnvSettings = Mapping[str, Any]
Infos = list[dict[str, Any]]
Transition = tuple[Singles, Singles, Bits, Infos]
SHOWN_LIMIT = 10.0  # bound of the observation space, well above what a memory shows
EPISODE = "episode"  # key under which Stable-Baselines3 looks for the result of an episode


def settings_of(
    sonars: Sequence[str], odometry: Sequence[str], difficulty: Sequence[str], faults: bool = False
) -> list[EnvSettings]:
    """Return the settings of every combination of sonar, odometry and difficulty.

    Args:
        sonars: names or folders of models.
        odometry: exact, wheels, worn.
        difficulty: easy, normal, hard, manoeuvre.
        faults: whether to add each sonar with faults.
    """
    models: list[str | SonarModel] = [*sonars]
    if faults:
        models += [with_faults(load_model(name)) for name in sonars]
    names = ("sonar", "odometry", "difficulty")
    return [dict(zip(names, values, strict=True)) for values in product(models, odometry, difficulty)]


def as_dict(observation: Any) -> dict[str, Singles]:
    """Return an observation with the type that Stable-Baselines3 does not declare."""
    assert isinstance(observation, dict)
    return observation


class EpisodeResult(NamedTuple):
    """Result of an episode: whether the car parked or collided, sum of rewards, number of decisions."""

    success: bool
    collision: bool
    score: float
    length: int


class AgentVecEnv(VecEnv):
    """n cars in several kinds of environment, each observed as its memory.

    Args:
        num_envs: number of cars, divided evenly among the kinds.
        settings: settings of `SonarParkingVectorEnv`, one mapping per kind.
        memory: settings of the memory.
        repeat: steps of 0.1 s for which an action holds.
        threads: number of threads that step the cars.

    Attributes:
        ended: results of finished episodes, in order; the caller clears it.
    """

    render_mode = None

    def __init__(
        self, num_envs: int, settings: Sequence[EnvSettings], memory: MemorySettings, repeat: int = 1, threads: int = 1
    ) -> None:
        if num_envs < len(settings) or repeat < 1:
            raise SettingError(
                f"num_envs must be >= {len(settings)}, one for each kind of environment, got {num_envs}; "
                f"repeat must be >= 1, got {repeat}"
            )
        self.parts = np.array_split(np.arange(num_envs), len(settings))
        self.venvs = [
            SonarVecEnv(len(part), threads=threads, **kind) for part, kind in zip(self.parts, settings, strict=True)
        ]
        self.memory, self.repeat = ObservationMemory(num_envs, settings=memory), repeat
        space = spaces.Box(-SHOWN_LIMIT, SHOWN_LIMIT, (self.memory.size,), np.float32)
        super().__init__(num_envs, space, self.venvs[0].action_space)
        self._all_rows = np.arange(num_envs)
        self._score, self._length = np.zeros(num_envs), np.zeros(num_envs, dtype=np.int64)
        self._actions = np.zeros((num_envs, 2), dtype=np.float32)
        self.ended: list[EpisodeResult] = []

    def reset(self) -> Singles:
        """Begin new episodes in all environments."""
        for part, venv in zip(self.parts, self.venvs, strict=True):
            if self._seeds[part[0]] is not None:
                venv.seed(self._seeds[part[0]])
            self.memory.reset(part)
            self.memory.update(part, venv.reset())
        self._reset_seeds()
        self._score[:], self._length[:] = 0.0, 0
        return self.memory.features(self._all_rows)

    def step_async(self, actions: NDArray[Any]) -> None:
        """Store the actions for `step_wait`."""
        self._actions = np.asarray(actions)

    def step_wait(self) -> Transition:
        """Repeat the stored actions; a car whose episode ends waits at the start of the next one."""
        rewards, done = np.zeros(self.num_envs, dtype=np.float32), np.zeros(self.num_envs, dtype=np.bool_)
        infos: Infos = [{} for _ in range(self.num_envs)]
        for _ in range(self.repeat):
            for part, venv in zip(self.parts, self.venvs, strict=True):
                actions = np.where(done[part, None], 0.0, self._actions[part])
                observation, reward, ended, part_infos = venv.step(actions)
                rewards[part] += np.where(done[part], 0.0, reward)
                self._end(part, ended & ~done[part], part_infos, infos)
                self.memory.update(part, as_dict(observation))
                done[part] |= ended
        self._count(rewards, done, infos)
        return self.memory.features(self._all_rows), rewards, done, infos

    def advance(self, actions: Singles) -> Transition:
        """Call `step`, with declared types."""
        self.step_async(actions)
        return self.step_wait()

    def _end(self, part: Ints, ended: Bits, part_infos: Infos, infos: Infos) -> None:
        """Store the last observation of episodes that end now, and clear the memory of their cars."""
        which = np.flatnonzero(ended)
        if not len(which):
            return
        rows = part[which]
        finals = [part_infos[k]["terminal_observation"] for k in which]
        self.memory.update(rows, {name: np.stack([final[name] for final in finals]) for name in finals[0]})
        for row, k, shown in zip(rows, which, self.memory.features(rows), strict=True):
            infos[row] = {**part_infos[k], "terminal_observation": shown}
        self.memory.reset(rows)

    def _count(self, rewards: Singles, done: Bits, infos: Infos) -> None:
        self._score += rewards
        self._length += 1
        for i in np.flatnonzero(done):
            score, length = float(self._score[i]), int(self._length[i])
            infos[i][EPISODE] = {"r": score, "l": length, "t": 0.0}
            self.ended.append(EpisodeResult(bool(infos[i]["is_success"]), bool(infos[i]["collision"]), score, length))
        self._score[done], self._length[done] = 0.0, 0

    def close(self) -> None:
        """Close all environments."""
        for venv in self.venvs:
            venv.close()

    # ---- methods that Stable-Baselines3 requires for single environments ---------------------------------------------

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """Return a shared attribute, once for each requested environment."""
        return [getattr(self, attr_name) for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Raise SettingError: settings are fixed at construction."""
        raise SettingError(f"AgentVecEnv: {attr_name!r} cannot be set; make a new environment")

    def env_method(self, method_name: str, *method_args: Any, indices: VecEnvIndices = None, **named: Any) -> list[Any]:
        """Raise SettingError: there are no single environments."""
        raise SettingError(f"AgentVecEnv: {method_name!r} cannot be called: there are no single environments")

    def env_is_wrapped(self, wrapper_class: type[gymnasium.Wrapper], indices: VecEnvIndices = None) -> list[bool]:
        """Return False for each requested environment."""
        return [False for _ in self._get_indices(indices)]
