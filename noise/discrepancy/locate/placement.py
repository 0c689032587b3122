"""The scatter of placements of each file: how carefully targets were placed is no property of a sonar."""

from __future__ import annotations

import numpy as np

from acquisition.arrays import Ints
from noise.discrepancy.locate.sample import Sample
from noise.discrepancy.locate.scores import ASPECTS, scores
from noise.discrepancy.result import Aspect
from noise.discrepancy.thresholds import MAX_PLACEMENT_M
from noise.fitting.batch import Batch
from noise.fitting.stack import PLACEMENT, Stack
from noise.fitting.visit_effects import placement_scatter
from noise.statistics import winsorised

BIAS = ASPECTS.index(Aspect.BIAS)


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
    scored = scores(law, batch, part)
    valid, error = scored.valid[:, BIAS], scored.natural[:, BIAS]
    count = np.bincount(batch.visit, valid)
    if np.sum(count >= 2) < 2:
        return law
    mean = np.bincount(batch.visit, error * valid) / np.maximum(count, 1.0)
    within = float(np.sum(valid * (error - mean[batch.visit]) ** 2) / np.sum(np.maximum(count - 1.0, 0.0)))
    several = count >= 2
    between = float(np.var(winsorised(mean[several]))) - within * float(np.mean(1.0 / count[several]))
    most = max(MAX_PLACEMENT_M, law.get(PLACEMENT))
    return law.put([PLACEMENT], [min(np.sqrt(max(between, 0.0)) / placement_scatter(1.0), most)])
