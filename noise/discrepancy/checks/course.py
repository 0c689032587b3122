"""The course of the air's temperature, from readings alone: a sonar before a still target is a thermometer.

Where a target keeps its distance, what a reading does in time is what sound does: range = distance sqrt(T0 / T), so
that T / T0 = (distance / range)^2. Only changes are known: a distance that is a little wrong is a temperature that is
wrong by a constant. Anything else that moves readings together (a zero that drifts, a target that sinks) is taken for
warmth too; `thermal_drift` among the named effects, or readings at two distances that swing in proportion, speak for
air.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from acquisition import Recording, SettingError
from acquisition.arrays import Floats
from noise.effects.medium import ASSUMED_TEMPERATURE_C, CELSIUS

STRAY = 0.08  # share of distance beyond which a reading is no echo of the target: +-45 K; ours
LEAST_PINGS = 8  # of a run, for its middle to mean anything


@dataclass(frozen=True)
class Course:
    """How much warmer than in the middle of its run the air was.

    Attributes:
        time: of each ping that was used, s.
        row: its row in the recording.
        warming: K, smoothed over the window, zero in the middle of each run.
        error: standard error of `warming` from the scatter of readings inside the window, K.
    """

    time: Floats
    row: np.ndarray
    warming: Floats
    error: Floats


def temperature_course(recording: Recording, window_s: float = 3600.0) -> Course:
    """Return the course of temperature that would explain how readings move in time.

    Args:
        recording: with times, of targets whose logged distances hold.
        window_s: over which readings are averaged by their median.

    Raises:
        SettingError: the window is not positive, or no run has enough echoes near their target.
    """
    if not window_s > 0:
        raise SettingError(f"window_s must be above 0 s, got {window_s:g} s")
    ping, reading, run = recording.ping, recording.reading, recording.run
    near = reading.echo & (np.abs(reading.range - ping.distance) < STRAY * ping.distance)
    parts = [np.flatnonzero(near & (run == each)) for each in np.unique(run)]
    kept = [rows for rows in parts if len(rows) >= LEAST_PINGS]
    if not kept:
        raise SettingError(f"{recording.name}: no run has {LEAST_PINGS} echoes within {STRAY:.0%} of the target")
    pieces = [_of_run(ping.time[r], ping.distance[r] / reading.range[r], window_s) for r in kept]
    warming, error = (np.concatenate(each) for each in zip(*pieces, strict=True))
    rows = np.concatenate(kept)
    return Course(ping.time[rows], rows, warming, error)


def _of_run(time: Floats, ratio: Floats, window_s: float) -> tuple[Floats, Floats]:
    """Return warming and its standard error over one run, K; the middle of the run is the zero."""
    kelvin = CELSIUS + ASSUMED_TEMPERATURE_C
    raw = kelvin * ((ratio / np.median(ratio)) ** 2 - 1.0)
    order = np.argsort(time, kind="stable")
    series = pd.Series(raw[order], index=pd.to_timedelta(time[order], unit="s"))
    window = series.rolling(pd.Timedelta(seconds=window_s), center=True, min_periods=1)
    count = window.count().to_numpy()
    scatter = window.std().fillna(series.std()).to_numpy()
    out, error = np.empty(len(raw)), np.empty(len(raw))
    out[order], error[order] = window.median().to_numpy(), 1.2533 * scatter / np.sqrt(count)
    return out, error
