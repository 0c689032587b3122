"""Import of logs of other programs (CSV, TOA5, serial monitor): a map from their columns to those of a recording.

A mapping is written `name=source:unit`, for example `distance_mm=true_cm:cm`; a constant column `name=value`. Numeric
columns without a mapping become covariates under their own names. `time_s` is shifted to start at 0.
"""

from __future__ import annotations

import csv
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd

from acquisition.arguments import checked
from acquisition.errors import RecordingError, SettingError
from acquisition.io.columns import DIGITS, TEXT, is_reading
from acquisition.io.logs.serial_log import is_serial_log, read_serial_log
from acquisition.io.recording import Recording
from acquisition.io.tables import COMMAS, Dialect, parse_table, read_bytes
from acquisition.limits import near

MICROSECONDS_PER_CM = 58.0  # round trip; the constant in the data sheets of the HC-SR04 family
ANY: Mapping[str, float] = {"": 1.0, "text": 1.0}
LENGTHS = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "in": 25.4, "us": 10.0 / MICROSECONDS_PER_CM}  # us: time of flight
TIMES = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "min": 60.0, "h": 3600.0, "date": 1.0}  # date: ISO 8601
# end of the name of a recording's column -> units of the log, with their factors to the unit in that name
QUANTITIES: Mapping[str, Mapping[str, float]] = {
    "_mm": {**ANY, **LENGTHS},
    "_deg": {**ANY, "deg": 1.0, "rad": 180.0 / np.pi},
    "_s": {**ANY, **TIMES},
}
UNITS: Mapping[str, float] = {**TIMES, **QUANTITIES["_deg"], "pct": 1.0, **QUANTITIES["_mm"]}  # of any other column
BEGINNING = 4096  # bytes
TOA5 = (b'"TOA5"', b"TOA5,")  # how such a file begins
TOA5_UNITS = {"ts": "date", "meters": "m", "meter": "m", "millimeters": "mm", "degrees": "deg", "%": "pct"}


@dataclass(frozen=True)
class ColumnMap:
    """One column of a recording, computed from one column of the log.

    Attributes:
        name: column of the recording.
        source: column of the log.
        unit: unit of the log's column, a key of `units_of`; "" for that which a TOA5 file states, or none.
    """

    name: str
    source: str
    unit: str

    def __post_init__(self) -> None:
        """Raise SettingError for a unit that is unknown or of another quantity than the column."""
        if self.unit not in units_of(self.name):
            known = ", ".join(filter(None, units_of(self.name)))
            raise SettingError(f"column map {str(self)!r}: expected a unit of {self.name} ({known}), got {self.unit!r}")

    def __str__(self) -> str:
        return f"{self.name}={self.source}{self.unit and f':{self.unit}'}"

    @classmethod
    def parse(cls, text: str) -> ColumnMap:
        """Parse `name=source` or `name=source:unit`.

        Raises:
            SettingError: no `=`, or a unit that the column cannot have.
        """
        name, equals, right = text.partition("=")
        source, colon, unit = right.rpartition(":")
        source, unit = (source, unit) if colon else (right, "")
        if not (equals and name and source):
            raise SettingError(f"column map {text!r}: expected name=source or name=source:unit")
        return cls(name.strip(), source.strip(), unit)


def units_of(name: str) -> Mapping[str, float]:
    """Return the units that a column of a recording can have in a log, with their factors to that in its name."""
    return UNITS if name in TEXT else next((u for end, u in QUANTITIES.items() if name.endswith(end)), UNITS)


def parse_constants(texts: Sequence[str]) -> dict[str, float | str]:
    """Parse `name=value` settings; the values of text columns remain text.

    Raises:
        SettingError: no `=`, a name is given twice, or the value of a numeric column is not a number.
    """
    out: dict[str, float | str] = {}
    check_once(text.partition("=")[0] for text in texts)
    for text in texts:
        name, equals, value = text.partition("=")
        if not equals:
            raise SettingError(f"constant {text!r}: expected name=value")
        try:
            out[name] = value if name in TEXT else float(value)
        except ValueError:
            raise SettingError(f"constant {text!r}: expected a number after =") from None
    return out


def check_once(names: Iterable[str]) -> None:
    """Raise SettingError where a column of a recording is given twice."""
    name, count = max(Counter(names).items(), key=lambda item: item[1], default=("", 0))
    if count > 1:
        raise SettingError(f"column {name}: is given {count} times; give it once")


@checked
def import_table(
    path: str | Path,
    columns: Sequence[ColumnMap],
    constants: Mapping[str, float | str],
    no_echo: float | None = None,
    skip_bad_rows: bool = False,
    dialect: Dialect = COMMAS,
) -> Recording:
    """Read a log of another program, CSV, TOA5 or of a serial monitor, as a recording.

    Args:
        path: of the file.
        columns: the map; `distance_mm`, `angle_deg` and `reading_mm` must come from it or from `constants`.
        constants: columns with one value in all rows.
        no_echo: value, in the log's unit, that means no echo in addition to 0.
        skip_bad_rows: omit faulty rows (listed in `rejected`) instead of rejecting the file.
        dialect: delimiter and decimal point of the file.

    Raises:
        RecordingNotFoundError: the file does not exist.
        RecordingError: a mapped column is missing, or a value violates the format; the message names the place.
        SettingError: a column of the recording is given twice.
    """
    path = Path(path)
    check_once([*(m.name for m in columns), *constants])
    log, units, origin = read_log(path, dialect)
    columns = [replace(m, unit=m.unit or units.get(m.source, "")) for m in columns]
    for mapping in columns:
        if mapping.source not in log.columns:
            found = ", ".join(log.columns)
            hint = near(mapping.source, log.columns)
            raise RecordingError(f"{path}, line 1: column {mapping.source!r} is missing, found {found}{hint}")
    named = [c for c in map(str, log.columns) if not c.startswith("Unnamed: ")]  # pandas' name for an empty header
    used = {m.source for m in columns} | {m.name for m in columns} | set(constants)
    others = [ColumnMap(c, c, "" if is_reading(c) else "text") for c in named if c not in used]
    mapped, rest = ({m.name: _column(log[m.source], m, no_echo) for m in maps} for maps in (columns, others))
    table = pd.DataFrame({**mapped, **constants, **rest}, log.index)
    return Recording.from_text(table.astype(str), origin, skip_bad_rows)


def read_log(path: Path, dialect: Dialect = COMMAS) -> tuple[pd.DataFrame, dict[str, str], str]:
    """Return the fields of a log as text, the units that it states, and its name in messages.

    Args:
        path: of a table of separated values, a TOA5 file or a log of a serial monitor.
        dialect: delimiter and decimal point of a table.

    Raises:
        RecordingNotFoundError: the file does not exist.
        RecordingError: it is none of them.
    """
    data = read_bytes(path)
    if data.startswith(TOA5):
        return *read_toa5(data, str(path)), f"{path} (line 1: its names)"
    if is_serial_log(beginning(data)):
        try:
            log = read_serial_log(data.decode("utf-8", "replace"))
        except RecordingError as error:
            raise RecordingError(f"{path}: {error}") from None
        return log.table, {}, f"{path} (its lines of numbers, from 2; {log.omitted} others)"
    return parse_table(data, str(path), dialect, number_twins=True), {}, str(path)


def beginning(data: bytes) -> str:
    """Return the first lines of a file as text, as far as it is text; by them a format is known."""
    return data[:BEGINNING].decode("utf-8-sig", "ignore").rpartition("\n")[0] or data[:BEGINNING].decode(
        "utf-8", "ignore"
    )


def read_toa5(data: bytes, name: str) -> tuple[pd.DataFrame, dict[str, str]]:
    """Return the fields of a TOA5 file as text, and the units of those whose unit is one of `UNITS`.

    TOA5 is the table of text that loggers of Campbell Scientific write: four lines with the station, the names of the
    fields, their units and how they were processed, then one line per record (LoggerNet manual, appendix B). NAN, the
    logger's word for a missing value, becomes an empty field.

    Args:
        data: content of the file.
        name: of the file, for messages.

    Raises:
        RecordingError: the header is incomplete, or the rows do not fit it.
    """
    lines = data.splitlines(keepends=True)
    rows = list(csv.reader(line.decode("utf-8", "replace") for line in lines[1:4]))
    if len(rows) < 3 or len(rows[1]) != len(rows[0]) or len(rows[2]) != len(rows[0]):
        raise RecordingError(f"{name}: TOA5 without its lines of names, units and processing; export it again")
    log = parse_table(b"".join([lines[1], *lines[4:]]), name, number_twins=True)
    units = {field: TOA5_UNITS.get(unit.lower(), unit) for field, unit in zip(log.columns, rows[1], strict=True)}
    log = log.mask(log.apply(lambda column: column.str.upper()) == "NAN", "")
    return log, {field: unit for field, unit in units.items() if unit in UNITS}


def _column(text: pd.Series, mapping: ColumnMap, no_echo: float | None) -> pd.Series:
    """Convert the numbers of a column; other text remains, so that an error message can quote it."""
    if mapping.unit == "text" or mapping.name in TEXT:
        return text
    number = _seconds(text) if mapping.unit == "date" else pd.to_numeric(text.replace("", None), errors="coerce")
    value = number.astype(np.float64) * units_of(mapping.name)[mapping.unit]
    if mapping.name == "time_s":
        value -= value.dropna().iloc[0] if number.notna().any() else 0.0
    if no_echo is not None and is_reading(mapping.name):
        value = value.mask(number == no_echo, 0.0)
    return value.map(lambda x: f"{x:{DIGITS}}").where(number.notna(), text)


def _seconds(text: pd.Series) -> pd.Series:
    """Return dates as seconds since 1970, UTC without a time zone; NaN for invalid dates."""
    known = text.where(text.str.match(r"\s*(1[7-9]|2[01])\d\d"), "")  # years that pandas counts in nanoseconds
    moment = pd.to_datetime(known, errors="coerce", format="ISO8601", utc=True)
    return (moment - pd.Timestamp(0, tz="UTC")).dt.total_seconds()
