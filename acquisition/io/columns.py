"""The columns of a recording: which are required, their limits, and their conversion from the fields of a file."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from itertools import repeat

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from acquisition.errors import RecordingError
from acquisition.io.tables import MISSING, check_twins, parse_numbers, parse_table
from acquisition.ping import MAX_RANGE

REQUIRED = ("distance_mm", "angle_deg", "reading_mm")
TEXT = ("session", "sensor")
CONDITION = ("time_s", "distance_mm", "angle_deg", "incidence_deg", "reflectance")
ECHO_COLUMN = re.compile(r"echo_(?:[2-9]|1[0-7])_mm")
LIMITS = {
    "time_s": (-1e12, 1e12),
    "distance_mm": (0.0, 100_000.0),
    "angle_deg": (-180.0, 180.0),
    "incidence_deg": (-180.0, 180.0),
    "reflectance": (0.0, 1.0),
    "reading_mm": (0.0, 1000.0 * MAX_RANGE),
}
MAX_FAULTS = 500_000  # that are listed; a file with more is no recording
MAX_COVARIATE = 1e15  # larger numbers are text: sums of their squares overflow in single precision
DIGITS = ".15g"  # of numbers that are written: a float64 keeps so many of any decimal number


@dataclass(frozen=True)
class RowFault:
    """One value that violates the format.

    Attributes:
        file: name of the file.
        line: number of the line, from 1.
        column: name of the column.
        value: text in the file.
        expected: description of valid values.
    """

    file: str
    line: int
    column: str
    value: str
    expected: str

    def __str__(self) -> str:
        return f"{self.file}, line {self.line}, column {self.column}: {self.value!r}, expected {self.expected}"


def is_reading(name: str) -> bool:
    """Return whether a column holds readings, the first echo or a further one."""
    return name == "reading_mm" or ECHO_COLUMN.fullmatch(name) is not None


def _expectation(name: str) -> str:
    low, high = LIMITS.get("reading_mm" if is_reading(name) else name, (-np.inf, np.inf))
    span = "a finite number" if np.isinf(low) else f"a number from {low:.7g} to {high:.7g}"
    return f"{span}, 0 for no echo, or nothing for no answer" if is_reading(name) else span


def _invalid(name: str, number: pd.Series, empty: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the mask of invalid values of a known column; `number` is NaN where a field is empty or no number."""
    low, high = LIMITS.get("reading_mm" if is_reading(name) else name, (-np.inf, np.inf))
    value = number.to_numpy()
    bad = ~np.isfinite(value) | (value < low) | (value > high)
    return bad & ~empty if is_reading(name) else bad


def _numbers(column: pd.Series) -> pd.Series:
    if pd.api.types.is_numeric_dtype(column):
        return column.astype(np.float64)
    return pd.to_numeric(column.replace("", None), errors="coerce").astype(np.float64)


def _empty(column: pd.Series) -> NDArray[np.bool_]:
    return (column.isna() if pd.api.types.is_numeric_dtype(column) else column == "").to_numpy()


def check_header(name: str, columns: Sequence[str]) -> None:
    """Raise RecordingError unless a header has the required columns, and each column once."""
    check_twins(name, columns)
    missing = [column for column in REQUIRED if column not in columns]
    if missing:
        raise RecordingError(
            f"{name}, line 1: column {missing[0]} is missing, expected {', '.join(REQUIRED)}; "
            f"found {', '.join(columns)}. `sonar-gym import` maps other names and units"
        )


def read_columns(
    data: bytes, name: str, first_line: int = 2, text: Collection[str] | None = None
) -> tuple[pd.DataFrame, list[RowFault]]:
    """Return the columns of CSV text and the faults of its values.

    Numbers are parsed at once. Where a value is not valid or its field is needed as it stands, all fields are read as
    text first, which takes several times as long and gives the same table.

    Args:
        data: CSV text in UTF-8.
        name: of the file, for messages.
        first_line: number of the line of the first row.
        text: columns without a meaning of their own that are text; by default, those that hold anything but numbers.
    """
    numbers = parse_numbers(data, name, (*TEXT, *(text or ())), MAX_COVARIATE)
    if numbers is not None:
        table, faults = convert(name, numbers, first_line, text)
        if not faults:
            return table, faults
    return convert(name, parse_table(data, name), first_line, text)


def convert(
    file: str, fields: pd.DataFrame, first_line: int = 2, text: Collection[str] | None = None
) -> tuple[pd.DataFrame, list[RowFault]]:
    """Convert fields, text or numbers, to the columns of a recording; see `read_columns`.

    The row with index k is line k + `first_line`.

    Raises:
        RecordingError: a required column is missing.
    """
    check_header(file, list(fields.columns))
    lines = fields.index + first_line
    faults, short = _short_rows(file, fields, lines)
    fields = fields.mask(fields == MISSING, "") if faults else fields
    columns: dict[str, pd.Series] = {}
    for name in fields.columns:
        if name in TEXT:
            columns[name] = _as_text(fields[name])
            continue
        number, empty = _numbers(fields[name]), _empty(fields[name])
        if name in CONDITION or is_reading(name):
            bad = _invalid(name, number, empty) & ~short
            faults += _listed(file, name, lines[bad], fields[name][bad], _expectation(name))
            columns[name] = number
        else:
            is_text = _is_text(number, empty) if text is None else name in text
            columns[name] = _as_text(fields[name]) if is_text else number
    return pd.DataFrame(columns), sorted(faults, key=lambda fault: fault.line)


def _short_rows(file: str, fields: pd.DataFrame, lines: pd.Index) -> tuple[list[RowFault], NDArray[np.bool_]]:
    """Return a fault for the first field that each row lacks, and the mask of these rows."""
    faults, short = list[RowFault](), np.zeros(len(fields), dtype=np.bool_)
    for name in (name for name in fields.columns if not pd.api.types.is_numeric_dtype(fields[name])):
        missing = (fields[name] == MISSING).to_numpy() & ~short
        faults += _listed(file, name, lines[missing], repeat(""), "a field; the row ends before it")
        short |= missing
    return faults, short


def _listed(file: str, name: str, lines: pd.Index, values: Iterable[object], expected: str) -> list[RowFault]:
    """Return a fault for each value, or raise RecordingError where they are too many."""
    listed = zip(lines[: MAX_FAULTS + 1], values, strict=False)
    faults = [RowFault(file, int(line), name, str(value), expected) for line, value in listed]
    if len(faults) > MAX_FAULTS:
        raise RecordingError(f"{faults[0]} (and {len(lines) - 1:,} more, too many to omit)")
    return faults


def _is_text(number: pd.Series, empty: NDArray[np.bool_]) -> bool:
    """Return whether a column holds anything but numbers, or nothing."""
    return bool(empty.all()) or not bool((number[~empty].abs() <= MAX_COVARIATE).all())


def _as_text(column: pd.Series) -> pd.Series:
    if not pd.api.types.is_numeric_dtype(column):
        return column
    return column.map(lambda x: "" if pd.isna(x) else f"{x:{DIGITS}}").astype(str)


def valid_rows(
    table: pd.DataFrame, faults: Sequence[RowFault], skip_bad_rows: bool, first_line: int = 2
) -> pd.DataFrame:
    """Return the rows without a fault.

    Args:
        table: of all rows.
        faults: of its values.
        skip_bad_rows: omit faulty rows; otherwise there must be none.
        first_line: number of the line of the first row.

    Raises:
        RecordingError: there are faults and they are not to be omitted; the message describes the first.
    """
    if faults and not skip_bad_rows:
        more = f" (and {len(faults) - 1} more)" if len(faults) > 1 else ""
        raise RecordingError(f"{faults[0]}{more}")
    return table.drop(index=sorted({fault.line - first_line for fault in faults})).reset_index(drop=True)
