"""The law of what a ping reads: p(reading | ping), exact on the grid of numbers that the sensor can report.

A law gives an arrival function `arrival(z)`: the probability that an echo is registered at an exact range <= z. The
register holds whole steps of `resolution` q: step j stands for exact ranges in ((j - 1/2) q, (j + 1/2) q], the first
step for everything below 3/2 q (a register of 0 means no echo), the last for everything above. What is left is
split between no echo and no answer, so all probabilities sum to one.
"""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np
from numpy.typing import ArrayLike, NDArray

from acquisition import EchoStatus, Reading

Floats = NDArray[np.float64]
CREDENCE_TOLERANCE = 0.1  # Esmi (2016), section 4.1: a reading is right within +-10 % of the true distance

FEW = 64  # pings; below this the inverse is looked for in wide rows


class EchoLaw(ABC):
    """Law of the readings of n pings.

    Attributes:
        distance: true distances, m, (n,).
        resolution: step of the register, m.
        max_range: of the register's last step, m.
        has_probabilities: whether it knows probabilities, or can only be drawn from.
    """

    has_probabilities = True

    def __init__(self, distance: Floats, resolution: float, max_range: float) -> None:
        self.distance = distance
        self.resolution = resolution
        self.max_range = max_range

    @abstractmethod
    def arrival(self, z: Floats) -> Floats:
        """Return P(an echo is registered at an exact range <= z), for z in m, (n,) or (m, n); +inf allowed."""

    def between(self, low: Floats, high: Floats) -> Floats:
        """Return P(an echo is registered at an exact range in (low, high]); laws that know their tails do better."""
        return np.maximum(self.arrival(high) - self.arrival(low), 0.0)

    @property
    @abstractmethod
    def no_answer(self) -> Floats:
        """P(the sensor does not answer), (n,)."""

    def __len__(self) -> int:
        """Return the number of pings."""
        return len(self.distance)

    @property
    def last_step(self) -> int:
        """Number of the register's last step."""
        return max(1, round(self.max_range / self.resolution))

    @property
    def echo(self) -> Floats:
        """P(an echo is registered), (n,)."""
        return self.arrival(np.full(len(self), np.inf))

    @property
    def no_echo(self) -> Floats:
        """P(the sensor answers that there is no echo), (n,)."""
        return np.clip(1.0 - self.echo - self.no_answer, 0.0, 1.0)

    def step(self, range_: ArrayLike) -> NDArray[np.int64]:
        """Return the register's step nearest to a range in m, 1 to `last_step`."""
        nearest = np.rint(np.asarray(range_, dtype=np.float64) / self.resolution)
        return np.clip(nearest, 1, self.last_step).astype(np.int64)

    def cdf_step(self, step: NDArray[np.int64]) -> Floats:
        """Return P(echo and register <= step), (n,) or (m, n); steps below 1 give 0."""
        return np.where(step < 1, 0.0, self.arrival(self.edge(step)))

    def edge(self, step: NDArray[np.int64]) -> Floats:
        """Return the exact range up to which a step stands, m; -inf below the first step, +inf from the last on."""
        inside = (step + 0.5) * self.resolution
        return np.where(step < 1, -np.inf, np.where(step >= self.last_step, np.inf, inside))

    def cdf(self, range_: ArrayLike) -> Floats:
        """Return P(echo and reading <= range), for range in m, (n,) or (m, n)."""
        return self.cdf_step(np.floor(np.asarray(range_) / self.resolution + 1e-9).astype(np.int64))

    def log_prob(self, reading: Reading) -> Floats:
        """Return the log probability of each reading, nats, (n,); -inf where the law excludes it."""
        step = self.step(reading.range)
        with np.errstate(divide="ignore"):
            echo = np.log(self.between(self.edge(step - 1), self.edge(step)))
            table = np.stack([np.log(self.no_echo), echo, np.log(self.no_answer)])
        return np.take_along_axis(table, reading.status[None].astype(np.int64), axis=0)[0]

    def sample(self, rng: np.random.Generator) -> Reading:
        """Draw a reading for each ping by inverting the law on its grid: one uniform number a ping."""
        u = rng.random(len(self))
        p_echo = self.echo
        step = self._invert(np.minimum(u, p_echo))
        status = np.where(u < p_echo, EchoStatus.ECHO, EchoStatus.NO_ECHO)
        status = np.where(u >= 1.0 - self.no_answer, EchoStatus.NO_ANSWER, status)
        return Reading.of(np.where(status == EchoStatus.ECHO, step * self.resolution, 0.0), status)

    def _invert(self, u: Floats) -> NDArray[np.int64]:
        """Return the smallest step whose cdf exceeds u, (n,) or (m, n), by cutting what is left into equal parts."""
        shape = np.broadcast_shapes(np.shape(u), (len(self),))
        low, high = np.zeros(shape, dtype=np.int64), np.full(shape, self.last_step)
        # a call costs more than its numbers where there are few, as in a simulator's step: many parts, few calls
        parts = 128 if len(shape) == 1 and len(self) <= FEW else 2
        share = np.arange(1, parts).reshape(-1, *[1] * len(shape))
        while np.any(high - low > 1):
            cuts = np.concatenate([low[None], low + (high - low) * share // parts, high[None]])
            below = np.sum(self._cdf_rows(cuts[1:-1]) <= u, axis=0)[None]
            low = np.take_along_axis(cuts, below, axis=0)[0]
            high = np.take_along_axis(cuts, below + 1, axis=0)[0]
        return high

    def _cdf_rows(self, step: NDArray[np.int64]) -> Floats:
        """Return `cdf_step` of steps with any number of leading axes, (..., n)."""
        return self.cdf_step(step.reshape(-1, len(self))).reshape(step.shape)

    def credence(self, tolerance: float = CREDENCE_TOLERANCE) -> Floats:
        """Return P(an echo reads within +-tolerance of the true distance), (n,): credence given the condition."""
        low = np.ceil((1 - tolerance) * self.distance / self.resolution - 1e-9).astype(np.int64)
        high = np.floor((1 + tolerance) * self.distance / self.resolution + 1e-9).astype(np.int64)
        below, upto = self.cdf_step(np.stack([low - 1, high]))
        return np.minimum(np.maximum(upto - below, 0.0), 1.0)

    def quantile(self, p: ArrayLike) -> Floats:
        """Return the reading below which a share p of the *echoes* lies, m, (n,); 0 where an echo cannot be."""
        echo = self.echo
        return np.where(echo > 0, self._invert(np.asarray(p) * echo * (1 - 1e-12)) * self.resolution, 0.0)
