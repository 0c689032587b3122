"""Whether readings of a moving target hold on to what they were until it has moved far enough: hysteresis, a dead band.

A link that repeats readings does so at random, however far the target has moved since. A host that lets go only beyond
some distance repeats the near ones and none of the far ones: so repeats to the digit and fresh readings are compared by
how far from the last reading the law expects the next.
"""

from __future__ import annotations

import numpy as np
from scipy.stats import norm, rankdata

from acquisition.arrays import Floats
from noise.discrepancy.locate.locate import Finding
from noise.fitting.batch import Batch
from noise.fitting.stack import Stack

FEWEST = 20  # repeats, and fresh readings, below which nothing is told; ours
PLAIN = 4.0  # deviations of a single reading, within which one may repeat the last by chance; ours
LEAST_M = 0.02  # from the last reading, for another to be due; ours
MOST = 0.9  # share of repeats that lie within the distance that is told; ours


def grip(stack: Stack, batch: Batch) -> Finding | None:
    """Return how readings hold on, as a finding everywhere; None where too few readings of a moving target tell.

    Its size is the distance within which nearly all repeats lie, m.

    Args:
        stack: the law of single readings.
        batch: readings, whole stays.
    """
    told = batch.reading.echo & batch.past.echo & (batch.count > 0) & ~batch.stationary[batch.visit]
    same = batch.repeats
    if min((told & same).sum(), (told & ~same).sum()) < FEWEST:
        return None
    apart, due = _apart(stack, batch)
    told &= due
    held, fresh = apart[told & same], apart[told & ~same]
    if min(len(held), len(fresh)) < FEWEST:
        return None
    # ranks, against which rows repeat; stretches are the witnesses, since repeats of one hang together
    rank = rankdata(apart[told]) / told.sum()
    pull = np.bincount(batch.visit[told], (rank - rank.mean()) * (same[told] - same[told].mean()))
    z = -float(pull.sum()) / float(np.sqrt((pull**2).sum()))
    p = max(float(norm.sf(z)), 1e-300)
    return Finding("grip", {}, float(np.quantile(held, MOST)), "m", p, -float(np.log(p)))


def _apart(stack: Stack, batch: Batch) -> tuple[Floats, np.ndarray]:
    """Return how far from the last reading the next is expected, m, and where that is too far for chance, (n,) each.

    All readings of a stretch may be off by the same: what they usually are off by is expected too.
    """
    middle, variance = stack.direct(batch)
    error = batch.reading.range - middle
    near = batch.is_target(error)
    off = np.array([np.median(error[rows][near[rows]]) if near[rows].any() else 0.0 for rows in batch.visit_rows])
    apart = np.abs(middle + off[batch.visit] - batch.past.range)
    return apart, apart > np.maximum(LEAST_M, PLAIN * np.sqrt(variance) + batch.resolution)
