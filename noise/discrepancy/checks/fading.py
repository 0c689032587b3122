"""Whether echoes fail more and more, or less and less, while a recording lasts: a battery, a wet membrane.

No effect of the catalogue changes a level with time. So the stays' silence beyond the law's is held against their order
in time, each stay one piece of evidence. Where stays were not visited in random order, what goes with time may go with
distance or angle, in which the law may err, and nothing is said.
"""

from __future__ import annotations

import numpy as np
from scipy.stats import norm, rankdata, spearmanr

from acquisition.arrays import Floats
from noise.discrepancy.locate.locate import Finding
from noise.discrepancy.locate.scan import by_block
from noise.fitting.batch import Batch
from noise.fitting.stack import Stack

FEWEST = 24  # stays, below which nothing is told; ours
ORDERED = 0.35  # rank correlation of time with a condition, beyond which the order was not random; ours


def fading(stack: Stack, batch: Batch) -> Finding | None:
    """Return how silence goes with time, as a finding; None where no time was logged or the order tells too little.

    Its size is by how much of pings silence is more frequent in the later half.

    Args:
        stack: the law of single readings.
        batch: readings, whole stays.
    """
    columns = by_block(batch)
    if not batch.timed or batch.n_visits < FEWEST or "time_s" not in columns:
        return None
    time = columns.pop("time_s")
    if any(_ordered(time, column) for column in columns.values()):
        return None
    silent = np.where(batch.reading.echo, 0.0, 1.0) - np.clip(stack.model.law(batch.ping, batch.past).no_echo, 0.0, 1.0)
    share = batch.visit_sums(silent) / batch.visit_sums(np.ones(len(batch)))
    if np.ptp(share) == 0.0:
        return None
    order = rankdata(time) / batch.n_visits - 0.5
    order -= order.mean()
    pull = (share - share.mean()) * order
    z = float(pull.sum() / np.sqrt((pull**2).sum()))
    late = order > 0.0
    more = float(share[late].mean() - share[~late].mean())
    return Finding("fading", {}, more, "1", float(2.0 * norm.sf(abs(z))), 0.5 * z**2)


def _ordered(time: Floats, column: Floats) -> bool:
    return bool(np.ptp(column) > 0.0 and abs(float(spearmanr(time, column).statistic)) > ORDERED)
