"""What could have been seen: the least sizes of aspects and effects that the test finds with a power of 90 %.

A statistic with mean mu and standard deviation 1 exceeds the critical value c with a power of 90 % if mu = c + 1.28.
One of few clusters is divided by their own root mean square, which is Student's t in other words, and mu is larger.
For an aspect everywhere, mu is its size over its standard error. For an effect, readings of the law with the effect and
without it are drawn from the same uniform numbers under the recording's conditions; mu is the difference of their
scores in the statistic that shows it best.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from acquisition import Reading
from acquisition.arrays import Floats, Ints
from noise.discrepancy.locate.location import TWO_SIDED, complexity, group_of, location_of
from noise.discrepancy.locate.orthogonal import Tested
from noise.discrepancy.moments.moments import moments
from noise.discrepancy.moments.sample import Sample
from noise.discrepancy.moments.scores import ASPECTS, ping_law, scores
from noise.discrepancy.result import Aspect, Location, Visible
from noise.discrepancy.thresholds import FALSE_ALARM
from noise.fitting.batch import Batch
from noise.fitting.stack import Key, Stack
from noise.law import GivenNumbers

POWER_QUANTILE = 1.2816  # standard normal, 90 %
STEPS = 5  # of the search; the shift is nearly proportional to the size, so that a few secant steps suffice
MAX_PINGS = 1000  # of the recording from which the shift of a statistic is estimated
PRECISION = 0.05  # of the least size, relative
EVERYWHERE = 0  # index of the regressor
SHOWN = (Aspect.BIAS, Aspect.SPREAD, Aspect.DETECTION, Aspect.EARLY, Aspect.LATE, Aspect.REPEAT)
# the commonest effects: the parameter that is their size, and the value of others that they need
COMMONEST: tuple[tuple[Key, dict[str, float]], ...] = (
    (("zero_offset", "offset_m"), {}),
    (("clock_scale", "error"), {}),
    (("dropped_reading", "probability"), {}),
    (("spike", "probability"), {}),
    (("false_alarm", "per_metre"), {}),
    (("sensitivity", "loss_db"), {}),
    (("beam_width", "ka"), {}),
    (("stale_repeat", "probability"), {}),
    (("fixed_clutter", "presence"), {"range_m": 0.5}),
    (("quantisation", "step_m"), {}),
)


def could_have_seen(law: Stack, sample: Sample, tested: Tested, rng: np.random.Generator) -> tuple[Visible, ...]:
    """Return the least sizes that the test shows with a power of 90 %.

    Args:
        law: law of the recording.
        sample: readings.
        tested: result of the test.
        rng: draws the readings from which the shift of a statistic is estimated.
    """
    wanted = _wanted(tested)
    probe = _Probe.of(law, sample, tested, rng)
    effects = [_effect(probe, key, others, wanted) for key, others in COMMONEST]
    return (*visible_aspects(tested), *(found for found in effects if found is not None))


def shown_by(
    effects: Sequence[Stack], law: Stack, sample: Sample, tested: Tested, rng: np.random.Generator
) -> tuple[Location, ...]:
    """Return where effects show most, for a difference that no statistic shows by itself.

    A test in the direction of an effect is more sensitive than one of any region. What differs is then known before
    where it does: in the region with the greatest expected statistic, less the logarithm of the number of clusters for
    each of its ends, as in `locate`. Its size is that of the readings. Without an effect, it is where the greatest
    statistic is, with the p-value of that.

    Args:
        effects: the law with each of them.
        law: of the recording without them.
        sample: readings.
        tested: result of the test of `law`, with the p-value of all tests.
        rng: draws readings.
    """
    if tested.best is None:
        return ()
    if not effects:
        a, k = ASPECTS.index(tested.best[0]), tested.best[1]
        return (location_of(tested, a, k, tested.p_of(float(tested.z[a, k]))),)
    probe, found = _Probe.of(law, sample, tested, rng), []
    ends = np.array([complexity(each) for each in tested.regressors]) * np.log(len(np.unique(tested.cluster)))
    comparable = np.isfinite(tested.z).any(axis=0)
    for stack in effects:
        gain = np.where(comparable, probe.expected(stack) ** 2 - ends, -np.inf)
        found.append(tuple(int(index) for index in np.unravel_index(np.argmax(gain), gain.shape)))
    return tuple(location_of(tested, a, k, tested.p_value) for a, k in dict.fromkeys(found))


def visible_aspects(tested: Tested) -> tuple[Visible, ...]:
    """Return the least size of each aspect, if it differs everywhere, that is seen with a power of 90 %."""
    found = [_aspect(tested, aspect) for aspect in SHOWN]
    return tuple(each for each in found if each is not None)


def _wanted(tested: Tested) -> float:
    """Return the statistic that is expected where the greatest one is significant with a power of 90 %."""
    n = len(np.unique(tested.cluster))
    mean = least_mean(_critical(tested), n)
    return mean * float(np.sqrt(n / (n - 1.0 + mean**2))) if np.isfinite(mean) else mean


def _critical(tested: Tested) -> float:
    return float(np.quantile(tested.greatest, 1.0 - FALSE_ALARM))


def least_mean(critical: float, n: int) -> float:
    """Return the size, in standard errors, at which a statistic of n clusters is significant with a power of 90 %.

    With z the sum over the root of the sum of squares, t = z sqrt((n - 1) / (n - z^2)) is Student's; the quantile of
    its noncentral law is approximated (Johnson and Welch 1940). Infinite where z, at most sqrt(n), cannot be critical.
    """
    if critical**2 >= n:
        return float("inf")
    t = critical * np.sqrt((n - 1.0) / (n - critical**2))
    return float(t + POWER_QUANTILE * np.sqrt(1.0 + t**2 / (2.0 * (n - 1.0))))


def _aspect(tested: Tested, aspect: Aspect) -> Visible | None:
    """Return the least size of an aspect that differs everywhere; None where it cannot be tested."""
    a = ASPECTS.index(aspect)
    if not np.isfinite(tested.z[a, EVERYWHERE]):
        return None
    group, size = group_of(tested, a), location_of(tested, a, EVERYWHERE, tested.p_value).size
    mean = least_mean(_critical(tested), len(np.unique(tested.cluster[group.valid])))
    if not np.isfinite(mean):
        return None
    return Visible(str(aspect), float(mean * (size.high - size.value) / TWO_SIDED), aspect.unit)


@dataclass(frozen=True, eq=False)
class _Probe:
    """Readings that the law without the effect gives, and what is needed to compare others with them.

    Attributes:
        law: law without the effect.
        batch: conditions, m pings.
        rows: their rows in the sample, (m,).
        uniform: random numbers that readings are drawn from, (m,).
        base: scores of readings that follow the law, (m, aspects).
        tested: result of the test.
        factor: number of pings of the recording for each ping drawn.
    """

    law: Stack
    batch: Batch
    rows: Ints
    uniform: Floats
    base: Floats
    tested: Tested
    factor: float

    @classmethod
    def of(cls, law: Stack, sample: Sample, tested: Tested, rng: np.random.Generator) -> _Probe:
        """Draw readings of whole visits, at most about `MAX_PINGS`."""
        whole = sample.recorded
        mask = whole.visit % -(-len(whole) // MAX_PINGS) == 0
        batch, rows = whole.select(mask), np.flatnonzero(mask)
        uniform = rng.random(len(batch))
        base = _scores_of(law, law, batch, uniform)
        return cls(law, batch, rows, uniform, base, tested, len(whole) / len(batch))

    def strength(self, stack: Stack) -> float:
        """Return the greatest expected statistic where the recording follows another stack."""
        return float(np.max(self.expected(stack), where=np.isfinite(self.tested.z), initial=0.0))

    def expected(self, stack: Stack) -> Floats:
        """Return the sizes of the statistics where the recording follows another stack, (A, K)."""
        shift = _scores_of(stack, self.law, self.batch, self.uniform) - self.base
        tested, out = self.tested, np.zeros_like(self.tested.z)
        value = np.zeros((len(tested.cluster), len(ASPECTS)))
        value[self.rows] = shift
        for group in tested.groups:
            own = value[:, group.aspects] * group.weight * group.valid[:, None]
            shifts = moments(group, tested.columns, tested.units, tested.cluster, own)
            total = self.factor * np.abs(shifts.sum(axis=0)).T
            # rare events add to the sum of squares that the statistic is divided by
            square = tested.scale[group.aspects] ** 2 + self.factor * (shifts**2).sum(axis=0).T
            out[group.aspects] = total / np.sqrt(np.maximum(square, 1e-300))
        return out


def _scores_of(truth: Stack, law: Stack, batch: Batch, uniform: Floats) -> Floats:
    """Return the scores under a law of readings that follow another."""
    drawn = ping_law(truth, batch).sample(GivenNumbers(uniform))
    reading = Reading.of(drawn.range, drawn.status)
    return scores(law, replace(batch, reading=reading)).value


def _effect(probe: _Probe, key: Key, others: dict[str, float], wanted: float) -> Visible | None:
    """Return the least change of an effect's parameter; None where not even the bound is seen."""
    parameter, law = probe.law.parameter(key), probe.law
    present = law.get(key)
    limit = parameter.high if parameter.high > present else parameter.low
    room, unit = abs(limit - present), parameter.unit
    if room == 0.0:
        return None
    missing = {(key[0], name): value for name, value in others.items() if key[0] not in law.values}

    def strength(size: float) -> float:
        return probe.strength(law.at({**missing, key: present + np.sign(limit - present) * size}))

    size = min(parameter.typical or 0.1 * room, room)
    for _ in range(STEPS):
        reached = strength(size)
        if abs(reached / wanted - 1.0) < PRECISION:
            break
        size = float(np.clip(size * wanted / max(reached, 0.1 * wanted), 1e-6 * room, room))
    return Visible(key[0], size, unit) if size < room else None
