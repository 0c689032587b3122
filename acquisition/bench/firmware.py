"""Firmware: which threshold crossings count as echoes, and the register values for them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from acquisition.arrays import Floats
from acquisition.bench.laboratory.air import sound_speed
from acquisition.bench.laboratory.setup import Output
from acquisition.bench.laboratory.unit import Unit

ECHOES = 17
COMPENSATED_C = 21.2  # degC; at this temperature 58 us are 1 cm there and back
# s per unit of output: 58 us/cm and 148 us/inch for this family of sensors
PER_UNIT: dict[Output, float] = {"cm": 58e-6, "inch": 148e-6, "us": 1e-6}


def first_echoes(ping: NDArray[np.int64], time: Floats, count: int, unit: Unit, listening: float) -> Floats:
    """Return the times of up to 17 echoes of each of `count` pings, s, (count, 17); NaN where there is none.

    Crossings before the end of blanking, within the dead time after an echo, or after the listening time do not count.
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


def to_codes(
    time: Floats, unit: Unit, output: Output, temperature_c: Floats | float = COMPENSATED_C
) -> NDArray[np.uint16]:
    """Return the register values of times in s, (n, k); 0 for no echo.

    Args:
        time: of the echoes, s; NaN for none.
        unit: the sensor.
        output: unit of the registers.
        temperature_c: of the air, (n,), for a sensor that compensates it.
    """
    counted = np.maximum(time + unit.t_offset, 0.0) * (1.0 + unit.clock_error)
    if unit.compensated:
        speed = sound_speed(temperature_c) / sound_speed(COMPENSATED_C)
        counted = counted * np.reshape(speed, (-1, *[1] * (time.ndim - 1)))
    if unit.ramp_tau_s > 0.0:
        counted = unit.ramp_tau_s * -np.expm1(-counted / unit.ramp_tau_s)
    ticks = np.floor(np.maximum(counted, unit.nearest_s) / unit.tick)
    value = ticks * unit.tick / PER_UNIT[output]
    whole = np.rint(value) if unit.rounding == "nearest" else np.floor(value + 1e-9)
    return np.where(np.isnan(time), 0.0, np.clip(whole, 1.0, 65_535.0)).astype(np.uint16)


def smoothed(code: NDArray[np.uint16], run: NDArray[np.int64], unit: Unit, output: Output) -> NDArray[np.uint16]:
    """Return the codes with the first echo averaged and held within a dead band.

    The first echo becomes the mean or median of the last `averaging` first echoes of the run; the previous output is
    then repeated until the value differs by more than the dead band. Pings of a run must be contiguous.
    """
    out = code.copy()
    band = unit.deadband / PER_UNIT[output]
    for rows in np.split(np.arange(len(run)), np.flatnonzero(np.diff(run)) + 1):
        detected = rows[code[rows, 0] > 0]
        value = _averaged(code[detected, 0].astype(np.float64), unit)
        out[detected, 0] = np.rint(_with_deadband(value, band) if band > 0.0 else value)
    return out


def _averaged(value: Floats, unit: Unit) -> Floats:
    if unit.averaging == 1 or not len(value):
        return value
    padded = np.concatenate([np.full(unit.averaging - 1, np.nan), value])
    window = np.lib.stride_tricks.sliding_window_view(padded, unit.averaging)
    return np.asarray(np.nanmean(window, axis=1) if unit.average == "mean" else np.nanmedian(window, axis=1))


def _with_deadband(value: Floats, band: float) -> Floats:
    """Return each value, or the previous output if the value is within a band of it."""
    out = value.copy()
    for k in range(1, len(out)):
        out[k] = out[k] if abs(out[k] - out[k - 1]) > band else out[k - 1]
    return out
