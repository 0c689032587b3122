"""Scores of a model on readings: log-likelihood, CRPS, PIT and reliability of credence.

Pings of one visit or session are correlated, so all standard errors are over clusters, never over pings.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from acquisition import Ping, Reading, SettingError
from acquisition.arguments import checked
from acquisition.limits import Count, as_numbers, shown
from acquisition.ping import check_pairs
from noise.law import CREDENCE_TOLERANCE, EchoLaw, Floats, Tolerance
from noise.model import SonarModel, follow

LEVELS = 50  # levels of the quantile form of the CRPS: within 0.2 % of 800 levels for learned laws
MAX_QUANTILES = 400_000  # computed at once; bounds the memory


@dataclass(frozen=True)
class ClusterMean:
    """A mean over pings with its standard error over clusters.

    Attributes:
        mean: mean over all pings.
        error: cluster-robust standard error; NaN with fewer than two clusters.
        pings, clusters: numbers of pings and of clusters.
    """

    mean: float
    error: float
    pings: int
    clusters: int

    @classmethod
    def of(cls, value: ArrayLike, cluster: ArrayLike) -> ClusterMean:
        """Return the mean of values, (n,), with clusters given by number or name, (n,).

        >>> ClusterMean.of([1.0, 1.0, 3.0, 3.0], [0, 0, 1, 1])
        ClusterMean(mean=2.0, error=1.0, pings=4, clusters=2)
        """
        x = as_numbers("ClusterMean.of.value", value)
        g = np.unique(_clusters(cluster, len(x)), return_inverse=True)[1]
        if not len(x) or len(x) != len(g):
            raise SettingError(
                f"ClusterMean needs at least one value and a cluster for each, got {len(x)} and {len(g)}"
            )
        mean, groups = float(x.mean()), int(g.max()) + 1
        total = np.bincount(g, weights=x - mean) if np.isfinite(mean) else np.full(groups, np.nan)
        if groups < 2:
            return cls(mean, float("nan"), len(x), groups)
        error = np.sqrt(groups / (groups - 1) * np.sum(total**2)) / len(x)
        return cls(mean, float(error), len(x), groups)

    def __str__(self) -> str:
        """Return the mean, with its standard error where there is one (several clusters, a finite mean)."""
        return f"{self.mean:.3f} +- {self.error:.3f}" if np.isfinite(self.error) else f"{self.mean:.3f}"


@checked
def crps(law: EchoLaw, reading: Reading, levels: Count = LEVELS) -> Floats:
    """Return the continuous ranked probability score of each echo, m, (n,); NaN where the reading is no echo.

    The score is that of the law conditional on an echo, in its quantile form
    2 mean_k (1[y < q_k] - t_k) (q_k - y) at levels t_k = (k - 1/2) / K, exact for K to infinity. The probability of an
    echo is scored only by the log-likelihood. Where an observed echo has probability 0, the quantiles are 0 m.

    Args:
        law: law of n pings.
        reading: readings, (n,).
        levels: number K of quantiles.
    """
    check_pairs("crps.reading", law, reading)
    score = _quantile_score(law.quantile, reading.range, levels)
    return np.where(reading.echo, score, np.nan)


@checked
def crps_with_silence(
    law: EchoLaw,
    reading: Reading,
    silence: float | None = None,
    levels: Count = LEVELS,
    tolerance: Tolerance | None = None,
) -> Floats:
    """Return the continuous ranked probability score of each reading, m, (n,), in which no echo counts as a range.

    With a tolerance, the score is threshold-weighted (Gneiting and Ranjan 2011): ranges are clipped to so much of the
    true distance on either side. A missed echo then counts no more than any other reading that is no use.

    Args:
        law: law of n pings.
        reading: readings, (n,).
        silence: range that stands for no echo and no answer, in the law and in the reading, m; `law.max_range` by
            default.
        levels: number K of quantiles; see `crps`.
        tolerance: as a share of the true distance; none by default.
    """
    check_pairs("crps_with_silence.reading", law, reading)
    end, echo = law.max_range if silence is None else silence, law.echo
    silent, nearer = 1.0 - echo, echo if end >= law.max_range else law.cdf(end)
    reach = np.inf if tolerance is None else tolerance * law.distance
    low, high = law.distance - reach, law.distance + reach

    def quantile(level: Floats) -> Floats:
        with np.errstate(over="ignore"):  # of the least probabilities of an echo: no level is a share of them
            among = np.where(level < nearer, level, np.maximum(level - silent, 0.0))
            share = np.divide(among, echo, where=echo > 0, out=np.zeros((len(level), len(echo))))
        at_end = (level >= nearer) & (level < nearer + silent)
        return np.clip(np.where(at_end, end, law.quantile(np.minimum(share, 1.0))), low, high)

    return _quantile_score(quantile, np.clip(np.where(reading.echo, reading.range, end), low, high), levels)


def _quantile_score(quantile: Callable[[Floats], Floats], value: Floats, levels: int) -> Floats:
    """Return 2 mean_k (1[y < q_k] - t_k) (q_k - y) at levels t_k = (k - 1/2) / K, (n,)."""
    level = ((np.arange(levels) + 0.5) / levels)[:, None]
    score, batch = np.zeros(len(value)), max(1, MAX_QUANTILES // max(len(value), 1))
    for part in (level[k : k + batch] for k in range(0, levels, batch)):
        at = quantile(part)
        score += np.sum(((value < at) - part) * (at - value), axis=0)
    return 2.0 * score / levels


@checked
def pit(law: EchoLaw, reading: Reading, rng: np.random.Generator) -> Floats:
    """Return the randomised probability integral transform of each reading, (n,): uniform if the law is true.

    Outcomes are ordered: echoes by range, then no echo, then no answer; the value is uniform within an outcome.
    """
    check_pairs("pit.reading", law, reading)
    step = law.step(reading.range)
    echo, silent = law.echo, law.no_echo
    below = np.stack([echo, law.cdf_step(step - 1), echo + silent])
    width = np.stack([silent, law.between(law.edge(step - 1), law.edge(step)), law.no_answer])
    kind = reading.status[None].astype(np.int64)
    start, share = (np.take_along_axis(table, kind, axis=0)[0] for table in (below, width))
    return np.clip(start + rng.random(len(reading)) * share, 0.0, 1.0)


@dataclass(frozen=True)
class Reliability:
    """Predicted probabilities and observed frequencies, by bins of the prediction.

    Attributes:
        predicted: mean predicted probability in each bin, (bins,); NaN where a bin is empty.
        observed: observed frequency in each bin, (bins,).
        error: standard error of the frequency over clusters, (bins,).
        pings: number of pings in each bin, (bins,).
    """

    predicted: Floats
    observed: Floats
    error: Floats
    pings: NDArray[np.int64]

    @property
    def gap(self) -> float:
        """Expected calibration error: mean of |predicted - observed| over pings."""
        filled = self.pings > 0
        return float(np.average(np.abs(self.predicted - self.observed)[filled], weights=self.pings[filled]))


@checked
def credence_reliability(
    law: EchoLaw,
    reading: Reading,
    cluster: ArrayLike,
    tolerance: float = CREDENCE_TOLERANCE,
    bins: int = 10,
    rows: NDArray[np.bool_] | slice = slice(None),
) -> Reliability:
    """Compare credence given the condition with the frequency of readings within tolerance.

    Args:
        law: law of n pings.
        reading: readings, (n,).
        cluster: cluster of each ping, (n,).
        tolerance: largest error of a right reading, relative to the true distance.
        bins: number of bins of equal width over [0, 1].
        rows: pings to use; all by default.
    """
    check_pairs("credence_reliability.reading", law, reading)
    true = is_correct(law, reading, tolerance)
    return reliability(law.credence(tolerance)[rows], true[rows], _clusters(cluster, len(reading))[rows], bins)


def is_correct(of: Ping | EchoLaw, reading: Reading, tolerance: float = CREDENCE_TOLERANCE) -> NDArray[np.bool_]:
    """Return which readings are echoes within a relative tolerance of the true distance, (n,)."""
    return reading.echo & (np.abs(reading.range - of.distance) <= tolerance * of.distance + 1e-9)


@checked
def reliability(predicted: Floats, true: NDArray[np.bool_], cluster: ArrayLike, bins: int = 10) -> Reliability:
    """Compare predicted probabilities, (n,), with outcomes, (n,), by bins of equal width over [0, 1]."""
    g = _clusters(cluster, len(predicted))
    place = np.minimum((predicted * bins).astype(np.int64), bins - 1)
    scores = [_mean_or_nan(true, g, place == k) for k in range(bins)]
    count = np.bincount(place, minlength=bins)
    total = np.bincount(place, weights=predicted, minlength=bins)
    return Reliability(
        predicted=np.divide(total, count, where=count > 0, out=np.full(bins, np.nan)),
        observed=np.array([score.mean for score in scores]),
        error=np.array([score.error for score in scores]),
        pings=count,
    )


def _clusters(cluster: ArrayLike, n: int) -> NDArray[np.int64]:
    """Return the cluster of each of n pings as a number; raise SettingError unless there is one for each."""
    try:
        found = np.asarray(cluster)
        number = np.unique(found, return_inverse=True)[1]
    except (MemoryError, RuntimeError, TypeError, ValueError):  # rows of unequal lengths, or neither numbers nor names
        found = number = np.array(None)
    if found.shape != (n,):
        raise SettingError(f"cluster: expected a number or name for each of {n} pings, got {shown(cluster)}")
    return number


def _mean_or_nan(value: NDArray, cluster: NDArray, rows: NDArray[np.bool_]) -> ClusterMean:
    return ClusterMean.of(value[rows], cluster[rows]) if rows.any() else ClusterMean(np.nan, np.nan, 0, 0)


@dataclass(frozen=True)
class Evaluation:
    """Scores of a model on test readings.

    Attributes:
        log_likelihood: log-likelihood per ping, nats.
        crps_mm: CRPS per echo, mm.
        credence_gap: expected calibration error of credence given the condition.
    """

    log_likelihood: ClusterMean
    crps_mm: ClusterMean
    credence_gap: float


@checked
def evaluate(
    model: SonarModel,
    ping: Ping,
    reading: Reading,
    cluster: ArrayLike,
    counts: NDArray[np.bool_] | None = None,
    answered: bool = False,
) -> Evaluation:
    """Score a model, each ping given the earlier pings of its run.

    Args:
        model: model to score.
        ping: conditions, (n,), in chronological order.
        reading: readings, (n,).
        cluster: visit or session of each ping, (n,).
        counts: pings to score, (n,) bool, all by default; the others only serve as history.
        answered: whether only answered pings are scored, by the law given an answer.
    """
    rows = np.ones(len(ping), dtype=bool) if counts is None else counts
    return score_law(follow(model, ping, reading), reading, cluster, rows, answered)


@checked
def score_law(
    law: EchoLaw, reading: Reading, cluster: ArrayLike, rows: NDArray[np.bool_], answered: bool = False
) -> Evaluation:
    """Score the given rows of a law of n pings on their readings; see `evaluate`."""
    g, answer = _clusters(cluster, len(reading)), np.ones(len(reading))
    if answered:
        rows, answer = rows & reading.answered, np.maximum(1.0 - law.no_answer, 1e-300)
    likelihood = ClusterMean.of((law.log_prob(reading) - np.log(answer))[rows], g[rows])
    crps_mm = _mean_or_nan(1e3 * crps(law, reading), g, reading.echo & rows)
    credence = np.minimum(law.credence() / answer, 1.0)
    return Evaluation(likelihood, crps_mm, reliability(credence[rows], is_correct(law, reading)[rows], g[rows]).gap)
