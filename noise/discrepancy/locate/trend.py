"""Trend test: a constant difference, or one that grows with a condition, between the mean errors of positions.

A bootstrap over ten positions cannot reject at 1 % whatever they show. Here mean errors are regressed on a constant and
one condition, with Student's t for either coefficient (Gosset 1908) and standard errors that allow for a scatter that
varies (HC3; MacKinnon and White 1985). Where the files share positions, only these are used: they are paired, so that
what the law gets wrong for both cancels. Otherwise each file has its own constant and slope, and the scatter of both
about their lines is the error. Mean shares of readings, of which a constant is fitted, have at least the binomial
error: shares of few positions may agree by chance. The p-value is Bonferroni's over all coefficients.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import t as student

from acquisition.arrays import Bits, Floats, Ints
from noise.discrepancy.locate.orthogonal import RATES
from noise.discrepancy.moments.bootstrap import NOTHING, Found
from noise.discrepancy.moments.sample import Sample, positions
from noise.discrepancy.moments.scores import ASPECTS, BIAS, Scores, scores_of_both
from noise.discrepancy.result import Aspect, Interval, Location, PValue, Visible
from noise.discrepancy.thresholds import FALSE_ALARM
from noise.effects.medium import TEMPERATURE
from noise.fitting.batch import Batch
from noise.fitting.stack import Key, Stack
from noise.fitting.starts import target_echo

MIN_PLACES = 5  # of each file: three degrees of freedom for a line
POWER, TWO_SIDED = 0.9, 0.95
N_TESTS = 5  # of one hypothesis, for which the level is adjusted: this one, the orthogonal test and those of `few`
ROUNDING = 1e-9  # m, below which errors are alike
UNCOMPENSATED: Key = ("sound_speed", "logged_share")
SHARES = np.linspace(0.0, 1.0, 21)  # from full compensation to none


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


def trend_test(law_recorded: Stack, law_simulated: Stack, sample: Sample) -> Found:
    """Test whether the mean errors of visits differ, everywhere or along a condition, or their shares of readings.

    Args:
        law_recorded: law of the recording.
        law_simulated: law that describes the simulation.
        sample: readings.
    """
    scored = scores_of_both(law_recorded, law_simulated, sample)
    error, recorded, place, first = _visit_means(scored, sample, BIAS)
    conditions = [None, *(value[first] for value in sample.conditions.values())]
    change = _of_temperature(law_simulated, sample)
    possible = [error] if change is None else [error - share * change[first] for share in SHARES]
    fits = [[line for x in conditions if (line := _line(each, recorded, place, x)) is not None] for each in possible]
    lines = max(fits, key=lambda each: min((line.p.min() for line in each), default=1.0))
    rates = {aspect: line for aspect in RATES if (line := _of_rate(scored, sample, aspect)) is not None}
    p = np.concatenate([line.p for line in (*lines, *rates.values())]) if lines or rates else np.ones(0)
    if not len(p):
        return NOTHING
    p_value = PValue(float(min(1.0, p.min() * len(p))), 0, len(p), 1 + len(rates))
    visible = None
    if lines:
        level = student.ppf(1.0 - FALSE_ALARM / (2.0 * N_TESTS * len(p)), lines[0].freedom)
        least = level + student.ppf(POWER, lines[0].freedom)
        visible = Visible(str(Aspect.BIAS), float(least * lines[0].error[0]), "m")
    where = _located(lines, rates, p_value) if p_value.value < FALSE_ALARM else ()
    return Found(p_value, where, visible)


def _located(lines: Sequence[_Line], rates: Mapping[Aspect, _Line], p_value: PValue) -> tuple[Location, ...]:
    """Return the mean difference of the aspect with the smallest p-value."""
    least = {Aspect.BIAS: min((line.p.min() for line in lines), default=1.0)}
    least |= {aspect: float(line.p.min()) for aspect, line in rates.items()}
    aspect = min(least, key=lambda each: least[each])
    mean = rates[aspect] if aspect in rates else lines[0]
    value, half = float(mean.value[0]), float(mean.error[0] * student.ppf(TWO_SIDED, mean.freedom))
    return (Location(aspect, {}, Interval(value, value - half, value + half, aspect.unit), p_value),)


def _of_rate(scored: Scores, sample: Sample, aspect: Aspect) -> _Line | None:
    """Return the mean difference of a share of readings; None where it is the same in all visits or cannot be told."""
    a = ASPECTS.index(aspect)
    rate, recorded, place, _ = _visit_means(scored, sample, a)
    line = _line(rate, recorded, place, None) if len(rate) and np.ptp(rate) > ROUNDING else None
    if line is None:
        return None
    valid = scored.valid[:, a]
    # of the readings themselves: the laws of both files may expect different shares
    share = float(np.mean(np.concatenate([_shows(batch, aspect) for batch in sample.batches])[valid]))
    n = np.bincount(sample.is_recorded[valid])
    least = float(np.sqrt(share * (1.0 - share) * (1.0 / n[n > 0]).sum()))
    return replace(line, error=np.maximum(line.error, least))


def _shows(batch: Batch, aspect: Aspect) -> Bits:
    """Return which readings are an echo, or an early or late one, (n,)."""
    if aspect is Aspect.DETECTION:
        return batch.reading.echo
    return batch.is_outlier(batch.error) & ((batch.error < 0.0) == (aspect is Aspect.EARLY))


def compensation_is_unknown(law: Stack, sample: Sample) -> bool:
    """Return whether both files log the temperature, and the simulation's readings do not tell how it enters."""
    logged = all(TEMPERATURE in batch.ping.covariates for batch in sample.batches)
    return sample.simulated is not None and logged and UNCOMPENSATED[0] not in law.values


def _of_temperature(law: Stack, sample: Sample) -> Floats | None:
    """Return the change of each reading without compensation for temperature, m, (n,); None where it is known."""
    if not compensation_is_unknown(law, sample):
        return None
    ends = [np.concatenate([target_echo(law.at({UNCOMPENSATED: x}), b) for b in sample.batches]) for x in (0.0, 1.0)]
    return ends[1] - ends[0]


def _visit_means(scored: Scores, sample: Sample, a: int) -> tuple[Floats, Bits, Ints, Ints]:
    """Return the mean of an aspect, its file, position and first row for each visit that shows the aspect.

    Visits of one position may share its error, so that positions are the independent units.
    """
    valid, natural = scored.valid[:, a], scored.natural[:, a]
    count = np.bincount(sample.visit, valid)
    mean = np.bincount(sample.visit, natural * valid) / np.maximum(count, 1.0)
    first = np.unique(sample.visit, return_index=True)[1]
    place = np.unique(np.concatenate([positions(b) for b in sample.batches]), axis=0, return_inverse=True)[1].ravel()
    seen = (count > 0) & _within_both(sample, first)
    return mean[seen], sample.is_recorded[first][seen], place[seen], first[seen]


def _within_both(sample: Sample, first: Ints) -> Bits:
    """Return which visits lie within the range of every condition in both files; beyond it the law is not known.

    Conditions of the day, such as the temperature, need not overlap: the law says how they enter.
    """
    file = sample.is_recorded[first]
    inside = np.ones(len(first), dtype=bool)
    for value in (each[first] for name, each in sample.conditions.items() if name not in sample.of_the_day):
        ends = [(value[rows].min(), value[rows].max()) for rows in (file, ~file) if rows.any()]
        inside &= (value >= max(low for low, _ in ends)) & (value <= min(high for _, high in ends))
    return inside


def _line(error: Floats, recorded: Bits, place: Ints, x: Floats | None) -> _Line | None:
    """Return the difference between the files, with a slope along x if given; None where positions are too few."""
    if not len(error):
        return None
    columns = [error] if x is None else [error, (x - x.mean()) / max(float(x.std()), 1e-12)]
    files = [rows for rows in (recorded, ~recorded) if rows.any()]
    known = [np.unique(place[rows]) for rows in files]
    shared = np.intersect1d(known[0], known[-1])
    if len(shared) >= MIN_PLACES:
        means = [_means(columns, place, rows, shared) for rows in files]
        y = means[0][0] - (means[1][0] if len(files) == 2 else 0.0)
        return _least_squares(y, [np.ones(len(shared)), *means[0][1:]], len(columns))
    if min(map(len, known)) < MIN_PLACES:
        return None
    own = [_means(columns, place, rows, places) for rows, places in zip(files, known, strict=True)]
    y, *slope = (np.concatenate(parts) for parts in zip(*own, strict=True))
    both = [np.ones(len(y)), *slope]
    is_first = np.arange(len(y)) < len(known[0])
    return _least_squares(y, [*(is_first * each for each in both), *both], len(columns))


def _means(values: Sequence[Floats], place: Ints, rows: Bits, wanted: Ints) -> list[Floats]:
    """Return the mean of each quantity over the visits of each of some positions."""
    n = int(place.max()) + 1
    count = np.bincount(place[rows], minlength=n)[wanted]
    return [np.bincount(place[rows], value[rows], n)[wanted] / count for value in values]


def _least_squares(y: Floats, columns: list[Floats], n_tested: int) -> _Line | None:
    design = np.stack(columns, axis=1)
    freedom = len(y) - design.shape[1]
    if freedom < MIN_PLACES - 2 or np.linalg.matrix_rank(design) < design.shape[1]:
        return None
    inverse = np.linalg.inv(design.T @ design)
    value = inverse @ design.T @ y
    leverage = np.sum(design @ inverse * design, axis=1)
    residual = np.maximum(np.abs(y - design @ value), ROUNDING) / np.maximum(1.0 - leverage, ROUNDING)
    error = np.sqrt(np.diag(inverse @ (design.T * residual**2) @ design @ inverse))
    return _Line(np.asarray(value[:n_tested]), np.asarray(error[:n_tested]), freedom)
