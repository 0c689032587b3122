"""Readings of the nearest visits as a law: a simulation, or a recording, between its own conditions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import ndtr
from sklearn.neighbors import NearestNeighbors

from acquisition import ModelError, Ping, Reading
from acquisition.arrays import Floats, Ints
from noise.fitting.batch import Batch
from noise.law import EchoLaw
from noise.model import MAX_RANGE

N_VISITS = 4  # nearest visits of a prediction: scatter of visits is included, and the conditions are still alike
N_READINGS = 8  # of each visit; more hardly add information, since readings of one visit agree
MAX_VALUES = 4_000_000  # computed at once; bounds the memory
INTERVAL = "interval_s"
ARRAYS = ("middle", "scale", "position")
N_CONDITIONS = 4  # distance, angle, incidence and reflectance


class NearestLaw(EchoLaw):
    """A weighted mixture of given readings, with the errors of echoes kept and each spread over one step.

    Attributes:
        weight: of each reading, (n, k); sums to one over a ping.
        centre: predicted readings, m, (n, k); infinite for no echo.
    """

    uniform_per_ping = True

    def __init__(self, ping: Ping, weight: Floats, centre: Floats, resolution: float, max_range: float) -> None:
        super().__init__(ping.distance, resolution, max_range)
        self.weight, self.centre = weight, centre

    def arrival(self, z: Floats) -> Floats:
        """Return P(an echo is registered at an exact range <= z)."""
        rows = np.atleast_2d(z)
        size = max(1, MAX_VALUES // max(self.weight.size, 1))
        parts = [self._rows(rows[k : k + size]) for k in range(0, len(rows), size)]
        return np.concatenate(parts).reshape(np.shape(z))

    def _rows(self, z: Floats) -> Floats:
        echo = np.isfinite(self.centre)
        near = np.where(echo, self.centre, 0.0)
        return np.sum(self.weight * echo * ndtr((z[..., None] - near) / self.resolution), axis=-1)

    @property
    def no_answer(self) -> Floats:
        """P(the sensor does not answer): 0."""
        return np.zeros(len(self))


@dataclass(frozen=True, eq=False)
class NearestVisits:
    """A sonar that reads what the nearest visits of a simulation or a recording read, at their errors.

    Distances between conditions are Euclidean in log distance, angle, incidence, reflectance and logged covariates,
    each in standard deviations; weights fall with a normal kernel as wide as the farthest of `N_VISITS` visits.

    Attributes:
        names: logged covariates that are compared.
        middle, scale: of the standardisation, (d,).
        position: standardised condition of each visit, (v, d).
        error: errors of readings of each visit, m, infinite for no echo, (v, r).
        resolution, max_range: of the register, m.
        remembers: False.
    """

    names: tuple[str, ...]
    middle: Floats
    scale: Floats
    position: Floats
    error: Floats
    resolution: float
    max_range: float
    remembers: bool = False

    @classmethod
    def of(cls, batch: Batch, max_range: float = MAX_RANGE) -> NearestVisits:
        """Return the law of readings, whose last range step is that of `max_range`, m."""
        names = tuple(name for name in batch.ping.covariates if name != INTERVAL)
        x = _columns(batch.ping, names)
        rows = np.stack([_spread(first, n) for first, n in zip(batch.starts, _counts(batch), strict=True)])
        error = np.where(batch.reading.echo, batch.error, np.inf)[rows]
        middle, scale = x.mean(axis=0), x.std(axis=0)
        scale = np.where(scale > 0, scale, 1.0)
        position = (x[rows].mean(axis=1) - middle) / scale
        return cls(names, middle, scale, position, error, batch.resolution, max_range)

    def law(self, ping: Ping, past: Reading | None = None) -> NearestLaw:
        """Return the law of n pings; the previous reading is not used."""
        k = min(N_VISITS, len(self.position))
        search = NearestNeighbors(n_neighbors=k).fit(self.position)
        apart, which = search.kneighbors((_columns(ping, self.names) - self.middle) / self.scale)
        weight = np.exp(-0.5 * (apart / np.maximum(apart[:, -1:], 1e-9)) ** 2)
        weight /= weight.sum(axis=1, keepdims=True)
        n_each = self.error.shape[1]
        error = self.error[which].reshape(len(ping), -1)
        every = np.repeat(weight / n_each, n_each, axis=1)
        centre = np.where(np.isfinite(error), np.maximum(ping.distance[:, None] + error, self.resolution), np.inf)
        return NearestLaw(ping, every, centre, self.resolution, self.max_range)

    def to_dict(self) -> dict[str, object]:
        """Return the model as plain data; readings without an echo are null."""
        arrays = {name: getattr(self, name).tolist() for name in ARRAYS}
        error = [[x if np.isfinite(x) else None for x in row] for row in self.error.tolist()]
        base = {"kind": "nearest", "resolution": self.resolution, "max_range": self.max_range}
        return {**base, "names": list(self.names), **arrays, "error": error}

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> NearestVisits:
        """Return the model that `to_dict` describes.

        Raises:
            ModelError: a part is missing or does not fit the others.
        """
        try:
            middle, scale, position = (np.asarray(data[name], dtype=np.float64) for name in ARRAYS)
            error = np.array([[np.inf if x is None else float(x) for x in row] for row in data["error"]])
            names, limits = tuple(map(str, data["names"])), (float(data["resolution"]), float(data["max_range"]))
            columns = N_CONDITIONS + len(names)
            fits = position.ndim == error.ndim == 2 and len(position) == len(error) > 0 and min(limits) > 0.0
            if not fits or {middle.shape, scale.shape, position.shape[1:]} != {(columns,)} or not (scale > 0).all():
                raise ValueError("its parts do not fit together")
            if not np.isfinite(np.r_[middle, scale, position.ravel(), limits]).all() or np.isnan(error).any():
                raise ValueError("a value is not finite")
        except (KeyError, TypeError, ValueError) as problem:
            raise ModelError(f"model: cannot be built from its parts ({problem}); it may be damaged") from None
        return cls(names, middle, scale, position, error, *limits)


def _columns(ping: Ping, names: tuple[str, ...]) -> Floats:
    """Return the compared conditions, (n, d); a covariate that was not logged counts as zero."""
    logged = [ping.covariates.get(name, np.zeros(len(ping))) for name in names]
    near = np.log(np.maximum(ping.distance, 0.02))
    return np.stack([near, np.abs(ping.angle), np.abs(ping.incidence), ping.reflectance, *logged], axis=1)


def _counts(batch: Batch) -> Ints:
    return np.diff(np.r_[batch.starts, len(batch)])


def _spread(first: np.int64, n: np.int64) -> Ints:
    """Return `N_READINGS` rows spread over a visit of n pings; rows repeat where it has fewer."""
    return first + np.linspace(0, n - 1, N_READINGS).round().astype(np.int64)
