"""The firmware: which trips of the comparator count as echoes, and what goes into the registers for them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from acquisition.bench.acoustics.air import Floats
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
    counted = np.maximum(time + unit.t_offset, 0.0) * (1.0 + unit.clock_error)
    if unit.ramp_tau_s > 0.0:
        counted = unit.ramp_tau_s * -np.expm1(-counted / unit.ramp_tau_s)
    ticks = np.floor(counted / unit.tick)
    value = ticks * unit.tick / PER_UNIT[output]
    whole = np.rint(value) if unit.rounding == "nearest" else np.floor(value + 1e-9)
    return np.where(np.isnan(time), 0.0, np.clip(whole, 1.0, 65_535.0)).astype(np.uint16)


def smoothed(code: NDArray[np.uint16], run: NDArray[np.int64], unit: Unit, output: Output) -> NDArray[np.uint16]:
    """Return the codes with the first echo as a firmware gives it that does not trust a single one.

    The mean or median of the last `averaging` first echoes of a run, then that before it until it differs by more than
    the dead band. Pings of a run must stand together.
    """
    out = code.copy()
    band = unit.deadband / PER_UNIT[output]
    for rows in np.split(np.arange(len(run)), np.flatnonzero(np.diff(run)) + 1):
        heard = rows[code[rows, 0] > 0]
        value = _averaged(code[heard, 0].astype(np.float64), unit)
        out[heard, 0] = np.rint(_held(value, band) if band > 0.0 else value)
    return out


def _averaged(value: Floats, unit: Unit) -> Floats:
    if unit.averaging == 1 or not len(value):
        return value
    padded = np.concatenate([np.full(unit.averaging - 1, np.nan), value])
    window = np.lib.stride_tricks.sliding_window_view(padded, unit.averaging)
    return np.asarray(np.nanmean(window, axis=1) if unit.average == "mean" else np.nanmedian(window, axis=1))


def _held(value: Floats, band: float) -> Floats:
    """Return each value, or the one given before it where it is within a band of that."""
    out = value.copy()
    for k in range(1, len(out)):
        out[k] = out[k] if abs(out[k] - out[k - 1]) > band else out[k - 1]
    return out
