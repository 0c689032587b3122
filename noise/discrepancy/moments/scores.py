"""Scores of readings under a law, one for each aspect, with mean zero where the law is right.

For an echo of the target, let U be its probability integral transform within the window of the target, and
x = Phi^-1(U) its normal score. A register step covers an interval (a, b] of U, so the score is the conditional mean
E[h(x) | a < U <= b] with h = x (bias), x^2 - 1 (spread) and x^3 - 3x (skew), winsorised at |x| = `LIMIT`. It needs no
random numbers, unlike the randomised transform (Czado, Gneiting and Held 2009). Detection, early and late are
indicators minus their probabilities. Repeat and memory compare lag one with lag two of a visit, so that an offset or a
register step that all pings of a visit share cancels.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
import torch
from scipy.special import ndtr, ndtri

from acquisition.arrays import Bits, Floats, Ints
from noise.discrepancy.moments.sample import DISTINCT, Sample
from noise.discrepancy.result import Aspect
from noise.discrepancy.thresholds import MAX_PLACEMENT_M
from noise.fitting.batch import Batch
from noise.fitting.stack import LEVEL_SD, PLACEMENT, Stack
from noise.fitting.visit_effects import direct_median, law_of, placement_scatter, single_ping_law
from noise.physical import PhysicalLaw
from noise.statistics import winsorised

ASPECTS = tuple(Aspect)
BIAS = ASPECTS.index(Aspect.BIAS)
KEPT = [ASPECTS.index(Aspect.REPEAT), ASPECTS.index(Aspect.MEMORY)]  # aspects of what a sonar keeps
LIMIT = 3.0  # normal scores are winsorised here: 0.3 % of a normal sample lie beyond
MIN_PROBABILITY = 1e-9  # smallest divisor: a window or step that the law all but excludes
AGREEMENT_M = 0.05  # outliers of one reflector agree within the absolute part of the tolerance about a target


@dataclass(frozen=True, eq=False)
class Scores:
    """Scores of n pings; columns in the order of `ASPECTS`.

    Attributes:
        value: scores, (n, aspects); 0 where not valid.
        valid: whether a ping has a score, (n, aspects).
        natural: what a size is the mean of: m for bias, relative standard deviation for spread, else the score.
        level_db: level of the direct path above the threshold, dB, (n,).
        sigma: standard deviation of the target's echo under the law, m, (n,).
        probability: of detection, early and late under the law, (n, 3).
    """

    value: Floats
    valid: Bits
    natural: Floats
    level_db: Floats
    sigma: Floats
    probability: Floats


@dataclass(frozen=True, eq=False)
class _Expected:
    """What a law says of n pings, whatever was read.

    Attributes:
        middle: median of the target's echo, m, (n,).
        sigma: its standard deviation, m, (n,).
        echo: probability of an echo, (n,).
        window: probability that an echo comes before the window of the target, and that it comes by its end, (2, n).
    """

    middle: Floats
    sigma: Floats
    echo: Floats
    window: Floats

    @classmethod
    def of(cls, law: PhysicalLaw, batch: Batch) -> _Expected:
        """Return what the law of the pings of a batch says."""
        middle, sigma = target_of(law)
        echo = law.arrival(np.full(len(batch), np.inf))
        return cls(middle, sigma, echo, _given_echo(law, echo, middle - batch.reach, middle + batch.reach))

    @property
    def probability(self) -> Floats:
        """Probability of detection, early and late, (n, 3)."""
        return np.stack([self.echo, self.window[0], 1.0 - self.window[1]], axis=1)


def ping_law(stack: Stack, batch: Batch) -> PhysicalLaw:
    """Return the law of single pings of a batch, the scatter of visits included."""
    with torch.no_grad():
        model, visits = stack.build()
        return single_ping_law(law_of(model, batch), visits)


def target_of(law: PhysicalLaw) -> tuple[Floats, Floats]:
    """Return median and standard deviation of the target's echo under a law, m, (n,) each."""
    middle, variance = (np.broadcast_to(part.numpy(), len(law)) for part in direct_median(law))
    return middle, np.sqrt(variance)


def level_of(law: PhysicalLaw) -> Floats:
    """Return the level of the direct path above the threshold, dB, (n,)."""
    level = torch.broadcast_to(law.state.direct.level_db, (len(law.state.log_weight), len(law)))
    return (torch.softmax(law.state.log_weight, dim=0) * level).sum(0).numpy()


def _given_echo(law: PhysicalLaw, echo: Floats, *edges: Floats) -> Floats:
    """Return the probability that an echo comes by each edge, m, (edges, n)."""
    arrival = law.arrival(np.nan_to_num(np.stack(edges), neginf=-1e4, posinf=1e4))
    return np.clip(arrival / np.maximum(echo, MIN_PROBABILITY), 0.0, 1.0)


def scores(stack: Stack, batch: Batch) -> Scores:
    """Return the scores of the readings of a batch under a stack."""
    law = ping_law(stack, batch)
    expected = _Expected.of(law, batch)
    other = _earlier_outlier(expected.middle, batch)
    step, past = law.step(batch.reading.range), law.step(batch.past.range)
    edges = law.edge(step - 1), law.edge(step), law.edge(past - 1), law.edge(past), other - AGREEMENT_M
    given = _given_echo(law, expected.echo, *edges, other + AGREEMENT_M)
    return _of_readings(expected, given, level_of(law), batch, other)


def scores_of_both(law_recorded: Stack, law_simulated: Stack, sample: Sample) -> Scores:
    """Return the scores of both files, in units of the spread under the law of the simulation.

    Several tests of two laws need them; those of the last pair of laws are kept with the sample. What a sonar keeps of
    earlier readings is not compared where recorded pings hardly ever follow their own visit, and simulated ones do.
    """
    for known, both in sample.scored:
        if known[0] is law_recorded and known[1] is law_simulated:
            return both
    both = _scores_of_both(law_recorded, law_simulated, sample)
    sample.scored[:] = [((law_recorded, law_simulated), both)]
    return both


def _scores_of_both(law_recorded: Stack, law_simulated: Stack, sample: Sample) -> Scores:
    parts = sample.left_out(law_simulated)
    own = scores(law_recorded.by_part(parts[0]), sample.recorded)
    common: Scores | _Expected = own
    if law_recorded is not law_simulated:
        common = _Expected.of(ping_law(law_simulated.by_part(parts[0]), sample.recorded), sample.recorded)
    rescaled = own.value.copy()
    rescaled[:, BIAS] *= own.sigma / common.sigma
    both = [replace(own, value=rescaled, sigma=common.sigma, probability=common.probability)]
    if sample.simulated is not None:
        both.append(scores(law_simulated.by_part(parts[1]), sample.simulated))
    out = Scores(*(np.concatenate([getattr(each, f.name) for each in both]) for f in fields(Scores)))
    if sample.follows_more < -DISTINCT:
        out.valid[:, KEPT] = False
    return out


def _of_readings(expected: _Expected, given: Floats, level_db: Floats, batch: Batch, other: Floats) -> Scores:
    """Return the scores of readings.

    Args:
        expected: under the law.
        given: probability that an echo comes by either edge of its step, of the step of the past reading, and of what
            agrees with the earlier outlier, (6, n).
        level_db: of the direct path, (n,).
        batch: readings.
        other: range of the earlier outlier, m, (n,).
    """
    error = np.where(batch.reading.echo, batch.reading.range - expected.middle, 0.0)
    target, outlier, echo = batch.is_target(error), batch.is_outlier(error), batch.reading.echo
    heard, early, late = expected.probability.T
    normal = normal_scores(*_within(given[:2], expected.window))
    memory, ordered = _memory(np.where(target, normal[0], 0.0), target, batch)
    repeat, comparable = _repeat(given[3] - given[2], batch)
    agree = np.abs(batch.reading.range - other) <= AGREEMENT_M
    outside = np.maximum(1.0 - (expected.window[1] - expected.window[0]), MIN_PROBABILITY)
    alike = np.clip((given[5] - given[4]) / outside, 0.0, 1.0)
    table = {
        Aspect.BIAS: (normal[0], target),
        Aspect.SPREAD: (normal[1], target),
        Aspect.SKEW: (normal[2], target),
        Aspect.DETECTION: (echo - heard, np.ones(len(batch), dtype=bool)),
        Aspect.EARLY: ((outlier & (error < 0)) - early, echo),
        Aspect.LATE: ((outlier & (error > 0)) - late, echo),
        Aspect.REPEAT: (repeat, comparable),
        Aspect.MEMORY: (memory, ordered),
        Aspect.COINCIDENCE: (agree - alike, outlier & np.isfinite(other)),
    }
    value = np.stack([np.where(table[a][1], table[a][0], 0.0) for a in ASPECTS], axis=1).astype(np.float64)
    natural = value.copy()
    natural[:, BIAS] = np.where(target, error, 0.0)
    natural[:, ASPECTS.index(Aspect.SPREAD)] /= 2.0  # d(sd) / sd = d(variance) / (2 variance)
    valid = np.stack([table[a][1] for a in ASPECTS], axis=1)
    return Scores(value, valid, natural, level_db, expected.sigma, expected.probability)


def _within(step: Floats, window: Floats) -> tuple[Floats, Floats]:
    """Return the interval of a step under the law given the window, 0 to 1."""
    mass = np.maximum(window[1] - window[0], MIN_PROBABILITY)
    low, high = (np.clip((edge - window[0]) / mass, 0.0, 1.0) for edge in step)
    return low, np.maximum(low, high)


def normal_scores(low: Floats, high: Floats) -> Floats:
    """Return E[h(Phi^-1(U)) | low < U <= high] - E[h], for the winsorised h of bias, spread and skew, (3, n)."""
    below, above = ndtri(low), ndtri(high)
    width = high - low
    finite = np.isfinite(below) & np.isfinite(above)
    middle = 0.5 * (np.where(finite, below, 0.0) + np.where(finite, above, 0.0))
    at = np.clip(np.where(finite, middle, np.where(low > 0.5, below, above)), -9, 9)
    narrow = width < 1e-7  # the difference of integrals has lost its digits
    mean = (_integrals(above) - _integrals(below)) / np.where(narrow, 1.0, width)
    return np.where(narrow, _hermite(np.clip(at, -LIMIT, LIMIT)), mean) - _integrals(np.array([np.inf]))


def _hermite(x: Floats) -> Floats:
    return np.stack([x, x**2 - 1.0, x**3 - 3.0 * x])


def _integrals(z: Floats) -> Floats:
    """Return the integral of h(clip(x)) times the normal density up to z, for each h, (3, n)."""
    inside = np.clip(z, -LIMIT, LIMIT)
    ends = _hermite(np.array([-LIMIT, LIMIT]))
    tails = ends[:, :1] * ndtr(np.minimum(z, -LIMIT)) + ends[:, 1:] * (ndtr(np.maximum(z, LIMIT)) - ndtr(LIMIT))
    return tails + _middle(inside) - _middle(np.array([-LIMIT]))


def _middle(z: Floats) -> Floats:
    """Return antiderivatives of the Hermite polynomials 1 to 3 times the normal density."""
    density = np.exp(-0.5 * z**2) / np.sqrt(2.0 * np.pi)
    return -np.stack([np.ones_like(z), z, z**2 - 1.0]) * density


def _memory(score: Floats, target: Bits, batch: Batch) -> tuple[Floats, Bits]:
    """Return the product with the score before minus that with the score two before, and where they exist."""
    one, two = _back(batch, 1), _back(batch, 2)
    valid = (batch.count >= 2) & target & target[one] & target[two]
    return score * (score[one] - score[two]), valid


def _repeat(again: Floats, batch: Batch) -> tuple[Floats, Bits]:
    """Return whether an echo equals the one before, minus the same at lag two or its probability, and where that holds.

    Lag two of the visit stands for lag one where the ping before was of this visit too, and the law where it was of
    another: in a new visit, or where visits alternate. Both earlier readings are at the target, before it or behind
    it: if one alone were, neither lag would stand for the other.
    """
    one, two, reading = _back(batch, 1), _back(batch, 2), batch.reading
    same = reading.echo & reading.echo[two] & (np.abs(reading.range - reading.range[two]) < 0.5 * batch.resolution)
    other_place = np.abs(batch.last[:, 1] - batch.ping.distance) > batch.reach
    place = np.sign(batch.error) * batch.is_outlier(batch.error)
    alike = (batch.count >= 2) & batch.follows & reading.echo[two] & (place[one] == place[two])
    valid = reading.echo & batch.past.echo & (alike | ~batch.follows & other_place)
    return batch.repeats - np.where(batch.follows, same, again), valid


def _back(batch: Batch, lag: int) -> Ints:
    """Return the row `lag` pings before, (n,); not meaningful where the visit has no such ping."""
    return np.maximum(np.arange(len(batch)) - lag, 0)


def _earlier_outlier(middle: Floats, batch: Batch) -> Floats:
    """Return the range of the outlier before each ping in its visit, m, (n,); nan where there is none."""
    outlier = batch.is_outlier(np.where(batch.reading.echo, batch.reading.range - middle, 0.0))
    row = np.maximum.accumulate(np.where(outlier, np.arange(len(batch)), -1))
    row = np.r_[-1, row[:-1]]
    return np.where(row >= batch.first, batch.reading.range[np.maximum(row, 0)], np.nan)


def with_own_placement(law: Stack, sample: Sample) -> tuple[Stack, Stack]:
    """Return the law of the recording and that of the simulation, each with the scatter of placements in its file.

    The variance of visit means, less that of a mean of so many pings, is that of placements (analysis of variance),
    what the law misses in a position included. Both are measured under laws that saw neither file there, so that this
    is alike. Where visits have a single ping, both scatters cannot be told apart, and the law is left as it is.
    """
    parts = sample.left_out(law)
    laws = [_placed(law, batch, part) for batch, part in zip(sample.batches, parts, strict=True)]
    return laws[0], laws[-1] if sample.simulated is not None else law


def _placed(law: Stack, batch: Batch, part: Ints) -> Stack:
    own = ping_law(law.by_part(part), batch)
    error = np.where(batch.reading.echo, batch.reading.range - target_of(own)[0], 0.0)
    valid = batch.is_target(error)
    count = np.bincount(batch.visit, valid)
    if np.sum(count >= 2) < 2:
        return law
    mean = np.bincount(batch.visit, error * valid) / np.maximum(count, 1.0)
    within = float(np.sum(valid * (error - mean[batch.visit]) ** 2) / np.sum(np.maximum(count - 1.0, 0.0)))
    several = count >= 2
    between = float(np.var(winsorised(mean[several]))) - within * float(np.mean(1.0 / count[several]))
    # the scatter of a visit's level scatters its readings by the time walk
    walk = np.broadcast_to(own.state.direct.walk.numpy(), len(batch))[valid]
    between -= float(np.mean((walk * law.get(LEVEL_SD)) ** 2))
    most = max(MAX_PLACEMENT_M, law.get(PLACEMENT))
    return law.put([PLACEMENT], [min(np.sqrt(max(between, 0.0)) / placement_scatter(1.0), most)])
