"""Comparison of two proportions that were measured on the same scenes, and of trained agents.

References:
    Agarwal et al. (2021), "Deep reinforcement learning at the edge of the statistical precipice".
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import binomtest, bootstrap, norm, permutation_test, trim_mean

from acquisition.arrays import Bits, Floats

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


RESAMPLES = 5000


def interquartile_mean(scores: Floats, axis: int = -1) -> Floats:
    """Return the mean of the middle half of scores along an axis.

    >>> float(interquartile_mean(np.array([0.0, 1.0, 2.0, 9.0])))
    1.5
    """
    return np.asarray(trim_mean(scores, 0.25, axis=axis), dtype=np.float64)


def _more_often(first: Floats, second: Floats, axis: int = -1) -> Floats:
    """Return P(a score of the second group exceeds one of the first), ties counted half."""
    a, b = np.moveaxis(first, axis, -1)[..., :, None], np.moveaxis(second, axis, -1)[..., None, :]
    share: Floats = (0.5 * ((b > a).mean((-2, -1)) + (b >= a).mean((-2, -1)))).astype(np.float64)
    return share


@dataclass(frozen=True)
class AgentScores:
    """Scores of the trained agents of one arm; the agent is the unit of all intervals.

    Attributes:
        scores: score of each agent on the same streets, (n,), n >= 2.
    """

    scores: Floats

    @property
    def centre(self) -> float:
        """Interquartile mean."""
        return float(interquartile_mean(self.scores))

    def interval(self, rng: np.random.Generator) -> tuple[float, float]:
        """Return the 95 % interval of the interquartile mean: percentile bootstrap over agents."""
        return _interval((self.scores,), interquartile_mean, rng)

    def exceeds(self, other: AgentScores, rng: np.random.Generator) -> tuple[float, tuple[float, float]]:
        """Return P(an agent of this arm is better than one of another), and its 95 % interval over agents."""
        pair = other.scores, self.scores
        return float(_more_often(*pair)), _interval(pair, _more_often, rng)

    def p(self, other: AgentScores, rng: np.random.Generator) -> float:
        """Return the two-sided p-value of equal distributions: permutation of agents, difference of means."""
        test = permutation_test(
            (self.scores, other.scores),
            lambda a, b, axis: np.mean(a, axis=axis) - np.mean(b, axis=axis),
            vectorized=True,
            rng=rng,
        )
        return float(test.pvalue)


AGENT_COLUMNS = ("agents", "parked, interquartile mean", "each", "better than {reference}", "p")


def agent_rows(scores: Mapping[str, AgentScores], reference: str, rng: np.random.Generator) -> list[tuple[object, ...]]:
    """Return a row for each arm, its name and `AGENT_COLUMNS`; intervals at 95 % over agents, p by permutation."""
    return [
        (arm, *_agent_row(one, None if arm == reference else scores[reference], rng)) for arm, one in scores.items()
    ]


def _agent_row(one: AgentScores, reference: AgentScores | None, rng: np.random.Generator) -> tuple[object, ...]:
    low, high = one.interval(rng)
    centre = f"{100 * one.centre:.1f} % ({100 * low:.1f} to {100 * high:.1f})"
    shown = len(one.scores), centre, ", ".join(f"{100 * score:.0f}" for score in one.scores)
    if reference is None:
        return *shown, "", ""
    better, (least, most) = one.exceeds(reference, rng)
    return *shown, f"{100 * better:.0f} % ({100 * least:.0f} to {100 * most:.0f})", f"{one.p(reference, rng):.2g}"


def _interval(groups: tuple[Floats, ...], statistic: Any, rng: np.random.Generator) -> tuple[float, float]:
    if all(np.ptp(group) == 0.0 for group in groups):  # the bootstrap of a constant is that constant
        value = float(statistic(*groups))
        return value, value
    settings: dict[str, Any] = {"vectorized": True, "method": "percentile", "n_resamples": RESAMPLES, "rng": rng}
    limits = bootstrap(groups, statistic, confidence_level=CONFIDENCE, **settings).confidence_interval
    return float(limits.low), float(limits.high)
