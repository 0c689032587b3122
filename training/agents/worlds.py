"""The worlds in which an agent learns: several kinds of street and sonar at once, shown to it through its memory."""

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
from noise import SonarModel, load_model
from noise.faults import Faulty, Noise, Short
from sonar_gym.control.memory import Memory, MemorySettings
from sonar_gym.sb3 import SonarVecEnv

Singles = NDArray[np.float32]
Bits = NDArray[np.bool_]
World = Mapping[str, Any]
Infos = list[dict[str, Any]]
Outcome = tuple[Singles, Singles, Bits, list[dict[str, Any]]]
CAUTION = 10.0  # most that a memory shows; anything beyond is a fault
FAULTS = (Short(0.05), Noise(0.1, 0.05))  # that training gives a sonar: of nothing there, and of 50 mm; ours
EPISODE = "episode"  # under which Stable-Baselines3 looks for what an episode came to


def with_faults(model: SonarModel) -> Faulty:
    """Return a sonar that is now and then wrong, so that nobody who drives with it learns to rely on one reading."""
    return Faulty(model, FAULTS)


def worlds_of(
    sonars: Sequence[str], odometry: Sequence[str], difficulty: Sequence[str], faults: bool = False
) -> list[World]:
    """Return every kind of world of some sonars, kinds of odometry and of street.

    Args:
        sonars: names or folders of models.
        odometry: exact, wheels, worn.
        difficulty: easy, normal, hard.
        faults: whether each sonar is also there with faults.
    """
    heard: list[str | SonarModel] = [*sonars]
    if faults:
        heard += [with_faults(load_model(name)) for name in sonars]
    names = ("sonar", "odometry", "difficulty")
    return [dict(zip(names, kind, strict=True)) for kind in product(heard, odometry, difficulty)]


def as_dict(observation: Any) -> dict[str, Singles]:
    """Return what worlds of several sonars say; Stable-Baselines3 cannot tell that it is a dictionary."""
    assert isinstance(observation, dict)
    return observation


class Ended(NamedTuple):
    """What an episode came to: whether the car parked, or touched something; sum of rewards; decisions."""

    success: bool
    collision: bool
    score: float
    length: int


class AgentVecEnv(VecEnv):
    """n cars in worlds of several kinds, each shown as its memory.

    Args:
        num_envs: cars in all; shared out evenly.
        worlds: settings of `SonarParkingVectorEnv`, one mapping a kind.
        memory: what is remembered.
        repeat: steps of 0.1 s for which an action holds.
        threads: that share the work of stepping.

    Attributes:
        ended: the episodes that are over, in their order; to be emptied by whoever counts them.
    """

    render_mode = None

    def __init__(
        self, num_envs: int, worlds: Sequence[World], memory: MemorySettings, repeat: int = 1, threads: int = 1
    ) -> None:
        if num_envs < len(worlds) or repeat < 1:
            raise SettingError(
                f"num_envs must be >= {len(worlds)}, one for each kind of world, got {num_envs}; "
                f"repeat must be >= 1, got {repeat}"
            )
        self.parts = np.array_split(np.arange(num_envs), len(worlds))
        self.venvs = [
            SonarVecEnv(len(part), threads=threads, **world) for part, world in zip(self.parts, worlds, strict=True)
        ]
        self.memory, self.repeat = Memory(num_envs, settings=memory), repeat
        space = spaces.Box(-CAUTION, CAUTION, (self.memory.size,), np.float32)
        super().__init__(num_envs, space, self.venvs[0].action_space)
        self._everyone = np.arange(num_envs)
        self._score, self._length = np.zeros(num_envs), np.zeros(num_envs, dtype=np.int64)
        self._actions = np.zeros((num_envs, 2), dtype=np.float32)
        self.ended: list[Ended] = []

    def reset(self) -> Singles:
        """Begin new episodes in all worlds."""
        for part, venv in zip(self.parts, self.venvs, strict=True):
            if self._seeds[part[0]] is not None:
                venv.seed(self._seeds[part[0]])
            self.memory.forget(part)
            self.memory.see(part, venv.reset())
        self._reset_seeds()
        self._score[:], self._length[:] = 0.0, 0
        return self.memory.show(self._everyone)

    def step_async(self, actions: NDArray[Any]) -> None:
        """Note what is wanted."""
        self._actions = np.asarray(actions)

    def step_wait(self) -> Outcome:
        """Do it for some steps; a car whose episode ends stands at the next one's beginning for the rest of them."""
        rewards, done = np.zeros(self.num_envs, dtype=np.float32), np.zeros(self.num_envs, dtype=np.bool_)
        infos: Infos = [{} for _ in range(self.num_envs)]
        for _ in range(self.repeat):
            for part, venv in zip(self.parts, self.venvs, strict=True):
                wanted = np.where(done[part, None], 0.0, self._actions[part])
                observation, reward, ended, told = venv.step(wanted)
                rewards[part] += np.where(done[part], 0.0, reward)
                self._end(part, ended & ~done[part], told, infos)
                self.memory.see(part, as_dict(observation))
                done[part] |= ended
        self._count(rewards, done, infos)
        return self.memory.show(self._everyone), rewards, done, infos

    def advance(self, actions: Singles) -> Outcome:
        """Return `step`, its types known."""
        self.step_async(actions)
        return self.step_wait()

    def _end(self, part: NDArray[np.int64], ended: Bits, told: Infos, infos: Infos) -> None:
        """Keep what episodes came to that end now, and clear the memory of their cars."""
        which = np.flatnonzero(ended)
        if not len(which):
            return
        rows = part[which]
        finals = [told[k]["terminal_observation"] for k in which]
        self.memory.see(rows, {name: np.stack([final[name] for final in finals]) for name in finals[0]})
        for row, k, shown in zip(rows, which, self.memory.show(rows), strict=True):
            infos[row] = {**told[k], "terminal_observation": shown}
        self.memory.forget(rows)

    def _count(self, rewards: Singles, done: Bits, infos: Infos) -> None:
        self._score += rewards
        self._length += 1
        for i in np.flatnonzero(done):
            score, length = float(self._score[i]), int(self._length[i])
            infos[i][EPISODE] = {"r": score, "l": length, "t": 0.0}
            self.ended.append(Ended(bool(infos[i]["is_success"]), bool(infos[i]["collision"]), score, length))
        self._score[done], self._length[done] = 0.0, 0

    def close(self) -> None:
        """Close all worlds."""
        for venv in self.venvs:
            venv.close()

    # ---- what Stable-Baselines3 asks of single environments ----------------------------------------------------------

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """Return an attribute, which all share, once for each environment asked."""
        return [getattr(self, attr_name) for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Refuse: worlds are made as they are."""
        raise SettingError(f"AgentVecEnv: {attr_name!r} cannot be set; make another one")

    def env_method(self, method_name: str, *method_args: Any, indices: VecEnvIndices = None, **named: Any) -> list[Any]:
        """Refuse: there are no single environments."""
        raise SettingError(f"AgentVecEnv: there are no single environments to call {method_name!r} of")

    def env_is_wrapped(self, wrapper_class: type[gymnasium.Wrapper], indices: VecEnvIndices = None) -> list[bool]:
        """Nothing is wrapped."""
        return [False for _ in self._get_indices(indices)]
