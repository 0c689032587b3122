"""How much a learner without physics still makes of what an explanation leaves over, in nats across unseen blocks.

A scan of regions says whether something is left and where; its statistics say little of how much, since no block counts
for more than one. Here boosted trees try to tell the residuals of cells that they have not seen from what is known
before a ping: from conditions (what a law of the place has wrong) and from the reading before the target was moved
(what a law of memory has wrong). What they gain over the residuals' own distribution can be held against what the
explanation gained.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm
from sklearn.ensemble import HistGradientBoostingClassifier
from sklearn.model_selection import GroupKFold
from threadpoolctl import ThreadpoolController

from acquisition.arrays import Floats
from noise.discrepancy.checks.transient import APART_M
from noise.discrepancy.common.rules import spread_over_blocks
from noise.discrepancy.locate.residuals import seen_alone, seen_in_cell
from noise.discrepancy.locate.scan import features
from noise.fitting.batch import Batch
from noise.fitting.stack import Stack

THREADS = ThreadpoolController()  # looks for libraries once, now: a process may be forbidden to later
CLASSES = 4  # of residuals: far below, below, above, far above
FOLDS = 5
LEAST_BLOCKS = 20
LEAST_CHANCE = 0.02
# standard errors beyond which a gain is more than chance; pings of a stay hang together by the air of the day, which a
# law of another day mistakes for memory: ours
SURE_T = {"conditions": 2.5, "memory": 4.0}
REACH_M = 0.5  # beyond which it no longer matters how far off the last reading was; ours


@dataclass(frozen=True)
class Remainder:
    """What a learner gains on residuals.

    Attributes:
        nats: across unseen blocks; at most 0 where it learned nothing.
        error: its standard error over blocks.
        of: "conditions" or "memory".
        n_visits: number of them.
    """

    nats: float
    error: float
    of: str
    n_visits: int = 0

    @property
    def p_value(self) -> float:
        """Of the gain, if blocks gain normally about nothing and two kinds are looked at."""
        return float(min(1.0, 2.0 * norm.sf(self.nats / self.error))) if self.error > 0 else 1.0

    @property
    def sure(self) -> bool:
        """Whether it is more than chance."""
        return self.nats > SURE_T[self.of] * self.error


NOTHING = Remainder(0.0, 0.0, "conditions")


def remainder(stack: Stack, batch: Batch, rng: np.random.Generator) -> Remainder:
    """Return the greater of what conditions and what memory still tell of residuals.

    Args:
        stack: the explanation, fitted elsewhere or with few parameters.
        batch: readings.
        rng: for randomised PIT values.
    """
    if batch.n_visits < LEAST_BLOCKS or batch.reading.echo.sum() < 4 * LEAST_BLOCKS:
        return NOTHING
    alone, law = seen_alone(stack, batch, rng)
    own, _ = seen_in_cell(stack, batch, rng)
    place = np.stack([np.zeros(len(batch)), *features(batch).values()], axis=1)
    # all pings of a cell share its offset: of its place, they are one witness
    once = 1.0 / np.bincount(batch.visit)[batch.visit]
    before, elsewhere = _memory(batch, law.quantile(0.5))
    both = (
        _gained(place, alone, once, batch, "conditions"),
        _gained(before, np.where(elsewhere, own, np.nan), np.ones(len(batch)), batch, "memory"),
    )
    return max(both, key=lambda each: each.nats)


def _memory(batch: Batch, middle: Floats) -> tuple[Floats, NDArray[np.bool_]]:
    """Return what a cell could remember of the one before, (n, 2), and where that was another place, (n,).

    How readings of one cell hang together is no business of this: air flutters, and does so otherwise every day.
    """
    first = batch.first
    off = np.clip(batch.past.range[first] - middle[first], -REACH_M, REACH_M)
    elsewhere = batch.past.echo[first] & (np.abs(off) > APART_M)
    return np.stack([off, batch.ping.distance], axis=1), elsewhere


def _gained(x: Floats, u: Floats, weight: Floats, batch: Batch, of: str) -> Remainder:
    """Return what trees gain on classes of residuals of unseen blocks, over how often each class is."""
    rows = np.flatnonzero(~np.isnan(u))
    x, weight, block = x[rows], weight[rows], batch.visit[rows]
    label = np.minimum((u[rows] * CLASSES).astype(np.int64), CLASSES - 1)
    if len(np.unique(block)) < LEAST_BLOCKS:
        return Remainder(0.0, 0.0, of, batch.n_visits)
    gain = np.zeros(len(rows))
    with THREADS.limit(limits=1):  # threads of so small a task wait for each other, for minutes where a machine is busy
        for train, test in GroupKFold(FOLDS, shuffle=True, random_state=0).split(x, label, block):
            if len(np.unique(label[train])) == CLASSES:
                gain[test] = _nats(x, label, weight, train, test)
    each = np.asarray(np.bincount(block, weight * gain, minlength=batch.n_visits), dtype=np.float64)
    return Remainder(float(each.sum()), spread_over_blocks(each), of, batch.n_visits)


def _nats(
    x: Floats, label: NDArray[np.int64], weight: Floats, train: NDArray[np.int64], test: NDArray[np.int64]
) -> Floats:
    """Return by how much each unseen residual's class is likelier than by its frequency alone, nats."""
    trees = HistGradientBoostingClassifier(
        max_iter=30, max_leaf_nodes=6, learning_rate=0.08, min_samples_leaf=20, l2_regularization=5.0, random_state=0
    )
    told = trees.fit(x[train], label[train], weight[train]).predict_proba(x[test])
    usual = np.bincount(label[train], weight[train], minlength=CLASSES) / weight[train].sum()
    likely = np.maximum(told[np.arange(len(test)), label[test]], LEAST_CHANCE)
    return np.asarray(np.log(likely) - np.log(np.maximum(usual[label[test]], LEAST_CHANCE)))
