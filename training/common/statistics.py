"""Comparison of two proportions that were measured on the same scenes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import binomtest, norm

from acquisition.arrays import Bits

CONFIDENCE = 0.95


@dataclass(frozen=True)
class PairedComparison:
    """Success rates of two methods on the same scenes.

    Attributes:
        gained: number of scenes on which only the second succeeded.
        lost: number of scenes on which only the first succeeded.
        scenes: number of scenes.
    """

    gained: int
    lost: int
    scenes: int

    @classmethod
    def of(cls, first: Bits, second: Bits) -> PairedComparison:
        """Return the comparison of successes, (n,) each."""
        return cls(int((second & ~first).sum()), int((first & ~second).sum()), len(first))

    @property
    def difference(self) -> float:
        """Success rate of the second minus that of the first."""
        return (self.gained - self.lost) / self.scenes

    @property
    def interval(self) -> tuple[float, float]:
        """95 % interval of the difference: Wald, with one scene added to `gained` and `lost` (Bonett and Price 2012).

        >>> [round(x, 4) for x in PairedComparison(gained=10, lost=2, scenes=100).interval]
        [0.0082, 0.1487]
        """
        n = self.scenes + 2
        gained, lost = (self.gained + 1) / n, (self.lost + 1) / n
        centre, z = gained - lost, float(norm.ppf(0.5 + 0.5 * CONFIDENCE))
        half = z * np.sqrt((gained + lost - centre**2) / n)
        return float(max(centre - half, -1.0)), float(min(centre + half, 1.0))

    @property
    def p(self) -> float:
        """Two-sided p-value of equal success rates: exact McNemar test (1947).

        >>> round(PairedComparison(gained=10, lost=2, scenes=100).p, 4)
        0.0386
        """
        discordant = self.gained + self.lost
        return float(binomtest(self.gained, discordant).pvalue) if discordant else 1.0

    def __str__(self) -> str:
        """Return difference, interval (both in percentage points) and p-value."""
        low, high = self.interval
        return f"{100 * self.difference:+.1f} ({100 * low:+.1f} to {100 * high:+.1f}; p {self.p:.2g})"
