"""Credence: the probability that a reading lies within +-10 % of the true distance (Esmi 2016, section 4.1).

Two kinds that must not be mixed up. Credence *given the condition* is `EchoLaw.credence`: it needs the truth.
Credence *given the reading* is what a robot can compute: P(distance within +-10 % | reading), by Bayes over a stated
prior of conditions, kept as a table over readings.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from acquisition import Ping, Reading
from noise.law import CREDENCE_TOLERANCE, EchoLaw, Floats
from noise.model import SonarModel

DEG = np.pi / 180.0
DRAWS = 3000  # of a prior's pings, at least one of each, where a law knows no probabilities


@dataclass(frozen=True)
class ConditionPrior:
    """What a robot expects to face before it listens: a grid with weights.

    Attributes:
        near, far: distances are uniform between them, m.
        distances: number of grid distances.
        angles_deg: bearings and incidences, equally likely.
        reflectances: equally likely.
    """

    near: float = 0.03
    far: float = 6.0
    distances: int = 600  # two a bin of the table, so that no bin is empty even for a sonar without noise
    angles_deg: tuple[float, ...] = (0.0, 7.5, 15.0, 22.5, 30.0, 45.0)
    reflectances: tuple[float, ...] = (0.1, 0.5, 0.9)

    def grid(self) -> tuple[Ping, int]:
        """Return all conditions, distance varying fastest, and how many share each distance."""
        distance = np.linspace(self.near, self.far, self.distances)
        angle, reflectance = np.meshgrid(np.array(self.angles_deg) * DEG, self.reflectances, indexing="ij")
        others = angle.size
        ping = Ping.of(
            distance=np.tile(distance, others),
            angle=np.repeat(angle.ravel(), self.distances),
            reflectance=np.repeat(reflectance.ravel(), self.distances),
        )
        return ping, others


@dataclass(frozen=True)
class CredenceTable:
    """Credence given a reading, tabulated over bins of range.

    Attributes:
        edges: of the bins, m, (bins + 1,).
        values: credence of a reading in each bin, (bins,); 0 where the model gives no reading.
        share: probability of each bin under the prior, (bins,).
    """

    edges: Floats
    values: Floats
    share: Floats

    @classmethod
    def of(
        cls,
        model: SonarModel,
        prior: ConditionPrior | None = None,
        bins: int = 300,
        tolerance: float = CREDENCE_TOLERANCE,
    ) -> CredenceTable:
        """Tabulate a model's credence under a prior.

        Args:
            model: whose laws to invert.
            prior: of the conditions; the default covers the SRF08's field out to 6 m.
            bins: of range, equally wide out to 10 % beyond the prior's farthest distance.
            tolerance: half width of "right", as a share of the true distance.
        """
        prior = prior or ConditionPrior()
        return cls.over(model, prior.grid()[0], np.linspace(0.0, prior.far * (1 + tolerance), bins + 1), tolerance)

    @classmethod
    def over(cls, model: SonarModel, ping: Ping, edges: Floats, tolerance: float = CREDENCE_TOLERANCE) -> CredenceTable:
        """Tabulate a model's credence where each of n pings is equally likely.

        Args:
            model: whose laws to invert.
            ping: the prior, as a sample of conditions, (n,).
            edges: of the bins of range, m, increasing, (bins + 1,).
            tolerance: half width of "right", as a share of the true distance.
        """
        law = model.law(ping)
        if not law.has_probabilities:
            return cls.counted(law, edges, tolerance)
        every = np.repeat(edges[:, None], len(ping), axis=1)
        right_only = np.clip(every, ping.distance * (1 - tolerance), ping.distance * (1 + tolerance))
        total = np.diff(law.arrival(every), axis=0).sum(axis=1)
        # a bin that straddles a limit counts by what the law puts on the right side of it
        right = law.arrival(right_only[1:]).sum(axis=1) - law.arrival(right_only[:-1]).sum(axis=1)
        return cls(edges, _ratio(np.clip(right, 0.0, total), total), total / len(ping))

    @classmethod
    def counted(cls, law: EchoLaw, edges: Floats, tolerance: float = CREDENCE_TOLERANCE) -> CredenceTable:
        """Tabulate the credence of a law that can only be drawn from, by counting some `DRAWS` draws of its pings.

        Always the same draws; with c of them in a bin, a credence p is off by about sqrt(p (1 - p)/c).
        """
        right, total = np.zeros(len(edges) - 1), np.zeros(len(edges) - 1)
        rng, repeats = np.random.default_rng(DRAWS), max(1, DRAWS // len(law))
        for _ in range(repeats):
            reading = law.sample(rng)
            within = reading.echo & (np.abs(reading.range - law.distance) <= tolerance * law.distance * (1 + 1e-9))
            total += np.histogram(reading.range[reading.echo], edges)[0]
            right += np.histogram(reading.range[within], edges)[0]
        return cls(edges, _ratio(right, total), total / (repeats * len(law)))

    def mixed(self, other: CredenceTable, weight: float) -> CredenceTable:
        """Return the table under a mixture of two priors, the other's weighing `weight`; the bins must be the same."""
        share = (1.0 - weight) * self.share + weight * other.share
        right = (1.0 - weight) * self.share * self.values + weight * other.share * other.values
        return CredenceTable(self.edges, _ratio(right, share), share)

    def given(self, reading: Reading) -> Floats:
        """Return the credence of each reading, (n,); 0 where there was no echo or no answer."""
        place = np.minimum(np.searchsorted(self.edges, reading.range, side="right") - 1, len(self.values) - 1)
        return np.where(reading.echo & (reading.range <= self.edges[-1]), self.values[place], 0.0)


def _ratio(part: Floats, whole: Floats) -> Floats:
    return np.divide(part, whole, out=np.zeros(len(whole)), where=whole > 1e-12)


def wilson(hits: ArrayLike, trials: ArrayLike, z: float = 1.96) -> tuple[Floats, Floats]:
    """Return Wilson's interval (1927) for the probability of what came true in some of many trials, each (...,).

    Args:
        hits: how often it came true.
        trials: of how many, at least 1.
        z: of the normal distribution; 1.96 holds 95 % of it.

    >>> low, high = wilson([0, 5], 10)
    >>> low.round(3).tolist(), high.round(3).tolist()
    ([0.0, 0.237], [0.278, 0.763])
    """
    n = np.asarray(trials, dtype=np.float64)
    share = np.asarray(hits, dtype=np.float64) / n
    centre = (share + z**2 / (2 * n)) / (1 + z**2 / n)
    half = z / (1 + z**2 / n) * np.sqrt(share * (1 - share) / n + z**2 / (4 * n**2))
    return np.clip(centre - half, 0.0, 1.0), np.clip(centre + half, 0.0, 1.0)
