"""Clusters that follow each other in time, and the sums with which their dependence enters the variance of a statistic.

An error of a robot's pose, or of the air above a fixed target, lasts longer than a cluster. The variance of a sum is
then that of its clusters with the autocovariances of neighbours, weighted by Bartlett's kernel (Newey and West 1987):
the sum of squares of moving sums over L clusters, divided by L. L is the bandwidth for a first-order autoregression
(Andrews 1991, equations 6.2 and 6.4). Its coefficient is that of the simulation, since two recordings of one sonar
depend on their past alike, and a recording that differs for some time would hide the difference.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from acquisition.arrays import Bits, Floats, Ints

MIN_PAIRS = 12  # of neighbours, for a correlation
LARGEST = 0.97  # coefficient that a finite record can tell from a random walk


@dataclass(frozen=True, eq=False)
class Chains:
    """Chains of clusters in time.

    Attributes:
        rows: clusters of the chains of each length, (chains, length) each.
    """

    rows: tuple[Ints, ...]

    @classmethod
    def of(cls, chain: Ints, time: Floats) -> Chains:
        """Return the chains of clusters with given labels and times, (clusters,) each."""
        order = np.lexsort((time, chain))
        every = np.split(order, np.flatnonzero(np.diff(chain[order])) + 1)
        sizes = np.array([len(each) for each in every])
        return cls(tuple(np.stack([each for each in every if len(each) == n]) for n in np.unique(sizes)))

    @property
    def n(self) -> int:
        """Number of clusters."""
        return sum(rows.size for rows in self.rows)

    def bandwidth(self, value: Floats, known: Bits) -> int:
        """Return the number of neighbouring clusters over which sums are taken, 1 where they are independent.

        Args:
            value: mean scores of clusters of the simulation, less their mean given the conditions, (clusters,).
            known: which clusters have one, (clusters,).
        """
        product = square = pairs = 0.0
        for rows in self.rows:
            both = known[rows[:, 1:]] & known[rows[:, :-1]]
            first, second = value[rows[:, :-1]][both], value[rows[:, 1:]][both]
            product, pairs = product + float(first @ second), pairs + both.sum()
            square += 0.5 * float(first @ first + second @ second)
        if pairs < MIN_PAIRS or square <= 0.0:
            return 1
        rho = min(max(product / square, 0.0), LARGEST)
        alpha = 4.0 * rho**2 / ((1.0 - rho) * (1.0 + rho)) ** 2
        longest = max(rows.shape[1] for rows in self.rows)
        return int(np.clip(np.ceil(1.1447 * (alpha * longest) ** (1.0 / 3.0)), 1, longest))

    def sums(self, psi: Floats, length: int) -> Floats:
        """Return moving sums over neighbours in a chain, a circle, over the root of their number, (clusters, k)."""
        if length == 1:
            return psi
        out = psi.copy()
        for rows in self.rows:
            n = min(length, rows.shape[1])
            if n > 1:
                part = psi[rows]
                total = np.cumsum(np.concatenate([np.zeros_like(part[:, :1]), part, part[:, : n - 1]], axis=1), axis=1)
                out[rows] = (total[:, n:] - total[:, :-n]) / np.sqrt(n)
        return out
