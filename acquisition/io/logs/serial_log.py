"""Logs of the serial monitor of Arduino sketches: lines of text with a number or named numbers.

| line | columns |
|---|---|
| `12:34:56.789 -> Distance: 45.6 cm` | `time` (of day, s), `Distance_cm` |
| `Ping: 12cm` | `Ping_cm` |
| `12in, 30cm` | `value_1_in`, `value_2_cm` |
| `left:120,right:98` (serial plotter) | `left`, `right` |
| `Out of range` | all columns but `time` are 0, no echo |

Lines that are none of these (what a sketch prints as it starts) are counted and omitted.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import pandas as pd

from acquisition.errors import RecordingError
from acquisition.io.tables import MAX_COLUMNS

STAMP = re.compile(r"^(\d{1,2}):(\d{2}):(\d{2}(?:\.\d+)?)\s*->\s*")
NUMBER = r"[-+]?\d+(?:\.\d+)?"
ITEM = re.compile(
    rf"\s*(?:([A-Za-z]\w*(?: \w+)*)\s*[:=]\s*)?({NUMBER})\s*(mm|cm|in|us|ms|m|s|inches|µs)?\s*(?:[,;\t]|$|\s(?=\S))"
)
OUT_OF_RANGE = re.compile(r"out of range|no echo|timeout|time out|no ping", re.IGNORECASE)
ALIASES = {"inches": "in", "µs": "us"}
DAY = 86_400.0


@dataclass(frozen=True)
class SerialLog:
    """Lines of a log as a table.

    Attributes:
        table: fields as text, one row per line with numbers; empty where a line has no such number.
        omitted: number of the lines that are none.
    """

    table: pd.DataFrame
    omitted: int


def is_serial_log(text: str) -> bool:
    r"""Return whether half of the lines of the beginning of a file are lines of a serial monitor.

    >>> is_serial_log("Ping: 12cm\nPing: 13cm\n"), is_serial_log("a,b\n1,2\n3,4\n")
    (True, False)
    """
    lines = [line for line in text.splitlines() if line.strip()]
    named = sum(bool(STAMP.match(line)) or _named(line) for line in lines)
    silent = sum(OUT_OF_RANGE.search(line) is not None for line in lines)
    return named > 0 and 2 * (named + silent) >= len(lines)


def _named(line: str) -> bool:
    """Return whether a line consists of numbers, at least one of them with a name or a unit."""
    items = _items(line)
    return items is not None and any(name or unit for name, _, unit in items)


def read_serial_log(text: str) -> SerialLog:
    """Return the numbers of the lines of a serial monitor.

    Args:
        text: of the log.

    Raises:
        RecordingError: the lines have more than 1,000 names.
    """
    rows, omitted, day, last = list[dict[str, str]](), 0, 0.0, 0.0
    for line in filter(str.strip, text.splitlines()):
        row = dict[str, str]()
        stamp = STAMP.match(line)
        if stamp:
            hour, minute, second = map(float, stamp.groups())
            time = 3600.0 * hour + 60.0 * minute + second
            day, last = day + DAY * (time < last - DAY / 2), time  # over midnight
            row["time"] = f"{day + time:.10g}"
        rest = line[stamp.end() :] if stamp else line
        items = _items(rest)
        if items is None and not OUT_OF_RANGE.search(rest):
            omitted += 1
            continue
        rows.append(row | (_named_fields(items) if items else {}))
    return SerialLog(_table(rows), omitted)


def _items(line: str) -> list[tuple[str, str, str]] | None:
    """Return name, number and unit of each item of a line; None where it holds anything else or only says no echo."""
    found, at, end = list[tuple[str, str, str]](), 0, len(line.rstrip())
    while at < end:
        item = ITEM.match(line, at)
        if item is None or item.end() == at or len(found) == MAX_COLUMNS:
            return None
        name, number, unit = (part or "" for part in item.groups())
        found.append((name, number, ALIASES.get(unit, unit)))
        at = item.end()
    return None if all(OUT_OF_RANGE.search(name) for name, _, _ in found) else found


def _named_fields(items: Sequence[tuple[str, str, str]]) -> dict[str, str]:
    several = sum(not name for name, _, _ in items) > 1
    fields = dict[str, str]()
    for k, (name, number, unit) in enumerate(items, 1):
        label = name.replace(" ", "_") or (f"value_{k}" if several else "value")
        fields[f"{label}_{unit}" if unit else label] = number
    return fields


def _table(rows: Sequence[dict[str, str]]) -> pd.DataFrame:
    """Return one row per line; a line without a number is no echo, 0 in the columns of most lines."""
    names = {name for row in rows for name in row}
    if len(names) > MAX_COLUMNS:
        raise RecordingError(f"its lines name {len(names)} numbers, expected at most {MAX_COLUMNS}; keep those needed")
    usual = Counter(own for row in rows if (own := tuple(name for name in row if name != "time")))
    silent = dict.fromkeys(usual.most_common(1)[0][0] if usual else (), "0")
    return pd.DataFrame([row if set(row) - {"time"} else row | silent for row in rows], dtype=str).fillna("")
