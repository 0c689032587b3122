"""Trend test: a constant difference, or one that grows with a condition, between a few visits of two files.

A bootstrap over ten visits cannot reject at 1 % whatever they show. Here the mean errors of visits are regressed on a
constant and one condition, with Student's t for either coefficient (Gosset 1908). Visits under the same conditions are
paired, so that what the law gets wrong for both files cancels; otherwise both files share a line in that condition.
The p-value is Bonferroni's over all coefficients.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import t as student

from acquisition.arrays import Bits, Floats, Ints
from noise.discrepancy.locate.sample import Sample
from noise.discrepancy.locate.scores import ASPECTS, scores
from noise.discrepancy.result import Aspect, Interval, Location, PValue, Visible
from noise.fitting.stack import Stack

MIN_VISITS = 5  # that both files have, or of each file: three degrees of freedom for a line
LEVEL, POWER, TWO_SIDED = 0.01, 0.9, 0.95
ROUNDING = 1e-9  # m, below which errors are alike


@dataclass(frozen=True)
class Trend:
    """Result of the test.

    Attributes:
        p_value: of the most significant coefficient.
        where: the mean difference, if the test rejects at `LEVEL`.
        visible: the least mean difference that is seen with a power of 90 %; None where nothing can be tested.
    """

    p_value: PValue
    where: tuple[Location, ...]
    visible: Visible | None


NO_TREND = Trend(PValue(1.0, 0), (), None)


@dataclass(frozen=True, eq=False)
class _Line:
    """Least squares with the coefficients of a difference among others.

    Attributes:
        value, error: coefficients of the difference and their standard errors, m.
        freedom: degrees of freedom.
    """

    value: Floats
    error: Floats
    freedom: int

    @property
    def p(self) -> Floats:
        """Two-sided p-values."""
        return np.asarray(2.0 * student.sf(np.abs(self.value) / self.error, self.freedom))


def trend_test(law_recorded: Stack, law_simulated: Stack, sample: Sample) -> Trend:
    """Test whether the mean errors of visits differ, everywhere or along a condition.

    Args:
        law_recorded: law of the recording.
        law_simulated: law that describes the simulation.
        sample: readings.
    """
    error, recorded, cluster, first = _visit_errors(law_recorded, law_simulated, sample)
    conditions = [value[first] for value in sample.conditions.values()]
    lines = [line for x in (None, *conditions) if (line := _line(error, recorded, cluster, x)) is not None]
    if not lines:
        return NO_TREND
    p = np.concatenate([line.p for line in lines])
    value = float(min(1.0, p.min() * len(p)))
    mean = lines[0]
    half = float(mean.error[0] * student.ppf(TWO_SIDED, mean.freedom))
    size = Interval(float(mean.value[0]), float(mean.value[0]) - half, float(mean.value[0]) + half, "m")
    p_value = PValue(value, 0, len(p), 1)
    least = student.ppf(1.0 - LEVEL / (2.0 * len(p)), mean.freedom) + student.ppf(POWER, mean.freedom)
    where = (Location(Aspect.BIAS, {}, size, p_value),) if value < LEVEL else ()
    return Trend(p_value, where, Visible(str(Aspect.BIAS), float(least * mean.error[0]), "m"))


def _visit_errors(law_recorded: Stack, law_simulated: Stack, sample: Sample) -> tuple[Floats, Bits, Ints, Ints]:
    """Return mean error, m, file, cluster and first row of each visit with an echo of the target."""
    laws = (law_recorded, law_simulated)
    scored = [scores(law, batch) for law, batch in zip(laws, sample.batches, strict=False)]
    bias = ASPECTS.index(Aspect.BIAS)
    valid = np.concatenate([each.valid[:, bias] for each in scored])
    natural = np.concatenate([each.natural[:, bias] for each in scored])
    count = np.bincount(sample.visit, valid)
    mean = np.bincount(sample.visit, natural * valid) / np.maximum(count, 1.0)
    first = np.unique(sample.visit, return_index=True)[1]
    seen = count > 0
    return mean[seen], sample.is_recorded[first][seen], sample.cluster[first][seen], first[seen]


def _line(error: Floats, recorded: Bits, cluster: Ints, x: Floats | None) -> _Line | None:
    """Return the difference between the files, with a slope along x if given; None where visits are too few."""
    centred = [] if x is None else [(x - x.mean()) / max(float(x.std()), 1e-12)]
    shared = np.intersect1d(cluster[recorded], cluster[~recorded])
    if len(shared) >= MIN_VISITS:
        own, other = (_cluster_means([error, *centred], cluster, rows, shared) for rows in (recorded, ~recorded))
        return _least_squares(own[0] - other[0], [np.ones(len(shared)), *own[1:]], 1 + len(centred))
    if not recorded.all() and min(recorded.sum(), (~recorded).sum()) < MIN_VISITS:
        return None
    each = [np.ones(len(error)), *centred]
    both = [] if recorded.all() else each
    return _least_squares(error, [*(recorded * column for column in each), *both], len(each))


def _cluster_means(values: Sequence[Floats], cluster: Ints, rows: Bits, shared: Ints) -> list[Floats]:
    """Return the mean of each quantity over some visits of each shared cluster."""
    n = int(cluster.max()) + 1
    count = np.bincount(cluster[rows], minlength=n)[shared]
    return [np.bincount(cluster[rows], value[rows], n)[shared] / count for value in values]


def _least_squares(y: Floats, columns: list[Floats], n_tested: int) -> _Line | None:
    design = np.stack(columns, axis=1)
    freedom = len(y) - design.shape[1]
    if freedom < MIN_VISITS - 2 or np.linalg.matrix_rank(design) < design.shape[1]:
        return None
    value, *_ = np.linalg.lstsq(design, y, rcond=None)
    variance = max(float(((y - design @ value) ** 2).sum()) / freedom, ROUNDING**2)
    error = np.sqrt(variance * np.diag(np.linalg.inv(design.T @ design)))
    return _Line(np.asarray(value[:n_tested], dtype=np.float64), np.asarray(error[:n_tested]), freedom)
