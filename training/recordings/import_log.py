"""Conversion of a log of another program, or of a ROS bag, into a recording."""

from __future__ import annotations

import shlex
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

import tyro

from acquisition import EchoStatus, Recording, SettingError
from acquisition.io.chunks import is_recording, read_chunks, write_chunks
from acquisition.io.columns import REQUIRED
from acquisition.io.logs.bags import GroundTruthSource, import_bag, is_bag
from acquisition.io.logs.foreign import ColumnMap, beginning, import_table, parse_constants, read_log
from acquisition.io.logs.guess import guess_columns, guess_dialect
from acquisition.io.places import OutputFile
from acquisition.io.tables import Dialect, read_beginning
from acquisition.io.units import doubtful_units
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
    """CSV or TOA5 file, log of a serial monitor, ROS bag (.bag, .mcap, .db3, ROS 2 folder), or recording."""
    out: OutputFile
    """Recording to write: Parquet if the name ends in .parquet, otherwise CSV."""
    columns: tuple[str, ...] = ()
    """CSV: columns of the recording as name=source:unit, with units mm cm m in us deg rad s ms min h date text;
    us of a length is the time of flight, 58 us per cm; date is ISO 8601; time_s is shifted to begin at 0.
    Without it, columns and delimiter are guessed and shown."""
    accept_guess: bool = False
    """CSV without --columns: use the columns that were guessed and shown."""
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
    if args.truth_csv is not None and not is_bag(args.source):
        raise SettingError(f"--truth-csv {args.truth_csv}: only a bag needs true distances, {args.source} is none")
    if not is_bag(args.source) and _is_unchanged(args) and is_recording(args.source):
        _convert(args)
        return
    recording, notes = (_bag if is_bag(args.source) else _table)(args)
    recording.save(args.out)
    status, conditions, runs = recording.reading.status, recording.condition.max() + 1, recording.run.max() + 1
    print(
        f"{args.out}: {len(recording)} pings in {conditions} conditions and {runs} runs; "
        f"{(status == EchoStatus.NO_ECHO).sum()} without echo, {(status == EchoStatus.NO_ANSWER).sum()} without answer"
    )
    for note in [*notes, *map(_warning, doubtful_units(recording))]:
        print(note)


def _is_unchanged(args: Args) -> bool:
    """Return whether no option changes the columns of the source, how it is read, or what it means."""
    return not (args.columns or args.constants) and (args.no_echo, args.delimiter, args.decimal) == (None, ",", ".")


def _convert(args: Args) -> None:
    """Write a recording in the other format, in parts; a unit is doubtful if it is in all of them."""
    doubts, omitted = list[set[str]](), list[str]()

    def parts() -> Iterator[Recording]:
        for part in read_chunks(args.source, args.skip_bad_rows):
            doubts.append(set(doubtful_units(part)))
            omitted.extend(_omitted(part))
            yield part

    n = write_chunks(args.out, parts())
    print(f"{args.out}: {n} pings; {args.source} is a recording already, and was converted in parts")
    for note in [*omitted, *map(_warning, sorted(set.intersection(*doubts)))]:
        print(note)


def _omitted(recording: Recording) -> list[str]:
    return [f"omitted: {fault}" for fault in recording.rejected]


def _warning(text: str) -> str:
    return f"warning: {text}"


def _table(args: Args) -> tuple[Recording, list[str]]:
    dialect = _dialect(args)
    columns = [ColumnMap.parse(text) for text in args.columns] or _guessed(args, dialect)
    constants = parse_constants(args.constants)
    recording = import_table(args.source, columns, constants, args.no_echo, args.skip_bad_rows, dialect)
    return recording, _omitted(recording)


def _dialect(args: Args) -> Dialect:
    if not args.columns and (args.delimiter, args.decimal) == (",", "."):
        return guess_dialect(beginning(read_beginning(args.source)))
    return Dialect("\t" if args.delimiter in ("tab", "\\t") else args.delimiter, args.decimal)


def _guessed(args: Args, dialect: Dialect) -> list[ColumnMap]:
    """Show what the columns seem to be; return it if the user has accepted it.

    Raises:
        SettingError: the guess has not been accepted, or a required column is missing; the message is the next step.
    """
    log, units, _ = read_log(args.source, dialect)
    constants = parse_constants(args.constants)
    columns = [replace(m, unit=units.get(m.source, m.unit)) for m in guess_columns(log) if m.name not in constants]
    print(f"{args.source}: separated by {dialect.delimiter!r}, decimal {dialect.decimal!r}; guessed columns:")
    for m in columns:
        unit = f", in {m.unit}" if m.unit else ""
        print(f"  {m.name} = {m.source}{unit}: {', '.join(log[m.source][:4].astype(str))}, ...")
    given = {m.name for m in columns} | set(constants)
    missing = [name for name in REQUIRED if name not in given]
    if missing:
        raise SettingError(
            f"{args.source}: no column seems to be {missing[0]}; give --columns, or --constants {missing[0]}=..."
        )
    if not args.accept_guess:
        maps = " ".join(shlex.quote(str(m)) for m in columns)
        dialects = "" if dialect == Dialect() else f" --delimiter {dialect.delimiter!r} --decimal '{dialect.decimal}'"
        raise SettingError(
            f"nothing is written yet: repeat with --accept-guess, or with what is right of --columns {maps}{dialects}"
        )
    return columns


def _bag(args: Args) -> tuple[Recording, list[str]]:
    truth = GroundTruthSource(args.truth_topic, args.truth_point, args.truth_csv, args.longest_gap_s)
    with bar(f"reading {args.source.name}", 1) as update:
        imported = import_bag(args.source, args.topics, truth, parse_constants(args.constants), update)
    notes = {
        f"omitted: {imported.left_out} pings without a true distance": imported.left_out,
        f"too close to measure (REP 117), recorded as no answer: {imported.too_close}": imported.too_close,
    }
    return imported.recording, [note for note, count in notes.items() if count]
