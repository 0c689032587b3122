"""Guesses what the columns of a log are, by their names and units; a guess is for a person to look at, not to use."""

from __future__ import annotations

import csv
import re
from collections.abc import Mapping, Sequence

import pandas as pd

from acquisition.io.logs.foreign import ColumnMap, units_of
from acquisition.io.tables import Dialect

# column of a recording -> words in the name of a log's column, the most specific first
WORDS: Mapping[str, tuple[str, ...]] = {
    "distance_mm": ("true", "truth", "actual", "reference", "ground", "expected", "laser", "nominal", "position"),
    "reading_mm": (
        "reading",
        "measured",
        "echo",
        "sonar",
        "ultrasonic",
        "ping",
        "range",
        "duration",
        "distance",
        "dist",
    ),
    "angle_deg": ("angle", "bearing", "azimuth"),
    "time_s": ("timestamp", "datetime", "time", "date", "milli"),
    "session": ("session", "run", "trial", "file"),
    "sensor": ("sensor", "device"),
}
UNIT_WORDS: Mapping[str, str] = {
    "millimeter": "mm",
    "centimeter": "cm",
    "meter": "m",
    "inch": "in",
    "inche": "in",
    "degree": "deg",
    "radian": "rad",
    "second": "s",
    "microsecond": "us",
    "millisecond": "ms",
    "µs": "us",
    "duration": "us",
    "milli": "ms",
}
DELIMITERS = ",;\t|"


def guess_dialect(text: str) -> Dialect:
    r"""Return the delimiter and the decimal point of a table, by its first lines.

    >>> guess_dialect("t;r\n0,5;1,2\n")
    Dialect(delimiter=';', decimal=',')
    """
    try:
        delimiter = csv.Sniffer().sniff(text, DELIMITERS).delimiter
    except csv.Error:
        delimiter = ","
    comma = delimiter != "," and re.search(r"\d,\d", text) is not None and re.search(r"\d\.\d", text) is None
    return Dialect(delimiter, "," if comma else ".")


def guess_columns(log: pd.DataFrame) -> list[ColumnMap]:
    """Return the columns of a recording that a log seems to have, each from one of its columns at most.

    Args:
        log: fields as text, or numbers.
    """
    free = [str(name) for name in log.columns]
    found = []
    for name in WORDS:
        source = _best(name, free)
        if source is not None:
            free.remove(source)
            found.append(ColumnMap(name, source, _unit(name, source, log[source])))
    return found


def _words(text: str) -> list[str]:
    """Return the words of a column's name, in lower case, without plural.

    >>> _words("trueDistance [cm]")
    ['true', 'distance', 'cm']
    """
    split = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", text)
    return [re.sub(r"(?<=\w{4})s$", "", word) for word in re.findall(r"[a-zµ]+", split.lower())]


def _best(name: str, free: Sequence[str]) -> str | None:
    """Return the column whose name is the recording's own, or has the earliest of its words."""
    if name in free:
        return name
    for word in WORDS[name]:
        match = next((source for source in free if word in _words(source)), None)
        if match is not None:
            return match
    return None


def _unit(name: str, source: str, column: pd.Series) -> str:
    """Return the unit in a column's name, or that of its values: dates, or the unit of the recording."""
    if name in ("session", "sensor"):
        return "text"
    if name == "time_s" and pd.to_numeric(column.replace("", None), errors="coerce").isna().all():
        return "date"
    named = [UNIT_WORDS.get(word, word) for word in _words(source)]
    return next((unit for unit in reversed(named) if unit in units_of(name)), "")
