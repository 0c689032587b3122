"""Wrappers that replace the ideal ranges of one environment, or of a vector environment, by sonar readings."""

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

from acquisition import SettingError
from acquisition.arrays import Bits, Ints
from sonar_gym.parking.environment import SonarParkingEnv
from sonar_gym.parking.vector import MASK, SonarParkingVectorEnv, masked
from sonar_gym.sensing.sonar import Sonar, SonarChoice, resolve, sonar_spaces
from sonar_gym.sensing.timing import PingSchedule, timing
from sonar_gym.wrappers.highway import RoadSource, is_road
from sonar_gym.wrappers.settings import SonarSettings
from sonar_gym.wrappers.sources import ConditionSource, RangesSource, StreetSource

WRAPPER_TAG = 0x5EA2  # of the random stream; differs from that of the sonars inside the environment
GOAL_REWARD = "compute_reward"
ONE = np.zeros(1, dtype=np.int64)  # row index of a single environment


def json_value(value: Any) -> Any:
    """Return a setting in a form that JSON can store: paths as text, mounts as mappings, arrays as lists."""
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if is_dataclass(value) and not isinstance(value, type):
        return asdict(value) if type(value).__module__.startswith("sonar_gym") else value
    if isinstance(value, np.ndarray):
        return value.tolist()
    return [json_value(item) for item in value] if isinstance(value, (list, tuple, range)) else value


def source_of(base: Any, space: spaces.Space[Any], settings: SonarSettings, copies: int) -> ConditionSource:
    """Return the source of the conditions: observed ranges if `key` or `indices` is set."""
    explicit = settings.key is not None or settings.indices is not None
    if not explicit and isinstance(base, (SonarParkingEnv, SonarParkingVectorEnv)):
        return StreetSource(base.fleet, settings)
    if not explicit and is_road(base):
        return RoadSource(base, space, settings)
    return RangesSource(space, settings, base, copies)


def timed_sonars(source: ConditionSource, sonar: SonarChoice, copies: int) -> PingSchedule:
    """Return sonars with the range, credence tables and ping times of a source."""
    model = resolve(sonar)
    sonars = Sonar(model, source.count, source.max_range, WRAPPER_TAG, source.tables(model), copies)
    return PingSchedule(sonars, timing(source.count, source.step_s, source.times), source.step_s)


def space_of(source: ConditionSource) -> spaces.Dict:
    """Return the observation space of one environment with sonars."""
    age = spaces.Box(0.0, 1.0, (source.count,), np.float32)
    return spaces.Dict({**source.retained_spaces, **sonar_spaces(source.count), "age": age})


class SonarObservation(gymnasium.Wrapper, RecordConstructorArgs):
    """Replaces ideal ranges by readings drawn from a sonar model, each with its credence.

    Three kinds of environment are supported. In `SonarParking-v0` the true conditions are used, whatever sonar the
    environment itself has. In highway-env cones are cast on `road.vehicles` and `road.objects`. Elsewhere the ranges
    are read from the observation: a `Box`, or the `Box` at `key` of a `Dict`; the other conditions come from the
    environment if it provides them, else from a prior.

    The new observation is a `Dict` of `ranges` (fraction of the maximum range, 1 without an echo), `credence` (given
    the reading), `echo` (1 echo, 0 no echo, -1 no answer), `age` (time since the ping, s, at most 1) and the retained
    parts of the old observation: the other keys of a `Dict`; the numbers that are not ranges, under `rest` or under
    their key; on a road, the state of the controlled vehicle, under `base` if it was not a `Dict`. `info["sonar"]`
    holds the true conditions of the pings whose readings are shown.

    The credence given a reading assumes a prior: the streets of the task for `SonarParking-v0`; elsewhere uniform
    distances, and the other conditions as set.

    Each sonar may have its own period, phase and latency, in seconds; a reading is shown until the next one arrives.
    Models with memory carry it from ping to ping and lose it at each reset. The wrapper has its own random stream: for
    the same seed the environment behaves identically with and without the wrapper. All fields of `SonarSettings`, and
    models given by name or path, are stored in the environment's spec and its JSON.

    Args:
        env: environment to wrap.
        sonar: name, path or model.
        settings: fields of `sonar_gym.wrappers.settings.SonarSettings`.

    >>> import gymnasium, sonar_gym
    >>> env = SonarObservation(gymnasium.make("SonarParking-v0"), "gaussian", latency_s=0.05)
    >>> sorted(env.reset(seed=0)[0])
    ['age', 'credence', 'echo', 'ego', 'ranges']
    """

    def __init__(self, env: gymnasium.Env, sonar: SonarChoice = "ideal", **settings: Any) -> None:
        sonar_settings = SonarSettings(**settings)
        recorded = {name: json_value(value) for name, value in settings.items()}
        RecordConstructorArgs.__init__(self, _disable_deepcopy=True, sonar=json_value(sonar), **recorded)
        gymnasium.Wrapper.__init__(self, env)
        self.source = source_of(env.unwrapped, env.observation_space, sonar_settings, copies=1)
        self.timed_sonars = timed_sonars(self.source, sonar, copies=1)
        self.observation_space = space_of(self.source)

    @property
    def sonar(self) -> Sonar:
        """The sonars, which draw the readings."""
        return self.timed_sonars.sonar

    def __getattr__(self, name: str) -> Any:
        """Provide `compute_reward` of a goal environment, which hindsight experience replay calls on the wrapper."""
        if name == GOAL_REWARD and self.env.has_wrapper_attr(name):
            return self.env.get_wrapper_attr(name)
        raise AttributeError(f"{type(self).__name__!r} has no attribute {name!r}")

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Clear the memory of the sonars, reset the environment, and ping."""
        self.sonar.clear_memory()
        if seed is not None:
            self.sonar.seed(seed)
        observation, info = self.env.reset(seed=seed, options=options)
        self.source.begin(ONE, observation, info, self.sonar.rngs)
        self.timed_sonars.begin(ONE, self.source.conditions(ONE, observation, info, self.sonar.rngs))
        return self._output(observation, info)

    def step(self, action: Any) -> tuple[dict[str, Any], Any, bool, bool, dict[str, Any]]:
        """Step the environment, then ping."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        self.timed_sonars.step(ONE, self.source.conditions(ONE, observation, info, self.sonar.rngs))
        observation, info = self._output(observation, info)
        return observation, reward, terminated, truncated, info

    def _output(self, observation: Any, info: dict[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
        readings = {name: value[0] for name, value in self.timed_sonars.observation().items()}
        truth = {name: value[0] for name, value in self.timed_sonars.truth().items()}
        return {**self.source.retained(observation), **readings}, {**info, "sonar": truth}


class SonarVectorObservation(VectorWrapper, RecordConstructorArgs):
    """`SonarObservation` for vector environments: environment i gets the same readings as if it were wrapped alone.

    The random stream of environment i is seeded with `seed + i`, or with item i of a list of seeds. The memory of a
    model is cleared where an episode begins, in all three autoreset modes. Environments of highway-env are wrapped one
    by one instead: `gymnasium.make_vec(..., wrappers=[SonarObservation])`.

    Args:
        env: vector environment to wrap.
        sonar: name, path or model, shared by all environments.
        settings: fields of `sonar_gym.wrappers.settings.SonarSettings`.
    """

    def __init__(self, env: VectorEnv, sonar: SonarChoice = "ideal", **settings: Any) -> None:
        sonar_settings = SonarSettings(**settings)
        recorded = {name: json_value(value) for name, value in settings.items()}
        RecordConstructorArgs.__init__(self, _disable_deepcopy=True, sonar=json_value(sonar), **recorded)
        VectorWrapper.__init__(self, env)
        base = env.unwrapped
        inner = getattr(base, "envs", [base])[0].unwrapped
        if is_road(inner):
            raise SettingError(
                "SonarVectorObservation does not support highway-env: wrap each environment alone, "
                "with make_vec(..., wrappers=[SonarObservation])"
            )
        sample = base if isinstance(base, SonarParkingVectorEnv) else inner
        self.source = source_of(sample, env.single_observation_space, sonar_settings, env.num_envs)
        self.timed_sonars = timed_sonars(self.source, sonar, env.num_envs)
        self.single_observation_space = space_of(self.source)
        self.observation_space = batch_space(self.single_observation_space, env.num_envs)
        self.autoreset_mode = AutoresetMode(env.metadata.get("autoreset_mode", AutoresetMode.NEXT_STEP))
        self._rows = np.arange(env.num_envs)
        self._done = np.zeros(env.num_envs, dtype=np.bool_)

    @property
    def sonar(self) -> Sonar:
        """The sonars, which draw the readings."""
        return self.timed_sonars.sonar

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Reset all environments, or those of `options["reset_mask"]`; clear the memory of their sonars, and ping."""
        mask = np.array((options or {}).get(MASK, np.ones(self.num_envs)), dtype=np.bool_)
        for i, one in self._seeds(seed, mask):
            self.sonar.seed(one, i)
        observation, info = self.env.reset(seed=seed, options=options)  # type: ignore[arg-type]
        self._done[mask] = False
        self._begin(self._rows[mask], observation, info)
        return self._output(observation, info, mask)

    def _seeds(self, seed: int | Sequence[int | None] | None, mask: Bits) -> Iterator[tuple[int, int]]:
        """Yield index and seed of the environments to seed."""
        each = [seed + i for i in range(self.num_envs)] if isinstance(seed, (int, np.integer)) else seed
        for i, one in enumerate(each or ()):
            if one is not None and mask[i]:
                yield i, int(one)

    def step(self, actions: Any) -> tuple[dict[str, Any], Any, Bits, Bits, dict[str, Any]]:
        """Step the environments, then ping; where an episode begins, the memory of the sonars is cleared first."""
        observation, rewards, terminated, truncated, info = self.env.step(actions)
        done, mode = terminated | truncated, self.autoreset_mode
        if mode is AutoresetMode.SAME_STEP and done.any():
            info = {**info, **self._finals(self._rows[done], info)}
        began = {AutoresetMode.NEXT_STEP: self._done, AutoresetMode.SAME_STEP: done}.get(mode, np.zeros_like(done))
        self._step(self._rows[~began], observation, info)
        self._begin(self._rows[began], observation, info)
        self._done = done
        observation, info = self._output(observation, info, np.ones(self.num_envs, dtype=np.bool_))
        return observation, rewards, terminated, truncated, info

    def _begin(self, rows: Ints, observation: Any, info: Mapping[str, Any]) -> None:
        if len(rows):
            part = rows_of(observation, rows), rows_of(info, rows), self.sonar.rngs
            self.source.begin(rows, *part)
            self.timed_sonars.begin(rows, self.source.conditions(rows, *part))

    def _step(self, rows: Ints, observation: Any, info: Mapping[str, Any]) -> None:
        if len(rows):
            self._ping(rows, rows_of(observation, rows), rows_of(info, rows))

    def _ping(self, rows: Ints, observation: Any, info: Mapping[str, Any]) -> None:
        self.timed_sonars.step(rows, self.source.conditions(rows, observation, info, self.sonar.rngs))

    def _finals(self, rows: Ints, info: Mapping[str, Any]) -> dict[str, Any]:
        """Return the final observations and infos of the episodes that have ended, with their readings."""
        last, final_obs = [info["final_obs"][i] for i in rows], np.full(self.num_envs, None, dtype=object)
        self._ping(rows, stacked(last), rows_of(info["final_info"], rows))
        readings = self.timed_sonars.observation()
        for i, one in zip(rows, last, strict=True):
            final_obs[i] = {**self.source.retained(one), **{name: value[i].copy() for name, value in readings.items()}}
        truth = masked({"sonar": self.timed_sonars.truth()}, np.isin(self._rows, rows))
        return {"final_obs": final_obs, "final_info": {**info["final_info"], **truth}}

    def _output(self, observation: Any, info: dict[str, Any], mask: Bits) -> tuple[dict[str, Any], dict[str, Any]]:
        out = {**self.source.retained(observation), **self.timed_sonars.observation()}
        return out, {**info, **masked({"sonar": self.timed_sonars.truth()}, mask)}


def stacked(observations: Sequence[Any]) -> Any:
    """Stack observations of single environments into one of a vector environment."""
    if not isinstance(observations[0], Mapping):
        return np.stack(observations)
    return {name: np.stack([one[name] for one in observations]) for name in observations[0]}


def rows_of(values: Any, rows: Ints) -> Any:
    """Return some rows of arrays, also inside mappings; mapping values without rows are omitted."""
    if not isinstance(values, Mapping):
        return np.asarray(values)[rows]
    return {name: rows_of(value, rows) for name, value in values.items() if isinstance(value, (np.ndarray, Mapping))}
