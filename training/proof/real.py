"""Real recordings with something about them hidden: what is hidden, what an honest answer is, and how it is scored."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from acquisition import Recording
from acquisition.arrays import Floats
from noise.discrepancy.checks.course import temperature_course

UNCOMPENSATED = 0.5 * 343.0e-6 * 1000.0  # mm a microsecond of echo, of a sound that knows no temperature
SNOW_WINDOW_S = 3600.0
Scored = dict[str, float]


@dataclass(frozen=True)
class Hidden:
    """A real recording as the diagnosis gets it, and what was taken away.

    Attributes:
        recorded: what is diagnosed; `simulated`, what stands for the simulation, None for an ideal sonar.
        score: what can be held against the hidden column, computed from the recording alone.
    """

    recorded: Recording
    simulated: Recording | None = None
    score: Scored | None = None


@dataclass(frozen=True)
class Case:
    """One real recording.

    Attributes:
        name: folder of it.
        hidden: what is taken away, in words.
        expected: ids of which a right answer names one; empty where only "unknown" is right.
        made: the recording without what is hidden, given its folder.
    """

    name: str
    hidden: str
    expected: tuple[str, ...]
    made: Callable[[Path], Hidden]


def snow(folder: Path) -> Hidden:
    """A fixed ranger over ground, months of it; the ground's distance is the middle of each segment."""
    log = pd.read_csv(folder / "segments-1-and-3.csv")
    time = pd.to_datetime(log.TIMESTAMP)
    middle = log.groupby("segment").range_raw_m.transform("median")
    columns = {
        "session": log.segment.astype(str),
        "time_s": (time - time.iloc[0]).dt.total_seconds(),
        "distance_mm": 1000.0 * middle,
        "angle_deg": 0.0,
        "reading_mm": 1000.0 * log.range_raw_m,
    }
    recording = Recording(pd.DataFrame(columns), "fixed-ranger-copenhagen")
    return Hidden(recording, None, against_air(recording, log.t_air_lower_c.to_numpy(float)))


def against_air(recording: Recording, air_c: Floats) -> Scored:
    """Return how the recovered course of temperature compares with the hidden one, segment by segment."""
    course = temperature_course(recording, SNOW_WINDOW_S)
    out: Scored = {}
    for run in np.unique(recording.run):
        here = (recording.run[course.row] == run) & np.isfinite(air_c[course.row])
        told, true = course.warming[here], air_c[course.row[here]]
        true = true - np.median(true)
        out[f"segment {run + 1}: correlation with the air"] = float(np.corrcoef(told, true)[0, 1])
        out[f"segment {run + 1}: root mean square error, K"] = float(np.sqrt(np.mean((told - true) ** 2)))
        out[f"segment {run + 1}: the air's own standard deviation, K"] = float(np.std(true))
    return out


def calibration(folder: Path) -> Hidden:
    """Bursts before a ruler; the order in the burst, the interval and both thermometers are taken away."""
    log = pd.read_csv(folder / "readings.csv")
    columns = {
        "session": log.source_file,
        "distance_mm": 10.0 * log.true_cm,
        "angle_deg": 0.0,
        "reading_mm": 10.0 * log.measured_cm,
    }
    return Hidden(Recording(pd.DataFrame(columns), "hcsr04-calibration"))


def wall(folder: Path) -> Hidden:
    """A robot that drives towards a wall; its speed and the time are taken away."""
    log = pd.read_csv(folder / "calibration.csv")
    columns = {"distance_mm": 1000.0 * log.range, "angle_deg": 0.0, "reading_mm": 1000.0 * log.sonar1}
    return Hidden(Recording(pd.DataFrame(columns), "hcsr04-maxbotix-wall"))


def ten(folder: Path) -> Hidden:
    """Echo times stand for the simulation, what the sketch made of them is the recording: that it cuts is hidden."""
    logs = {10.0 * float(path.stem[:-2]): pd.read_csv(path) for path in sorted(folder.glob("*cm.csv"))}

    def recording(name: str, column: int, unit_mm: float) -> Recording:
        parts = [
            pd.DataFrame(
                {
                    "session": f"{true:g}",
                    "distance_mm": true,
                    "angle_deg": 0.0,
                    "reading_mm": unit_mm * log.iloc[:, column],
                }
            )
            for true, log in logs.items()
        ]
        return Recording(pd.concat(parts, ignore_index=True), name)

    return Hidden(recording("hcsr04-ten-distances", 0, 10.0), recording("echo times", 1, UNCOMPENSATED))


def apple(folder: Path) -> Hidden:
    """Scans of an apple: the one with nothing behind it stands for the simulation, that there is a plant is hidden."""
    scans = []
    for kind in ("No", "Plant"):
        log = pd.read_csv(folder / f"Apple_150mm_{kind}_Backdrop.csv")
        columns = {
            "distance_mm": 150.0,
            "angle_deg": 0.0,
            "reading_mm": 10.0 * log.ultra,
            "x_mm": log.x.astype(float),
            "y_mm": log.y.astype(float),
        }
        scans.append(Recording(pd.DataFrame(columns), f"mb1213-apple, {kind.lower()} backdrop"))
    return Hidden(scans[1], scans[0])


CASES = (
    Case(
        "fixed-ranger-copenhagen",
        "air temperature and every other column of weather",
        ("thermal_drift", "sound_speed"),
        snow,
    ),
    Case("hcsr04-ten-distances", "that the sketch cuts to whole centimetres", ("truncation", "quantisation"), ten),
    Case(
        "hcsr04-calibration",
        "order in the burst, interval, both thermometers",
        ("zero_offset", "sound_speed", "clock_scale"),
        calibration,
    ),
    Case("hcsr04-maxbotix-wall", "speed and time", ("zero_offset",), wall),
    Case("mb1213-apple", "the plant behind the apple", ("background_reflector", "fixed_clutter"), apple),
)
