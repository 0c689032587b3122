"""`Recording`: pings and readings of one CSV file with one row per ping.

Required columns: `distance_mm`, `angle_deg`, `reading_mm`. In `reading_mm` (and `echo_2_mm` ... `echo_17_mm`) 0 means
no echo and an empty field no answer. Optional: `time_s`, `session`, `sensor`, `reflectance`, `incidence_deg`. Any other
complete numeric column is a covariate.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, field, replace
from functools import cached_property
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from acquisition.arguments import checked
from acquisition.arrays import Bits, Floats, Ints
from acquisition.brief import shortened
from acquisition.errors import RecordingError, SettingError
from acquisition.extras import FigureLike, load_extra
from acquisition.io.columns import (
    CONDITION,
    DIGITS,
    ECHO_COLUMN,
    REQUIRED,
    TEXT,
    RowFault,
    check_header,
    convert,
    is_reading,
    read_columns,
    valid_rows,
)
from acquisition.io.files import write_atomic
from acquisition.io.grid import ROUNDED_MM, shifted_step, step_of
from acquisition.io.parquet import SUFFIX, is_parquet, read_parquet, write_parquet
from acquisition.io.tables import read_bytes
from acquisition.limits import as_numbers, check_value, is_list, shown
from acquisition.ping import EchoStatus, Ping, Reading, check_pairs, interval

MM, DEG = 1e-3, np.pi / 180.0


def unfinished_path(path: Path) -> Path:
    """Return the path of the file that exists beside a recording while its session is unfinished."""
    return path.with_name(path.name + ".unfinished")


def _content(path: Path) -> bytes:
    """Return the content of a file; of an unfinished session, only complete lines: a power cut may end any."""
    data = read_bytes(path)
    return data[: data.rfind(b"\n") + 1] if unfinished_path(path).exists() else data


def as_rows(name: str, given: Any, n: int) -> NDArray[np.int64]:
    """Return the indices at a mask of n rows, or indices as given.

    Raises:
        SettingError: it is neither a mask of n rows nor an array of indices below n.
    """
    number = as_numbers(name, given)
    is_mask = np.asarray(given).dtype == bool
    rows = np.flatnonzero(number) if is_mask else number
    if number.ndim != 1 or (is_mask and len(number) != n) or not _are_indices(rows, n):
        raise SettingError(f"{name}: expected a mask of {n} rows or indices below {n}, got {shown(given)}")
    return rows.astype(np.int64)


def _are_indices(rows: NDArray[Any], n: int) -> bool:
    return bool(np.all((rows == np.floor(rows)) & (rows >= -n) & (rows < n)))


@dataclass(frozen=True, eq=False)
class Recording:
    """Pings and readings of one CSV file, in its order.

    Attributes:
        table: numeric columns as float64, text columns as text; NaN in a reading column means no answer.
        name: origin, for messages.
        rejected: faults of the rows that were omitted with `skip_bad_rows`.
    """

    table: pd.DataFrame
    name: str = "recording"
    rejected: tuple[RowFault, ...] = field(default=())

    def __post_init__(self) -> None:
        """Raise SettingError for what is no table of numbers, RecordingError where a column is missing."""
        if not isinstance(self.table, pd.DataFrame):
            raise SettingError(f"Recording.table: expected a DataFrame, got {shown(self.table)}")
        check_value("Recording.name", self.name, str)
        check_header(self.name, list(map(str, self.table.columns)))
        for name in (*REQUIRED, *(column for column in CONDITION if self.has(column))):
            if not pd.api.types.is_numeric_dtype(self.table[name]):
                raise SettingError(f"Recording.table: column {name} holds text; `as_recording` converts it")

    @classmethod
    @checked
    def load(cls, path: str | os.PathLike[str], skip_bad_rows: bool = False) -> Recording:
        """Read and check a recording.

        Args:
            path: of the file, CSV or Parquet.
            skip_bad_rows: omit faulty rows (listed in `rejected`) instead of rejecting the file.

        Raises:
            RecordingNotFoundError: the file does not exist.
            RecordingError: a column is missing or a value violates the format; the message describes the first fault.
        """
        path = Path(path)
        columns = read_parquet(path) if is_parquet(path) else read_columns(_content(path), str(path))
        return cls._of_columns(*columns, str(path), skip_bad_rows)

    @classmethod
    @checked
    def from_text(cls, text: pd.DataFrame, name: str, skip_bad_rows: bool = False) -> Recording:
        """Check a table of text as read from a CSV file; see `load`. The row with index k is line k + 2 of the file."""
        if not (pd.api.types.is_integer_dtype(text.index) and text.index.is_unique):
            text = text.reset_index(drop=True)
        return cls._of_columns(*convert(name, text), name, skip_bad_rows)

    @classmethod
    def _of_columns(cls, table: pd.DataFrame, faults: list[RowFault], name: str, skip_bad_rows: bool) -> Recording:
        table = valid_rows(table, faults, skip_bad_rows)
        if table.empty:
            raise RecordingError(f"{name}: has no rows below its header, expected one row per ping")
        return cls(table, name, tuple(faults))

    @classmethod
    @checked
    def of(cls, ping: Ping, reading: Reading, name: str = "recording", **columns: ArrayLike) -> Recording:
        """Return a recording of arrays; `columns` adds or replaces columns (session, sensor, covariates)."""
        check_pairs("Recording.of.reading", ping, reading)
        for key, value in columns.items():
            is_one = np.isscalar(value) and not isinstance(value, memoryview)
            if not (is_one or _is_column(value, len(ping))):
                raise SettingError(f"Recording.of.{key}: expected one value or {len(ping)}, got {shown(value)}")
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
        given: dict[str, Any] = columns  # pandas accepts fewer types of arrays than NumPy
        return cls(table.assign(**given).round(6), name)

    def __repr__(self) -> str:
        return shortened(f"<Recording {self.name}: {', '.join(self._counts())}>")

    def _repr_html_(self) -> str:
        return f"<p>{escape(self.summary())}</p>{self.table.head(5).to_html(index=False, na_rep='no answer')}"

    def summary(self) -> str:
        """Return number of pings and conditions, range of distances, and shares of echoes, in one line."""
        return f"{self.name}: {', '.join(self._counts())}; columns {', '.join(self.table.columns)}"

    def _counts(self) -> list[str]:
        distance, reading = self.ping.distance, self.reading
        return [
            f"{len(self):,} pings",
            f"{len(np.unique(self.condition)):,} conditions",
            f"{distance.min():.3g} to {distance.max():.3g} m",
            f"{100 * np.mean(reading.echo):.1f} % echoes",
            f"{100 * np.mean(~reading.answered):.1f} % no answer",
        ]

    def plot(self) -> FigureLike:
        """Return a matplotlib figure: share of echoes, and readings against true distances.

        Raises:
            MissingExtraError: matplotlib is not installed.
        """
        figure: FigureLike = load_extra("training.recordings.figures", "train").overview(self)
        return figure

    def __len__(self) -> int:
        """Return the number of pings."""
        return len(self.table)

    @checked
    def has(self, column: str) -> bool:
        """Return whether the recording has a column."""
        return column in self.table.columns

    def select(self, mask: Bits | Ints) -> Recording:
        """Return the recording of the rows at a mask or array of indices.

        Raises:
            SettingError: it is neither a mask of all rows nor an array of their indices.
        """
        rows = as_rows("Recording.select", mask, len(self))
        return replace(self, table=self._with_interval().iloc[rows].reset_index(drop=True))

    def _with_interval(self) -> pd.DataFrame:
        """Return the table with `interval_s`, the time since the previous ping; a selection of rows would lose it."""
        if not self.has("time_s") or self.has("interval_s"):
            return self.table
        return self.table.assign(interval_s=interval(self.table["time_s"].to_numpy(), self.run))

    @cached_property
    def run(self) -> NDArray[np.int64]:
        """Index of the uninterrupted run (session and sensor) of each ping, (n,)."""
        keys = [self.table[name] for name in TEXT if self.has(name)]
        if not keys:
            return np.zeros(len(self), dtype=np.int64)
        return self.table.groupby(keys, sort=False).ngroup().to_numpy().astype(np.int64)

    @cached_property
    def condition(self) -> NDArray[np.int64]:
        """Index of the condition (distance, angles, reflectance) of each ping, (n,), equal for equal conditions."""
        keys = [self.table[name] for name in CONDITION[1:] if self.has(name)]
        return self.table.groupby(keys, sort=False).ngroup().to_numpy().astype(np.int64)

    @cached_property
    def ping(self) -> Ping:
        """True conditions of the pings, with the time since the first of them: logs count from any origin."""
        angle = self.table["angle_deg"].to_numpy() * DEG
        column = self.table.get
        table = self._with_interval()
        ping = Ping.of(
            distance=self.table["distance_mm"].to_numpy() * MM,
            angle=angle,
            incidence=angle if not self.has("incidence_deg") else self.table["incidence_deg"].to_numpy() * DEG,
            reflectance=column("reflectance", pd.Series(1.0, self.table.index)).to_numpy(),
            time=self._elapsed(),
            run=self.run,
        )
        names = (*self.covariates, *table.columns.difference(self.table.columns))
        return replace(ping, covariates={name: table[name].to_numpy(np.float64) for name in names})

    def _elapsed(self) -> Floats:
        """Return the time since the first ping, s, (n,); the index of each ping where no time was logged."""
        index = pd.Series(np.arange(len(self)), dtype=np.float64)
        time: Floats = np.asarray(self.table.get("time_s", index), dtype=np.float64)
        return time - time.min() if len(time) else time

    @cached_property
    def reading(self) -> Reading:
        """Readings of the sensor."""
        value = self.table["reading_mm"].to_numpy() * MM
        status = np.where(value > 0, EchoStatus.ECHO, EchoStatus.NO_ECHO)
        status = np.where(np.isnan(value), EchoStatus.NO_ANSWER, status)
        more = self.table[[name for name in self.table.columns if ECHO_COLUMN.fullmatch(name)]]
        return Reading.of(np.nan_to_num(value), status, np.nan_to_num(more.to_numpy(dtype=np.float64)) * MM)

    @cached_property
    def covariates(self) -> tuple[str, ...]:
        """Names of the other numeric columns that have a value in every row."""
        known = {*CONDITION, *TEXT}
        return tuple(
            name
            for name in self.table.columns
            if name not in known and not is_reading(name) and _is_complete_number(self.table[name])
        )

    @property
    def resolution(self) -> float:
        """Step of the grid on which all readings lie, m; 1 mm if there is none."""
        return self.grid[0]

    @cached_property
    def grid(self) -> tuple[float, float]:
        """Step of the grid on which all readings lie, m, and the range of its step 0, m, in (-step, 0].

        The common steps are 10 mm (cm output) and 25.4 mm (inch output). Other steps, and multiples of the common ones,
        are accepted if a coincidence is improbable and the true distances do not lie on the same grid. A constant that
        was added after rounding, such as the place of the sensor on a robot, shifts the whole grid.
        """
        reading_mm, distance_mm = (value[self.reading.echo] / MM for value in (self.reading.range, self.ping.distance))
        echo_mm = np.unique(reading_mm)
        step = step_of(echo_mm, np.unique(self.ping.distance / MM))
        shifted = None if len(echo_mm) < 2 else shifted_step(reading_mm, distance_mm, step or 2.0 * ROUNDED_MM)
        if shifted is None:
            return (MM if step is None else step * MM), 0.0
        return shifted * MM, -(-float(echo_mm[0]) % shifted) * MM

    @checked
    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write the recording, atomically: as Parquet if the name ends in .parquet, otherwise as CSV."""
        path = Path(path)
        if path.suffix.lower() == SUFFIX:
            return write_parquet(path, [self.table])
        return write_atomic(path, lambda file: self.table.to_csv(file, index=False, float_format=f"%{DIGITS}"))


def _is_column(value: Any, n: int) -> bool:
    is_flat = value.ndim == 1 if isinstance(value, np.ndarray | pd.Series) else is_list(value)
    return is_flat and len(value) == n


def _is_complete_number(column: pd.Series) -> bool:
    return pd.api.types.is_numeric_dtype(column) and bool(np.isfinite(column.to_numpy(dtype=np.float64)).all())
