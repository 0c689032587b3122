"""SonarObservation: environments with ideal ranges, one or many, get the readings of real sonars instead."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, is_dataclass
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.utils import RecordConstructorArgs
from gymnasium.vector import AutoresetMode, VectorEnv, VectorWrapper
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from acquisition import SettingError
from sonar_gym.parking.environment import SonarParkingEnv
from sonar_gym.parking.vector import MASK, SonarParkingVectorEnv, masked
from sonar_gym.sensing.sonar import Sonar, SonarChoice, resolve, sonar_spaces
from sonar_gym.sensing.timing import Listener, timing
from sonar_gym.wrappers.highway import RoadSource, is_road
from sonar_gym.wrappers.settings import Hearing
from sonar_gym.wrappers.sources import RangesSource, Source, StreetSource

Bits = NDArray[np.bool_]
Ints = NDArray[np.int64]
WRAPPER_TAG = 0x5EA2  # another stream than that of sonars inside the environment
GOAL_REWARD = "compute_reward"
ONE = np.zeros(1, dtype=np.int64)  # the row of a single environment


def plain(value: Any) -> Any:
    """Return a setting as it goes to JSON: paths as text, mounts as mappings, arrays as lists."""
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if is_dataclass(value) and not isinstance(value, type):
        return asdict(value) if type(value).__module__.startswith("sonar_gym") else value
    if isinstance(value, np.ndarray):
        return value.tolist()
    return [plain(item) for item in value] if isinstance(value, (list, tuple, range)) else value


def source_of(base: Any, space: spaces.Space[Any], hearing: Hearing, copies: int) -> Source:
    """Return where the conditions of pings come from: ranges where the settings say which, else what the world is."""
    told = hearing.key is not None or hearing.indices is not None
    if not told and isinstance(base, (SonarParkingEnv, SonarParkingVectorEnv)):
        return StreetSource(base.fleet, hearing)
    if not told and is_road(base):
        return RoadSource(base, space, hearing)
    return RangesSource(space, hearing, base, copies)


def listener_of(source: Source, sonar: SonarChoice, copies: int) -> Listener:
    """Return sonars that hear what a source meets."""
    model = resolve(sonar)
    sonars = Sonar(model, source.count, source.max_range, WRAPPER_TAG, source.tables(model), copies)
    return Listener(sonars, timing(source.count, source.step_s, source.times), source.step_s)


def space_of(source: Source) -> spaces.Dict:
    """Return the observation space of one environment with sonars."""
    age = spaces.Box(0.0, 1.0, (source.count,), np.float32)
    return spaces.Dict({**source.kept, **sonar_spaces(source.count), "age": age})


class SonarObservation(gymnasium.Wrapper, RecordConstructorArgs):
    """Replaces ideal ranges by readings drawn from a sonar's law, with the credence of each.

    It knows three kinds of world. In `SonarParking-v0` it takes the truth, whatever the sonar inside. In highway-env it
    casts cones of its own on `road.vehicles` and `road.objects`. Anywhere else the observation holds the ranges: a
    `Box`, or a `Box` at `key` of a `Dict`; the other conditions come from the environment where it offers them, else
    from a stated prior.

    The new observation is a `Dict`: `ranges` (shares of the maximum range, 1 without an echo), `credence` (given the
    reading), `echo` (1 echo, 0 silence, -1 no answer), `age` (s since the ping, at most 1), and whatever else the old
    one held: the other keys of a `Dict`; the numbers beside the ranges under `rest`, or under their key; on a road,
    what tells of the own vehicle, under `base` where it was no `Dict`. `info["sonar"]` holds the truth of the pings
    whose readings are shown.

    Credence given a reading is taken over a prior: the task's own streets for `SonarParking-v0`; elsewhere distances
    equally likely and the other conditions as told.

    Sonars may ping each at its own period and phase, and be heard after a latency, all in seconds; until the next
    reading the last one stays. Models that remember do so from ping to ping, and forget at each reset. The wrapper
    draws from a stream of its own: the same seed gives the same world with and without it. All settings of `Hearing`,
    and models given by name or path, go through the environment's spec and JSON.

    Args:
        env: to listen to.
        sonar: name, path or model.
        settings: fields of `sonar_gym.wrappers.settings.Hearing`.

    >>> import gymnasium, sonar_gym
    >>> env = SonarObservation(gymnasium.make("SonarParking-v0"), "gaussian", latency_s=0.05)
    >>> sorted(env.reset(seed=0)[0])
    ['age', 'credence', 'echo', 'ego', 'ranges']
    """

    def __init__(self, env: gymnasium.Env, sonar: SonarChoice = "ideal", **settings: Any) -> None:
        hearing = Hearing(**settings)
        recorded = {name: plain(value) for name, value in settings.items()}
        RecordConstructorArgs.__init__(self, _disable_deepcopy=True, sonar=plain(sonar), **recorded)
        gymnasium.Wrapper.__init__(self, env)
        self.source = source_of(env.unwrapped, env.observation_space, hearing, copies=1)
        self.listener = listener_of(self.source, sonar, copies=1)
        self.observation_space = space_of(self.source)

    @property
    def sonar(self) -> Sonar:
        """What draws the readings."""
        return self.listener.sonar

    def __getattr__(self, name: str) -> Any:
        """Where there are goals, their reward is the environment's own: hindsight replay asks the wrapper for it."""
        if name == GOAL_REWARD and self.env.has_wrapper_attr(name):
            return self.env.get_wrapper_attr(name)
        raise AttributeError(f"{type(self).__name__!r} has no attribute {name!r}")

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Forget previous readings, reset the environment, and listen."""
        self.sonar.forget()
        if seed is not None:
            self.sonar.seed(seed)
        observation, info = self.env.reset(seed=seed, options=options)
        self.source.begin(ONE, observation, info, self.sonar.rngs)
        self.listener.begin(ONE, self.source.meet(ONE, observation, info, self.sonar.rngs))
        return self._told(observation, info)

    def step(self, action: Any) -> tuple[dict[str, Any], Any, bool, bool, dict[str, Any]]:
        """Step the environment, then listen."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        self.listener.step(ONE, self.source.meet(ONE, observation, info, self.sonar.rngs))
        observation, info = self._told(observation, info)
        return observation, reward, terminated, truncated, info

    def _told(self, observation: Any, info: dict[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
        heard = {name: value[0] for name, value in self.listener.observation().items()}
        truth = {name: value[0] for name, value in self.listener.truth().items()}
        return {**self.source.rest(observation), **heard}, {**info, "sonar": truth}


class SonarVectorObservation(VectorWrapper, RecordConstructorArgs):
    """What `SonarObservation` is, for many environments at once: environment i hears what it would hear alone.

    Environment i's stream is seeded with `seed + i`, or with item i of a list of seeds. Memory is cleared where an
    episode begins, in all three autoreset modes. On roads each environment is to be wrapped instead:
    `gymnasium.make_vec(..., wrappers=[SonarObservation])`.

    Args:
        env: a vector environment.
        sonar: name, path or model, shared by all.
        settings: fields of `sonar_gym.wrappers.settings.Hearing`.
    """

    def __init__(self, env: VectorEnv, sonar: SonarChoice = "ideal", **settings: Any) -> None:
        hearing = Hearing(**settings)
        recorded = {name: plain(value) for name, value in settings.items()}
        RecordConstructorArgs.__init__(self, _disable_deepcopy=True, sonar=plain(sonar), **recorded)
        VectorWrapper.__init__(self, env)
        base = env.unwrapped
        inner = getattr(base, "envs", [base])[0].unwrapped
        if is_road(inner):
            raise SettingError("SonarVectorObservation hears no roads: wrap each, with make_vec(..., wrappers=[...])")
        world = base if isinstance(base, SonarParkingVectorEnv) else inner
        self.source = source_of(world, env.single_observation_space, hearing, env.num_envs)
        self.listener = listener_of(self.source, sonar, env.num_envs)
        self.single_observation_space = space_of(self.source)
        self.observation_space = batch_space(self.single_observation_space, env.num_envs)
        self.autoreset_mode = AutoresetMode(env.metadata.get("autoreset_mode", AutoresetMode.NEXT_STEP))
        self._rows = np.arange(env.num_envs)
        self._over = np.zeros(env.num_envs, dtype=np.bool_)

    @property
    def sonar(self) -> Sonar:
        """What draws the readings."""
        return self.listener.sonar

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Reset the environments, or those of `options["reset_mask"]`; forget what was read in them, and listen."""
        mask = np.array((options or {}).get(MASK, np.ones(self.num_envs)), dtype=np.bool_)
        for i, one in self._seeds(seed, mask):
            self.sonar.seed(one, i)
        observation, info = self.env.reset(seed=seed, options=options)  # type: ignore[arg-type]
        self._over[mask] = False
        self._begin(self._rows[mask], observation, info)
        return self._told(observation, info, mask)

    def _seeds(self, seed: int | Sequence[int | None] | None, mask: Bits) -> Iterator[tuple[int, int]]:
        """Return number and seed of the environments that are given one."""
        each = [seed + i for i in range(self.num_envs)] if isinstance(seed, (int, np.integer)) else seed
        for i, one in enumerate(each or ()):
            if one is not None and mask[i]:
                yield i, int(one)

    def step(self, actions: Any) -> tuple[dict[str, Any], Any, Bits, Bits, dict[str, Any]]:
        """Step the environments, then listen; what begins anew has forgotten what was read before."""
        observation, rewards, terminated, truncated, info = self.env.step(actions)
        over, mode = terminated | truncated, self.autoreset_mode
        if mode is AutoresetMode.SAME_STEP and over.any():
            info = {**info, **self._finals(self._rows[over], info)}
        begun = {AutoresetMode.NEXT_STEP: self._over, AutoresetMode.SAME_STEP: over}.get(mode, np.zeros_like(over))
        self._step(self._rows[~begun], observation, info)
        self._begin(self._rows[begun], observation, info)
        self._over = over
        observation, info = self._told(observation, info, np.ones(self.num_envs, dtype=np.bool_))
        return observation, rewards, terminated, truncated, info

    def _begin(self, rows: Ints, observation: Any, info: Mapping[str, Any]) -> None:
        if len(rows):
            part = rows_of(observation, rows), rows_of(info, rows), self.sonar.rngs
            self.source.begin(rows, *part)
            self.listener.begin(rows, self.source.meet(rows, *part))

    def _step(self, rows: Ints, observation: Any, info: Mapping[str, Any]) -> None:
        if len(rows):
            self._heard(rows, rows_of(observation, rows), rows_of(info, rows))

    def _heard(self, rows: Ints, observation: Any, info: Mapping[str, Any]) -> None:
        self.listener.step(rows, self.source.meet(rows, observation, info, self.sonar.rngs))

    def _finals(self, rows: Ints, info: Mapping[str, Any]) -> dict[str, Any]:
        """Return the last observations and infos of the episodes that are over, as their sonars heard them."""
        last, finals = [info["final_obs"][i] for i in rows], np.full(self.num_envs, None, dtype=object)
        self._heard(rows, stacked(last), rows_of(info["final_info"], rows))
        heard = self.listener.observation()
        for i, one in zip(rows, last, strict=True):
            finals[i] = {**self.source.rest(one), **{name: value[i].copy() for name, value in heard.items()}}
        truth = masked({"sonar": self.listener.truth()}, np.isin(self._rows, rows))
        return {"final_obs": finals, "final_info": {**info["final_info"], **truth}}

    def _told(self, observation: Any, info: dict[str, Any], mask: Bits) -> tuple[dict[str, Any], dict[str, Any]]:
        told = {**self.source.rest(observation), **self.listener.observation()}
        return told, {**info, **masked({"sonar": self.listener.truth()}, mask)}


def stacked(observations: Sequence[Any]) -> Any:
    """Return observations of single environments as one of many."""
    if not isinstance(observations[0], Mapping):
        return np.stack(observations)
    return {name: np.stack([one[name] for one in observations]) for name in observations[0]}


def rows_of(values: Any, rows: Ints) -> Any:
    """Return some rows of arrays, also of those in mappings; what has no rows is left out."""
    if not isinstance(values, Mapping):
        return np.asarray(values)[rows]
    return {name: rows_of(value, rows) for name, value in values.items() if isinstance(value, (np.ndarray, Mapping))}
