"""Parts of a recording that share no visit: two folds for cross-fitting, and visits that no estimate uses."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from acquisition.arrays import Bits, Ints
from noise.discrepancy.moments.sample import MIN_CLUSTERS, positions
from noise.fitting.batch import Batch
from noise.fitting.stack import Stack

UNSEEN = 2
DEAL = np.array([0, 0, 1, 1, UNSEEN])  # of every five neighbouring units: two in each fold, one unseen; chosen here


@dataclass(frozen=True, eq=False)
class Folds:
    """Parts of one batch.

    Attributes:
        first, second: folds of whole conditions or runs; an estimate on one is scored on the other.
        both: both folds.
        unseen: visits that no estimate uses.
        is_unseen: which pings of the whole batch are unseen, (n,).
    """

    first: Batch
    second: Batch
    both: Batch
    unseen: Batch
    is_unseen: np.ndarray

    @classmethod
    def of(cls, batch: Batch, rng: np.random.Generator) -> Folds:
        """Deal conditions, or runs of a moving robot, by distance and angle, so that all parts cover them alike.

        A condition of more pings than its neighbours together, such as that of an empty place, is in a fold.
        """
        index = np.unique(batch.ping.run if batch.by_run else batch.condition, return_inverse=True)[1].ravel()
        count = np.bincount(index)
        distance = np.bincount(index, batch.ping.distance) / count
        angle = np.bincount(index, np.abs(batch.ping.angle)) / count
        order = np.lexsort((angle, distance))
        starts = range(0, len(count), len(DEAL))
        dealt = [_fair(rng.permutation(DEAL), count[order[k : k + len(DEAL)]]) for k in starts]
        part = np.concatenate(dealt)[np.argsort(order)][index]
        first, second, unseen = (batch.select(part == k) for k in range(3))
        return cls(first, second, batch.select(part != UNSEEN), unseen, part == UNSEEN)

    def divided(self, batch: Batch) -> tuple[Batch, ...]:
        """Return the pings of a batch in each fold; in one part where a fold would hold too few conditions."""
        if len(np.unique(batch.condition)) < MIN_CLUSTERS:
            return (batch,)
        first = self.in_first(batch)
        return batch.select(first), batch.select(~first)

    def in_first(self, batch: Batch) -> Bits:
        """Return which pings of a batch are in the first fold, (n,)."""
        return np.isin(batch.condition, self.first.condition)


def _fair(deal: Ints, count: Ints) -> Ints:
    """Return parts dealt to neighbours, another being unseen instead of one that has most of their pings."""
    deal, most = deal[: len(count)].copy(), int(count.argmax())
    if deal[most] == UNSEEN and 2 * count[most] > count.sum():
        deal[most] = 0
        deal[np.flatnonzero(np.arange(len(deal)) != most)[:1]] = UNSEEN
    return deal


def with_simulated_offset(batch: Batch, law: Stack, simulated: Batch) -> Batch:
    """Return a recording with the mean error of the simulation beside its law at the same position, where it has one.

    What the law of the simulation gets wrong at a position, and a target that both files heard in one place, is then no
    difference.
    """
    middle, _ = law.direct(simulated)
    error = simulated.reading.range - middle
    heard = simulated.is_target(error)
    known = pd.DataFrame(positions(simulated)[simulated.visit][heard]).assign(error=error[heard])
    mean = known.groupby([0, 1, 2, 3]).error.mean()
    at = pd.MultiIndex.from_frame(pd.DataFrame(positions(batch)))
    return replace(batch, simulated_offset=mean.reindex(at).to_numpy()[batch.visit])
