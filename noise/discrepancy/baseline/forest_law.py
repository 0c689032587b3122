"""The law of weighted readings: a chance of an echo, and quantiles of its range, for each ping."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_array

from acquisition.arrays import Floats, Ints
from noise.law import EchoLaw

N_LEVELS = 101
# cumulative probabilities of the quantiles, dense in both tails: 2.5e-4 at the ends, 0.016 in the middle
LEVELS = np.sin(0.5 * np.pi * np.arange(N_LEVELS) / (N_LEVELS - 1)) ** 2


class QuantileLaw(EchoLaw):
    """Echoes whose arrival function is linear between given quantiles.

    Attributes:
        p_echo: probability of an echo, (n,).
        knots: quantiles of the range of an echo at `LEVELS`, m, ascending, (n, `N_LEVELS`).
    """

    uniform_per_ping = True

    def __init__(self, distance: Floats, p_echo: Floats, knots: Floats, resolution: float, max_range: float) -> None:
        super().__init__(distance, resolution, max_range)
        self.p_echo, self.knots = p_echo, knots
        # rows are shifted apart, so that one sorted array serves the search in all of them
        self._shift = np.arange(len(knots)) * (1.0 + 2.0 * float(knots.max(initial=0.0)))
        self._sorted = (knots + self._shift[:, None]).ravel()

    def _arrival(self, z: Floats) -> Floats:
        first, last = self.knots[:, 0], self.knots[:, -1]
        inside = np.clip(z, first, last)
        row = np.arange(len(self))
        at = np.searchsorted(self._sorted, inside + self._shift, side="right") - row * N_LEVELS
        at = np.clip(at, 1, N_LEVELS - 1)
        low, high = self.knots[row, at - 1], self.knots[row, at]
        share = np.clip(np.divide(inside - low, high - low, out=np.ones_like(inside), where=high > low), 0.0, 1.0)
        between = LEVELS[at - 1] + share * (LEVELS[at] - LEVELS[at - 1])
        return self.p_echo * np.where(z < first, 0.0, np.where(z >= last, 1.0, between))

    @property
    def echo(self) -> Floats:
        """P(an echo is registered), (n,)."""
        return self.p_echo

    @property
    def no_answer(self) -> Floats:
        """P(the sensor does not answer): 0."""
        return np.zeros(len(self))

    def _invert(self, u: Floats) -> Ints:
        """Return the smallest step whose cdf exceeds u, from the quantiles."""
        level = np.divide(u, self.p_echo, out=np.zeros(np.shape(u)), where=self.p_echo > 0)
        at = np.clip(np.searchsorted(LEVELS, level, side="right"), 1, N_LEVELS - 1)
        row = np.broadcast_to(np.arange(len(self)), at.shape)
        share = np.minimum((level - LEVELS[at - 1]) / (LEVELS[at] - LEVELS[at - 1]), 1.0)
        low, high = self.knots[row, at - 1], self.knots[row, at]
        step = np.ceil((low + share * (high - low) - self.origin) / self.resolution - 0.5)
        return np.clip(step, 1, self.last_step).astype(np.int64)


def quantiles(weight: csr_array, value: Floats) -> Floats:
    """Return the quantiles of weighted values at `LEVELS`, (n, `N_LEVELS`); 0 where no value has a weight.

    A value stands at the middle of its weight in the cumulative sum. Between values that have a weight the quantile is
    linear; others do not matter.

    Args:
        weight: of each value, (n, k), sorted by column.
        value: ascending, (k,).
    """
    count = np.diff(weight.indptr)[:, None]
    # the weights of each row and their values, side by side, up to the longest row
    stored = np.arange(max(count.max(initial=0), 1)) < count
    each, at = np.zeros(stored.shape), np.zeros(stored.shape)
    each[stored], at[stored] = weight.data, value[weight.indices]
    total = np.cumsum(each, axis=1)
    middle = (total - 0.5 * each) / np.maximum(total[:, -1:], 1e-300)
    row = np.arange(len(each))[:, None]
    # levels lie in 0..1, so rows two apart make one sorted array
    found = np.searchsorted((middle + 2.0 * row).ravel(), LEVELS + 2.0 * row) - stored.shape[1] * row
    high = np.clip(found, 0, np.maximum(count - 1, 0))
    low = np.maximum(high - 1, 0)
    below, above = middle[row, low], middle[row, high]
    share = np.divide(LEVELS - below, above - below, out=np.ones_like(above), where=above > below)
    return np.asarray(at[row, low] + np.clip(share, 0.0, 1.0) * (at[row, high] - at[row, low]))
