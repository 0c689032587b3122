"""Turn the log of another program into a recording, units stated."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from acquisition import EchoStatus
from acquisition.foreign import ColumnMap, import_table, parse_constants


@dataclass(frozen=True)
class Args:
    """Settings of `sonar-gym import`.

    Example:
        sonar-gym import log.csv --out rec.csv
        --columns distance_mm=true_cm:cm reading_mm=measured_cm:cm session=file --constants angle_deg=0
    """

    source: Annotated[Path, tyro.conf.Positional]
    """CSV file of the other program."""
    out: Path
    """Recording to write."""
    columns: tuple[str, ...]
    """Which of their columns become ours: ours=theirs:unit, units mm cm m in us deg rad s ms text."""
    constants: tuple[str, ...] = ()
    """Columns that are the same in every row: ours=value, for example angle_deg=0."""
    no_echo: float | None = None
    """Value (in their unit) that means no echo, besides 0; for example 400 for a sensor that reads full scale."""
    skip_bad_rows: bool = False
    """Leave faulty rows out, and say which, rather than refuse the file."""


def main(args: Args) -> None:
    """Import one file and say what came in."""
    columns = [ColumnMap.parse(text) for text in args.columns]
    constants = parse_constants(args.constants)
    recording = import_table(args.source, columns, constants, args.no_echo, args.skip_bad_rows)
    recording.save(args.out)
    status, cells, runs = recording.reading.status, recording.cell.max() + 1, recording.run.max() + 1
    print(
        f"{args.out}: {len(recording)} pings in {cells} conditions and {runs} runs; "
        f"{(status == EchoStatus.NO_ECHO).sum()} without echo, {(status == EchoStatus.NO_ANSWER).sum()} without answer"
    )
    for fault in recording.rejected:
        print(f"left out: {fault}")
