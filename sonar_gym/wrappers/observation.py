"""Wrappers that replace the ideal ranges of one environment, or of a vector environment, by sonar readings."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, is_dataclass
from typing import Any, Literal

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.utils import RecordConstructorArgs
from gymnasium.vector import AutoresetMode, VectorEnv, VectorWrapper
from gymnasium.vector.utils import batch_space

from acquisition import SettingError
from acquisition.arrays import Bits, Ints
from acquisition.limits import SEEDS, check_number, is_list, shown
from sonar_gym.checks import check_options, settings_of
from sonar_gym.parking.environment import SonarParkingEnv
from sonar_gym.parking.fleet import MAX_RANGE, Fleet
from sonar_gym.parking.vector import MASK, SonarParkingVectorEnv, masked
from sonar_gym.sensing.mounts import Layout
from sonar_gym.sensing.pipeline import Sensing
from sonar_gym.sensing.sonar import Sonar, SonarChoice, resolve, sonar_spaces
from sonar_gym.wrappers.highway import RoadSource, is_road
from sonar_gym.wrappers.settings import ConditionSetting, SonarSettings, given_settings
from sonar_gym.wrappers.sources import ObservedSonars, PathSource, RangesSource

WRAPPER_TAG = 0x5EA2  # of the random stream; differs from that of the sonars inside the environment
GOAL_REWARD = "compute_reward"
ONE = np.zeros(1, dtype=np.int64)  # row index of a single environment


def as_text(path: Any) -> Any:
    """Return a path as text, and anything else as it is."""
    return os.fspath(path) if isinstance(path, os.PathLike) else path


def json_value(value: Any) -> Any:
    """Return a valid setting in a form that JSON can store: paths as text, mounts as mappings, arrays as lists."""
    if is_dataclass(value) and not isinstance(value, type):
        return asdict(value) if type(value).__module__.startswith("sonar_gym") else value
    if isinstance(value, np.ndarray):
        return value.tolist()
    return [json_value(item) for item in value] if isinstance(value, (list, tuple, range)) else as_text(value)


def observed_sonars(
    base: Any, space: spaces.Space[Any], settings: SonarSettings, sonar: SonarChoice, copies: int
) -> ObservedSonars:
    """Return the sonars of an environment that has none: on its road, or by observed ranges if `key` is set."""
    model = resolve(sonar)
    on_road = is_road(base) and not settings.explicit
    source: PathSource = (
        RoadSource(base, space, settings, model) if on_road else RangesSource(space, settings, base, copies)
    )
    sonars = Sonar(model, len(source.names), source.max_range, WRAPPER_TAG, source.tables(model), copies)
    return ObservedSonars(source, sonars)


def space_of(count: int, retained: dict[str, spaces.Space[Any]]) -> spaces.Dict:
    """Return the observation space of one environment with sonars.

    Raises:
        SettingError: a retained part has the name of what the sonars observe.
    """
    own = {**sonar_spaces(count), "age": spaces.Box(0.0, 1.0, (count,), np.float32)}
    hidden = [name for name in own if name in retained]
    if hidden and set(hidden) != set(own) - {"ranges"}:  # these are of the environment's sonars, which are replaced
        raise SettingError(
            f"SonarObservation: the retained part {hidden[0]!r} of the observation has the name of a part that the "
            "sonars give: rename it before you wrap the environment, as with gymnasium.wrappers.TransformObservation"
        )
    return spaces.Dict({**retained, **own})


def fleet_of(base: Any, settings: SonarSettings, sonar: SonarChoice) -> Fleet | None:
    """Return the cars of a parking environment with their sonars replaced, or None for another environment."""
    if settings.explicit or not isinstance(base, (SonarParkingEnv, SonarParkingVectorEnv)):
        return None
    times = settings.times if settings.timed else None
    base.fleet.install(sonar, settings.max_range or MAX_RANGE, times, WRAPPER_TAG)
    return base.fleet


class SonarObservation(gymnasium.Wrapper, RecordConstructorArgs):
    """Replaces ideal ranges by readings drawn from a sonar model, each with its credence.

    Three kinds of environment are supported. In `SonarParking-v0` the sonars of the environment are replaced. In
    highway-env cones are cast on `road.vehicles` and `road.objects`. Elsewhere the ranges are read from the
    observation: a `Box`, or the `Box` at `key` of a `Dict`; the other conditions come from the environment if it
    provides them, else from a prior.

    The new observation is a `Dict` of `ranges` (fraction of the maximum range, 1 without an echo), `credence` (given
    the reading), `echo` (1 echo, 0 no echo, -1 no answer), `age` (time since the ping, s, at most 1) and the retained
    parts of the old observation: the other keys of a `Dict`; the numbers that are not ranges, under `rest` or under
    their key; on a road, the state of the controlled vehicle, under `base` if it was not a `Dict`. `info["sonar"]`
    holds the true conditions of the pings whose readings are shown.

    The credence given a reading assumes a prior: the streets of the task for `SonarParking-v0`; elsewhere uniform
    distances, and the other conditions as set.

    Each sonar may have its own period, phase and latency, in seconds; a reading is shown until the next one arrives.
    Models with memory carry it from ping to ping and lose it at each reset. The wrapper has its own random stream: for
    the same seed the environment behaves identically with and without the wrapper. All arguments that
    differ from their defaults, and models given by name or path, are stored in the environment's spec and its JSON.

    Args:
        env: environment to wrap.
        sonar: name, path or model.
        key: key of the ranges in a `Dict` observation.
        indices: indices of the ranges in the flattened array; None: all.
        empty: value of the observation for a ray that hits nothing, as -1 of MuJoCo's rangefinders. Infinity, and any
            value at or beyond `max_range`, always means that nothing is in reach.
        metres_per_unit: length in metres, for the sonar, of one unit of the observation, or of 1 m of a road.
        max_range: maximum range of the sonars, m; anything at or beyond it gives no echo. None: 3.01 m in the parking
            street, 6 m elsewhere.
        incidence: angle between beam and surface normal, rad: a constant, a pair (uniform, drawn at every step), or a
            key of the observation or of `info`.
        bearing: angle of the reflector off the beam axis, rad; same choices.
        reflectance: reflectance of the reflector; same choices, but a pair is drawn once per episode and sonar.
        sonar_layout: on a road, mounts relative to the centre of the vehicle, or mappings of their fields; times given
            there take precedence. None: eight sonars, four per bumper.
        keep: part of a road observation to retain: "own" (the state of the controlled vehicle), "all" or "nothing".
        step_s: time between observations, s. None: that of the environment, else 0.1 s.
        period_s: time between pings, s, one number or one per sonar; 0: one ping per observation, or fewer where the
            real sensor needs longer.
        phase_s: time of the first ping, s, one number or one per sonar.
        latency_s: time from a ping to its reading, s, one number or one per sonar. None: that of the real sensor, 65 ms
            for a maximum range of 11 m.
        crosstalk: whether the sonars on a road also receive each other's bursts by way of a face; those of the parking
            street follow the setting of the environment, and observed ranges do not tell.

    >>> import gymnasium, sonar_gym
    >>> env = SonarObservation(gymnasium.make("SonarParking-v0"), "gaussian", latency_s=0.05)
    >>> sorted(env.reset(seed=0)[0])
    ['age', 'credence', 'echo', 'ego', 'ranges']
    """

    def __init__(
        self,
        env: gymnasium.Env,
        sonar: SonarChoice = "ideal",
        *,
        key: str | None = None,
        indices: Sequence[int] | None = None,
        empty: float | None = None,
        metres_per_unit: float = 1.0,
        max_range: float | None = None,
        incidence: ConditionSetting = (0.0, 0.4),
        bearing: ConditionSetting = 0.0,
        reflectance: ConditionSetting = (0.1, 0.9),
        sonar_layout: Layout | None = None,
        keep: Literal["own", "all", "nothing"] = "own",
        step_s: float | None = None,
        period_s: float | Sequence[float] = 0.0,
        phase_s: float | Sequence[float] = 0.0,
        latency_s: float | Sequence[float] | None = None,
        crosstalk: bool = True,
    ) -> None:
        settings = given_settings(locals())
        if not isinstance(env, gymnasium.Env):
            raise SettingError(f"SonarObservation.env: expected a gymnasium.Env, got {shown(env)}")
        sonar_settings: SonarSettings = settings_of(SonarSettings, settings)
        recorded = {name: json_value(value) for name, value in settings.items()}
        RecordConstructorArgs.__init__(self, _disable_deepcopy=True, sonar=as_text(sonar), **recorded)
        gymnasium.Wrapper.__init__(self, env)
        self.fleet = fleet_of(env.unwrapped, sonar_settings, sonar)
        if self.fleet is None:
            self.observed = observed_sonars(env.unwrapped, env.observation_space, sonar_settings, sonar, copies=1)
            self.source = self.observed.source
            self.observation_space = space_of(self.sonar.count, self.source.retained_spaces)

    @property
    def sensing(self) -> Sensing:
        """The sensing pipeline."""
        return self.observed.sensing if self.fleet is None else self.fleet.sensing

    @property
    def sonar(self) -> Sonar:
        """The sonars, which draw the readings."""
        return self.sensing.sonar

    def __getattr__(self, name: str) -> Any:
        """Provide `compute_reward` of a goal environment, which hindsight experience replay calls on the wrapper."""
        if name == GOAL_REWARD and self.env.has_wrapper_attr(name):
            return self.env.get_wrapper_attr(name)
        raise AttributeError(f"{type(self).__name__!r} has no attribute {name!r}")

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Clear the memory of the sonars, reset the environment, and ping."""
        if seed is not None:
            check_number("seed", seed, SEEDS, whole=True)
            self.sonar.seed(seed)
        observation, info = self.env.reset(seed=seed, options=options)
        if self.fleet is None:
            self.observed.begin(ONE, observation, info)
        return self._output(observation, info)

    def step(self, action: Any) -> tuple[dict[str, Any], Any, bool, bool, dict[str, Any]]:
        """Step the environment, then ping."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        if self.fleet is None:
            self.observed.step(ONE, observation, info)
        observation, info = self._output(observation, info)
        return observation, reward, terminated, truncated, info

    def _output(self, observation: Any, info: dict[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
        info = {**info, "sonar": self.sensing.truth(0)}
        if self.fleet is not None:
            return observation, info
        return {**self.source.retained(observation), **self.sensing.observation(0)}, info


class SonarVectorObservation(VectorWrapper, RecordConstructorArgs):
    """`SonarObservation` for vector environments: environment i gets the same readings as if it were wrapped alone.

    The random stream of environment i is seeded with `seed + i`, or with item i of a list of seeds. The memory of a
    model is cleared where an episode begins, in all three autoreset modes. Environments of highway-env are wrapped one
    by one instead: `gymnasium.make_vec(..., wrappers=[SonarObservation])`. The arguments are those of
    `SonarObservation`; the sonar is shared by all environments.
    """

    def __init__(
        self,
        env: VectorEnv,
        sonar: SonarChoice = "ideal",
        *,
        key: str | None = None,
        indices: Sequence[int] | None = None,
        empty: float | None = None,
        metres_per_unit: float = 1.0,
        max_range: float | None = None,
        incidence: ConditionSetting = (0.0, 0.4),
        bearing: ConditionSetting = 0.0,
        reflectance: ConditionSetting = (0.1, 0.9),
        sonar_layout: Layout | None = None,
        keep: Literal["own", "all", "nothing"] = "own",
        step_s: float | None = None,
        period_s: float | Sequence[float] = 0.0,
        phase_s: float | Sequence[float] = 0.0,
        latency_s: float | Sequence[float] | None = None,
        crosstalk: bool = True,
    ) -> None:
        settings = given_settings(locals())
        if not isinstance(env, VectorEnv):
            raise SettingError(f"SonarVectorObservation.env: expected a gymnasium.vector.VectorEnv, got {shown(env)}")
        sonar_settings: SonarSettings = settings_of(SonarSettings, settings)
        recorded = {name: json_value(value) for name, value in settings.items()}
        RecordConstructorArgs.__init__(self, _disable_deepcopy=True, sonar=as_text(sonar), **recorded)
        VectorWrapper.__init__(self, env)
        base = env.unwrapped
        inner = getattr(base, "envs", [base])[0].unwrapped
        if is_road(inner):
            raise SettingError(
                "SonarVectorObservation does not support highway-env: wrap each environment alone, "
                "with make_vec(..., wrappers=[SonarObservation])"
            )
        self.fleet = fleet_of(base, sonar_settings, sonar)
        if self.fleet is None:
            self.observed = observed_sonars(inner, env.single_observation_space, sonar_settings, sonar, env.num_envs)
            self.source = self.observed.source
            self.single_observation_space = space_of(self.sonar.count, self.source.retained_spaces)
            self.observation_space = batch_space(self.single_observation_space, env.num_envs)
        self.autoreset_mode = AutoresetMode(env.metadata.get("autoreset_mode", AutoresetMode.NEXT_STEP))
        self._rows = np.arange(env.num_envs)
        self._done = np.zeros(env.num_envs, dtype=np.bool_)

    @property
    def sensing(self) -> Sensing:
        """The sensing pipeline."""
        return self.observed.sensing if self.fleet is None else self.fleet.sensing

    @property
    def sonar(self) -> Sonar:
        """The sonars, which draw the readings."""
        return self.sensing.sonar

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Reset all environments, or those of `options["reset_mask"]`; clear the memory of their sonars, and ping."""
        check_options(options)
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
        if each is None:
            return
        if not is_list(each) or len(each) != self.num_envs:
            raise SettingError(f"seed: expected a whole number or {self.num_envs} of them, got {shown(seed)}")
        for i, one in enumerate(each):
            if one is not None and mask[i]:
                check_number("seed", one, SEEDS, whole=True)
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
        if len(rows) and self.fleet is None:
            self.observed.begin(rows, rows_of(observation, rows), rows_of(info, rows))

    def _step(self, rows: Ints, observation: Any, info: Mapping[str, Any]) -> None:
        if len(rows) and self.fleet is None:
            self.observed.step(rows, rows_of(observation, rows), rows_of(info, rows))

    def _finals(self, rows: Ints, info: Mapping[str, Any]) -> dict[str, Any]:
        """Return the final observations and infos of the episodes that have ended, with their readings."""
        final = info["final_info"]
        if self.fleet is not None:
            truth = {name: value for name, value in final.items() if name in self.sensing.truth(0)}
            return {"final_info": {**final, **masked({"sonar": truth}, np.isin(self._rows, rows))}}
        last, final_obs = [info["final_obs"][i] for i in rows], np.full(self.num_envs, None, dtype=object)
        self.observed.step(rows, stacked(last), rows_of(final, rows))
        for i, one in zip(rows, last, strict=True):
            final_obs[i] = {**self.source.retained(one), **self.sensing.observation(i)}
        truth = masked({"sonar": self.sensing.truth(slice(None))}, np.isin(self._rows, rows))
        return {"final_obs": final_obs, "final_info": {**final, **truth}}

    def _output(self, observation: Any, info: dict[str, Any], mask: Bits) -> tuple[dict[str, Any], dict[str, Any]]:
        info = {**info, **masked({"sonar": self.sensing.truth(slice(None))}, mask)}
        if self.fleet is not None:
            return observation, info
        return {**self.source.retained(observation), **self.sensing.observation(slice(None))}, info


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
