"""SonarObservation: any environment with ideal ranges gets the readings of a real sonar instead."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.utils import RecordConstructorArgs
from numpy.typing import ArrayLike, NDArray

from acquisition import Ping, SettingError
from noise import CredenceTable
from sonar_gym.scene import EMPTY_M
from sonar_gym.sonar import BEARINGS_DEG, BINS, Heard, Sonar, SonarChoice, bin_edges, resolve, sonar_spaces

Floats = NDArray[np.float64]
Condition = float | tuple[float, float] | str  # the same for all, the limits of a uniform prior, or a key
WRAPPER_TAG = 0x5EA2  # another stream than that of sonars inside the environment
PRIOR_ROUNDS = 15  # samples of the other conditions for each distance of the prior
REST = "rest"  # where the numbers beside the ranges go, when the observation was one vector


def plain(sonar: SonarChoice) -> Any:
    """Return a sonar as it goes to JSON: paths as text."""
    return os.fspath(sonar) if isinstance(sonar, os.PathLike) else sonar


def check_condition(name: str, given: Any) -> Condition:
    """Return a number, a pair of limits or a key, or say what is wrong."""
    if isinstance(given, str):
        return given
    pair = tuple(float(x) for x in given) if isinstance(given, Sequence) else (float(given), float(given))
    if len(pair) != 2 or not pair[0] <= pair[1] or not np.all(np.isfinite(pair)):
        raise SettingError(f"SonarObservation.{name} must be a number, two limits low <= high, or a key, got {given!r}")
    return pair if isinstance(given, Sequence) else pair[0]


def prior_ping(conditions: Mapping[str, Condition], max_range: float) -> Ping:
    """Return a sample of what the sonars may face: what the wrapper is told of it, and broad where it is not.

    Distances are equally likely up to `max_range` m. A condition that comes from a key is taken to be one of those a
    cone of 55 deg; bearing and incidence alike, as of faces parallel to the sensor's.
    """
    rng, distance = np.random.default_rng(0), np.tile(np.linspace(0.01, max_range, 2 * BINS), PRIOR_ROUNDS)
    n = len(distance)
    angle = np.radians(rng.choice(BEARINGS_DEG, n))
    broad = {"incidence": angle, "bearing": angle, "reflectance": rng.uniform(0.1, 0.9, n)}
    told = {
        name: broad[name] if isinstance(c, str) else rng.uniform(*c, n) if isinstance(c, tuple) else np.full(n, c)
        for name, c in conditions.items()
    }
    return Ping.of(distance, told["bearing"], told["incidence"], told["reflectance"])


class SonarObservation(gymnasium.ObservationWrapper, RecordConstructorArgs):
    """Replaces ideal ranges by readings drawn from a sonar's law, with the credence of each.

    The new observation is a `Dict`: `ranges` (shares of `max_range`, 1 without an echo), `credence` (given the
    reading), `echo` (1 echo, 0 silence, -1 no answer), and whatever else the old one held: the other keys of a `Dict`
    as they were; the numbers beside the ranges of a vector under `rest`, or under their own key of a `Dict`.
    `info["sonar"]` holds the true `distance` (m) and `credence_given_condition`.

    Credence given a reading is taken over a prior: distances equally likely, the other conditions as told below. Where
    the scene is known better than that, a table of its own is better (`sonar_gym.prior` is that of the parking task).

    The wrapper draws from a stream of its own: the same seed gives the same world with and without it. Model by name
    or path goes through the environment's spec and JSON.

    Args:
        env: whose observation is a `Box`, or a `Dict` with a `Box` at `key`.
        sonar: name, path or model.
        key: of the ranges in a `Dict`.
        indices: of the ranges in the flattened array; all of it by default.
        metres_per_unit: what 1 in the observation stands for, m.
        max_range: the sonar's greatest range, m; what the observation puts there or beyond it is an empty cone.
        incidence: between beam and surface normal, rad: a number, a pair (uniform, drawn anew every step), or a key of
            the observation or of `info`.
        bearing: of the reflector off the beam axis, rad; likewise.
        reflectance: of the reflector; likewise, but a pair is drawn once an episode for each sonar.
        step_s: time between steps, s.

    >>> import gymnasium, sonar_gym
    >>> env = SonarObservation(gymnasium.make("SonarParking-v0"), "gaussian", key="ranges", metres_per_unit=3.01,
    ...     max_range=3.01, incidence="incidence", bearing="bearing", reflectance="reflectance")
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
        metres_per_unit: float = 1.0,
        max_range: float = 6.0,
        incidence: Condition = (0.0, 0.4),
        bearing: Condition = 0.0,
        reflectance: Condition = (0.1, 0.9),
        step_s: float = 0.1,
    ) -> None:
        indices = None if indices is None else [int(i) for i in indices]
        given = {"incidence": incidence, "bearing": bearing, "reflectance": reflectance}
        self.conditions = {name: check_condition(name, value) for name, value in given.items()}
        RecordConstructorArgs.__init__(
            self,
            _disable_deepcopy=True,
            sonar=plain(sonar),
            key=key,
            indices=indices,
            metres_per_unit=metres_per_unit,
            max_range=max_range,
            step_s=step_s,
            **self.conditions,
        )
        gymnasium.ObservationWrapper.__init__(self, env)
        for name, value in (("metres_per_unit", metres_per_unit), ("max_range", max_range)):
            if not value > 0.0:
                raise SettingError(f"SonarObservation.{name} must be > 0 m, got {value:g} m")
        self.key, self.metres_per_unit, self.max_range, self.step_s = key, metres_per_unit, max_range, step_s
        box = self._ranges_box()
        self._mask = self._range_mask(box, indices)
        model, count = resolve(sonar), int(self._mask.sum())
        table = CredenceTable.over(model, prior_ping(self.conditions, max_range), bin_edges(max_range))
        self.sonar = Sonar(model, count, max_range, WRAPPER_TAG, [table] * count)
        self.observation_space = spaces.Dict({**self._rest_spaces(box), **sonar_spaces(self.sonar.count)})
        self._steps = 0
        self._info: dict[str, Any] = {}
        self._reflectance: ArrayLike = 1.0

    # ---- spaces ------------------------------------------------------------------------------------------------------

    def _ranges_box(self) -> spaces.Box:
        space = self.env.observation_space
        if isinstance(space, spaces.Dict):
            if self.key not in space.spaces:
                raise SettingError(
                    f"SonarObservation.key {self.key!r}: the observation holds {', '.join(space.spaces)}"
                )
            space = space.spaces[self.key]
        elif self.key is not None:
            raise SettingError(f"SonarObservation.key {self.key!r}: the observation is no Dict; leave the key out")
        if not isinstance(space, spaces.Box):
            raise SettingError(f"SonarObservation needs ranges in a Box, got {space}: give the key of one")
        return space

    def _range_mask(self, box: spaces.Box, indices: Sequence[int] | None) -> NDArray[np.bool_]:
        size = int(np.prod(box.shape))
        mask = np.full(size, indices is None)
        for index in indices or ():
            if not 0 <= index < size:
                raise SettingError(f"SonarObservation.indices must lie in [0, {size - 1}], got {index}")
            mask[index] = True
        if not mask.any():
            raise SettingError("SonarObservation.indices holds 0 indices, expected 1 or more")
        return mask

    def _rest_spaces(self, box: spaces.Box) -> dict[str, spaces.Space[Any]]:
        space = self.env.observation_space
        parts = space.spaces if isinstance(space, spaces.Dict) else {}
        rest: dict[str, spaces.Space[Any]] = {name: part for name, part in parts.items() if name != self.key}
        if not self._mask.all():
            low, high = box.low.ravel()[~self._mask], box.high.ravel()[~self._mask]
            rest[self.key or REST] = spaces.Box(low, high, dtype=box.dtype.type)
        return rest

    @property
    def _is_dict(self) -> bool:
        return isinstance(self.env.observation_space, spaces.Dict)

    # ---- what happens ------------------------------------------------------------------------------------------------

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Forget previous readings, reset the environment, and listen."""
        self.sonar.forget()
        if seed is not None:
            self.sonar.seed(seed)
        self._steps = 0
        observation, info = self.env.reset(seed=seed, options=options)
        self._reflectance = self._draw("reflectance", observation, info)
        return self._listen(observation, info)

    def step(self, action: Any) -> tuple[dict[str, Any], Any, bool, bool, dict[str, Any]]:
        """Step the environment, then listen."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        self._steps += 1
        observation, info = self._listen(observation, info)
        return observation, reward, terminated, truncated, info

    def _listen(self, observation: Any, info: dict[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
        self._info = info
        distance, heard, out = self._hear(observation)
        truth = {"distance": distance, "credence_given_condition": heard.credence_given_condition}
        return out, {**info, "sonar": truth}

    def observation(self, observation: Any) -> dict[str, Any]:
        """Return the observation with readings in place of ideal ranges; each call is one ping."""
        return self._hear(observation)[2]

    def _hear(self, observation: Any) -> tuple[Floats, Heard, dict[str, Any]]:
        whole = np.asarray(observation[self.key] if self._is_dict else observation)
        flat = whole.ravel()
        distance = flat[self._mask].astype(np.float64) * self.metres_per_unit
        if np.any(np.isnan(distance)) or np.any(distance < 0.0):
            raise SettingError("SonarObservation met a range that is negative or NaN: check key, indices and unit")
        seen = distance < self.max_range * (1.0 - 1e-6)  # float32 rounds a maximum range to either side
        heard = self.sonar.listen(self._ping(np.where(seen, distance, EMPTY_M), observation), seen)
        rest = {name: value for name, value in observation.items() if name != self.key} if self._is_dict else {}
        if not self._mask.all():
            rest[self.key or REST] = flat[~self._mask]
        return distance, heard, {**rest, **heard.observation(self.max_range)}

    def _ping(self, distance: Floats, observation: Any) -> Ping:
        reflectance = self._reflectance
        if isinstance(self.conditions["reflectance"], str):
            reflectance = self._draw("reflectance", observation, self._info)
        return Ping.of(
            distance=distance,
            angle=self._draw("bearing", observation, self._info),
            incidence=self._draw("incidence", observation, self._info),
            reflectance=reflectance,
            time=self._steps * self.step_s,
            run=np.arange(self.sonar.count),
        )

    def _draw(self, name: str, observation: Any, info: Mapping[str, Any]) -> Floats:
        """Return a condition of every sonar, (n,)."""
        source, n = self.conditions[name], self.sonar.count
        if isinstance(source, tuple):
            return self.sonar.rng.uniform(*source, size=n)
        if isinstance(source, str):
            inside = self._is_dict and source in observation
            if not inside and source not in info:
                raise SettingError(
                    f"SonarObservation.{name} {source!r}: neither the observation nor info holds that key"
                )
            value = np.asarray(observation[source] if inside else info[source], dtype=np.float64)
            if value.shape != (n,):
                raise SettingError(f"SonarObservation.{name} {source!r} has shape {value.shape}, expected ({n},)")
            return value
        return np.full(n, source)
