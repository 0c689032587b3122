"""When sonars ping and when their readings arrive, from periods, phases and latencies in seconds."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from acquisition import SettingError
from acquisition.arrays import Floats
from acquisition.limits import as_numbers
from sonar_gym.sensing.kernels import SOUND_SPEED
from sonar_gym.sensing.records import SAME_TIME_S

Times = tuple[ArrayLike, ArrayLike, ArrayLike | None]  # period, phase and latency, s
BUS_S = 0.002  # s; command, range gate and reading of the registers at 100 kHz (Devantech, SRF08)


def sensor_latency(max_range: float) -> float:
    """Return the time that an SRF08 needs for a ping, s: the flight to the end of its range and back, and the bus.

    >>> round(sensor_latency(11.0), 3), round(sensor_latency(3.01), 3)
    (0.066, 0.02)
    """
    return 2.0 * max_range / SOUND_SPEED + BUS_S


def _column(name: str, value_s: ArrayLike, count: int) -> Floats:
    value = as_numbers(name, value_s)
    if value.shape not in ((), (count,)):
        raise SettingError(f"{name} has shape {value.shape}, expected one number or {count}, one for each sonar")
    if not np.all((value >= 0.0) & np.isfinite(value)):
        raise SettingError(f"{name} must be finite and >= 0 s, got {value_s!r}")
    return np.broadcast_to(value, count).copy()


def timing(names: Sequence[str], step_s: float, times: Times, max_range: float) -> Floats:
    """Return period, phase and latency of each sonar, s, (n, 3).

    A sonar without a period pings once for every observation, one latency before it, so that its reading arrives with
    the observation.

    Args:
        names: names of the sonars, for messages.
        step_s: time between observations, s.
        times: period (0 for none), time of the first ping (unused without a period), and latency of the reading, s;
            each is one number or one for each sonar. Without a latency (None or NaN), that of the real sensor, which
            then pings at every k-th observation if it needs longer than a step.
        max_range: maximum range, m.

    Raises:
        SettingError: a time is negative or not finite, or a period is shorter than `step_s`.
    """
    count, own = len(names), sensor_latency(max_range)
    given = np.full(count, np.nan) if times[2] is None else np.asarray(times[2], dtype=np.float64)
    real = np.broadcast_to(np.isnan(given), count) if given.shape in ((), (count,)) else np.zeros(count, np.bool_)
    period, phase = _column("period_s", times[0], count), _column("phase_s", times[1], count)
    latency = _column("latency_s", np.where(np.isnan(given), own, given), count)
    for name, value in zip(names, period, strict=True):
        if 0.0 < value < step_s - SAME_TIME_S:
            raise SettingError(
                f"period_s of {name!r} is {value:g} s, less than the {step_s:g} s from one observation to the next: "
                "give 0 for a ping at every observation"
            )
    for i in np.flatnonzero(period == 0.0):
        steps = max(1, math.ceil(latency[i] / step_s - SAME_TIME_S)) if real[i] else 1
        period[i], phase[i] = steps * step_s, steps * step_s - math.fmod(latency[i], step_s)
    return np.stack([period, phase, latency], axis=1)
