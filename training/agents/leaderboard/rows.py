"""Rows of the leaderboard: one file per driver, with the result on every street and checksums of what it rests on.

A checksum finds changes and rows of other streets; it proves nobody's identity. Rates are computed from the results on
single streets when the table is made, so that a row cannot claim a rate that it does not hold.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

from annotated_types import Len
from pydantic import StringConstraints

from acquisition import ModelError, SettingError
from acquisition.io.files import write_text
from acquisition.io.schema import Schema, read_json
from training.agents.evaluate import Outcomes, Rate
from training.agents.leaderboard.tracks import TRACKS, board_checksum, digits
from training.common.checksum import canonical, sha256
from training.common.tables import markdown_table

Hash = Annotated[str, StringConstraints(pattern="^[0-9a-f]{64}$")]
Bits = Annotated[str, StringConstraints(pattern="^[01]+$")]
CHECKSUM = "checksum"
Row = dict[str, Any]


class _Result(Schema):
    parked: Bits
    collided: Bits
    steps: Annotated[list[int], Len(1)]


class _Row(Schema):
    name: str
    driver: str
    algorithm: str
    driver_sha256: Hash
    board_sha256: Hash
    commit: str
    results: dict[str, _Result]
    checksum: Hash


def row_of(about: Mapping[str, str], outcomes: Mapping[str, Outcomes]) -> Row:
    """Return a row with its checksum.

    Args:
        about: name, driver, algorithm, driver_sha256, commit.
        outcomes: result on each track.
    """
    results = {
        name: {"parked": digits(one.success), "collided": digits(one.collision), "steps": one.steps.tolist()}
        for name, one in outcomes.items()
    }
    row = {**about, "board_sha256": board_checksum(), "results": results}
    return {**row, CHECKSUM: sha256(canonical(row))}


def row_path(folder: Path, name: str) -> Path:
    """Return the file of a row in a folder, by its name."""
    return folder / f"{name.replace(' ', '-')}.json"


def check_free(folder: Path, name: str, driver_sha256: str) -> None:
    """Raise SettingError where a folder has a row of that name of another driver."""
    path = row_path(folder, name)
    if path.exists() and read_json(path, _Row)["driver_sha256"] != driver_sha256:
        raise SettingError(f"{path}: is the row of another driver, or of this one before a change; give --name")


def write_row(folder: Path, row: Row) -> Path:
    """Write a row into a folder, under its name."""
    return write_text(row_path(folder, row["name"]), json.dumps(row, indent=1) + "\n")


def read_row(path: Path, board: str) -> Row:
    """Return a row.

    Args:
        path: of the file.
        board: checksum of today's tracks.

    Raises:
        ModelError: the file is no row, it was changed, or it was scored on other streets or settings.
    """
    row = read_json(path, _Row)
    if row[CHECKSUM] != sha256(canonical({name: value for name, value in row.items() if name != CHECKSUM})):
        raise ModelError(f"{path}: was changed after it was written: score the driver again")
    counts = {name: {len(value) for value in one.values()} for name, one in row["results"].items()}
    expected = {name: {track.streets} for name, track in TRACKS.items()}
    if row["board_sha256"] != board or counts != expected:
        raise ModelError(f"{path}: was scored on other streets or settings than today's: score the driver again")
    return row


def read_rows(folder: Path) -> list[Row]:
    """Return all rows of a folder, the best on the first track first."""
    board = board_checksum()
    rows = [read_row(path, board) for path in sorted(folder.glob("*.json"))]
    return sorted(rows, key=lambda row: -rate(row, next(iter(TRACKS)), "parked").share)


def rate(row: Row, track: str, event: str) -> Rate:
    """Return the rate of "parked" or "collided" on a track."""
    bits = row["results"][track][event]
    return Rate(bits.count("1"), len(bits))


def table(rows: list[Row]) -> str:
    """Return the leaderboard in Markdown."""
    header = ["driver", "commit", *(f"{name}: {event}" for name in TRACKS for event in ("parked", "collided"))]
    return markdown_table(header, map(_cells, rows))


def _cells(row: Row) -> list[object]:
    rates = [rate(row, name, event) for name in TRACKS for event in ("parked", "collided")]
    return [row["name"], row["commit"], *rates]
