"""Where the conditions of pings come from: ranges that an environment observes, or the truth of the parking street.

A source serves n environments alike, one or many: what it is given has a leading axis of n, which a single environment
may leave out. `sonar_gym.wrappers.highway` is the third source.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from acquisition import SettingError
from noise import CredenceTable, SonarModel
from sonar_gym.parking.fleet import MAX_RANGE, STEP_S, Fleet
from sonar_gym.parking.prior import street_credence
from sonar_gym.sensing.sonar import bin_edges
from sonar_gym.sensing.timing import Met, Times
from sonar_gym.wrappers.settings import CONDITIONS, USUAL_RANGE, Condition, Hearing, prior_ping, usual_step

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Generators = Sequence[np.random.Generator]
REST = "rest"  # where the numbers beside the ranges go, when the observation was one vector


class Source(Protocol):
    """Where the conditions of pings come from.

    Attributes:
        count: of sonars.
        max_range: m.
        step_s: from observation to observation, s.
        times: of the sonars' pings.
        kept: spaces of what is kept of a single environment's observation.
    """

    count: int
    max_range: float
    step_s: float
    times: Times
    kept: dict[str, spaces.Space[Any]]

    def tables(self, model: SonarModel) -> Sequence[CredenceTable]:
        """Return the credence given a reading of each sonar."""
        ...

    def begin(self, rows: Ints, observation: Any, info: Mapping[str, Any], rngs: Generators) -> None:
        """Begin episodes in some environments, of which observation and info are."""
        ...

    def meet(self, rows: Ints, observation: Any, info: Mapping[str, Any], rngs: Generators) -> Met:
        """Return what the cones of some environments meet."""
        ...

    def rest(self, observation: Any) -> dict[str, Any]:
        """Return what is kept of an observation."""
        ...


class RangesSource:
    """Ranges in a `Box`, or in a `Box` of a `Dict`.

    Args:
        space: observation space of one environment.
        hearing: which of its numbers are ranges, and what is known of the rest.
        base: the environment, whose `dt` is the time between steps where it has one.
        copies: environments.
    """

    def __init__(self, space: spaces.Space[Any], hearing: Hearing, base: Any, copies: int) -> None:
        self.space, self.hearing, self.key = space, hearing, hearing.key
        self.step_s, self.times = hearing.step_s or usual_step(base), hearing.times
        self.max_range = hearing.max_range or USUAL_RANGE
        box = self._box()
        self._shape, self._mask = box.shape, self._range_mask(box)
        self.count = int(self._mask.sum())
        self.kept = self._rest_spaces(box)
        self.conditions: dict[str, Condition] = {name: getattr(hearing, name) for name in CONDITIONS}
        self._reflectance = np.ones((copies, self.count))

    def _box(self) -> spaces.Box:
        space = self.space
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

    def _range_mask(self, box: spaces.Box) -> NDArray[np.bool_]:
        size, indices = int(np.prod(box.shape)), self.hearing.indices
        mask = np.full(size, indices is None)
        for index in indices if indices is not None else ():
            if not 0 <= index < size:
                raise SettingError(f"SonarObservation.indices must lie in [0, {size - 1}], got {index}")
            mask[index] = True
        if not mask.any():
            raise SettingError("SonarObservation.indices holds 0 indices, expected 1 or more")
        return mask

    def _rest_spaces(self, box: spaces.Box) -> dict[str, spaces.Space[Any]]:
        parts = self.space.spaces if isinstance(self.space, spaces.Dict) else {}
        rest: dict[str, spaces.Space[Any]] = {name: part for name, part in parts.items() if name != self.key}
        if not self._mask.all():
            low, high = box.low.ravel()[~self._mask], box.high.ravel()[~self._mask]
            rest[self.key or REST] = spaces.Box(low, high, dtype=box.dtype.type)
        return rest

    def tables(self, model: SonarModel) -> Sequence[CredenceTable]:
        """Return the credence given a reading, under the prior that the conditions make."""
        ping = prior_ping(self.conditions, self.max_range)
        return [CredenceTable.over(model, ping, bin_edges(self.max_range))] * self.count

    def begin(self, rows: Ints, observation: Any, info: Mapping[str, Any], rngs: Generators) -> None:
        """Draw what stays as it is through an episode: the reflectances, where they are not told at every step."""
        self._reflectance[rows] = self._drawn("reflectance", rows, observation, info, rngs)

    def meet(self, rows: Ints, observation: Any, info: Mapping[str, Any], rngs: Generators) -> Met:
        """Take the ranges out of the observation, and the other conditions from where they come."""
        told = self._flat(observation)[..., self._mask].reshape(len(rows), self.count)
        distance = told * self.hearing.metres_per_unit
        if self.hearing.empty is not None:
            distance[told == self.hearing.empty] = np.inf
        if np.any(np.isnan(distance)) or np.any(distance < 0.0):
            raise SettingError("SonarObservation met a range that is negative or NaN: check key, indices and unit")
        seen = distance < self.max_range * (1.0 - 1e-6)  # float32 rounds a maximum range to either side
        anew = isinstance(self.conditions["reflectance"], str)
        bearing, incidence = (self._drawn(name, rows, observation, info, rngs) for name in ("bearing", "incidence"))
        reflectance = self._drawn("reflectance", rows, observation, info, rngs) if anew else self._reflectance[rows]
        return Met(distance, bearing, incidence, reflectance, seen)

    def rest(self, observation: Any) -> dict[str, Any]:
        """Return the other keys, and the numbers beside the ranges."""
        rest = {name: value for name, value in observation.items() if name != self.key} if self.key else {}
        if not self._mask.all():
            part = observation[self.key] if self.key else observation
            rest[self.key or REST] = self._flat(observation)[..., ~self._mask].astype(part.dtype)
        return rest

    def _flat(self, observation: Any) -> Floats:
        """Return the array that holds the ranges, (..., size)."""
        whole = np.asarray(observation[self.key] if self.key else observation, dtype=np.float64)
        return whole.reshape(*whole.shape[: whole.ndim - len(self._shape)], -1)

    def _drawn(self, name: str, rows: Ints, observation: Any, info: Mapping[str, Any], rngs: Generators) -> Floats:
        """Return a condition of every sonar, (r, s)."""
        source, shape = self.conditions[name], (len(rows), self.count)
        if isinstance(source, tuple):
            return np.stack([rngs[row].uniform(*source, size=self.count) for row in rows])
        if not isinstance(source, str):
            return np.full(shape, source)
        inside = self.key is not None and source in observation
        if not inside and source not in info:
            raise SettingError(f"SonarObservation.{name} {source!r}: neither the observation nor info holds that key")
        value = np.asarray(observation[source] if inside else info[source], dtype=np.float64)
        if value.shape not in (shape, shape[1:]):
            raise SettingError(f"SonarObservation.{name} {source!r} has shape {value.shape}, expected {shape[1:]}")
        return value.reshape(shape)


class StreetSource:
    """The truth of SonarParking-v0, whatever sonar it has of its own.

    Args:
        fleet: of the environment, single or many.
        hearing: maximum range and times alone count.
    """

    def __init__(self, fleet: Fleet, hearing: Hearing) -> None:
        self.fleet, self.count, self.step_s, self.times = fleet, len(fleet.mounts), STEP_S, hearing.times
        self.max_range = hearing.max_range or MAX_RANGE
        if any(mount.period_s or mount.latency_s for mount in fleet.mounts):
            raise SettingError(
                "SonarObservation needs the truth at every step, and this layout's sonars ping less often or are heard "
                "later: make the environment with sonar_layout='eight', and give periods and latencies to the wrapper"
            )
        self.kept = {"ego": fleet.observation_space.spaces["ego"]}

    def tables(self, model: SonarModel) -> Sequence[CredenceTable]:
        """Return the credence given a reading in streets of the task's kind."""
        return street_credence(
            model, self.fleet.street_settings, self.fleet.car_settings, self.fleet.mounts, self.max_range
        )

    def begin(self, rows: Ints, observation: Any, info: Mapping[str, Any], rngs: Generators) -> None:
        """Begin episodes: nothing stays from the last, nothing is drawn."""

    def meet(self, rows: Ints, observation: Any, info: Mapping[str, Any], rngs: Generators) -> Met:
        """Take the truth from info."""
        parts = (info[name] for name in ("distance", "bearing", "incidence", "reflectance", "in_cone"))
        distance, bearing, incidence, reflectance, in_cone = (
            np.asarray(part).reshape(len(rows), self.count) for part in parts
        )
        return Met(distance, bearing, incidence, reflectance, in_cone & (distance < self.max_range))

    def rest(self, observation: Any) -> dict[str, Any]:
        """Return what odometry and clock tell."""
        return {"ego": observation["ego"]}
