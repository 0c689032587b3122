"""Conversion of a log of another program, or of a ROS bag, into a recording."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from acquisition import EchoStatus, Recording, SettingError
from acquisition.io.bags import GroundTruthSource, import_bag, is_bag
from acquisition.io.foreign import ColumnMap, import_table, parse_constants
from acquisition.io.places import OutputFile
from acquisition.io.tables import Dialect
from acquisition.limits import Finite, Limit
from training.common.progress import bar


@dataclass(frozen=True)
class Args:
    """Settings of `sonar-gym import`.

    Example:
        sonar-gym import log.csv --out rec.csv
        --columns distance_mm=true_cm:cm reading_mm=measured_cm:cm session=file --constants angle_deg=0
    """

    source: Annotated[Path, tyro.conf.Positional]
    """CSV file, or ROS bag (.bag, .mcap, .db3, ROS 2 folder) with sensor_msgs/Range."""
    out: OutputFile
    """Recording to write."""
    columns: tuple[str, ...] = ()
    """CSV: columns of the recording as name=source:unit, with units mm cm m in us deg rad s ms min h date text;
    us is the time of flight, 58 us per cm; date is ISO 8601; time_s is shifted to begin at 0."""
    constants: tuple[str, ...] = ()
    """Columns with one value in every row: name=value, for example angle_deg=0."""
    no_echo: Finite | None = None
    """CSV: value in the source's unit that means no echo, besides 0; for example 400 for full scale."""
    delimiter: str = ","
    """CSV: character between two columns, for example ; or tab."""
    decimal: Literal[".", ","] = "."
    """CSV: decimal point or comma of the numbers."""
    skip_bad_rows: bool = False
    """CSV: omit and list invalid rows instead of rejecting the file."""
    topics: tuple[str, ...] = ()
    """Bag: topics of the sonars. Default: all sensor_msgs/Range topics except infrared."""
    truth_topic: str = ""
    """Bag: topic with the true distance: sensor_msgs/Range of a laser, or a position (see truth_point)."""
    truth_point: tuple[Finite, Finite, Finite] | None = None
    """Bag: position of the reflector, m, in the frame of truth_topic."""
    truth_csv: Path | None = None
    """Bag: CSV with time_s (since the first ping) or stamp_s (the bag's clock), distance_m, and angle_deg if known."""
    longest_gap_s: Annotated[float, Limit(0.0, 86_400.0, "s", open_low=True)] = 0.5
    """Bag: true distances further apart than this are not interpolated; pings between them are omitted."""


def main(args: Args) -> None:
    """Import one file and print a summary."""
    recording, notes = (_bag if is_bag(args.source) else _table)(args)
    recording.save(args.out)
    status, conditions, runs = recording.reading.status, recording.condition.max() + 1, recording.run.max() + 1
    print(
        f"{args.out}: {len(recording)} pings in {conditions} conditions and {runs} runs; "
        f"{(status == EchoStatus.NO_ECHO).sum()} without echo, {(status == EchoStatus.NO_ANSWER).sum()} without answer"
    )
    for note in notes:
        print(note)


def _table(args: Args) -> tuple[Recording, list[str]]:
    if not args.columns:
        raise SettingError(
            f"{args.source}: --columns is required, for example distance_mm=true_cm:cm reading_mm=got:cm"
        )
    dialect = Dialect("\t" if args.delimiter in ("tab", "\\t") else args.delimiter, args.decimal)
    columns = [ColumnMap.parse(text) for text in args.columns]
    constants = parse_constants(args.constants)
    recording = import_table(args.source, columns, constants, args.no_echo, args.skip_bad_rows, dialect)
    return recording, [f"omitted: {fault}" for fault in recording.rejected]


def _bag(args: Args) -> tuple[Recording, list[str]]:
    truth = GroundTruthSource(args.truth_topic, args.truth_point, args.truth_csv, args.longest_gap_s)
    with bar(f"reading {args.source.name}", 1) as update:
        imported = import_bag(args.source, args.topics, truth, parse_constants(args.constants), update)
    notes = {
        f"omitted: {imported.left_out} pings without a true distance": imported.left_out,
        f"too close to measure (REP 117), recorded as no answer: {imported.too_close}": imported.too_close,
    }
    return imported.recording, [note for note, count in notes.items() if count]
