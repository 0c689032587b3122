"""The firmware: which trips of the comparator count as echoes, and what goes into the registers for them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from acquisition.bench.air import Floats
from acquisition.bench.setup import Output
from acquisition.bench.unit import Unit

ECHOES = 17
# time per unit: 58 us/cm and 148 us/inch, the constants of the family; microseconds are given as they are
PER_UNIT: dict[Output, float] = {"cm": 58e-6, "inch": 148e-6, "us": 1e-6}


def first_echoes(ping: NDArray[np.int64], time: Floats, count: int, unit: Unit, listening: float) -> Floats:
    """Return the times of up to 17 echoes of each of `count` pings, s, (count, 17); NaN where there is none.

    Nothing counts before the blanking ends, within the dead time after an echo, or after listening ends.
    """
    stride = 1.0  # s: longer than any waveform
    key = ping * stride + time
    rows = np.arange(count)
    earliest = np.full(count, unit.blanking)
    out = np.full((count, ECHOES), np.nan)
    for k in range(ECHOES):
        at = np.searchsorted(key, rows * stride + earliest)
        found = at < len(key)
        found[found] = (ping[at[found]] == rows[found]) & (time[at[found]] <= listening)
        rows, at = rows[found], at[found]
        if not len(rows):
            break
        out[rows, k] = time[at]
        earliest = time[at] + unit.rearm
    return out


def to_codes(time: Floats, unit: Unit, output: Output) -> NDArray[np.uint16]:
    """Return what the firmware writes into its registers for times in s; 0 for none."""
    ticks = np.floor(np.maximum(time + unit.t_offset, 0.0) * (1.0 + unit.clock_error) / unit.tick)
    value = ticks * unit.tick / PER_UNIT[output]
    whole = np.rint(value) if unit.rounding == "nearest" else np.floor(value + 1e-9)
    return np.where(np.isnan(time), 0.0, np.clip(whole, 1.0, 65_535.0)).astype(np.uint16)


def averaged(code: NDArray[np.uint16], run: NDArray[np.int64], count: int) -> NDArray[np.uint16]:
    """Return the codes with the first echo replaced by the mean of the last `count` first echoes of its run."""
    out = code.copy()
    for number in np.unique(run):
        heard = np.flatnonzero((run == number) & (code[:, 0] > 0))
        total = np.concatenate([[0.0], np.cumsum(code[heard, 0], dtype=np.float64)])
        end = np.arange(1, len(heard) + 1)
        begin = np.maximum(end - count, 0)
        out[heard, 0] = np.rint((total[end] - total[begin]) / (end - begin))
    return out
