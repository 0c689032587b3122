"""Real recordings divided into two halves that must agree, and known changes planted in one of them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pandas as pd

from acquisition import Recording
from acquisition.arrays import Bits, Floats
from noise.fitting.visits import visits_of
from training.diagnosis.generators.trial import TrueCause

SCALES = ("clock_scale", "sound_speed")
ONE_DISTANCE = 0.02  # relative spread of distance below which an offset and a scale cannot be told apart
ROUNDING_MM = 1e-6  # of stored readings
Rng = np.random.Generator
Change = Callable[[Floats, Rng], Floats]


def _table(distance_mm: pd.Series | float, reading_mm: pd.Series, **columns: pd.Series | float | str) -> pd.DataFrame:
    reading = reading_mm.where(np.isfinite(reading_mm) & (reading_mm > 0), 0.0)
    return pd.DataFrame({"distance_mm": distance_mm, "angle_deg": 0.0, "reading_mm": reading, **columns})


def _snow(folder: Path) -> pd.DataFrame:
    log = pd.read_csv(folder / "segments-1-and-3.csv")
    time = pd.to_datetime(log.TIMESTAMP)
    ground = 1000.0 * log.groupby("segment").range_raw_m.transform("median")
    elapsed = (time - time.iloc[0]).dt.total_seconds()
    return _table(ground, 1000.0 * log.range_raw_m, session=log.segment.astype(str), time_s=elapsed)


def _wall(sonar: str) -> Callable[[Path], pd.DataFrame]:
    def read(folder: Path) -> pd.DataFrame:
        log = pd.read_csv(folder / "calibration.csv")
        return _table(1000.0 * log["range"], 1000.0 * log[sonar], time_s=log.time)

    return read


def _calibration(folder: Path) -> pd.DataFrame:
    log = pd.read_csv(folder / "readings.csv")
    interval = log.interval_ms.astype(float)
    return _table(10.0 * log.true_cm, 10.0 * log.measured_cm, session=log.source_file, interval_ms=interval)


def _ten(folder: Path) -> pd.DataFrame:
    logs = {path.stem: pd.read_csv(path) for path in sorted(folder.glob("*cm.csv"))}
    parts = [_table(10.0 * float(name[:-2]), 10.0 * log.iloc[:, 0], session=name) for name, log in logs.items()]
    return pd.concat(parts, ignore_index=True)


def _angles(folder: Path) -> pd.DataFrame:
    log = pd.read_csv(folder / "Misure_prove.csv")
    marks = {1: 20.0, 4: 40.0, 7: 60.0, 10: 100.0}  # column of the reading -> distance of the upright card, mm
    parts = [
        _table(mark, 10.0 * pd.to_numeric(log.iloc[:, k], errors="coerce")).assign(
            angle_deg=pd.to_numeric(log.iloc[:, k - 1], errors="coerce")
        )
        for k, mark in marks.items()
    ]
    return pd.concat(parts, ignore_index=True).dropna()


def _box(folder: Path) -> pd.DataFrame:
    log = pd.read_csv(folder / "20210102_alldata.csv")
    log = log[log.ObjectClass != "ObjectClass"].reset_index(drop=True)  # the header stands in the middle once more
    reading = 10.0 * pd.to_numeric(log.HCSR04_001)
    return _table(reading.groupby(log.ObjectClass).transform("median"), reading, session=log.ObjectClass)


def _apple(folder: Path) -> pd.DataFrame:
    log = pd.read_csv(folder / "Apple_150mm_No_Backdrop.csv")
    return _table(150.0, 10.0 * log.ultra, x_mm=log.x.astype(float), y_mm=log.y.astype(float))


READERS: dict[str, tuple[str, Callable[[Path], pd.DataFrame]]] = {
    "snow": ("fixed-ranger-copenhagen", _snow),
    "wall, HC-SR04": ("hcsr04-maxbotix-wall", _wall("sonar1")),
    "wall, MaxBotix": ("hcsr04-maxbotix-wall", _wall("sonar2")),
    "calibration": ("hcsr04-calibration", _calibration),
    "ten distances": ("hcsr04-ten-distances", _ten),
    "angles": ("hcsr04-angle", _angles),
    "box": ("seven-hcsr04-objects", _box),
    "apple": ("mb1213-apple", _apple),
}


def _at_random(share: float, value: Callable[[Floats, Rng], Floats]) -> Change:
    def change(reading: Floats, rng: Rng) -> Floats:
        return np.where(rng.random(len(reading)) < share, value(reading, rng), reading)

    return change


def _repeated(reading: Floats, rng: Rng) -> Floats:
    """Return readings of which 15 % are the reported reading before."""
    out, again = reading.copy(), rng.random(len(reading)) < 0.15
    for k in range(1, len(out)):
        out[k] = out[k - 1] if again[k] else out[k]
    return out


SPIKE_MM = (20.0, 4000.0)  # range of an HC-SR04 by its data sheet
CHANGES: dict[str, tuple[Change, tuple[str, ...]]] = {
    "as it is": (lambda reading, rng: reading, ()),
    "+12 mm": (lambda reading, rng: np.where(reading > 0, reading + 12.0, 0.0), ("zero_offset",)),
    "+1.5 %": (lambda reading, rng: 1.015 * reading, SCALES),
    "6 % lost": (_at_random(0.06, lambda reading, rng: 0.0 * reading), ("dropped_reading",)),
    "4 % spikes": (_at_random(0.04, lambda reading, rng: rng.uniform(*SPIKE_MM, len(reading))), ("spike",)),
    "15 % repeats": (_repeated, ("stale_repeat",)),
}


def cases(folder: Path) -> Iterator[str]:
    """Return the names of all cases whose recording is there, "recording: change"."""
    for name, (place, _) in READERS.items():
        if (folder / place).is_dir():
            yield from (f"{name}: {change}" for change in CHANGES)


def planted(folder: Path, case: str, rng: Rng) -> tuple[Recording, Recording, tuple[TrueCause, ...]]:
    """Return two halves of a real recording, the second with a change, and the answer."""
    name, change = case.split(": ")
    place, read = READERS[name]
    table = read(folder / place).reset_index(drop=True)
    first = half_of(Recording(table, name))
    simulated, recorded = table[first].copy(), table[~first].copy()
    change_of, accepted = CHANGES[change]
    register = _register_of(Recording(table, name))
    before = np.asarray(recorded.reading_mm, dtype=np.float64)
    recorded["reading_mm"] = register(change_of(before, rng))
    distance = table.distance_mm.astype(float)
    if distance.std() < ONE_DISTANCE * distance.mean() and accepted and accepted[0] in ("zero_offset", *SCALES):
        accepted = (accepted[0], *sorted({"zero_offset", *SCALES} - {accepted[0]}))
    changed = bool((recorded.reading_mm != before).any())  # few readings may all escape, or have been alike before
    causes = (TrueCause(accepted[0], accepted, 1.0),) if accepted and changed else ()
    return _recording(simulated, name), _recording(recorded, name), causes


def _register_of(recording: Recording) -> Callable[[Floats], Floats]:
    """Return what rounds readings, mm, to the steps of the sensor, or leaves them where no steps are known."""
    step, reading = 1000.0 * recording.resolution, 1000.0 * recording.reading.range[recording.reading.echo]

    def rounded(value: Floats) -> Floats:
        return np.asarray(step * np.round(value / step))

    return rounded if np.allclose(rounded(reading), reading, rtol=0.0, atol=ROUNDING_MM) else lambda value: value


def half_of(recording: Recording) -> Bits:
    """Return which readings belong to the first half, (n,).

    Visits under the same logged conditions alternate; the readings of the last one do where their number is odd. Each
    half holds about as many readings under every condition.
    """
    visit, ping = visits_of(recording)[1], recording.ping
    logged = {"distance": ping.distance, "angle": ping.angle, **ping.covariates}
    first = pd.DataFrame({**logged, "visit": visit}).drop_duplicates("visit")
    same = first.groupby(list(logged), dropna=False).visit
    rank = same.cumcount()
    shared = first.visit[(rank % 2 == 0) & (rank == same.transform("size") - 1)]
    place = pd.Series(visit).groupby(visit).cumcount().to_numpy() + visit  # visits of odd length begin in turn
    return np.where(np.isin(visit, shared), place % 2 == 0, np.isin(visit, first.visit[rank % 2 == 0]))


def _recording(table: pd.DataFrame, name: str) -> Recording:
    return Recording(table.reset_index(drop=True), name)
