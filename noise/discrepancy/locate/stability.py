"""Stability: is the size of an effect the same under all conditions, at all times, and after all readings?

The score of a reading is the derivative of its log probability with respect to the size of the effect, under the
corrected law for the recording and under the law of the simulation for the simulation. Where one size is right
everywhere, it has mean zero in every region, but for what both laws get wrong. An effect that stands for something
else, such as lost readings for those lost beyond 2 m alone, has a size that differs from region to region
(parameter instability tests; Nyblom 1989, Zeileis and Hornik 2007).
"""

from __future__ import annotations

import numpy as np
from torch import Tensor

from acquisition.arrays import Floats, Ints
from noise.discrepancy.locate.orthogonal import compared
from noise.discrepancy.locate.regressors import Regressor
from noise.discrepancy.locate.sample import Sample
from noise.discrepancy.locate.scores import BIAS, Scores, scores_of_both
from noise.discrepancy.result import Aspect, PValue
from noise.fitting.batch import Batch
from noise.fitting.likelihood import at_each
from noise.fitting.stack import Key, Stack
from noise.fitting.visit_effects import VisitEffects, law_of, single_ping_law
from noise.physical import PhysicalModel

STEP = 1e-3  # of a parameter, as a share of its bounds: a derivative
QUANTILE = 0.995  # of the scores of the recording, beyond which scores are winsorised: no reading decides
LOWEST = 1e-12  # probability


def stability_test(
    law_recorded: Stack, law_simulated: Stack, sample: Sample, name: str, rng: np.random.Generator
) -> PValue:
    """Test whether an effect of the recording has one size.

    Args:
        law_recorded: corrected law.
        law_simulated: law of the simulation.
        sample: readings.
        name: effect id.
        rng: draws folds and signs.

    Returns:
        p-value; 1 where its size cannot be varied.
    """
    key = next(((name, p.name) for p in map(law_recorded.parameter, _keys(law_recorded, name)) if p.low < p.high), None)
    if key is None:
        return PValue(1.0, 0)
    others = {k: law_recorded.get(k) for k in _keys(law_recorded, name) if k != key}
    base = law_simulated if name in law_simulated.values else law_simulated.at(others)
    laws = (law_recorded, base)[: len(sample.batches)]
    parts = sample.left_out(law_simulated)
    value = [_by_part(*each, key) for each in zip(laws, sample.batches, parts, strict=True)]
    limit = float(np.quantile(np.abs(value[0]), QUANTILE))
    if limit <= 0.0:
        return PValue(1.0, 0)
    scores = np.clip(np.concatenate(value) / limit, -1.0, 1.0)
    scored = scores_of_both(law_recorded, law_simulated, sample)
    return compared(_only(scored, scores), sample, rng, only=varies).p_value


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
