"""Sources of the conditions of pings: ranges that an environment observes, or the true state of the parking street.

A source serves one environment or n of them. Its inputs have a leading axis of n, which a single environment may omit.
`sonar_gym.wrappers.highway` contains the third source.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import numpy as np
from gymnasium import spaces

from acquisition import SettingError
from acquisition.arrays import Bits, Floats, Ints
from noise import CredenceTable, SonarModel
from sonar_gym.parking.fleet import MAX_RANGE, STEP_S, Fleet
from sonar_gym.parking.prior import street_credence
from sonar_gym.sensing.sonar import bin_edges
from sonar_gym.sensing.timing import PingConditions, Times
from sonar_gym.wrappers.settings import (
    CONDITION_NAMES,
    DEFAULT_MAX_RANGE,
    ConditionSetting,
    SonarSettings,
    default_step,
    prior_ping,
)

Generators = Sequence[np.random.Generator]
REST = "rest"  # key of the numbers that are not ranges, if the observation was a single array


class ConditionSource(Protocol):
    """Source of the conditions of pings.

    Attributes:
        count: number of sonars.
        max_range: maximum range, m.
        step_s: time between observations, s.
        times: period, phase and latency of the pings, s.
        retained_spaces: spaces of the retained parts of an observation, for one environment.
    """

    count: int
    max_range: float
    step_s: float
    times: Times
    retained_spaces: dict[str, spaces.Space[Any]]

    def tables(self, model: SonarModel) -> Sequence[CredenceTable]:
        """Return the credence given a reading, one table per sonar."""
        ...

    def begin(self, rows: Ints, observation: Any, info: Mapping[str, Any], rngs: Generators) -> None:
        """Begin episodes in some environments, given their observations and infos."""
        ...

    def conditions(self, rows: Ints, observation: Any, info: Mapping[str, Any], rngs: Generators) -> PingConditions:
        """Return the conditions of pings sent now in some environments."""
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

    def tables(self, model: SonarModel) -> Sequence[CredenceTable]:
        """Return the credence given a reading under the prior that the settings imply, one table per sonar."""
        ping = prior_ping(self._sources, self.max_range)
        return [CredenceTable.over(model, ping, bin_edges(self.max_range))] * self.count

    def begin(self, rows: Ints, observation: Any, info: Mapping[str, Any], rngs: Generators) -> None:
        """Draw the reflectances of the episode."""
        self._reflectance[rows] = self._values("reflectance", rows, observation, info, rngs)

    def conditions(self, rows: Ints, observation: Any, info: Mapping[str, Any], rngs: Generators) -> PingConditions:
        """Return the observed ranges with the other conditions, from their keys, constants or priors."""
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
        return PingConditions(distance, bearing, incidence, reflectance, in_range)

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


class StreetSource:
    """True conditions of SonarParking-v0, whatever the sonar inside the environment.

    Args:
        fleet: state of the environments, one or many.
        settings: maximum range and times; the other settings are not used.
    """

    def __init__(self, fleet: Fleet, settings: SonarSettings) -> None:
        self.fleet, self.count, self.step_s, self.times = fleet, len(fleet.mounts), STEP_S, settings.times
        self.max_range = settings.max_range or MAX_RANGE
        if any(mount.period_s or mount.latency_s for mount in fleet.mounts):
            raise SettingError(
                "SonarObservation needs the true conditions at every step, but the sonars of this layout have periods "
                "or latencies: make the environment with sonar_layout='eight', and give the times to the wrapper"
            )
        self.retained_spaces = {"ego": fleet.observation_space.spaces["ego"]}

    def tables(self, model: SonarModel) -> Sequence[CredenceTable]:
        """Return the credence given a reading in streets of the task, one table per sonar."""
        return street_credence(
            model, self.fleet.street_settings, self.fleet.car_settings, self.fleet.mounts, self.max_range
        )

    def begin(self, rows: Ints, observation: Any, info: Mapping[str, Any], rngs: Generators) -> None:
        """Do nothing: no condition is drawn per episode."""

    def conditions(self, rows: Ints, observation: Any, info: Mapping[str, Any], rngs: Generators) -> PingConditions:
        """Return the true conditions in `info`."""
        parts = (info[name] for name in ("distance", "bearing", "incidence", "reflectance", "in_cone"))
        distance, bearing, incidence, reflectance, in_cone = (
            np.asarray(part).reshape(len(rows), self.count) for part in parts
        )
        return PingConditions(distance, bearing, incidence, reflectance, in_cone & (distance < self.max_range))

    def retained(self, observation: Any) -> dict[str, Any]:
        """Return the odometry and the elapsed time."""
        return {"ego": observation["ego"]}
