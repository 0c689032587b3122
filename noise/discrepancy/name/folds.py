"""Parts of a recording that share no visit: two folds for cross-fitting, and visits that no estimate uses."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from acquisition.arrays import Floats
from noise.fitting.batch import Batch

DEAL = np.array([0, 0, 1, 1, 2])  # of every five neighbouring conditions: two in each fold, one unseen; chosen here


@dataclass(frozen=True, eq=False)
class Folds:
    """Parts of one batch.

    Attributes:
        first, second: folds of whole conditions; an estimate on one is scored on the other.
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
        """Deal conditions, sorted by distance and angle, so that every part covers the conditions alike."""
        conditions, index = np.unique(batch.condition, return_inverse=True)
        count = np.bincount(index)
        distance = np.bincount(index, batch.ping.distance) / count
        angle = np.bincount(index, np.abs(batch.ping.angle)) / count
        rank = np.empty(len(conditions), dtype=np.int64)
        rank[np.lexsort((angle, distance))] = np.arange(len(conditions))
        deal = np.concatenate([rng.permutation(DEAL) for _ in range(-(-len(conditions) // len(DEAL)))])
        part = deal[rank][index]
        first, second, unseen = (batch.select(part == k) for k in range(3))
        return cls(first, second, batch.select(part < 2), unseen, part == 2)

    def crossed(self, nats: Callable[[int, Batch], Floats]) -> Floats:
        """Return per-visit values of both folds: `nats(k, other)` scores what was fitted on fold k on the other."""
        parts = [(0, self.second), (1, self.first)]
        return np.concatenate([batch.visit_sums(nats(k, batch)) for k, batch in parts])
