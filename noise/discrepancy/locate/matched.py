"""Cells that simulation and recording share, compared without any model: what is named must show here as well.

Each shared condition gives one difference in where its readings lie, how often it answers and how often it strays. Were
the two alike, either file could have been the other: the signs of all differences of a cell may be flipped together,
whatever its pings share. The greatest sum over regions of conditions is compared with the same after such flips.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from acquisition import Ping
from acquisition.arrays import Floats
from noise.discrepancy.locate.scan import flipped, regions
from noise.fitting.batch import Batch

FEWEST = 12  # shared cells, below which flips of sign say nothing; ours
ASPECTS = ("place", "answers", "strays")


@dataclass(frozen=True)
class Matched:
    """A comparison of shared cells.

    Attributes:
        cells: number of them.
        p_value: that two files of one and the same sonar differ as much.
        shift_m: median difference of where readings lie, m.
    """

    cells: int
    p_value: float
    shift_m: float

    @property
    def differs(self) -> bool:
        """Whether the two files differ beyond chance."""
        return self.p_value < 0.05


def conditions_of(ping: Ping) -> list[tuple[float, ...]]:
    """Return the condition of each ping, to a tenth of a millimetre and of a degree."""
    table = [ping.distance, ping.angle, ping.incidence, ping.reflectance]
    scale = (1e4, 1800.0 / np.pi, 1800.0 / np.pi, 1e3)
    return list(zip(*(np.rint(k * value).tolist() for k, value in zip(scale, table, strict=True)), strict=True))


def compare(simulated: Batch, recorded: Batch, rng: np.random.Generator) -> Matched | None:
    """Compare the cells that two batches share; None where they share fewer than `FEWEST`.

    Args:
        simulated: readings in the order of their cells.
        recorded: the same of the real sonar.
        rng: for flips of sign.
    """
    own, other = _by_condition(simulated), _by_condition(recorded)
    shared = own.index.intersection(other.index)
    if len(shared) < FEWEST:
        return None
    first = np.flatnonzero(recorded.count == 0)
    keys = pd.Index(conditions_of(recorded.ping[first]), tupleize_cols=False)
    kept = keys.isin(shared) & ~keys.duplicated()
    part = recorded.select(np.isin(recorded.visit, np.flatnonzero(kept)))
    difference = (other.loc[keys[kept]] - own.loc[keys[kept]]).to_numpy(dtype=np.float64)
    shift = float(np.nanmedian(difference[:, 0])) if np.isfinite(difference[:, 0]).any() else 0.0
    scanned = flipped(_bounded(difference), np.zeros_like(difference), regions(part), rng)
    return Matched(len(difference), scanned.p_value(scanned.best), shift)


def _bounded(difference: Floats) -> Floats:
    """Return differences in robust units, none of which outweighs all others."""
    size = np.nanmedian(np.abs(difference), axis=0)
    size = np.where(np.isfinite(size) & (size > 0), size, np.nanmax(np.abs(difference), axis=0, initial=1e-9))
    return np.nan_to_num(np.clip(difference / size, -4.0, 4.0))


def _by_condition(batch: Batch) -> pd.DataFrame:
    """Return median error, share of answers and share of strays of each condition."""
    near = batch.is_target(batch.error)
    frame = pd.DataFrame(
        {
            "place": np.where(near, batch.error, np.nan),
            "answers": batch.reading.echo.astype(np.float64),
            "strays": (batch.reading.echo & ~near).astype(np.float64),
        }
    )
    key = pd.Series(pd.Index(conditions_of(batch.ping), tupleize_cols=False))
    grouped = frame.groupby(key)
    table = grouped.mean()
    table["place"] = grouped["place"].median()
    return table[list(ASPECTS)]
