"""Recordings as Parquet files, a third of the size of CSV and read in parts. Requires pyarrow (extra `parquet`).

The columns are those of a CSV recording: numbers as float64 (null: no answer, where CSV has an empty field), text as
strings.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from importlib import import_module
from itertools import chain
from pathlib import Path
from typing import Any

import pandas as pd

from acquisition.errors import RecordingError
from acquisition.extras import require
from acquisition.io.columns import RowFault, convert
from acquisition.io.files import is_file, write_atomic
from acquisition.io.tables import MAX_COLUMNS

MAGIC = b"PAR1"
SUFFIX = ".parquet"
INDEX = re.compile(r"__index_level_\d+__")  # column that pandas makes of an index without a name
BATCH = 2**17  # rows that are read at once
MAX_VALUES = 2**27  # of a file that is read whole: 1 GiB; a file of a few bytes can hold any number of equal ones


def _arrow() -> tuple[Any, Any]:
    require("pyarrow", "parquet")
    return import_module("pyarrow"), import_module("pyarrow.parquet")


def is_parquet(path: Path) -> bool:
    """Return whether a file begins as a Parquet file; a pipe, which would wait for a writer, is none."""
    if not is_file(path):
        return False
    try:
        with path.open("rb") as file:
            return file.read(len(MAGIC)) == MAGIC
    except OSError:
        return False


def read_batches(path: Path, rows: int = BATCH) -> Iterator[pd.DataFrame]:
    """Yield the fields of a Parquet file in parts.

    Args:
        path: of the file.
        rows: of a part, at most.

    Raises:
        RecordingError: the file is damaged.
        MissingExtraError: pyarrow is not installed.
    """
    _, parquet = _arrow()
    with _readable(path), parquet.ParquetFile(path) as file:
        if len(file.schema_arrow) > MAX_COLUMNS:
            raise RecordingError(f"{path}: has more than {MAX_COLUMNS} columns; keep those that are needed")
        for batch in file.iter_batches(batch_size=rows, use_threads=False):
            # what pandas notes beside the columns may rename them to anything, or hide some as an index
            yield _fields(batch.to_pandas(self_destruct=True, ignore_metadata=True))


def read_parquet(path: Path) -> tuple[pd.DataFrame, list[RowFault]]:
    """Return the columns of a Parquet file and the faults of its values, with the line that each would have in CSV.

    Raises:
        RecordingError: the file is damaged, or a required column is missing.
        MissingExtraError: pyarrow is not installed.
    """
    parts, n_values = list[pd.DataFrame](), 0
    for part in read_batches(path):
        parts, n_values = [*parts, part], n_values + part.size
        if n_values > MAX_VALUES:
            raise RecordingError(
                f"{path}: has more than {MAX_VALUES // 10**6} million values; read it in parts (acquisition.io.chunks)"
            )
    if not parts:
        raise RecordingError(f"{path}: has no rows, expected one row per ping")
    return convert(str(path), pd.concat(parts, ignore_index=True))


def write_parquet(path: Path, tables: Iterable[pd.DataFrame]) -> Path:
    """Write tables of the same columns below each other, atomically.

    Args:
        path: of the file.
        tables: numeric columns as numbers, others as text; at least one.

    Raises:
        MissingExtraError: pyarrow is not installed.
    """
    arrow, parquet = _arrow()
    rest = iter(tables)
    first = next(rest)
    schema = arrow.schema([(str(name), _kind(arrow, first[name])) for name in first.columns])

    def write(file: Any) -> None:
        with parquet.ParquetWriter(file, schema, compression="zstd") as writer:
            for table in chain([first], rest):
                writer.write_table(arrow.Table.from_pandas(table, schema, preserve_index=False))

    return write_atomic(path, write, binary=True)


def _kind(arrow: Any, column: pd.Series) -> Any:
    return arrow.float64() if pd.api.types.is_numeric_dtype(column) else arrow.string()


def _fields(table: pd.DataFrame) -> pd.DataFrame:
    """Return numbers as they are and anything else as text, empty where there is nothing; an index is left out."""
    table = table.drop(columns=[name for name in table.columns if INDEX.fullmatch(name)])
    others = [name for name in table.columns if not pd.api.types.is_numeric_dtype(table[name])]
    text = {name: table[name].astype(object).where(table[name].notna(), "").astype(str) for name in others}
    return table.assign(**text)


@contextmanager
def _readable(path: Path) -> Iterator[None]:
    """Turn the errors of the reader of a damaged file into a RecordingError."""
    arrow, _ = _arrow()
    try:
        yield
    except (arrow.ArrowException, OSError, ValueError) as error:
        reason = " ".join(str(error).split())
        raise RecordingError(f"{path}: not a readable Parquet file: {reason}") from None
