"""Tests for recordings of few positions, in which a bootstrap over positions has no power.

Between positions: careful placement scatters by at most `MAX_PLACEMENT_M`, two recordings of one sonar differ by the
tolerances in shares of readings and scatter, and the error of the law shows in the simulation. Where the means of the
recorded positions scatter more than both, in an F test without the greatest of them, the sonar differs: one target may
have been misplaced, and one visit disturbed.

Shares of readings that are far from the target, silent or repeated differ where their mean over positions does, in
Welch's t test, which knows how they vary between positions.

Within positions: pings of one position are comparable with each other, whatever is wrong with the position. Scores and
regressors lose their mean there, so that regressors of time, order and history remain. The statistic of a regressor is
its slope in the recording less that in the simulation, and clusters are blocks of pings, long enough that the means of
neighbours are not correlated in the simulation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import f as fisher
from scipy.stats import t as student

from acquisition.arrays import Bits, Floats, Ints
from noise.discrepancy.locate.location import TWO_SIDED, region_of
from noise.discrepancy.locate.orthogonal import INDICATORS, MIN_CLUSTERS
from noise.discrepancy.moments.bootstrap import NOTHING, Found, exceeded, leverage_factor, signs_of, studentised
from noise.discrepancy.moments.moments import bin_sums
from noise.discrepancy.moments.regressors import Column, Form, columns_of
from noise.discrepancy.moments.sample import Sample, positions
from noise.discrepancy.moments.scores import ASPECTS, BIAS, LIMIT, Scores, ping_law, scores_of_both, target_of
from noise.discrepancy.result import Aspect, Interval, Location, PValue
from noise.discrepancy.thresholds import FALSE_ALARM, LEAST_CHANCE, MAX_PLACEMENT_M, SHARE_TOLERANCE, SPREAD_TOLERANCE
from noise.fitting.batch import Batch
from noise.fitting.stack import LEVEL_SD, PLACEMENT, Stack

SPREAD = ASPECTS.index(Aspect.SPREAD)
SHARES = ((Aspect.EARLY, Aspect.LATE), (Aspect.DETECTION,), (Aspect.REPEAT,))  # each the sum of its aspects
COARSER = 1.5  # ratio of the steps of two registers that differ
KNOWN = 1e9  # degrees of freedom where nothing is estimated
MIN_PLACES = 5  # positions of each file for an F test, or Welch's
MIN_PER_PLACE = 3  # blocks of a position, on average
MAX_BLOCKS = 200  # of a file; more do not improve the variance estimates
TOLERANCES = {  # by which means of one position differ between two recordings of one sonar
    Aspect.BIAS: MAX_PLACEMENT_M,
    Aspect.SPREAD: SPREAD_TOLERANCE,
    **dict.fromkeys((Aspect.DETECTION, Aspect.EARLY, Aspect.LATE, Aspect.REPEAT), SHARE_TOLERANCE),
}
CORRELATED = 1.64  # standard errors of a correlation at the 5 % level, one-sided


def register_test(recorded: Batch) -> Found:
    """Test whether the readings lie on a coarser grid than that of the register.

    The p-value is the probability that as many different readings on a fine register lie on one such grid by chance.
    """
    if recorded.grid_m <= COARSER * recorded.resolution:
        return NOTHING
    different = len(np.unique(recorded.reading.range[recorded.reading.echo]))
    chance = (recorded.resolution / recorded.grid_m) ** max(different - 1, 0)
    return Found(PValue(max(chance, LEAST_CHANCE), 0, 1, 1))


def placement_test(law_recorded: Stack, law_simulated: Stack, sample: Sample) -> Found:
    """Test whether means of recorded positions scatter more than two recordings of one sonar and the law's error allow.

    The p-value is Bonferroni's with weights (Genovese, Roeder and Wasserman 2006): half of the level is for the mean
    error, which most differences change, and the other aspects share the rest.

    Args:
        law_recorded: law of the recording.
        law_simulated: law that describes the simulation.
        sample: readings.
    """
    scored = _spread_within(scores_of_both(law_recorded, law_simulated, sample), law_recorded, law_simulated, sample)
    found = [each for aspect in TOLERANCES if (each := _of_aspect(scored, sample, aspect)) is not None]
    if not found:
        return NOTHING
    n_others = len(TOLERANCES) - 1
    adjusted = [2.0 * each.p * (1 if each.aspect is Aspect.BIAS else n_others) for each in found]
    least = found[int(np.argmin(adjusted))]
    p_value = PValue(min(1.0, *adjusted), 0, len(found), len(found))
    return Found(p_value, (least.largest(p_value),) if p_value.value < FALSE_ALARM else ())


def _spread_within(scored: Scores, law_recorded: Stack, law_simulated: Stack, sample: Sample) -> Scores:
    """Return scores with the spread about the mean of a position, which does not depend on where the target stands."""
    laws = [law.at({PLACEMENT: 0.0, LEVEL_SD: 0.0}) for law in (law_recorded, law_simulated)]
    pairs = zip(laws, sample.batches, sample.left_out(law_simulated), strict=False)
    sigma = np.concatenate([target_of(ping_law(law.by_part(part), batch))[1] for law, batch, part in pairs])
    place, valid = _places(sample), scored.valid[:, SPREAD]
    count = np.bincount(place, valid)[place]
    error = _within(scored.natural[:, BIAS], valid, place) / sigma
    square = np.clip(error, -LIMIT, LIMIT) ** 2 * count / np.maximum(count - 1.0, 1.0)
    natural, several = scored.natural.copy(), valid & (count > 1)
    natural[:, SPREAD] = 0.5 * (square - 1.0)  # as in `scores`
    both = scored.valid.copy()
    both[:, SPREAD] = several
    return replace(scored, natural=natural, valid=both)


@dataclass(frozen=True, eq=False)
class _Positions:
    """Means of an aspect at the recorded positions.

    Attributes:
        aspect: what differs.
        mean: of each position, (positions,), in the unit of the aspect.
        variance: of the means, what two recordings of one sonar differ by included.
        distance: of each position, m.
        p: p-value of the F test.
    """

    aspect: Aspect
    mean: Floats
    variance: Floats
    distance: Floats
    p: float

    def largest(self, p_value: PValue) -> Location:
        """Return the interval of distances in which the mean is most significant, less log n for each of its ends."""
        order = np.argsort(self.distance)
        mean, variance, distance = self.mean[order], self.variance[order], self.distance[order]
        runs = [(k, j) for k in range(len(mean)) for j in range(k + 1, len(mean) + 1)]
        whole = (0, len(mean))

        def gain(run: tuple[int, int]) -> float:
            ends = (run[0] > whole[0]) + (run[1] < whole[1])
            part = slice(*run)
            return float(mean[part].sum() ** 2 / variance[part].sum() - ends * np.log(len(mean)))

        best = max(runs, key=gain)
        part = slice(*best)
        error = TWO_SIDED * float(np.sqrt(variance[part].sum())) / (best[1] - best[0])
        value = float(mean[part].mean())
        region = {} if best == whole else {"distance": (float(distance[part][0]), float(distance[part][-1]))}
        return Location(self.aspect, region, Interval(value, value - error, value + error, self.aspect.unit), p_value)


def _of_aspect(scored: Scores, sample: Sample, aspect: Aspect) -> _Positions | None:
    """Return the F test of the means of an aspect; None where positions are too few."""
    a = ASPECTS.index(aspect)
    value, valid = scored.natural[:, a], scored.valid[:, a]
    files = [_means(value, valid, sample, rows) for rows in (sample.is_recorded, ~sample.is_recorded) if rows.any()]
    if min(len(mean) for mean, _, _ in files) < MIN_PLACES:
        return None
    (mean, variance, distance), others = files[0], files[1:]
    variance = variance + TOLERANCES[aspect] ** 2 + sum(float(np.mean(other**2)) for other, _, _ in others)
    ratio = np.sort(mean**2 / variance)[:-1]
    p = float(fisher.sf(ratio.mean(), len(ratio), len(others[0][0]) if others else KNOWN))
    return _Positions(aspect, mean, variance, distance, p)


def share_test(law_recorded: Stack, law_simulated: Stack, sample: Sample) -> Found:
    """Test whether shares of readings are those of the simulation, less what each law says.

    The p-value is Bonferroni's of the shares that can be tested.

    Args:
        law_recorded: law of the recording.
        law_simulated: law that describes the simulation.
        sample: readings.
    """
    scored = scores_of_both(law_recorded, law_simulated, sample)
    found = [each for aspects in SHARES if (each := _of_share(scored, sample, aspects)) is not None]
    if not found:
        return NOTHING
    least = min(found, key=lambda each: each.p_value.value)
    p_value = PValue(min(1.0, len(found) * least.p_value.value), 0, len(found), len(found))
    return Found(p_value, (replace(least, p_value=p_value),) if p_value.value < FALSE_ALARM else ())


def _of_share(scored: Scores, sample: Sample, aspects: Sequence[Aspect]) -> Location | None:
    """Return how a share differs, in Welch's t test; None where positions are too few, or no reading could differ.

    The variance of a mean is at least that of so many independent readings, which have the share that is read or that
    the law expects: shares of few positions may agree by chance.
    """
    columns = [ASPECTS.index(aspect) for aspect in aspects]
    value, valid = scored.natural[:, columns].sum(axis=1), scored.valid[:, columns[0]]
    event = (value < 0) if Aspect.DETECTION in aspects else (value > 0)
    share = float(np.mean((event + np.abs(event - np.abs(value)))[valid]) / 2.0) if valid.any() else 0.0
    sides = [rows for rows in (sample.is_recorded, ~sample.is_recorded) if rows.any()]
    files = [_means(value, valid, sample, rows)[0] for rows in sides]
    if not 0.0 < share < 1.0 or min(map(len, files)) < MIN_PLACES:
        return None
    single = max(share * (1.0 - share), float(np.var(value[valid])))
    counts = [int((valid & rows).sum()) for rows in sides]
    each = [max(float(np.var(m)) / (len(m) - 1), single / n) for m, n in zip(files, counts, strict=True)]
    total = sum(each)
    freedom = total**2 / sum(v**2 / (len(m) - 1) for v, m in zip(each, files, strict=True))
    size, error = float(files[0].mean() - sum(mean.mean() for mean in files[1:])), float(np.sqrt(total))
    p_value = PValue(max(float(2.0 * student.sf(abs(size) / error, freedom)), LEAST_CHANCE), 0, 1, 1)
    most = columns[int(np.abs(scored.natural[sample.is_recorded][:, columns].sum(axis=0)).argmax())]
    interval = Interval(size, size - TWO_SIDED * error, size + TWO_SIDED * error, ASPECTS[most].unit)
    return Location(ASPECTS[most], {}, interval, p_value)


def _means(value: Floats, valid: Bits, sample: Sample, rows: Bits) -> tuple[Floats, Floats, Floats]:
    """Return the mean of a score, its variance, and the distance, m, of each position of a file, (positions,)."""
    rows = rows & valid
    value, every = value[rows], np.concatenate([batch.ping.distance for batch in sample.batches])
    place = np.unique(_places(sample)[rows], return_inverse=True)[1]
    count = np.bincount(place)
    mean = np.bincount(place, value) / np.maximum(count, 1)
    within = np.bincount(place, (value - mean[place]) ** 2) / np.maximum(count - 1, 1)
    return mean, within / np.maximum(count, 1), np.bincount(place, every[rows]) / np.maximum(count, 1)


def _places(sample: Sample) -> Ints:
    """Return the position of each ping in each file, (n,)."""
    rows = [np.c_[np.full(len(b), k), positions(b)[b.visit]] for k, b in enumerate(sample.batches)]
    return np.asarray(np.unique(np.concatenate(rows), axis=0, return_inverse=True)[1].ravel(), dtype=np.int64)


def within_test(law_recorded: Stack, law_simulated: Stack, sample: Sample, rng: np.random.Generator) -> Found:
    """Test whether readings depend otherwise on time, order or history than those of the simulation.

    Args:
        law_recorded: law of the recording.
        law_simulated: law that describes the simulation.
        sample: readings.
        rng: draws signs.
    """
    scored = scores_of_both(law_recorded, law_simulated, sample)
    place = _places(sample)
    block = _blocks(scored, sample, place)
    columns = [column for column in columns_of(sample) if column.form is not Form.CONDITION]
    if block is None:
        return NOTHING
    signs, factor = signs_of(block, rng), _leverage_of(place, block)
    greatest, best = np.zeros(len(signs)), (0.0, Aspect.BIAS, 0, 0)
    n_aspects = 0
    for a, aspect in enumerate(ASPECTS):
        rows = np.flatnonzero(scored.valid[:, a])
        if not len(rows) or not columns:
            continue
        parts = [_of_column(scored, sample, column, place, block, a) for column in columns]
        psi, allowed = (np.concatenate([each[k] for each in parts], axis=-1) for k in range(2))
        z, _, scaled = studentised(psi, allowed, unbiased=psi * factor[:, None])
        if not scaled.shape[1]:
            continue
        n_aspects += 1
        greatest = np.maximum(greatest, np.abs(signs @ scaled).max(axis=1))
        k = int(np.nanargmax(np.abs(z)))
        best = max(best, (float(abs(z[k])), aspect, k, a), key=lambda each: each[0])
    if not n_aspects:
        return NOTHING
    n_regressors = sum(len(column.regressors) for column in columns)
    p_value = PValue(exceeded(best[0], greatest), len(signs), n_regressors, n_aspects)
    if p_value.value >= FALSE_ALARM:
        return Found(p_value)
    return Found(p_value, (_located(scored, sample, columns, place, block, best[2], best[3], p_value),))


def _blocks(scored: Scores, sample: Sample, place: Ints) -> Ints | None:
    """Return the block of each ping, (n,): neighbouring pings of one visit, twice as many as are not independent.

    Where the errors of a position are correlated throughout it, its pings cannot be compared with each other: None.
    """
    longest, length = max(int(batch.count.max()) + 1 for batch in sample.batches), 1
    while length <= longest:
        block = _divided(sample, 2 * length)
        n_blocks = int(block.max()) + 1
        if n_blocks < MIN_PER_PLACE * (int(place.max()) + 1):
            break
        enough = n_blocks <= MAX_BLOCKS * len(sample.batches)
        if enough and not _correlated(scored, place, _divided(sample, length), sample):
            return block
        length *= 2
    return None


def _divided(sample: Sample, length: int) -> Ints:
    """Return blocks of so many pings of each visit, (n,)."""
    label = np.concatenate([batch.count // length for batch in sample.batches])
    return np.asarray(np.unique(np.c_[sample.visit, label], axis=0, return_inverse=True)[1].ravel(), dtype=np.int64)


def _correlated(scored: Scores, place: Ints, block: Ints, sample: Sample) -> bool:
    """Return whether mean errors of neighbouring blocks of a position are correlated in the simulation.

    Two recordings of one sonar are correlated alike, and readings of a known law are not.
    """
    if sample.simulated is None:
        return False
    valid = scored.valid[:, BIAS]
    value = _within(scored.value[:, BIAS] * valid, valid, place)
    mean = np.bincount(block, value) / np.maximum(np.bincount(block, valid), 1.0)
    first = np.unique(block, return_index=True)[1]
    pair = (place[first][1:] == place[first][:-1]) & ~sample.is_recorded[first][1:]
    if pair.sum() < MIN_CLUSTERS or not min(np.ptp(mean[1:][pair]), np.ptp(mean[:-1][pair])) > 0:
        return False
    r = float(np.corrcoef(mean[1:][pair], mean[:-1][pair])[0, 1])
    # k independent values less their mean have a correlation of -1 / (k - 1)
    each = pair.sum() / len(np.unique(place[first][1:][pair])) + 1.0
    return r + 1.0 / (each - 1.0) > CORRELATED / np.sqrt(pair.sum())


def _within(value: Floats, valid: Bits, place: Ints) -> Floats:
    """Return values less their mean at each position, 0 where not valid, (n, ...)."""
    n = int(place.max()) + 1
    count = np.maximum(np.bincount(place, valid, n), 1.0)
    flat = value.reshape(len(value), -1)
    mean = np.stack([np.bincount(place, column * valid, n) / count for column in flat.T], axis=1)
    return np.asarray(((flat - mean[place]) * valid[:, None]).reshape(value.shape))


def _leverage_of(place: Ints, block: Ints) -> Floats:
    """Return the factor of each block's residuals about the mean of its position, (blocks,)."""
    first = np.unique(block, return_index=True)[1]
    return leverage_factor(np.bincount(block) / np.bincount(place)[place[first]])


def _regressors(column: Column) -> Floats:
    """Return the regressors of a column at each ping, 0 where it is unknown, (n, k)."""
    known = column.base >= 0
    phi = np.where(known[:, None], column.combine[np.maximum(column.base, 0)], 0.0)
    return np.asarray(phi if column.factor is None else phi * column.factor[:, None])


def _of_column(scored: Scores, sample: Sample, column: Column, place: Ints, block: Ints, a: int) -> tuple[Floats, Bits]:
    """Return the part of each block in the difference of slopes, (blocks, k), and which regressors are tested, (k,)."""
    valid = scored.valid[:, a] & (column.base >= 0)
    value = _within(scored.value[:, a], valid, place)
    phi = _within(_regressors(column), valid, place)
    n = int(block.max()) + 1
    out = np.zeros((n, phi.shape[1]))
    allowed = np.ones(phi.shape[1], dtype=bool)
    for rows, sign in ((sample.is_recorded, 1.0), (~sample.is_recorded, -1.0)):
        if not rows.any():
            continue
        norm = (phi[rows] ** 2).sum(axis=0)
        sums = np.stack([np.bincount(block[rows], (part[rows] * value[rows]), n) for part in phi.T], axis=1)
        out += sign * sums / np.maximum(norm, 1e-12)
        acting = np.stack([np.bincount(block[rows], np.abs(part[rows]) > 0, n) > 0 for part in phi.T], axis=1)
        allowed &= (norm > 1e-9) & (acting.sum(axis=0) >= MIN_CLUSTERS)
    if ASPECTS[a] in INDICATORS:
        event = valid & (np.abs(scored.value[:, a]) > 0.5)
        allowed &= (bin_sums(column, block, event.astype(np.float64), n, absolute=True) @ column.combine > 0).sum(
            axis=0
        ) >= MIN_CLUSTERS
    return out, allowed


def _located(
    scored: Scores,
    sample: Sample,
    columns: Sequence[Column],
    place: Ints,
    block: Ints,
    k: int,
    a: int,
    p_value: PValue,
) -> Location:
    """Return the difference of the k-th regressor in an aspect, in natural units."""
    for column in columns:
        if k < len(column.regressors):
            break
        k -= len(column.regressors)
    natural = replace(scored, value=scored.natural)
    psi = _of_column(natural, sample, column, place, block, a)[0][:, k]
    value, error = float(psi.sum()), float(np.linalg.norm(psi * _leverage_of(place, block)))
    region = region_of(column.regressors[k], [column])
    size = Interval(value, value - TWO_SIDED * error, value + TWO_SIDED * error, ASPECTS[a].unit)
    return Location(ASPECTS[a], region, size, p_value)
