"""Credence: the probability that a reading lies within +-10 % of the true distance (Esmi 2016, section 4.1).

There are two kinds. Credence *given the condition* is `EchoLaw.credence`; it requires the true condition. Credence
*given the reading* can be computed by a robot: P(distance within +-10 % | reading), by Bayes' rule with a stated prior
over conditions, tabulated over readings.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from acquisition import Ping, Reading
from acquisition.arguments import checked
from acquisition.brief import brief
from noise.law import CREDENCE_TOLERANCE, EchoLaw, Floats
from noise.model import SonarModel

DEG = np.pi / 180.0
N_DRAWS = 3000  # in total, and at least one per ping of the prior, where a law has no probabilities


@dataclass(frozen=True)
class ConditionPrior:
    """Prior distribution of a robot's conditions: a grid of equally likely conditions.

    Attributes:
        near, far: limits of the distances, m.
        distances: number of grid distances.
        angles_deg: bearings, equal to the incidences, deg.
        reflectances: reflectances, 0..1.
    """

    near: float = 0.03
    far: float = 6.0
    distances: int = 600  # two per bin of the table, so that no bin is empty even for a sonar without noise
    angles_deg: tuple[float, ...] = (0.0, 7.5, 15.0, 22.5, 30.0, 45.0)
    reflectances: tuple[float, ...] = (0.1, 0.5, 0.9)

    def grid(self) -> tuple[Ping, int]:
        """Return all conditions, distance varying fastest, and the number of conditions per distance."""
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
        edges: edges of the bins, m, (bins + 1,).
        values: credence of a reading in each bin, (bins,); 0 where the model gives no reading.
        share: probability of each bin under the prior, (bins,).
    """

    __repr__ = brief

    edges: Floats
    values: Floats
    share: Floats

    @classmethod
    @checked
    def of(
        cls,
        model: SonarModel,
        prior: ConditionPrior | None = None,
        bins: int = 300,
        tolerance: float = CREDENCE_TOLERANCE,
    ) -> CredenceTable:
        """Tabulate a model's credence under a prior.

        Args:
            model: model to tabulate.
            prior: prior over conditions; the default covers the SRF08's field up to 6 m.
            bins: number of bins of equal width, up to 10 % beyond the prior's largest distance.
            tolerance: largest error of a right reading, relative to the true distance.
        """
        prior = prior or ConditionPrior()
        return cls.over(model, prior.grid()[0], np.linspace(0.0, prior.far * (1 + tolerance), bins + 1), tolerance)

    @classmethod
    @checked
    def over(cls, model: SonarModel, ping: Ping, edges: Floats, tolerance: float = CREDENCE_TOLERANCE) -> CredenceTable:
        """Tabulate a model's credence for n equally likely pings.

        Args:
            model: model to tabulate.
            ping: sample of conditions from the prior, (n,).
            edges: edges of the bins of range, m, increasing, (bins + 1,).
            tolerance: largest error of a right reading, relative to the true distance.
        """
        law = model.law(ping)
        if not law.has_probabilities:
            return cls.by_sampling(law, edges, tolerance)
        every = np.repeat(edges[:, None], len(ping), axis=1)
        right_only = np.clip(every, ping.distance * (1 - tolerance), ping.distance * (1 + tolerance))
        total = np.diff(law.arrival(every), axis=0).sum(axis=1)
        # a bin that contains a limit of the tolerance counts with its probability inside the tolerance
        right = law.arrival(right_only[1:]).sum(axis=1) - law.arrival(right_only[:-1]).sum(axis=1)
        return cls(edges, _ratio(np.clip(right, 0.0, total), total), total / len(ping))

    @classmethod
    @checked
    def by_sampling(cls, law: EchoLaw, edges: Floats, tolerance: float = CREDENCE_TOLERANCE) -> CredenceTable:
        """Tabulate the credence of a law that can only be sampled, from about `N_DRAWS` draws with a fixed seed.

        With c draws in a bin, the standard error of a credence p is sqrt(p (1 - p) / c).
        """
        right, total = np.zeros(len(edges) - 1), np.zeros(len(edges) - 1)
        rng, repeats = np.random.default_rng(N_DRAWS), max(1, N_DRAWS // len(law))
        for _ in range(repeats):
            reading = law.sample(rng)
            within = reading.echo & (np.abs(reading.range - law.distance) <= tolerance * law.distance * (1 + 1e-9))
            total += np.histogram(reading.range[reading.echo], edges)[0]
            right += np.histogram(reading.range[within], edges)[0]
        return cls(edges, _ratio(right, total), total / (repeats * len(law)))

    @checked
    def mixed(self, other: CredenceTable, weight: float) -> CredenceTable:
        """Return the table under a mixture of two priors, with weight `weight` on the other; the bins must be equal."""
        share = (1.0 - weight) * self.share + weight * other.share
        right = (1.0 - weight) * self.share * self.values + weight * other.share * other.values
        return CredenceTable(self.edges, _ratio(right, share), share)

    @checked
    def given(self, reading: Reading) -> Floats:
        """Return the credence of each reading, (n,); 0 where there was no echo or no answer."""
        place = np.minimum(np.searchsorted(self.edges, reading.range, side="right") - 1, len(self.values) - 1)
        return np.where(reading.echo & (reading.range <= self.edges[-1]), self.values[place], 0.0)


def _ratio(part: Floats, whole: Floats) -> Floats:
    return np.divide(part, whole, out=np.zeros(len(whole)), where=whole > 1e-12)


def wilson(hits: ArrayLike, trials: ArrayLike, z: float = 1.96) -> tuple[Floats, Floats]:
    """Return Wilson's score interval (1927) for a binomial probability, lower and upper limit, each (...,).

    Args:
        hits: numbers of successes.
        trials: numbers of trials, at least 1.
        z: normal quantile; 1.96 gives 95 % coverage.

    >>> low, high = wilson([0, 5], 10)
    >>> low.round(3).tolist(), high.round(3).tolist()
    ([0.0, 0.237], [0.278, 0.763])
    """
    n = np.asarray(trials, dtype=np.float64)
    share = np.asarray(hits, dtype=np.float64) / n
    centre = (share + z**2 / (2 * n)) / (1 + z**2 / n)
    half = z / (1 + z**2 / n) * np.sqrt(share * (1 - share) / n + z**2 / (4 * n**2))
    return np.clip(centre - half, 0.0, 1.0), np.clip(centre + half, 0.0, 1.0)
