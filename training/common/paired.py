"""Shares compared on the same scenes: what differs is told by the scenes on which one did what the other did not."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binomtest, norm

Bits = NDArray[np.bool_]
CONFIDENCE = 0.95


@dataclass(frozen=True)
class Paired:
    """Two shares over the same scenes.

    Attributes:
        gained, lost: scenes on which only the second, and only the first, succeeded.
        scenes: all of them.
    """

    gained: int
    lost: int
    scenes: int

    @classmethod
    def of(cls, first: Bits, second: Bits) -> Paired:
        """Compare successes, (n,) each, scene by scene."""
        return cls(int((second & ~first).sum()), int((first & ~second).sum()), len(first))

    @property
    def difference(self) -> float:
        """Share of the second less that of the first."""
        return (self.gained - self.lost) / self.scenes

    @property
    def interval(self) -> tuple[float, float]:
        """Of the difference at 95 %: Wald's with one scene added to either kind (Bonett and Price 2012).

        >>> [round(x, 4) for x in Paired(gained=10, lost=2, scenes=100).interval]
        [0.0082, 0.1487]
        """
        n = self.scenes + 2
        gained, lost = (self.gained + 1) / n, (self.lost + 1) / n
        middle, z = gained - lost, float(norm.ppf(0.5 + 0.5 * CONFIDENCE))
        wide = z * np.sqrt((gained + lost - middle**2) / n)
        return float(max(middle - wide, -1.0)), float(min(middle + wide, 1.0))

    @property
    def p(self) -> float:
        """P(a difference as great, either way), were both alike: McNemar's test, exact (1947).

        >>> round(Paired(gained=10, lost=2, scenes=100).p, 4)
        0.0386
        """
        discordant = self.gained + self.lost
        return float(binomtest(self.gained, discordant).pvalue) if discordant else 1.0

    def __str__(self) -> str:
        low, high = self.interval
        return f"{100 * self.difference:+.1f} ({100 * low:+.1f} to {100 * high:+.1f}; p {self.p:.2g})"
