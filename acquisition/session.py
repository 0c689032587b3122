"""Sessions: a survey plan, measured cell by cell into a recording that survives a power cut.

A cell is one condition and all its pings. A cell is written whole, in one append, and forced to disk; `resume` cuts a
torn tail off and goes on with the next cell. Needs numpy and pandas alone, so it runs on the small machine that the
sonar is wired to.
"""

from __future__ import annotations

import io
import os
from collections.abc import Callable
from dataclasses import astuple, dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from acquisition.errors import RecordingError, SettingError
from acquisition.ping import Reading
from acquisition.plan import Plan
from acquisition.recording import ECHO_COLUMN, Recording
from acquisition.sources import Measured, Source

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class Session:
    """Measure a plan into a file.

    Attributes:
        plan: what to measure.
        source: what to measure it with.
        path: of the recording, CSV.
        resume: go on with a recording that is there, rather than refuse to touch it.
        echoes: how many echoes a ping to write down, 1..17.
        sensor: what to call the sensor.
    """

    plan: Plan
    source: Source
    path: Path
    resume: bool = False
    echoes: int = 4
    sensor: str = "0"

    def __post_init__(self) -> None:
        """Refuse a number of echoes that no recording holds."""
        if not 1 <= self.echoes <= 17:
            raise SettingError(f"echoes must lie from 1 to 17, got {self.echoes}: a sonar has 17 echo registers")

    def run(self, progress: Progress | None = None) -> Path:
        """Measure what is still to be measured.

        Args:
            progress: called with pings done and pings in all, after each cell.

        Raises:
            RecordingError: the file is there and `resume` was not asked for, or it belongs to another plan.
        """
        done, session = self._take_up()
        total = len(self.plan)
        for number in range(done, total):
            self._append(self._rows(self.source.measure(self.plan, number), session))
            if progress is not None:
                progress((number + 1) * self.plan.pings, total * self.plan.pings)
        return self.path

    def _take_up(self) -> tuple[int, int]:
        """Return how many cells are done and the number of this session; cut a torn tail off."""
        if not self.path.exists():
            self.path.parent.mkdir(parents=True, exist_ok=True)
            return 0, 0
        if not self.resume:
            raise RecordingError(f"{self.path}: is there already; go on with it (--resume) or give another file")
        whole, done = _whole_cells(self.path.read_bytes(), self.plan.pings)
        table = pd.read_csv(io.BytesIO(whole), dtype={"session": str}) if done else None
        if table is not None:
            self._check(table)
        _truncate(self.path, len(whole) if done else 0)
        last = 0 if table is None else int(table["session"].iloc[-1])
        return done, last if self.source.simulated or table is None else last + 1

    def _check(self, table: pd.DataFrame) -> None:
        """Refuse a file whose cells are not the first ones of the plan."""
        deepest = 1 + sum(ECHO_COLUMN.fullmatch(str(name)) is not None for name in table)
        if deepest != self.echoes:
            raise RecordingError(
                f"{self.path}: holds {deepest} echoes a ping, this session {self.echoes}; give the same number"
            )
        there = table[["distance_mm", "angle_deg", "reflectance", "incidence_deg"]].to_numpy(dtype=np.float64)
        due = np.repeat([astuple(cell) for cell in self.plan.cells], self.plan.pings, axis=0)[: len(there)]
        same = np.isclose(there[: len(due)], due, rtol=0.0, atol=1e-5).all(axis=1)
        if len(due) < len(there) or not same.all():
            row = int(np.argmin(same)) if not same.all() else len(due)
            raise RecordingError(
                f"{self.path}, line {row + 2}: holds another condition than the plan has there; "
                "resume with the plan, pings a cell and seed that it was begun with"
            )

    def _rows(self, measured: Measured, session: int) -> pd.DataFrame:
        reading = measured.reading
        echoes = np.zeros((len(reading), self.echoes - 1))
        kept = reading.echoes[:, : self.echoes - 1]
        echoes[:, : kept.shape[1]] = kept
        fixed = Reading(reading.range, reading.status, echoes)
        table = Recording.of(measured.ping, fixed).table
        return table.assign(session=str(session), sensor=self.sensor, **measured.columns)

    def _append(self, rows: pd.DataFrame) -> None:
        """Write a cell, with the header before the first, and do not return before it is on disk."""
        with open(self.path, "ab") as file:
            text = rows.to_csv(index=False, header=file.tell() == 0, float_format="%.10g", lineterminator="\n")
            file.write(text.encode())
            file.flush()
            os.fsync(file.fileno())


def _whole_cells(data: bytes, pings: int) -> tuple[bytes, int]:
    """Return the header with all whole cells, and how many these are."""
    lines = data.split(b"\n")[:-1]  # what follows the last line end is torn
    cells = max(len(lines) - 1, 0) // pings
    kept = lines[: 1 + cells * pings]
    return b"".join(line + b"\n" for line in kept), cells


def _truncate(path: Path, size: int) -> None:
    with open(path, "r+b") as file:
        file.truncate(size)
        file.flush()
        os.fsync(file.fileno())
