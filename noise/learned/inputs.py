"""Features of pings for a network, and the distance of a ping from the learned conditions."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from acquisition import Ping
from acquisition.arrays import Bits, Floats, Ints
from acquisition.ping import CELSIUS, RANGE_RATE, TEMPERATURE
from noise.learned.gain import GAIN, LOSS, with_loss
from noise.model import ORDER
from noise.replay import SIMULATED, SIMULATED_BEFORE

NATURAL_SPAN = {"distance": 0.1, "angle": 0.05, "incidence": 0.05, "reflectance": 0.1}  # m, rad, rad, 1
COMPARED_C = (-11.0, 46.0)  # degC; -10 to 45 degC with the drift of a room: training/noise/conditions.py
# of the past or of a simulation; this package adds them to pings, and no learned law of a condition needs them
ADDED = ("interval_s", RANGE_RATE, *SIMULATED, *SIMULATED_BEFORE, ORDER)
LOG_OFFSET_M = 0.02  # m; added to the distance to limit the slope of its logarithm


class FeatureBatch(NamedTuple):
    """Features of n pings.

    Attributes:
        feature: features within -1..1, (n, width).
        distance: true distances, m, (n,).
        excess: distance of each condition from the learned range, relative to its width, (n,).
        missing: whether a covariate is missing, (n,) bool.
        outside: whether a covariate has a value with which the law was not trained, (n,) bool.
    """

    feature: Floats
    distance: Floats
    excess: Floats
    missing: Bits
    outside: Bits


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
        uncompensated: whether readings are times of flight at one assumed speed of sound, so that at temperatures
            outside the learned range the law is that of equal time of flight at its end (see `equivalent`).
        fixed: other covariates and the one value that each had in the training data.
        averaged: other covariates that varied in the training data; the law is that over their values there.
    """

    names: tuple[str, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]
    folded: bool = False
    tied: bool = False
    open_end: bool = False
    uncompensated: bool = False
    fixed: Mapping[str, float] = field(default_factory=dict, hash=False)
    averaged: tuple[str, ...] = ()

    @classmethod
    def of(
        cls, ping: Ping, names: tuple[str, ...], horizon: float | None = None, uncompensated: bool = False
    ) -> Inputs:
        """Determine the ranges from pings.

        Args:
            ping: conditions of a recording.
            names: logged quantities, "distance" first; incidence is omitted if it always equals bearing.
            horizon: distance beyond which there is no echo, m; all farther pings are one condition.
            uncompensated: see the attribute.
        """
        ping = with_loss(ping) if LOSS in names else ping
        turned = np.concatenate([ping.angle, ping.incidence])
        folded = bool(np.all(turned >= 0) or np.all(turned <= 0))
        tied = bool(np.allclose(np.abs(ping.angle), np.abs(ping.incidence)))
        used = tuple(name for name in names if not (tied and name == "incidence"))
        value = cls(used, (), (), folded, tied).raw(ping)
        low, high = np.nanmin(value, axis=0), np.nanmax(value, axis=0)
        beyond = bool(horizon is not None and high[0] > horizon)
        high[0] = horizon if beyond else high[0]
        seen = (*used, *ADDED, *((GAIN,) if LOSS in used else ()))
        others = {name: value for name, value in ping.covariates.items() if name not in seen}
        fixed = {name: float(value[0]) for name, value in others.items() if len(value) and np.ptp(value) == 0.0}
        averaged = tuple(sorted(others.keys() - fixed.keys()))
        ends = tuple(map(float, low)), tuple(map(float, high))
        return cls(used, *ends, folded, tied, beyond, uncompensated, fixed, averaged)

    def to_dict(self) -> dict[str, Any]:
        """Return plain data; `averaged` is left out where it is empty, so that it changes no digest of a model."""
        data = asdict(self)
        return data if self.averaged else {key: value for key, value in data.items() if key != "averaged"}

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> Inputs:
        """Build from plain data, in which tuples are lists."""
        ranges = {key: tuple(map(float, data[key])) for key in ("low", "high")}
        if not len(data["names"]) == len(ranges["low"]) == len(ranges["high"]):
            raise ValueError("inputs: names, low and high differ in number")
        fixed, averaged = dict(data.get("fixed", {})), tuple(data.get("averaged", ()))
        names = ("folded", "tied", "open_end", "uncompensated")
        folded, tied, open_end, uncompensated = (bool(data.get(key, False)) for key in names)
        ends = ranges["low"], ranges["high"]
        return cls(tuple(data["names"]), *ends, folded, tied, open_end, uncompensated, fixed, averaged)

    @cached_property
    def covariates(self) -> tuple[str, ...]:
        """Names of the optional quantities."""
        return tuple(name for name in self.names if name not in NATURAL_SPAN)

    @cached_property
    def known(self) -> frozenset[str]:
        """Names of covariates that the law uses, that were in its training data, or that this package adds."""
        return frozenset((*self.covariates, *self.fixed, *self.averaged, *ADDED, *((GAIN,) if self.by_loss else ())))

    @cached_property
    def by_loss(self) -> bool:
        """Whether the gain is an input, by the loss that it causes."""
        return LOSS in self.names

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

    def equivalent(self, ping: Ping) -> Ping:
        """Return pings within the learned temperatures whose readings have the same law, with the loss by their gain.

        The reading of a sensor without temperature compensation is a time of flight, 2 d / c(T): at T it is that of the
        distance d c(T') / c(T) at T', with c proportional to the square root of the absolute temperature. Absorption
        and what the electronics do with temperature are those at T'. A gain is replaced by the loss that it causes.

        Args:
            ping: conditions, (n,).
        """
        return self._of_equal_time(with_loss(ping) if self.by_loss else ping)

    def _of_equal_time(self, ping: Ping) -> Ping:
        given = ping.covariates.get(TEMPERATURE) if self.uncompensated and TEMPERATURE in self.names else None
        if given is None:
            return ping
        k = self.names.index(TEMPERATURE)
        compared = np.clip(given, min(COMPARED_C[0], self.low[k]), max(COMPARED_C[1], self.high[k]))
        learned = np.clip(compared, self.low[k], self.high[k])
        if np.array_equal(learned, compared, equal_nan=True):
            return ping
        ratio = np.where(np.isnan(given), 1.0, np.sqrt((learned + CELSIUS) / (compared + CELSIUS)))
        covariates = {**ping.covariates, TEMPERATURE: learned + (given - compared)}
        return replace(ping, distance=ping.distance * ratio, covariates=covariates)

    def stated_outside(self, ping: Ping) -> list[str]:
        """Return a sentence for each covariate with a value outside the training data, of equivalent pings."""
        limits = {n: (low, high) for n, low, high in zip(self.names, self.low, self.high, strict=True)}
        limits = {n: limits[n] for n in self.covariates} | {n: (v, v) for n, v in self.fixed.items()}
        return [
            f"{name} from {low:g} to {high:g}" if low < high else f"{name} {low:g}"
            for name, (low, high) in limits.items()
            if name in ping.covariates and _beyond(ping.covariates[name], low, high).any()
        ]

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
        outside: Bits = np.zeros(len(value), dtype=bool)
        if self.covariates:
            outside = np.any(off[:, self._covariate] > 0.0, axis=1)
        for name in self.fixed.keys() & ping.covariates.keys():
            outside |= _beyond(ping.covariates[name], self.fixed[name], self.fixed[name])
        return FeatureBatch(feature, ping.distance, excess, missing, outside)

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


def _beyond(value: Floats, low: float, high: float) -> Bits:
    """Return whether values lie outside limits, apart from rounding; not NaN."""
    margin = 1e-6 * max(1.0, abs(low), abs(high))
    return np.asarray((value < low - margin) | (value > high + margin))
