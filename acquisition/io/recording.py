"""A recording: one CSV row a ping, loaded whole or refused with the place of each fault.

Columns: `distance_mm`, `angle_deg`, `reading_mm` are required. `reading_mm` (and `echo_2_mm` ... `echo_17_mm`):
0 = no echo, empty = no answer. `time_s`, `session`, `sensor`, `reflectance`, `incidence_deg` are used where present;
any further numeric column is kept as a covariate under its own name.
"""

from __future__ import annotations

import io
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from acquisition.errors import RecordingError, RecordingNotFoundError
from acquisition.io.files import write_atomic
from acquisition.ping import EchoStatus, Ping, Reading, interval

REQUIRED = ("distance_mm", "angle_deg", "reading_mm")
TEXT = ("session", "sensor")
CONDITION = ("time_s", "distance_mm", "angle_deg", "incidence_deg", "reflectance")
ECHO_COLUMN = re.compile(r"echo_(?:[2-9]|1[0-7])_mm")
LIMITS = {
    "distance_mm": (0.0, 100_000.0),
    "angle_deg": (-180.0, 180.0),
    "incidence_deg": (-180.0, 180.0),
    "reflectance": (0.0, 1.0),
    "reading_mm": (0.0, 1_700_000.0),  # whatever 16 bits can say, in inches too: a wire may set any of them
}
MM, DEG = 1e-3, np.pi / 180.0
LUCK = 1e-4  # chance of so many different readings to keep to an unusual step, below which it is believed; ours


@dataclass(frozen=True)
class Fault:
    """One value that breaks the format."""

    file: str
    line: int
    column: str
    value: str
    expected: str

    def __str__(self) -> str:
        return f"{self.file}, line {self.line}, column {self.column}: {self.value!r}, expected {self.expected}"


def _is_reading(name: str) -> bool:
    return name == "reading_mm" or ECHO_COLUMN.fullmatch(name) is not None


def _expectation(name: str) -> str:
    low, high = LIMITS.get("reading_mm" if _is_reading(name) else name, (-np.inf, np.inf))
    span = "a finite number" if np.isinf(low) else f"a number from {low:.7g} to {high:.7g}"
    return f"{span}, 0 for no echo, or nothing for no answer" if _is_reading(name) else span


def _faulty(name: str, text: pd.Series, number: pd.Series) -> NDArray[np.bool_]:
    """Tell which cells of a known numeric column break its rules; `number` is NaN where `text` is no number."""
    low, high = LIMITS.get("reading_mm" if _is_reading(name) else name, (-np.inf, np.inf))
    value = number.to_numpy()
    bad = ~np.isfinite(value) | (value < low) | (value > high)
    empty = (text == "").to_numpy()
    return bad & ~empty if _is_reading(name) else bad


def _numbers(text: pd.Series) -> pd.Series:
    return pd.to_numeric(text.replace("", None), errors="coerce").astype(np.float64)


def unfinished(path: Path) -> Path:
    """Return the path of the file that lies beside a recording while its session is unfinished."""
    return path.with_name(path.name + ".unfinished")


def _whole(path: Path) -> Path | io.BytesIO:
    """Return what to read: of an unfinished session the whole lines, for a power cut may have torn the last one."""
    if not unfinished(path).exists():
        return path
    data = path.read_bytes()
    return io.BytesIO(data[: data.rfind(b"\n") + 1])


def _read_text(path: Path) -> pd.DataFrame:
    if not path.exists():
        raise RecordingNotFoundError(f"{path}: no such file; give the path of a recording (CSV, one row a ping)")
    if path.is_dir():
        raise RecordingError(f"{path}: is a folder, expected a recording (CSV, one row a ping)")
    try:
        return pd.read_csv(_whole(path), dtype=str, keep_default_na=False, skipinitialspace=True, encoding="utf-8-sig")
    except pd.errors.EmptyDataError:
        raise RecordingError(
            f"{path}, line 1: the file is empty, expected a header with {', '.join(REQUIRED)}"
        ) from None
    except pd.errors.ParserError as error:
        raise RecordingError(f"{path}: not a table of comma-separated values: {str(error).strip()}") from None
    except UnicodeDecodeError as error:
        raise RecordingError(f"{path}: not UTF-8 text (byte {error.start}); expected a CSV file") from None


def _check_header(name: str, columns: Sequence[str]) -> None:
    missing = [column for column in REQUIRED if column not in columns]
    if missing:
        raise RecordingError(
            f"{name}, line 1: column {missing[0]} is missing, expected {', '.join(REQUIRED)}; "
            f"found {', '.join(columns)}. `sonar-gym import` maps other names and units"
        )


@dataclass(frozen=True, eq=False)
class Recording:
    """Pings and readings of one CSV file, in its order.

    Attributes:
        table: the columns as numbers (float64), text columns as text; NaN in a reading column means no answer.
        name: where it came from, for messages.
        rejected: the faults of rows that were left out, when loading was asked to go on without them.
    """

    table: pd.DataFrame
    name: str = "recording"
    rejected: tuple[Fault, ...] = field(default=())

    @classmethod
    def load(cls, path: str | os.PathLike[str], skip_bad_rows: bool = False) -> Recording:
        """Read and check a recording.

        Args:
            path: of the CSV file.
            skip_bad_rows: leave rows with faults out, listed in `rejected`, rather than refuse the file.

        Raises:
            RecordingNotFoundError: there is no such file.
            RecordingError: a column is missing or a value breaks the format; the first fault is named in full.
        """
        path = Path(path)
        return cls.from_text(_read_text(path), str(path), skip_bad_rows)

    @classmethod
    def from_text(cls, text: pd.DataFrame, name: str, skip_bad_rows: bool = False) -> Recording:
        """Check a table of text cells as read from a CSV; see `load`. Row k of it stands on line k + 2."""
        _check_header(name, list(text.columns))
        table, faults = _convert(name, text)
        if faults and not skip_bad_rows:
            more = f" (and {len(faults) - 1} more)" if len(faults) > 1 else ""
            raise RecordingError(f"{faults[0]}{more}")
        bad_rows = sorted({fault.line - 2 for fault in faults})
        table = table.drop(index=bad_rows).reset_index(drop=True)
        if table.empty:
            raise RecordingError(f"{name}: holds no rows below its header, expected one row a ping")
        return cls(table, name, tuple(faults))

    @classmethod
    def of(cls, ping: Ping, reading: Reading, name: str = "recording", **columns: Any) -> Recording:
        """Build a recording from arrays; `columns` adds or replaces columns (session, sensor, covariates)."""
        table = pd.DataFrame(
            {
                "time_s": ping.time,
                "session": [str(run) for run in ping.run],
                "sensor": "0",
                "distance_mm": ping.distance / MM,
                "angle_deg": ping.angle / DEG,
                "incidence_deg": ping.incidence / DEG,
                "reflectance": ping.reflectance,
                **{key: np.asarray(value) for key, value in ping.covariates.items()},
                "reading_mm": np.where(reading.answered, reading.range / MM, np.nan),
                **{
                    f"echo_{k + 2}_mm": np.where(reading.answered, column / MM, np.nan)
                    for k, column in enumerate(reading.echoes.T)
                },
            }
        )
        return cls(table.assign(**columns).round(6), name)

    def __len__(self) -> int:
        """Return the number of pings."""
        return len(self.table)

    def has(self, column: str) -> bool:
        """Tell whether the recording holds a column."""
        return column in self.table.columns

    def select(self, mask: NDArray[Any]) -> Recording:
        """Return the rows at a mask or array of indices, in their order."""
        rows = np.flatnonzero(mask) if np.asarray(mask).dtype == bool else np.asarray(mask)
        return replace(self, table=self._with_interval().iloc[rows].reset_index(drop=True))

    def _with_interval(self) -> pd.DataFrame:
        """Return the table with the time since each run's ping before: among picked rows it can no longer be seen."""
        if not self.has("time_s") or self.has("interval_s"):
            return self.table
        return self.table.assign(interval_s=interval(self.table["time_s"].to_numpy(), self.run))

    @cached_property
    def run(self) -> NDArray[np.int64]:
        """Number of the uninterrupted run (session and sensor) of each ping, (n,)."""
        keys = [self.table[name] for name in TEXT if self.has(name)]
        if not keys:
            return np.zeros(len(self), dtype=np.int64)
        return self.table.groupby(keys, sort=False).ngroup().to_numpy().astype(np.int64)

    @cached_property
    def condition(self) -> NDArray[np.int64]:
        """Number of the condition (distance, angles, reflectance) of each ping, (n,); equal conditions share it."""
        keys = [self.table[name] for name in CONDITION[1:] if self.has(name)]
        return self.table.groupby(keys, sort=False).ngroup().to_numpy().astype(np.int64)

    @cached_property
    def ping(self) -> Ping:
        """What the sensor faced."""
        angle = self.table["angle_deg"].to_numpy() * DEG
        column = self.table.get
        table = self._with_interval()
        return Ping.of(
            distance=self.table["distance_mm"].to_numpy() * MM,
            angle=angle,
            incidence=angle if not self.has("incidence_deg") else self.table["incidence_deg"].to_numpy() * DEG,
            reflectance=column("reflectance", pd.Series(1.0, self.table.index)).to_numpy(),
            time=column("time_s", pd.Series(np.arange(len(self)), dtype=np.float64)).to_numpy(),
            run=self.run,
            **{
                name: table[name].to_numpy()
                for name in (*self.covariates, *table.columns.difference(self.table.columns))
            },
        )

    @cached_property
    def reading(self) -> Reading:
        """What the sensor said."""
        value = self.table["reading_mm"].to_numpy() * MM
        status = np.where(value > 0, EchoStatus.ECHO, EchoStatus.NO_ECHO)
        status = np.where(np.isnan(value), EchoStatus.NO_ANSWER, status)
        more = self.table[[name for name in self.table.columns if ECHO_COLUMN.fullmatch(name)]]
        return Reading.of(np.nan_to_num(value), status, np.nan_to_num(more.to_numpy(dtype=np.float64)) * MM)

    @cached_property
    def covariates(self) -> tuple[str, ...]:
        """Names of the further numeric columns that are logged in every row."""
        known = {*CONDITION, *TEXT}
        return tuple(
            name
            for name in self.table.columns
            if name not in known and not _is_reading(name) and _is_complete_number(self.table[name])
        )

    @cached_property
    def resolution(self) -> float:
        """Grid on which readings lie, m: the coarsest step that divides them all, else 1 mm.

        The usual steps are 10 mm (cm output) and 25.4 mm (inch output); any other, and any multiple of these, is found
        where more different readings keep to it than by luck, and the true distances do not. A finer output is treated
        in 1 mm bins.
        """
        echo_mm = np.unique(self.reading.range[self.reading.echo] / MM)
        usual = next((step for step in (25.4, 10.0) if len(echo_mm) and on_grid(echo_mm, step, 0.051)), None)
        found = unusual_step(echo_mm) if usual is None else usual * common_multiple(np.rint(echo_mm / usual))
        given = found is not None and on_grid(np.unique(self.ping.distance / MM), found, 0.051)
        step = usual if found is None or given else found
        return MM if step is None else step * MM

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write the recording as CSV, atomically: the file is there whole or not at all."""
        return write_atomic(Path(path), lambda file: self.table.to_csv(file, index=False, float_format="%.10g"))


def on_grid(value: NDArray[np.float64], step: float, tolerance: float) -> bool:
    """Tell whether values are multiples of a step, within a tolerance."""
    return bool(np.all(np.abs(value - np.rint(value / step) * step) < tolerance))


def common_multiple(count: NDArray[np.float64]) -> int:
    """Return the greatest number that divides sorted different whole numbers; 1 where that may be luck."""
    divisor = max(1, int(np.gcd.reduce(count.astype(np.int64))))
    return divisor if divisor ** -(len(count) - 1.0) < LUCK else 1


def unusual_step(value: NDArray[np.float64]) -> float | None:
    """Return the step of which all sorted different values, mm, are multiples; None where that may be luck.

    Whole millimetres may have been rounded to after the step was taken: a little more than half of one is allowed then.
    """
    if len(value) < 2:
        return None
    rounded = on_grid(value, 1.0, 1e-6)
    least, tolerance = (10.0, 0.6) if rounded else (2.0, 0.051)
    gaps = np.diff(value)
    gap = float(gaps[gaps < 1.5 * gaps.min() + 1e-9].mean())  # of neighbours on the grid; rounding errors cancel
    for step in (_refined(value, gap / share) for share in (1, 2, 3) if gap / share >= least - tolerance):
        luck = (2.0 * tolerance / max(step, least)) ** (len(value) - 1)  # the first gap gave the step
        if step >= least and luck < LUCK and on_grid(value, step, tolerance):
            return step
    return None


def _refined(value: NDArray[np.float64], step: float) -> float:
    """Return a step that fits ever greater multiples of it, each of them near enough to count from the one before."""
    product = square = 0.0
    for each in value:
        count = np.rint(each / step)
        product, square = product + count * each, square + count**2
        step = product / square if square > 0 else step
    return float(step)


def _is_complete_number(column: pd.Series) -> bool:
    return pd.api.types.is_numeric_dtype(column) and bool(np.isfinite(column.to_numpy(dtype=np.float64)).all())


def _convert(file: str, text: pd.DataFrame) -> tuple[pd.DataFrame, list[Fault]]:
    """Turn text columns into numbers where they are numbers, and list what breaks the rules."""
    faults: list[Fault] = []
    columns: dict[str, pd.Series] = {}
    for name in text.columns:
        number = _numbers(text[name])
        if name in CONDITION or _is_reading(name):
            rows = np.flatnonzero(_faulty(name, text[name], number))
            faults += [Fault(file, int(r) + 2, name, text[name].iloc[r], _expectation(name)) for r in rows]
            columns[name] = number
        else:
            empty = text[name] == ""
            is_number = name not in TEXT and not empty.all() and bool(np.isfinite(number[~empty]).all())
            columns[name] = number if is_number else text[name]
    return pd.DataFrame(columns), sorted(faults, key=lambda fault: fault.line)
