"""Which cell a ping belongs to, the uninterrupted stay there, and what was last heard before it."""

from __future__ import annotations

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from acquisition import Recording

BLOCK = 25  # pings taken as one cell where conditions never repeat (a moving robot); ours
FEW_CELLS = 12


def last_echo(recording: Recording) -> NDArray[np.float64]:
    """Return the latest echo before each ping in its run, and how far off its target stood, m, (n, 2)."""
    echo, run = recording.reading.echo, recording.run
    columns = {"read": recording.reading.range, "stood": recording.ping.distance}
    heard = pd.DataFrame({name: np.where(echo, column, np.nan) for name, column in columns.items()})
    return heard.groupby(run).ffill().groupby(run).shift().to_numpy()


def visits_of(recording: Recording) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the cell of each ping, and the block (stay in one cell during one run), each (n,).

    Where conditions hardly repeat, or hardly change, runs are cut into stretches of `BLOCK` pings instead.
    """
    n = len(recording)
    pair = np.unique(np.stack([recording.condition, recording.run], axis=1), axis=0, return_inverse=True)[1].ravel()
    crowded = np.bincount(recording.condition)
    if crowded.mean() < 2.0 and n > 2 * FEW_CELLS:
        stretch = _stretches(recording.run)
        return stretch, stretch
    block = pair
    if len(np.unique(pair)) < FEW_CELLS:
        block = np.unique(pair * (n + 1) + _stretches(pair), return_inverse=True)[1]
    cell = recording.condition if len(crowded) >= FEW_CELLS else block
    return cell, block


def _stretches(group: NDArray[np.int64]) -> NDArray[np.int64]:
    """Number stretches of at most BLOCK consecutive pings of each group, (n,)."""
    order = np.argsort(group, kind="stable")
    starts = np.r_[0, np.flatnonzero(np.diff(group[order])) + 1]
    rank = np.empty(len(group), dtype=np.int64)
    rank[order] = np.arange(len(group)) - np.repeat(starts, np.diff(np.r_[starts, len(group)]))
    return np.unique(group * (len(group) + 1) + rank // BLOCK, return_inverse=True)[1].ravel()
