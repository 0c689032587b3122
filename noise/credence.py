"""Credence: the probability that a reading lies within +-10 % of the true distance (Esmi 2016, section 4.1).

There are two kinds. Credence *given the condition* is `EchoLaw.credence`; it requires the true condition. Credence
*given the reading* can be computed by a robot: P(distance within +-10 % | reading), by Bayes' rule with a stated prior
over conditions, tabulated over readings.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from annotated_types import MinLen
from numpy.typing import ArrayLike

from acquisition import Ping, Reading, SettingError
from acquisition.arguments import checked
from acquisition.brief import brief
from acquisition.limits import Count, Limit, Metres, PositiveMetres, Share, as_numbers, check_settings, shown
from noise.law import CREDENCE_TOLERANCE, EchoLaw, Floats, Ints, Tolerance
from noise.model import SonarModel, listener

DEG = np.pi / 180.0
Angle = Annotated[float, Limit(-90.0, 90.0, "deg")]
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

    near: Metres = 0.03
    far: PositiveMetres = 6.0
    distances: Count = 600  # two per bin of the table, so that no bin is empty even for a sonar without noise
    angles_deg: Annotated[tuple[Angle, ...], MinLen(1)] = (0.0, 7.5, 15.0, 22.5, 30.0, 45.0)
    reflectances: Annotated[tuple[Share, ...], MinLen(1)] = (0.1, 0.5, 0.9)

    def __post_init__(self) -> None:
        """Raise SettingError for values outside their limits."""
        check_settings(self)

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

    def __post_init__(self) -> None:
        """Raise SettingError unless there is one value and one probability for each bin."""
        edges = as_bins("CredenceTable.edges", self.edges)
        for name in ("values", "share"):
            number = as_numbers(f"CredenceTable.{name}", getattr(self, name))
            if number.shape != (len(edges) - 1,):
                raise SettingError(f"CredenceTable.{name} has shape {number.shape}, expected ({len(edges) - 1},)")
            object.__setattr__(self, name, number)
        object.__setattr__(self, "edges", edges)

    @classmethod
    @checked
    def of(
        cls,
        model: SonarModel,
        prior: ConditionPrior | None = None,
        bins: Count = 300,
        tolerance: Tolerance = CREDENCE_TOLERANCE,
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
    def over(
        cls, model: SonarModel, ping: Ping, edges: Floats, tolerance: Tolerance = CREDENCE_TOLERANCE
    ) -> CredenceTable:
        """Tabulate a model's credence for n equally likely pings.

        Args:
            model: model to tabulate.
            ping: sample of conditions from the prior, (n,).
            edges: edges of the bins of range, m, increasing, (bins + 1,).
            tolerance: largest error of a right reading, relative to the true distance.
        """
        law, edges = listener(model).law(ping), as_bins("CredenceTable.over.edges", edges)
        if not law.has_probabilities:
            return cls.by_sampling(law, edges, tolerance)
        step = _steps_below(law, edges)[:, None]
        # a bin that contains a limit of the tolerance counts with its probability inside the tolerance
        right_only = np.clip(step, *law._right_steps(tolerance))
        total, right = (np.diff(law.cdf_step(each), axis=0).sum(axis=1) for each in (step, right_only))
        return cls(edges, _ratio(np.clip(right, 0.0, total), total), total / len(ping))

    @classmethod
    @checked
    def by_sampling(cls, law: EchoLaw, edges: Floats, tolerance: Tolerance = CREDENCE_TOLERANCE) -> CredenceTable:
        """Tabulate the credence of a law that can only be sampled, from about `N_DRAWS` draws with a fixed seed.

        With c draws in a bin, the standard error of a credence p is sqrt(p (1 - p) / c).
        """
        edges = as_bins("CredenceTable.by_sampling.edges", edges)
        right, total = np.zeros(len(edges) - 1), np.zeros(len(edges) - 1)
        rng, repeats = np.random.default_rng(N_DRAWS), max(1, N_DRAWS // len(law))
        for _ in range(repeats):
            reading = law.sample(rng)
            within = reading.echo & (np.abs(reading.range - law.distance) <= tolerance * law.distance * (1 + 1e-9))
            total += np.histogram(reading.range[reading.echo], edges)[0]
            right += np.histogram(reading.range[within], edges)[0]
        return cls(edges, _ratio(right, total), total / (repeats * len(law)))

    @checked
    def mixed(self, other: CredenceTable, weight: Share) -> CredenceTable:
        """Return the table under a mixture of two priors, with weight `weight` on the other; the bins must be equal."""
        if not np.array_equal(self.edges, other.edges):
            raise SettingError(f"CredenceTable.mixed.other: has other bins ({len(other.values)}): tabulate both alike")
        share = (1.0 - weight) * self.share + weight * other.share
        right = (1.0 - weight) * self.share * self.values + weight * other.share * other.values
        return CredenceTable(self.edges, _ratio(right, share), share)

    @checked
    def given(self, reading: Reading) -> Floats:
        """Return the credence of each reading, (n,); 0 without an echo, and outside the bins."""
        place = np.minimum(np.searchsorted(self.edges, reading.range, side="right") - 1, len(self.values) - 1)
        inside = (reading.range >= self.edges[0]) & (reading.range <= self.edges[-1])
        return np.where(reading.echo & inside, self.values[place], 0.0)


def as_bins(name: str, edges: ArrayLike) -> Floats:
    """Return the edges of bins; raise SettingError unless there are two or more that increase."""
    edge = as_numbers(name, edges)
    if edge.ndim != 1 or len(edge) < 2 or not np.all(np.diff(edge) > 0):
        raise SettingError(f"{name}: expected two or more increasing numbers, got {shown(edges)}")
    return edge


def _steps_below(law: EchoLaw, edges: Floats) -> Ints:
    """Return the largest step of the register that reads less than each edge; that reads no more than the last."""
    reading = law._range(np.arange(1, law.last_step + 1))
    return np.r_[np.searchsorted(reading, edges[:-1]), np.searchsorted(reading, edges[-1], side="right")]


def _ratio(part: Floats, whole: Floats) -> Floats:
    return np.divide(part, whole, out=np.zeros(len(whole)), where=whole > 1e-12)


@checked
def wilson(hits: ArrayLike, trials: ArrayLike, z: Annotated[float, Limit(0.0, 40.0)] = 1.96) -> tuple[Floats, Floats]:
    """Return Wilson's score interval (1927) for a binomial probability, lower and upper limit, each (...,).

    Args:
        hits: numbers of successes.
        trials: numbers of trials, at least 1.
        z: normal quantile; 1.96 gives 95 % coverage.

    >>> low, high = wilson([0, 5], 10)
    >>> low.round(3).tolist(), high.round(3).tolist()
    ([0.0, 0.237], [0.278, 0.763])
    """
    n = as_numbers("wilson.trials", trials)
    share = as_numbers("wilson.hits", hits) / n
    centre = (share + z**2 / (2 * n)) / (1 + z**2 / n)
    half = z / (1 + z**2 / n) * np.sqrt(share * (1 - share) / n + z**2 / (4 * n**2))
    return np.clip(centre - half, 0.0, 1.0), np.clip(centre + half, 0.0, 1.0)
