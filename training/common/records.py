"""Records of experiments: what a figure is drawn from, beside it, with the command and the commit that made it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from acquisition.io.files import write_text

DIGITS = 5  # of each number


def write_record(figure: Path, made_by: str, command: str, content: Any) -> Any:
    """Write the record of a figure; return it as it will be read.

    Args:
        figure: path of the picture.
        made_by: the commit.
        command: as it was given.
        content: lists, dictionaries, arrays and numbers.
    """
    rounded = json.loads(
        json.dumps(content, default=lambda array: array.tolist()),
        parse_float=lambda text: float(f"{float(text):.{DIGITS}g}"),
    )
    record = {"command": command, "commit": made_by, "content": rounded}
    write_text(record_of(figure), json.dumps(record, separators=(",", ":")) + "\n")
    return rounded


def read_record(figure: Path) -> Any:
    """Return what a figure is drawn from."""
    return json.loads(record_of(figure).read_text(encoding="utf-8"))["content"]


def record_of(figure: Path) -> Path:
    """Return the path of a figure's record."""
    return figure.with_suffix(".json")
