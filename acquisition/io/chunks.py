"""Recordings of any length, in parts: read, written and sampled in a memory that does not grow with the file.

The parts are recordings themselves. A part ends where the condition or the session changes, if it does within the
part, so that no visit is divided that is shorter than a part.
"""

from __future__ import annotations

import heapq
import itertools
import os
from codecs import BOM_UTF8
from collections.abc import Collection, Iterable, Iterator
from pathlib import Path
from typing import IO

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from acquisition.arguments import checked
from acquisition.errors import RecordingError, SettingError
from acquisition.io.columns import CONDITION, DIGITS, REQUIRED, TEXT, RowFault, convert, read_columns, valid_rows
from acquisition.io.files import write_atomic
from acquisition.io.parquet import SUFFIX, is_parquet, read_batches, write_parquet
from acquisition.io.recording import Recording, unfinished_path
from acquisition.io.tables import read_beginning, read_blocks

Columns = tuple[pd.DataFrame, list[RowFault], int]  # table, faults, line of the first row
VISIT = (*TEXT, *CONDITION[1:])  # columns that are constant within a visit
MAX_VISIT = 2**20  # rows of one visit that are held in memory


def read_chunks(path: str | os.PathLike[str], skip_bad_rows: bool = False) -> Iterator[Recording]:
    """Yield a recording in parts, CSV or Parquet, in its order. CSV is read twice: first, which columns are text.

    Args:
        path: of the file.
        skip_bad_rows: omit faulty rows (listed in `rejected` of their part) instead of rejecting the file.

    Raises:
        RecordingNotFoundError: the file does not exist.
        RecordingError: a column is missing or a value violates the format; the message describes the first fault.
        MissingExtraError: the file is Parquet and pyarrow is not installed.
    """
    path = Path(path)
    parts = _parquet_parts(path) if is_parquet(path) else _csv_parts(path, _text_columns(path))
    return _recordings(parts, str(path), skip_bad_rows)


def is_recording(path: Path) -> bool:
    """Return whether a file is Parquet, or CSV with the columns that a recording requires."""
    if is_parquet(path):
        return True
    header = read_beginning(path).removeprefix(BOM_UTF8).partition(b"\n")[0]
    return {column.encode() for column in REQUIRED} <= {name.strip(b' "\r') for name in header.split(b",")}


@checked
def write_chunks(path: str | os.PathLike[str], chunks: Iterable[Recording]) -> int:
    """Write parts with the same columns as one file, atomically; Parquet if the name ends in .parquet, otherwise CSV.

    Args:
        path: of the file.
        chunks: at least one.

    Returns:
        Number of rows.
    """
    path, rows = Path(path), 0

    def counted() -> Iterator[pd.DataFrame]:
        nonlocal rows
        for chunk in chunks:
            rows += len(chunk)
            yield chunk.table

    if path.suffix.lower() == SUFFIX:
        write_parquet(path, counted())
    else:
        write_atomic(path, lambda file: _write_csv(file, counted()))
    return rows


@checked
def sample_visits(path: str | os.PathLike[str], n: int, rng: np.random.Generator) -> Recording:
    """Return a random sample of the visits of a recording, each as likely as any other, in the order of the file.

    Args:
        path: of a CSV or Parquet file of any length.
        n: number of visits, at most.
        rng: source of the sample.
    """
    if n < 1:
        raise SettingError(f"n: expected at least 1 visit, got {n}")
    heap: list[tuple[float, int, pd.DataFrame]] = []  # the n smallest of one random number per visit
    for number, visit in enumerate(itertools.chain.from_iterable(map(_visits, read_chunks(path)))):
        item = (-rng.random(), number, visit)
        if len(heap) < n:
            heapq.heappush(heap, item)
        elif item > heap[0]:
            heapq.heapreplace(heap, item)
    tables = [visit for _, _, visit in sorted(heap, key=lambda item: item[1])]
    return Recording(pd.concat(tables, ignore_index=True), str(path))


def _csv_parts(path: Path, text: Collection[str] | None) -> Iterator[Columns]:
    unfinished = unfinished_path(path).exists()
    for data, line in read_blocks(path):
        whole = data[: data.rfind(b"\n") + 1] if unfinished else data
        yield *read_columns(whole, str(path), line, text), line


def _parquet_parts(path: Path) -> Iterator[Columns]:
    line = 2
    for fields in read_batches(path):
        text = [name for name in fields.columns if not pd.api.types.is_numeric_dtype(fields[name])]
        yield *convert(str(path), fields, line, text), line
        line += len(fields)


def _text_columns(path: Path) -> frozenset[str]:
    """Return the columns that hold anything but numbers somewhere, or nothing anywhere; see `columns.convert`."""
    numbers, text, names = set[str](), set[str](), set[str]()
    for table, _, _ in _csv_parts(path, None):
        is_number = {name: pd.api.types.is_numeric_dtype(table[name]) for name in table.columns}
        names |= set(is_number)
        numbers |= {name for name, number in is_number.items() if number}
        text |= {name for name, number in is_number.items() if not number and (table[name] != "").any()}
    return frozenset(text | (names - numbers))


def _recordings(parts: Iterator[Columns], name: str, skip_bad_rows: bool) -> Iterator[Recording]:
    """Yield valid rows, the last visit of a part together with its continuation in the next."""
    found, rest, rejected = False, pd.DataFrame(), tuple[RowFault, ...]()
    for table, faults, line in parts:
        rest = pd.concat([rest, valid_rows(table, faults, skip_bad_rows, line)], ignore_index=True)
        rejected += tuple(faults)
        if cut := _last_visit(rest):
            found = True
            yield Recording(rest[:cut], name, rejected)
            rest, rejected = rest[cut:], ()
    if len(rest):
        yield Recording(rest.reset_index(drop=True), name, rejected)
    elif not found:
        raise RecordingError(f"{name}: has no rows below its header, expected one row per ping")


def _visit_starts(table: pd.DataFrame) -> NDArray[np.int64]:
    """Return the indices of the rows whose condition, session or sensor differs from that of the row before."""
    changed = np.zeros(len(table), dtype=bool)
    for name in (name for name in VISIT if name in table):
        value = table[name].to_numpy()
        changed[1:] |= value[1:] != value[:-1]
    return np.flatnonzero(changed)


def _last_visit(table: pd.DataFrame) -> int:
    """Return where the last visit begins; the end of a table that is a single long visit."""
    starts = _visit_starts(table)
    if len(starts):
        return int(starts[-1])
    return len(table) if len(table) > MAX_VISIT else 0


def _visits(recording: Recording) -> list[pd.DataFrame]:
    edges = [0, *_visit_starts(recording.table), len(recording)]
    return [recording.table[start:end] for start, end in itertools.pairwise(edges)]


def _write_csv(file: IO[str], tables: Iterable[pd.DataFrame]) -> None:
    for k, table in enumerate(tables):
        table.to_csv(file, index=False, header=k == 0, float_format=f"%{DIGITS}")
