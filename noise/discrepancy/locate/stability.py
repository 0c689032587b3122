"""Stability: is the size of an effect the same under all conditions, at all times, and after all readings?

The score of a reading is the derivative of its log probability with respect to the size of the effect, under the
corrected law for the recording and under the law of the simulation for the simulation. Where one size is right
everywhere, it has mean zero in every region, but for what both laws get wrong. An effect that stands for something
else, such as lost readings for those lost beyond 2 m alone, has a size that differs from region to region
(parameter instability tests; Nyblom 1989, Zeileis and Hornik 2007).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from torch import Tensor

from acquisition.arrays import Floats, Ints
from noise.discrepancy.locate.moments import one_weight
from noise.discrepancy.locate.orthogonal import Tested, compared
from noise.discrepancy.locate.regressors import Regressor
from noise.discrepancy.locate.sample import Sample
from noise.discrepancy.locate.scores import BIAS, Scores, scores_of_both
from noise.discrepancy.result import Aspect, PValue
from noise.discrepancy.thresholds import FALSE_ALARM
from noise.fitting.batch import Batch
from noise.fitting.likelihood import at_each
from noise.fitting.stack import Key, Stack
from noise.fitting.visit_effects import VisitEffects, law_of, single_ping_law
from noise.physical import PhysicalModel

STEP = 1e-3  # of a parameter, as a share of its bounds: a derivative
QUANTILE = 0.995  # of the scores of the recording, beyond which scores are winsorised: no reading decides
LOWEST = 1e-12  # probability
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
    law_recorded: Stack, law_simulated: Stack, sample: Sample, name: str, rng: np.random.Generator
) -> Stability:
    """Test whether an effect of the recording has one size.

    Args:
        law_recorded: corrected law.
        law_simulated: law of the simulation.
        sample: readings.
        name: effect id.
        rng: draws folds and signs.
    """
    scored = scores_of_both(law_recorded, law_simulated, sample)
    found = [_of_parameter(law_recorded, law_simulated, sample, scored, key, rng) for key in sizes(law_recorded, name)]
    p = min((each.p_value for each in found), key=lambda each: each.value, default=PValue(1.0, 0))
    value = min(1.0, len(found) * p.value)
    return Stability(replace(p, value=value), max((each.variation for each in found), default=0.0))


def sizes(law: Stack, name: str) -> list[Key]:
    """Return the parameters that are the size of an effect: its first, and the share of the pings that have it."""
    first, *others = (p for p in map(law.parameter, _keys(law, name)))
    return [(name, p.name) for p in (first, *others) if p.low < p.high and (p is first or p.name == SHARE)]


def _of_parameter(
    recorded: Stack, simulated: Stack, sample: Sample, scored: Scores, key: Key, rng: np.random.Generator
) -> Stability:
    """Return the stability of one parameter."""
    absent = key[0] not in simulated.values
    others = {k: recorded.get(k) for k in _keys(recorded, key[0]) if k != key}
    laws = (recorded, simulated.at(others) if absent else simulated)[: len(sample.batches)]
    parts = sample.left_out(simulated)
    value = [_by_part(*each, key) for each in zip(laws, sample.batches, parts, strict=True)]
    limit = float(np.quantile(np.abs(value[0]), QUANTILE))
    size = recorded.get(key) - (simulated.get(key) if key[1] != SHARE or not absent else 0.0)
    if limit <= 0.0 or size == 0.0:
        return Stability()
    scores = np.clip(np.concatenate(value) / limit, -1.0, 1.0)
    tested = compared(_only(scored, scores), sample, rng, only=varies)
    return Stability(tested.p_value, min(1.0, abs(_change(tested, scores) / (limit * size))))


def _change(tested: Tested, scores: Floats) -> float:
    """Return the change of the parameter in the most deviating region beyond chance, times the limit of the scores.

    It is one step of Newton's method: the sum of the scores over their information.
    """
    if tested.best is None:
        return 0.0
    k, group = tested.best[1], tested.groups[0]
    z, scale = tested.z[BIAS, k], tested.scale[BIAS, k]
    beyond = max(0.0, abs(float(z)) - float(np.quantile(tested.greatest, 1.0 - FALSE_ALARM)))
    weight, phi = one_weight(group, tested.columns, tested.units, k)
    information = float(np.sum((weight * phi * scores**2) * (group.recorded[tested.units] > 0)))
    return beyond * float(scale) / information if information > 0.0 else 0.0


def varies(regressor: Regressor, aspect: Aspect) -> bool:
    """Return whether a regressor distinguishes regions; the mean over all pings is what the size was fitted to."""
    return bool(regressor.columns)


def _keys(law: Stack, name: str) -> list[Key]:
    return [(name, p.name) for p in law.known[name].parameters]


def _only(scored: Scores, value: Floats) -> Scores:
    """Return scores with a value in the place of the bias, and no others."""
    every, valid = np.zeros_like(scored.value), np.zeros_like(scored.valid)
    every[:, BIAS], valid[:, BIAS] = value, True
    return Scores(every, valid, every, scored.level_db, scored.sigma, scored.probability)


def _by_part(law: Stack, batch: Batch, part: Ints, key: Key) -> Floats:
    """Return the slope at each reading under the law whose smooth correction was fitted without its part, (n,)."""
    out = np.empty(len(batch))
    for k in np.unique(part):
        out[part == k] = slope(law.without_part(int(k)), batch.select(part == k), key)
    return out


def slope(law: Stack, batch: Batch, key: Key) -> Floats:
    """Return the derivative of the log probability of each reading with respect to a parameter, (n,)."""
    p = law.parameter(key)
    step, value = STEP * (p.high - p.low), law.get(key)
    ends = np.clip([value - step, value + step], p.low, p.high)

    def probability(model: PhysicalModel, visits: VisitEffects) -> Tensor:
        return single_ping_law(law_of(model, batch), visits).probability_tensor(batch.reading)

    low, high = np.log(np.maximum(at_each(law, [key], ends[:, None], probability), LOWEST))
    return np.asarray((high - low) / (ends[1] - ends[0]))
