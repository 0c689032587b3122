"""Logs of other programs as recordings: a map from their columns and units to ours.

A mapping is written `ours=theirs:unit`, for example `distance_mm=true_cm:cm`; a fixed value `ours=number`. Every
numeric column that is not mapped is kept as a covariate under its own name. `time_s` is made to count from the first
row, whatever their clock began with.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from acquisition.errors import RecordingError, RecordingNotFoundError, SettingError
from acquisition.io.recording import ECHO_COLUMN, TEXT, Recording

MICROSECONDS_PER_CM = 58.0  # there and back; the constant of the HC-SR04 family's data sheets
UNITS: Mapping[str, float] = {  # factor to the unit that our column's name states
    "": 1.0,
    "mm": 1.0,
    "cm": 10.0,
    "m": 1000.0,
    "in": 25.4,
    "us": 10.0 / MICROSECONDS_PER_CM,
    "deg": 1.0,
    "rad": 180.0 / np.pi,
    "s": 1.0,
    "ms": 1e-3,
    "min": 60.0,
    "h": 3600.0,
    "date": 1.0,  # a date and time of day, ISO 8601, becomes seconds
    "pct": 1.0,
    "text": 1.0,
}


@dataclass(frozen=True)
class ColumnMap:
    """One column of ours: taken from a column of theirs, times a factor."""

    ours: str
    theirs: str
    unit: str

    @classmethod
    def parse(cls, text: str) -> ColumnMap:
        """Read `ours=theirs` or `ours=theirs:unit`.

        Raises:
            SettingError: no `=`, or an unknown unit.
        """
        ours, equals, rest = text.partition("=")
        theirs, colon, unit = rest.rpartition(":")
        theirs, unit = (theirs, unit) if colon else (rest, "")
        if not (equals and ours and theirs):
            raise SettingError(f"column map {text!r}: expected ours=theirs or ours=theirs:unit")
        if unit not in UNITS:
            known = ", ".join(filter(None, UNITS))
            raise SettingError(f"column map {text!r}: unknown unit {unit!r}, expected one of {known}")
        return cls(ours.strip(), theirs.strip(), unit)


def parse_constants(texts: Sequence[str]) -> dict[str, float | str]:
    """Read `ours=value` settings; text columns keep text.

    Raises:
        SettingError: no `=`, or a value that is no number where one is needed.
    """
    out: dict[str, float | str] = {}
    for text in texts:
        name, equals, value = text.partition("=")
        if not equals:
            raise SettingError(f"constant {text!r}: expected ours=value")
        try:
            out[name] = value if name in TEXT else float(value)
        except ValueError:
            raise SettingError(f"constant {text!r}: expected a number after =") from None
    return out


def import_table(
    path: str | Path,
    columns: Sequence[ColumnMap],
    constants: Mapping[str, float | str],
    no_echo: float | None = None,
    skip_bad_rows: bool = False,
) -> Recording:
    """Read a foreign CSV as a recording.

    Args:
        path: of the CSV.
        columns: the map; `distance_mm`, `angle_deg`, `reading_mm` must come from it or from `constants`.
        constants: fixed columns.
        no_echo: value (in their unit) by which the other program says that there was no echo; 0 always does.
        skip_bad_rows: leave faulty rows out (listed in `rejected`) rather than refuse the file.

    Raises:
        RecordingNotFoundError: no such file.
        RecordingError: a mapped column is missing, or a value breaks the format: file, line, column, value, expected.
    """
    path = Path(path)
    if not path.is_file():
        raise RecordingNotFoundError(f"{path}: no such file; give the path of a CSV file")
    try:
        theirs = pd.read_csv(path, dtype=str, keep_default_na=False, skipinitialspace=True, encoding="utf-8-sig")
    except (pd.errors.EmptyDataError, pd.errors.ParserError, UnicodeDecodeError) as error:
        raise RecordingError(f"{path}: not a table of comma-separated values: {str(error).strip()}") from None
    for mapping in columns:
        if mapping.theirs not in theirs.columns:
            found = ", ".join(theirs.columns)
            raise RecordingError(f"{path}, line 1: column {mapping.theirs!r} is missing, found {found}")
    ours = pd.DataFrame({m.ours: _column(theirs[m.theirs], m, no_echo) for m in columns})
    ours = ours.assign(**constants)
    rest = [c for c in map(str, theirs.columns) if not c.startswith("Unnamed: ")]  # pandas' word for no name
    used = {m.theirs for m in columns} | set(ours.columns)
    for column in (c for c in rest if c not in used):
        ours[column] = theirs[column]
    return Recording.from_text(ours.astype(str), str(path), skip_bad_rows)


def _column(text: pd.Series, mapping: ColumnMap, no_echo: float | None) -> pd.Series:
    """Convert what is a number and leave the rest as written, so that a fault is shown as it stands in the file."""
    if mapping.unit == "text" or mapping.ours in TEXT:
        return text
    number = _seconds(text) if mapping.unit == "date" else pd.to_numeric(text.replace("", None), errors="coerce")
    value = number.astype(np.float64) * UNITS[mapping.unit]
    if mapping.ours == "time_s":
        value -= value.dropna().iloc[0] if number.notna().any() else 0.0
    if no_echo is not None and (mapping.ours == "reading_mm" or ECHO_COLUMN.fullmatch(mapping.ours)):
        value = value.mask(number == no_echo, 0.0)
    return value.map(lambda x: f"{x:.10g}").where(number.notna(), text)


def _seconds(text: pd.Series) -> pd.Series:
    """Return dates as seconds since 1970, UTC where they do not say otherwise; NaN for what is no date."""
    moment = pd.to_datetime(text, errors="coerce", format="ISO8601", utc=True)
    return (moment - pd.Timestamp(0, tz="UTC")).dt.total_seconds()
