"""Sources of the paths of pings, and the sonars that hear them: here, ranges that an environment observes.

A source serves one environment or n of them. Its inputs have a leading axis of n, which a single environment may omit.
`sonar_gym.wrappers.highway` contains the other source. `SonarParking-v0` needs none: its own sonars are replaced.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np
from gymnasium import spaces

from acquisition import SettingError
from acquisition.arrays import Bits, Floats, Ints
from noise import CredenceTable, SonarModel
from sonar_gym.sensing import paths, records
from sonar_gym.sensing.laws.numbers import Streams
from sonar_gym.sensing.paths import MAX_PATHS, N_PATH
from sonar_gym.sensing.pipeline import Sensing
from sonar_gym.sensing.records import PingArrays
from sonar_gym.sensing.sonar import Sonar, bin_edges
from sonar_gym.sensing.timing import Times, timing
from sonar_gym.wrappers.settings import (
    CONDITION_NAMES,
    DEFAULT_MAX_RANGE,
    ConditionSetting,
    SonarSettings,
    default_step,
    prior_ping,
)

Generators = Sequence[np.random.Generator] | Streams
REST = "rest"  # key of the numbers that are not ranges, if the observation was a single array


class Paths(NamedTuple):
    """Paths of a ping of each of s sonars in r environments.

    Attributes:
        paths: the paths that a law is given, see `paths.cast_paths`, (r, s, MAX_PATHS, N_PATH).
        counts: number of paths, (r, s).
    """

    paths: Floats
    counts: Ints


class PathSource(Protocol):
    """Source of the paths of pings.

    Attributes:
        names: names of the sonars.
        max_range: maximum range, m.
        step_s: time between observations, s.
        times: period, phase and latency of the pings, s.
        retained_spaces: spaces of the retained parts of an observation, for one environment.
    """

    names: tuple[str, ...]
    max_range: float
    step_s: float
    times: Times
    retained_spaces: dict[str, spaces.Space[Any]]

    def tables(self, model: SonarModel) -> Floats:
        """Return the credence given a reading for each sonar, on `bin_edges`, (s, BINS)."""
        ...

    def begin(self, rows: Ints, observation: Any, info: Mapping[str, Any], rngs: Generators) -> None:
        """Begin episodes in some environments, given their observations and infos."""
        ...

    def paths(self, rows: Ints, observation: Any, info: Mapping[str, Any], rngs: Generators) -> Paths:
        """Return the paths of pings sent now in some environments."""
        ...

    def hear_others(self, pings: PingArrays) -> None:
        """Add the paths of other sonars' bursts to pings that were sent, if the faces are known."""
        ...

    def retained(self, observation: Any) -> dict[str, Any]:
        """Return the retained parts of an observation."""
        ...


class RangesSource:
    """Conditions from ranges in a `Box`, or in a `Box` of a `Dict`.

    Args:
        space: observation space of one environment.
        settings: which numbers are ranges, and where the other conditions come from.
        base: the environment; its `dt`, if any, is the time between steps.
        copies: number of environments.
    """

    def __init__(self, space: spaces.Space[Any], settings: SonarSettings, base: Any, copies: int) -> None:
        self.space, self.settings, self.key = space, settings, settings.key
        self.step_s, self.times = settings.step_s or default_step(base), settings.times
        self.max_range = settings.max_range or DEFAULT_MAX_RANGE
        box = self._box()
        self._shape, self._mask = box.shape, self._range_mask(box)
        self.count = int(self._mask.sum())
        self.names = tuple(f"range {i}" for i in range(self.count))
        self.retained_spaces = self._retained_spaces(box)
        self._sources: dict[str, ConditionSetting] = {name: getattr(settings, name) for name in CONDITION_NAMES}
        self._reflectance = np.ones((copies, self.count))

    def _box(self) -> spaces.Box:
        space = self.space
        if isinstance(space, spaces.Dict):
            if self.key not in space.spaces:
                names = ", ".join(space.spaces)
                raise SettingError(f"SonarObservation.key {self.key!r}: not in the observation, which has {names}")
            space = space.spaces[self.key]
        elif self.key is not None:
            raise SettingError(f"SonarObservation.key {self.key!r}: the observation is not a Dict; omit the key")
        if not isinstance(space, spaces.Box):
            raise SettingError(f"SonarObservation needs ranges in a Box, got {space}: give the key of a Box")
        return space

    def _range_mask(self, box: spaces.Box) -> Bits:
        size, indices = int(np.prod(box.shape)), self.settings.indices
        mask = np.full(size, indices is None)
        for index in indices if indices is not None else ():
            if not 0 <= index < size:
                raise SettingError(f"SonarObservation.indices must lie in [0, {size - 1}], got {index}")
            mask[index] = True
        if not mask.any():
            raise SettingError("SonarObservation.indices holds 0 indices, expected 1 or more")
        return mask

    def _retained_spaces(self, box: spaces.Box) -> dict[str, spaces.Space[Any]]:
        parts = self.space.spaces if isinstance(self.space, spaces.Dict) else {}
        out: dict[str, spaces.Space[Any]] = {name: part for name, part in parts.items() if name != self.key}
        if not self._mask.all():
            low, high = box.low.ravel()[~self._mask], box.high.ravel()[~self._mask]
            out[self.key or REST] = spaces.Box(low, high, dtype=box.dtype.type)
        return out

    def tables(self, model: SonarModel) -> Floats:
        """Return the credence given a reading under the prior that the settings imply, (s, BINS)."""
        table = CredenceTable.over(model, prior_ping(self._sources, self.max_range), bin_edges(self.max_range))
        return np.tile(table.values, (self.count, 1))

    def begin(self, rows: Ints, observation: Any, info: Mapping[str, Any], rngs: Generators) -> None:
        """Draw the reflectances of the episode."""
        self._reflectance[rows] = self._values("reflectance", rows, observation, info, rngs)

    def paths(self, rows: Ints, observation: Any, info: Mapping[str, Any], rngs: Generators) -> Paths:
        """Return one path per sonar: the observed range, and the other conditions by keys, constants or priors."""
        ranges = self._flat(observation)[..., self._mask].reshape(len(rows), self.count)
        distance = ranges * self.settings.metres_per_unit
        if self.settings.empty is not None:
            distance[ranges == self.settings.empty] = np.inf
        if np.any(np.isnan(distance)) or np.any(distance < 0.0):
            raise SettingError("SonarObservation: a range is negative or NaN; check key, indices and empty")
        in_range = distance < self.max_range * (1.0 - 1e-6)  # float32 rounds a maximum range to either side
        every_step = isinstance(self._sources["reflectance"], str)
        bearing, incidence = (self._values(name, rows, observation, info, rngs) for name in ("bearing", "incidence"))
        reflectance = (
            self._values("reflectance", rows, observation, info, rngs) if every_step else self._reflectance[rows]
        )
        out = np.zeros((len(rows), self.count, MAX_PATHS, N_PATH))
        one = out[:, :, 0]
        one[..., paths.DISTANCE] = np.where(np.isinf(distance), self.max_range, distance)
        one[..., paths.BEARING] = bearing
        one[..., paths.INCIDENCE], one[..., paths.REFLECTANCE] = incidence, reflectance
        one[..., paths.OBSTACLE] = one[..., paths.FACE] = np.where(in_range, np.arange(self.count), -1)
        return Paths(out, np.ones((len(rows), self.count), np.int64))

    def hear_others(self, pings: PingArrays) -> None:
        """Add nothing: ranges do not tell by which faces a sonar hears another."""

    def retained(self, observation: Any) -> dict[str, Any]:
        """Return the other keys, and the numbers that are not ranges."""
        out = {name: value for name, value in observation.items() if name != self.key} if self.key else {}
        if not self._mask.all():
            part = observation[self.key] if self.key else observation
            out[self.key or REST] = self._flat(observation)[..., ~self._mask].astype(part.dtype)
        return out

    def _flat(self, observation: Any) -> Floats:
        """Return the array that contains the ranges, (..., size)."""
        whole = np.asarray(observation[self.key] if self.key else observation, dtype=np.float64)
        return whole.reshape(*whole.shape[: whole.ndim - len(self._shape)], -1)

    def _values(self, name: str, rows: Ints, observation: Any, info: Mapping[str, Any], rngs: Generators) -> Floats:
        """Return one condition for every sonar, (r, s)."""
        source, shape = self._sources[name], (len(rows), self.count)
        if isinstance(source, tuple):
            return np.stack([rngs[row].uniform(*source, size=self.count) for row in rows])
        if not isinstance(source, str):
            return np.full(shape, source)
        observed = self.key is not None and source in observation
        if not observed and source not in info:
            raise SettingError(f"SonarObservation.{name} {source!r}: neither the observation nor info has that key")
        value = np.asarray(observation[source] if observed else info[source], dtype=np.float64)
        if value.shape not in (shape, shape[1:]):
            raise SettingError(f"SonarObservation.{name} {source!r} has shape {value.shape}, expected {shape[1:]}")
        return value.reshape(shape)


class ObservedSonars:
    """Sonars in environments that are known only at their observations.

    Args:
        source: paths of the pings.
        sonar: sonars, with one copy per environment.
    """

    def __init__(self, source: PathSource, sonar: Sonar) -> None:
        self.source, self.step_s = source, source.step_s
        self.sensing = Sensing(
            sonar, timing(source.names, source.step_s, source.times, source.max_range), source.step_s
        )
        pings = self.sensing.pings
        self._before = np.zeros_like(pings.paths), np.ones_like(pings.n_paths)
        self._steps = np.zeros(sonar.copies, np.int64)

    def begin(self, rows: Ints, observation: Any, info: Mapping[str, Any]) -> None:
        """Begin episodes in some environments: all sonars ping, and their readings are shown at once."""
        rngs, pings = self.sensing.sonar.rngs, self.sensing.pings
        self.source.begin(rows, observation, info, rngs)
        now = self.source.paths(rows, observation, info, rngs)
        self._steps[rows] = 0
        self.sensing.begin(rows)
        pings.paths[: len(rows)], pings.n_paths[: len(rows)] = now
        self._before[0][rows], self._before[1][rows] = now
        self.source.hear_others(pings)
        self.sensing.update(rows, np.zeros(len(rows)))

    def step(self, rows: Ints, observation: Any, info: Mapping[str, Any]) -> None:
        """Advance some environments by one observation."""
        now = self.source.paths(rows, observation, info, self.sensing.sonar.rngs)
        begin: Floats = self._steps[rows] * np.float64(self.step_s)
        self._steps[rows] += 1
        end: Floats = self._steps[rows] * np.float64(self.step_s)
        records.fire(rows, begin, self.step_s, self.sensing.timing, *now, *self._before, self.sensing.pings)
        self.source.hear_others(self.sensing.pings)
        self.sensing.update(rows, end)
