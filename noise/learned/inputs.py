"""Features of pings for a network, and the distance of a ping from the learned conditions."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from acquisition import Ping
from acquisition.arrays import Bits, Floats, Ints

NATURAL_SPAN = {"distance": 0.1, "angle": 0.05, "incidence": 0.05, "reflectance": 0.1}  # m, rad, rad, 1
LOG_OFFSET_M = 0.02  # m; added to the distance to limit the slope of its logarithm


class FeatureBatch(NamedTuple):
    """Features of n pings.

    Attributes:
        feature: features within -1..1, (n, width).
        distance: true distances, m, (n,).
        excess: distance of each condition from the learned range, relative to its width, (n,).
        missing: whether a covariate is missing, (n,) bool.
    """

    feature: Floats
    distance: Floats
    excess: Floats
    missing: Bits


@dataclass(frozen=True)
class Inputs:
    """Definition of the features of a network, with the learned ranges.

    A covariate that is absent or NaN is marked as missing; the network has learned the law over all of its values for
    this case.

    Attributes:
        names: names of the conditions and covariates, "distance" first.
        low, high: learned range of each quantity.
        folded: whether bearings and incidences had one sign, so that only their magnitude is used.
        tied: whether incidence always equalled bearing, so that only bearing is used.
        open_end: whether distances beyond the learned range are equivalent to its end, out of range of the sensor.
    """

    names: tuple[str, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]
    folded: bool = False
    tied: bool = False
    open_end: bool = False

    @classmethod
    def of(cls, ping: Ping, names: tuple[str, ...], horizon: float | None = None) -> Inputs:
        """Determine the ranges from pings.

        Args:
            ping: conditions of a recording.
            names: logged quantities, "distance" first; incidence is omitted if it always equals bearing.
            horizon: distance beyond which there is no echo, m; all farther pings are one condition.
        """
        turned = np.concatenate([ping.angle, ping.incidence])
        folded = bool(np.all(turned >= 0) or np.all(turned <= 0))
        tied = bool(np.allclose(np.abs(ping.angle), np.abs(ping.incidence)))
        used = tuple(name for name in names if not (tied and name == "incidence"))
        value = cls(used, (), (), folded, tied).raw(ping)
        low, high = np.nanmin(value, axis=0), np.nanmax(value, axis=0)
        beyond = bool(horizon is not None and high[0] > horizon)
        high[0] = horizon if beyond else high[0]
        return cls(used, tuple(map(float, low)), tuple(map(float, high)), folded, tied, beyond)

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> Inputs:
        """Build from plain data, in which tuples are lists."""
        ranges = {key: tuple(map(float, data[key])) for key in ("low", "high")}
        if not len(data["names"]) == len(ranges["low"]) == len(ranges["high"]):
            raise ValueError("inputs: names, low and high differ in number")
        flags = [bool(data[key]) for key in ("folded", "tied", "open_end")]
        return cls(tuple(data["names"]), ranges["low"], ranges["high"], *flags)

    @cached_property
    def covariates(self) -> tuple[str, ...]:
        """Names of the optional quantities."""
        return tuple(name for name in self.names if name not in NATURAL_SPAN)

    @cached_property
    def width(self) -> int:
        """Number of features."""
        return len(self.names) + 1 + len(self.covariates)

    def raw(self, ping: Ping) -> Floats:
        """Return the named quantities, (n, names); NaN for a missing covariate."""
        value = np.empty((len(ping), len(self.names)))
        for k, name in enumerate(self.names):
            value[:, k] = self._column(ping, name)
        return value

    def _column(self, ping: Ping, name: str) -> Floats | float:
        if name in NATURAL_SPAN:
            value = getattr(ping, name)
            return np.abs(value) if self.folded and name in ("angle", "incidence") else value
        return ping.covariates.get(name, math.nan)

    def features(self, ping: Ping) -> FeatureBatch:
        """Return the features of pings; numpy calls are few, since a simulator calls this at every step."""
        value, (low, high, span) = self.raw(ping), self.ranges
        inside = np.minimum(np.maximum(value, low), high)
        off = np.abs(value - inside) / span
        if self.open_end:
            off[value[:, 0] > high[0], 0] = 0.0
        feature = np.empty((len(value), self.width))
        scaled, known = feature[:, : len(self.names)], feature[:, len(self.names) + 1 :]
        np.multiply(inside - low, 2.0 / span, out=scaled)
        scaled -= 1.0
        feature[:, len(self.names)] = self._log_distance(inside[:, 0])
        missing: Bits = np.zeros(len(value), dtype=bool)
        known[:] = 1.0
        if self.covariates:
            gone = np.isnan(value)
            if gone.any():
                off[gone], scaled[gone], known[gone[:, self._covariate]] = 0.0, 0.0, -1.0
                missing = np.any(gone, axis=1)
        excess = off.max(axis=1)
        if self.tied:
            apart = np.abs(np.abs(ping.incidence) - np.abs(ping.angle))
            excess = np.maximum(excess, np.where(apart > 1e-9, apart / 0.5, 0.0))
        return FeatureBatch(feature, ping.distance, excess, missing)

    @cached_property
    def _covariate(self) -> Ints:
        return np.array([k for k, name in enumerate(self.names) if name in self.covariates], dtype=np.int64)

    @cached_property
    def ranges(self) -> tuple[Floats, Floats, Floats]:
        """Low, high and scale of each quantity; the scale is limited below by `NATURAL_SPAN`."""
        known = zip(self.names, self.high, strict=True)
        natural = [NATURAL_SPAN.get(name, 1e-6 + 0.1 * abs(high)) for name, high in known]
        low, high = np.array(self.low), np.array(self.high)
        return low, high, np.maximum(high - low, natural)

    def _log_distance(self, distance: Floats) -> Floats:
        near, far = math.log(self.low[0] + LOG_OFFSET_M), math.log(self.high[0] + LOG_OFFSET_M)
        return 2.0 * (np.log(distance + LOG_OFFSET_M) - near) / max(far - near, 0.1) - 1.0
