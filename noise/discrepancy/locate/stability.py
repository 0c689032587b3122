"""Stability: is the size of an effect the same under all conditions, at all times, and after all readings?

The score of a reading is the derivative of its log probability with respect to the size of the effect under the
corrected law, less its mean under the law of the file. Where one size is right everywhere, the mean of the recording is
that of the simulation in every region, what both laws get wrong included. An effect that stands for something else,
such as lost readings for those lost beyond 2 m alone, has a size that differs from region to region
(parameter instability tests; Nyblom 1989, Zeileis and Hornik 2007).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from acquisition import Reading
from acquisition.arrays import Floats, Ints
from noise.discrepancy.locate.directed import single_log_prob_after
from noise.discrepancy.locate.orthogonal import Tested, compared
from noise.discrepancy.moments.moments import one_weight
from noise.discrepancy.moments.regressors import Regressor
from noise.discrepancy.moments.sample import Sample
from noise.discrepancy.moments.scores import BIAS, Scores, ping_law, scores_of_both
from noise.discrepancy.result import Aspect, PValue
from noise.discrepancy.thresholds import FALSE_ALARM
from noise.fitting.batch import Batch
from noise.fitting.stack import Key, Stack

DRAWN = 10  # readings of each ping for the expected score under a law
STEP = 1e-3  # of a parameter, as a share of its bounds: a derivative
QUANTILE = 0.995  # of the scores of the recording, beyond which scores are winsorised: no reading decides
SHARE = "share"  # parameter of effects that act in a part of the pings


@dataclass(frozen=True)
class Stability:
    """Whether an effect has one size everywhere.

    Attributes:
        p_value: of the test.
        variation: by how much its size differs in the most deviating region, beyond chance, relative to itself, 0 to 1.
    """

    p_value: PValue = field(default_factory=lambda: PValue(1.0, 0))
    variation: float = 0.0


def stability_test(
    law_recorded: Stack, law_simulated: Stack, without: Stack, sample: Sample, name: str, rng: np.random.Generator
) -> Stability:
    """Test whether an effect of the recording has one size.

    Args:
        law_recorded: corrected law.
        law_simulated: law of the simulation's readings, on which the effect may have acted.
        without: law of the simulation without the effect.
        sample: readings.
        name: effect id.
        rng: draws folds and signs.
    """
    scored = scores_of_both(law_recorded, law_simulated, sample)
    found = [
        _of_parameter(law_recorded, law_simulated, sample, scored, key, size_between(law_recorded, without, key), rng)
        for key in sizes(law_recorded, name)
    ]
    p = min((each.p_value for each in found), key=lambda each: each.value, default=PValue(1.0, 0))
    value = min(1.0, len(found) * p.value)
    return Stability(replace(p, value=value), max((each.variation for each in found), default=0.0))


def sizes(law: Stack, name: str) -> list[Key]:
    """Return the parameters that are the size of an effect: its first, and the share of the pings that have it."""
    first, *others = (p for p in map(law.parameter, _keys(law, name)))
    return [(name, p.name) for p in (first, *others) if p.low < p.high and (p is first or p.name == SHARE)]


def size_between(law: Stack, without: Stack, key: Key) -> float:
    """Return the difference of a parameter between two laws; a share of pings is one from none."""
    absent = key[0] not in without.values
    return law.get(key) - (0.0 if absent and key[1] == SHARE else without.get(key))


def _of_parameter(
    recorded: Stack, simulated: Stack, sample: Sample, scored: Scores, key: Key, size: float, rng: np.random.Generator
) -> Stability:
    """Return the stability of one parameter, in which the laws differ by a size."""
    parts = sample.left_out(simulated)
    slopes = [
        _slopes(recorded, law, batch, part, key, rng)
        for law, batch, part in zip((recorded, simulated), sample.batches, parts, strict=False)
    ]
    limit = max(float(np.quantile(np.abs(each[0]), QUANTILE)) for each in slopes)
    if limit <= 0.0 or size == 0.0:
        return Stability()
    within = [np.clip(each / limit, -1.0, 1.0) for each in slopes]
    scores = np.concatenate([each[0] - each[1:].mean(axis=0) for each in within])
    information = np.concatenate([each[1:].var(axis=0, ddof=1) for each in within])
    tested = compared(_only(scored, scores), sample, rng, only=varies)
    return Stability(tested.p_value, min(1.0, abs(_change(tested, information) / (limit * size))))


def _slopes(recorded: Stack, law: Stack, batch: Batch, part: Ints, key: Key, rng: np.random.Generator) -> Floats:
    """Return the slope under the law of the recording at each reading, and at drawn ones, (1 + draws, n).

    Each part of the readings has laws whose smooth corrections were fitted without it.
    """
    drawing = ping_law(law.by_part(part), batch)
    readings = [batch.reading, *(drawing.sample(rng) for _ in range(DRAWN))]
    every = Reading(np.stack([each.range for each in readings]), np.stack([each.status for each in readings]))
    return slope(recorded.by_part(part), replace(batch, reading=every), key)


def _change(tested: Tested, information: Floats) -> float:
    """Return the change of the parameter in the most deviating region beyond chance, times the limit of the scores.

    It is one step of Fisher's method: the sum of the scores over their information, the variance under the law, (n,).
    """
    if tested.best is None:
        return 0.0
    k, group = tested.best[1], tested.groups[0]
    z, scale = tested.z[BIAS, k], tested.scale[BIAS, k]
    beyond = max(0.0, abs(float(z)) - float(np.quantile(tested.greatest, 1.0 - FALSE_ALARM)))
    weight, phi = one_weight(group, tested.columns, tested.units, k)
    total = float(np.sum(weight * phi * information * group.recorded[tested.units]))
    return beyond * float(scale) / total if total > 0.0 else 0.0


def varies(regressor: Regressor, aspect: Aspect) -> bool:
    """Return whether a regressor distinguishes regions; the mean over all pings is what the size was fitted to."""
    return bool(regressor.columns)


def _keys(law: Stack, name: str) -> list[Key]:
    return [(name, p.name) for p in law.known[name].parameters]


def _only(scored: Scores, value: Floats) -> Scores:
    """Return scores with a value in the place of the bias, and no others."""
    every, valid = np.zeros_like(scored.value), np.zeros_like(scored.valid)
    every[:, BIAS], valid[:, BIAS] = value, True
    return replace(scored, value=every, valid=valid, natural=every)


def slope(law: Stack, batch: Batch, key: Key) -> Floats:
    """Return the derivative of the log probability of each reading with respect to a parameter, (n,) or (k, n)."""
    p = law.parameter(key)
    step, value = STEP * (p.high - p.low), law.get(key)
    ends = np.clip([value - step, value + step], p.low, p.high)
    low, high = single_log_prob_after(law, [{key: float(end)} for end in ends], batch)
    return np.asarray((high - low) / (ends[1] - ends[0]))
