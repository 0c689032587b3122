"""Real recordings of which one fact is hidden; they are not part of the project."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from acquisition import Recording
from training.common.checksum import sha256
from training.diagnosis.judging.real import READERS
from training.proof.diagnosing import RECORDED, SIMULATED
from training.proof.work import Diagnose, as_csv

EVENT = "real"
FOLDER = "SONAR_GYM_RECORDINGS"  # environment variable
MM_PER_US = 0.5 * 343.0e-3  # of an echo's time, with sound at 20 degC
Tables = tuple[pd.DataFrame, pd.DataFrame | None]  # recording, and what stands for the simulation


@dataclass(frozen=True)
class Case:
    """One real recording.

    Attributes:
        name: of the folder and the case.
        hidden: what is taken away.
        accepted: ids that name what is hidden, or its consequence.
        tables: the recording without it, and the simulation if there is one, from the folder.
    """

    name: str
    hidden: str
    accepted: tuple[str, ...]
    tables: Callable[[Path], Tables]


def _without(reader: str, *columns: str) -> Callable[[Path], Tables]:
    return lambda folder: (READERS[reader][1](folder).drop(columns=list(columns)), None)


def _echo_times(folder: Path) -> Tables:
    """Return readings, and the times of the same echoes as the simulation; the sketch truncates them."""
    table, marks = READERS["ten distances"][1](folder), sorted(folder.glob("*cm.csv"))
    times = pd.concat([pd.read_csv(path).iloc[:, 1] for path in marks], ignore_index=True)
    return table, table.assign(reading_mm=MM_PER_US * times)


def _plant(folder: Path) -> Tables:
    """Return the scan of an apple before a plant, and the one with nothing behind it as the simulation."""
    simulated = READERS["apple"][1](folder)
    log = pd.read_csv(folder / "Apple_150mm_Plant_Backdrop.csv")
    x, y = log.x.astype(float), log.y.astype(float)
    readings = {"distance_mm": 150.0, "angle_deg": 0.0, "reading_mm": 10.0 * log.ultra, "x_mm": x, "y_mm": y}
    return pd.DataFrame(readings), simulated


CASES = (
    Case("fixed-ranger-copenhagen", "all weather", ("thermal_drift", "sound_speed"), _without("snow")),
    Case("hcsr04-ten-distances", "that the sketch truncates", ("quantisation", "truncation"), _echo_times),
    Case(
        "hcsr04-calibration",
        "interval, temperature",
        ("zero_offset", "sound_speed", "clock_scale"),
        _without("calibration", "interval_ms"),
    ),
    Case("hcsr04-maxbotix-wall", "speed and time", ("zero_offset",), _without("wall, HC-SR04", "time_s")),
    Case("mb1213-apple", "a plant behind the apple", ("background_reflector", "fixed_clutter"), _plant),
)


def available() -> list[Case]:
    """Return the cases whose recordings are in the folder that the variable `SONAR_GYM_RECORDINGS` names."""
    folder = os.environ.get(FOLDER)
    return [case for case in CASES if folder and (Path(folder) / case.name).is_dir()]


def diagnosed_case(case: Case, diagnose: Diagnose) -> dict[str, Any]:
    """Return the line of a real recording: what was hidden, the hashes of the files, and the verdict."""
    recorded, simulated = case.tables(Path(os.environ[FOLDER]) / case.name)
    files = {RECORDED: as_csv(Recording(recorded, case.name))}
    if simulated is not None:
        files[SIMULATED] = as_csv(Recording(simulated, "simulation"))
    result, _ = diagnose(files)
    answer = {"name": case.name, "hidden": case.hidden, "accepted": list(case.accepted)}
    return {**answer, "files": {name: sha256(data) for name, data in files.items()}, **result}
