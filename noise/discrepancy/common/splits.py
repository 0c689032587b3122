"""Which cells are looked at, which confirm, and which stay closed until the end. Never split by ping."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from noise.fitting.batch import Batch

DEAL = np.array([0, 0, 1, 2])  # of every four neighbouring cells: two discover, one confirms, one goes to the vault


@dataclass(frozen=True)
class Split:
    """Three parts of one batch that share no cell."""

    discover: Batch
    confirm: Batch
    vault: Batch
    both: Batch  # discover and confirm together
    whole: Batch  # everything, for pictures alone

    @classmethod
    def of(cls, batch: Batch, rng: np.random.Generator) -> Split:
        """Deal cells, sorted by distance and angle, so that every part covers the field alike."""
        cells, index = np.unique(batch.condition, return_inverse=True)
        count = np.bincount(index)
        distance = np.bincount(index, batch.ping.distance) / count
        angle = np.bincount(index, np.abs(batch.ping.angle)) / count
        rank = np.empty(len(cells), dtype=np.int64)
        rank[np.lexsort((angle, distance))] = np.arange(len(cells))
        deal = np.concatenate([rng.permutation(DEAL) for _ in range(-(-len(cells) // 4))])
        part = deal[rank][index]
        discover, confirm, vault = (batch.select(part == k) for k in range(3))
        return cls(discover, confirm, vault, batch.select(part < 2), batch)
