"""How well a model describes readings: log-likelihood, CRPS, PIT, credence reliability.

Pings of one cell or session are correlated, so every standard error here is over clusters, never over pings.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from acquisition import Ping, Reading, SettingError
from noise.law import CREDENCE_TOLERANCE, EchoLaw, Floats
from noise.model import SonarModel, follow

LEVELS = 50  # of the quantile form of CRPS: within 0.2 % of 800 for learned laws
AT_ONCE = 400_000  # quantiles taken at once; bounds the memory


@dataclass(frozen=True)
class Score:
    """A mean over pings with its standard error over clusters.

    Attributes:
        mean: over all pings.
        error: standard error, clusters resampled; NaN with fewer than two clusters, where nothing is known of it.
        pings, clusters: how many.
    """

    mean: float
    error: float
    pings: int
    clusters: int

    @classmethod
    def of(cls, value: ArrayLike, cluster: ArrayLike) -> Score:
        """Average values, (n,), whose clusters are given by number or name, (n,).

        >>> Score.of([1.0, 1.0, 3.0, 3.0], [0, 0, 1, 1])
        Score(mean=2.0, error=1.0, pings=4, clusters=2)
        """
        x, g = np.asarray(value, dtype=np.float64), np.unique(np.asarray(cluster), return_inverse=True)[1]
        if not len(x) or len(x) != len(g):
            raise SettingError(f"Score needs a cluster for each of at least one value, got {len(x)} and {len(g)}")
        mean, groups = float(x.mean()), int(g.max()) + 1
        total = np.bincount(g, weights=x - mean) if np.isfinite(mean) else np.full(groups, np.nan)
        if groups < 2:
            return cls(mean, float("nan"), len(x), groups)
        error = np.sqrt(groups / (groups - 1) * np.sum(total**2)) / len(x)
        return cls(mean, float(error), len(x), groups)

    def __str__(self) -> str:
        return f"{self.mean:.3f} +- {self.error:.3f}"


def crps(law: EchoLaw, reading: Reading, levels: int = LEVELS) -> Floats:
    """Return the continuous ranked probability score of each echo, m, (n,); NaN where the reading is no echo.

    It scores *where* an echo is, given that there is one: the law conditional on an echo, in its quantile form
    2 mean_k (1[y < q_k] - t_k) (q_k - y) at levels t_k = (k - 1/2) / K, exact as K grows. Whether there is an echo is
    scored by the log-likelihood alone. Where the law excludes an echo that came, its quantiles are 0 m.

    Args:
        law: of n pings.
        reading: what they read.
        levels: number K of quantiles.
    """
    level = ((np.arange(levels) + 0.5) / levels)[:, None]
    score, batch = np.zeros(len(law)), max(1, AT_ONCE // max(len(law), 1))
    for part in (level[k : k + batch] for k in range(0, levels, batch)):
        quantile = law.quantile(part)
        score += np.sum(((reading.range < quantile) - part) * (quantile - reading.range), axis=0)
    return np.where(reading.echo, 2.0 * score / levels, np.nan)


def pit(law: EchoLaw, reading: Reading, rng: np.random.Generator) -> Floats:
    """Return the randomised probability integral transform of each reading, (n,): uniform if the law is true.

    Outcomes are ordered: echoes by range, then no echo, then no answer; within one a uniform number decides.
    """
    step = law.step(reading.range)
    echo, silent = law.echo, law.no_echo
    below = np.stack([echo, law.cdf_step(step - 1), echo + silent])
    width = np.stack([silent, law.between(law.edge(step - 1), law.edge(step)), law.no_answer])
    kind = reading.status[None].astype(np.int64)
    start, share = (np.take_along_axis(table, kind, axis=0)[0] for table in (below, width))
    return np.clip(start + rng.random(len(reading)) * share, 0.0, 1.0)


@dataclass(frozen=True)
class Reliability:
    """Credence as said and as it came true, by bins of what was said.

    Attributes:
        said: mean credence in each bin, (bins,); NaN where a bin is empty.
        came_true: share of readings within tolerance, (bins,).
        error: its standard error over clusters, (bins,).
        pings: in each bin, (bins,).
    """

    said: Floats
    came_true: Floats
    error: Floats
    pings: NDArray[np.int64]

    @property
    def gap(self) -> float:
        """Mean of |said - came true| over pings: expected calibration error."""
        filled = self.pings > 0
        return float(np.average(np.abs(self.said - self.came_true)[filled], weights=self.pings[filled]))


def credence_reliability(
    law: EchoLaw,
    reading: Reading,
    cluster: ArrayLike,
    tolerance: float = CREDENCE_TOLERANCE,
    bins: int = 10,
    rows: NDArray[np.bool_] | slice = slice(None),
) -> Reliability:
    """Compare credence given the condition with how often readings were within tolerance.

    Args:
        law: of n pings.
        reading: what they read.
        cluster: of each ping, (n,).
        tolerance: half width of "right", as a share of the true distance.
        bins: of equal width over [0, 1].
        rows: pings that count; all by default.
    """
    slack = 1e-9
    true = reading.echo & (np.abs(reading.range - law.distance) <= tolerance * law.distance + slack)
    return reliability(law.credence(tolerance)[rows], true[rows], np.asarray(cluster)[rows], bins)


def reliability(said: Floats, true: NDArray[np.bool_], cluster: ArrayLike, bins: int = 10) -> Reliability:
    """Compare probabilities as said, (n,), with what came true, (n,), by bins of equal width over [0, 1]."""
    g = np.asarray(cluster)
    place = np.minimum((said * bins).astype(np.int64), bins - 1)
    scores = [_score_or_none(true, g, place == k) for k in range(bins)]
    count = np.bincount(place, minlength=bins)
    total = np.bincount(place, weights=said, minlength=bins)
    return Reliability(
        said=np.divide(total, count, where=count > 0, out=np.full(bins, np.nan)),
        came_true=np.array([score.mean for score in scores]),
        error=np.array([score.error for score in scores]),
        pings=count,
    )


def _score_or_none(value: NDArray[np.bool_], cluster: NDArray, rows: NDArray[np.bool_]) -> Score:
    return Score.of(value[rows], cluster[rows]) if rows.any() else Score(np.nan, np.nan, 0, 0)


@dataclass(frozen=True)
class Evaluation:
    """A model's scores on readings it has not seen.

    Attributes:
        log_likelihood: of a ping, nats.
        crps_mm: of an echo, mm.
        credence_gap: expected calibration error of credence given the condition.
    """

    log_likelihood: Score
    crps_mm: Score
    credence_gap: float


def evaluate(
    model: SonarModel,
    ping: Ping,
    reading: Reading,
    cluster: ArrayLike,
    counts: NDArray[np.bool_] | None = None,
) -> Evaluation:
    """Score a model, each ping given what the model remembers of those before it in its run.

    Args:
        model: to score.
        ping: conditions, (n,), in the order in which they were faced.
        reading: what was read, (n,).
        cluster: cell or session of each ping, (n,).
        counts: which pings are scored, (n,); the others are only remembered. All by default.
    """
    rows = np.ones(len(ping), dtype=bool) if counts is None else counts
    return score_law(follow(model, ping, reading), reading, cluster, rows)


def score_law(law: EchoLaw, reading: Reading, cluster: ArrayLike, rows: NDArray[np.bool_]) -> Evaluation:
    """Score the rows of a law of n pings by what was read, (n,)."""
    g, echo = np.asarray(cluster), reading.echo & rows
    likelihood = Score.of(law.log_prob(reading)[rows], g[rows])
    crps_mm = Score.of(1e3 * crps(law, reading)[echo], g[echo]) if echo.any() else Score(np.nan, np.nan, 0, 0)
    return Evaluation(likelihood, crps_mm, credence_reliability(law, reading, g, rows=rows).gap)
