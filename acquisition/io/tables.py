"""Tables of text from CSV files of any program: what cannot be read as one table is named, never guessed."""

from __future__ import annotations

import csv
import gzip
import io
import itertools
import re
import warnings
import zlib
from codecs import getincrementaldecoder
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np
import pandas as pd

from acquisition.arrays import Bits, Ints
from acquisition.errors import RecordingError, RecordingNotFoundError, SettingError, SonarError

MAX_COLUMNS, MAX_FIELD = 1000, 100_000  # columns of a table, and characters of one field
MAX_BYTES = 2**30  # of a table, decompressed
MAX_EXPANSION, SMALL = 100, 2**26  # of gzip, beyond so many bytes; tables of measurements compress 5- to 20-fold
GZIP, ZIP, XZ, UTF16 = b"\x1f\x8b", b"PK\x03\x04", b"\xfd7zXZ", (b"\xff\xfe", b"\xfe\xff")
FORMATS = (
    (ZIP, "a ZIP archive"),
    (XZ, "compressed by xz"),
    (b"SQLite format 3", "a database"),
    (b"\x89HDF", "HDF5"),
    (b"PAR1", "Parquet"),
)
HEADER_BYTES = 1_000_000
MISSING = "\0"  # in place of a field that a row lacks; no field of a file holds this character
MAX_ROW = 10 * 2**20  # bytes; the parser takes many times as much for a row of empty fields
BLOCK = 2**24  # bytes of a file that is read in parts
LONG_ROW = f"{{}}: a row of more than {MAX_ROW // 2**20} MiB; the file is damaged or no table"


@dataclass(frozen=True)
class Dialect:
    """How a CSV file separates and writes numbers.

    Attributes:
        delimiter: between two fields, one character.
        decimal: decimal point, one character.
    """

    delimiter: str = ","
    decimal: str = "."

    def __post_init__(self) -> None:
        """Raise SettingError for characters that cannot be told apart."""
        if len(self.delimiter) != 1 or self.delimiter in '"\r\n.0123456789':
            raise SettingError(f"delimiter: expected one character such as ; or a tab, got {self.delimiter!r}")
        if self.decimal not in (".", ",") or self.decimal == self.delimiter:
            raise SettingError(f"decimal: expected . or , and not the delimiter, got {self.decimal!r}")


COMMAS = Dialect()


def read_text_table(path: Path, dialect: Dialect = COMMAS, number_twins: bool = False) -> pd.DataFrame:
    """Return the fields of a CSV file as text; gzip, a byte order mark and any line ends are read.

    Args:
        path: of the file.
        dialect: its delimiter and decimal point; the latter becomes a point.
        number_twins: number columns of the same name ("x", "x.1") instead of rejecting the file.

    Raises:
        RecordingNotFoundError: the file does not exist.
        RecordingError: it is no file, is not text, or is no table with unique names of columns.
    """
    return parse_table(read_bytes(path), str(path), dialect, number_twins)


def read_bytes(path: Path) -> bytes:
    """Return the content of a file, decompressed if it is compressed by gzip.

    Raises:
        RecordingNotFoundError: the file does not exist.
        RecordingError: it is no file, cannot be read, or is too large.
    """
    with _opened(path) as file:
        data = file.read(SMALL + 1)
        _check_expansion(path, len(data))
        if len(data) > SMALL:
            file.seek(0)
            data = file.read(MAX_BYTES + 1)
            _check_expansion(path, len(data))
    if len(data) > MAX_BYTES:
        raise RecordingError(
            f"{path}: has more than {MAX_BYTES // 2**20} MiB of text; read it in parts with acquisition.io.chunks"
        )
    return data


def read_beginning(path: Path) -> bytes:
    """Return the first bytes of a file, which hold its header; see `read_bytes`."""
    with _opened(path) as file:
        return file.read(HEADER_BYTES)


def read_blocks(path: Path, size: int = BLOCK) -> Iterator[tuple[bytes, int]]:
    """Yield a file in blocks of whole rows, each below the header, with the number of the line of its first row.

    Args:
        path: of a file as for `read_bytes`, of any length.
        size: of a block, bytes.
    """
    header, rest, line, total = b"", b"", 2, 0
    with _opened(path) as file:
        while piece := file.read(size):
            rest, total = rest + piece, total + len(piece)
            _check_expansion(path, total)
            if not header:
                header = rest[: rest.find(b"\n") + 1]
                rest = rest[len(header) :]
            cut = _row_end(rest) if header else 0
            if cut:
                yield header + rest[:cut], line
                line, rest = line + rest.count(b"\n", 0, cut), rest[cut:]
            if len(rest) > max(MAX_ROW, size):
                raise RecordingError(LONG_ROW.format(f"{path}, line {line}"))
    if rest or line == 2:
        yield header + rest, line


def _check_expansion(path: Path, n_bytes: int) -> None:
    """Raise RecordingError where a file gives so many bytes that its compression must be meant to fill memory."""
    if n_bytes > SMALL and n_bytes > MAX_EXPANSION * path.stat().st_size:
        raise RecordingError(
            f"{path}: expands to more than {MAX_EXPANSION} times its size, as no table of measurements does; "
            "decompress it, and give the result if it is one"
        )


def _check_rows(data: bytes, name: str) -> None:
    """Raise RecordingError where a row is too long for the parser."""
    at = 0
    while len(data) - at > MAX_ROW:
        end = max(data.rfind(end, at, at + MAX_ROW) for end in (b"\n", b"\r"))
        if end < 0:
            line = data.count(b"\n", 0, at) + 1
            raise RecordingError(LONG_ROW.format(f"{name}, line {line}"))
        at = end + 1


def _row_end(data: bytes) -> int:
    """Return the place behind the last line end that is not inside quotes, 0 for none."""
    return _unquoted(data, b",").rfind(b"\n") + 1


def _unquoted(data: bytes, delimiter: bytes) -> bytes:
    """Return text with a null character for each line end in quotes and a space for each delimiter there.

    As in the parser, only a quotation mark that begins a field opens quotes, not the one of 5" in a note.
    """
    if b'"' not in data:
        return data
    quoted = rb'(?:\A|(?<=[\r\n%s])) *"[^"]*(?:""[^"]*)*(?:"|\Z)' % re.escape(delimiter)
    return re.sub(quoted, lambda field: field[0].replace(b"\n", b"\0").replace(delimiter, b" "), data)


def _rows(data: bytes, delimiter: bytes) -> tuple[Ints, Ints]:
    """Return the line, from 0, and the number of fields of each row, the header's included; blank lines are no rows."""
    plain = _unquoted(data.replace(b"\r\n", b"\n").replace(b"\r", b"\n"), delimiter)
    text, blank = np.frombuffer(plain, np.uint8), b" \t".replace(delimiter, b"")
    ends = np.append(np.flatnonzero(text == ord("\n")), len(text))
    starts = np.append(0, ends[:-1] + 1)
    marks = np.flatnonzero(text == ord(delimiter))
    fields = np.searchsorted(marks, ends) - np.searchsorted(marks, starts) + 1
    for k in np.flatnonzero(fields == 1):
        fields[k] = bool(plain[starts[k] : ends[k]].strip(blank))
    rows = np.flatnonzero(fields)
    line = rows + np.searchsorted(np.flatnonzero(text == 0), starts[rows])
    return line.astype(np.int64), fields[rows].astype(np.int64)


@contextmanager
def _opened(path: Path) -> Iterator[IO[bytes]]:
    """Open a file, decompressed if it is compressed by gzip; see `read_bytes` for errors, also of reading."""
    try:
        if "\0" in str(path) or not path.exists():
            raise RecordingNotFoundError(f"{path}: no such file; give the path of a CSV file")
        if not path.is_file():
            what = "a folder" if path.is_dir() else "a device or a pipe"
            raise RecordingError(f"{path}: is {what}, expected a CSV file")
        with path.open("rb") as raw:
            packed = raw.read(len(GZIP)) == GZIP
        opened: Callable[..., Any] = gzip.open if packed else open
        with opened(path, "rb") as file:
            yield file
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise RecordingError(f"{path}: damaged gzip file: {error}; copy or record it again") from None
    except OSError as error:
        if isinstance(error, SonarError):
            raise
        raise RecordingError(f"{path}: cannot be read: {error.strerror or error}; check its permissions") from None


def parse_numbers(
    data: bytes, name: str, text: Collection[str], largest: float, dialect: Dialect = COMMAS
) -> pd.DataFrame | None:
    """Return the fields of CSV text, columns of numbers as such (NaN where empty), the others as text.

    Args:
        data: CSV text.
        name: of the file, for messages.
        text: columns that are text, whatever they hold.
        largest: magnitude of a number.
        dialect: delimiter of the file.

    Returns:
        None where a column is neither text nor finite numbers up to `largest`, or a row lacks a field: the text has to
        decide.
    """
    options = {"dtype": dict.fromkeys(text, str), "na_values": [""], "low_memory": False}
    table, missing = _parsed(data, name, dialect, False, **options)
    number = table.select_dtypes(["int64", "float64"])
    others = table.columns.difference(number.columns)
    known = missing is None and all(pd.api.types.is_string_dtype(table[column]) for column in others)
    if table.empty or not known or any((number[column].abs() > largest).any() for column in number):
        return None
    return table.fillna(dict.fromkeys(others, ""))


def parse_table(data: bytes, name: str, dialect: Dialect = COMMAS, number_twins: bool = False) -> pd.DataFrame:
    """Return the fields of CSV text as text, `MISSING` where a row lacks one; see `read_text_table`.

    The index is that of the line, 0 for the second one.
    """
    # as missing values, empty fields are also recognised behind a delimiter at the end of each row
    table, missing = _parsed(data, name, dialect, number_twins, dtype=str, na_values=[""])
    table = table.fillna("")
    if missing is not None:
        table = table.mask(missing, MISSING)
    if dialect.decimal == ",":
        table = table.apply(lambda column: column.str.replace(",", ".", regex=False))
    return table


def _parsed(
    data: bytes, name: str, dialect: Dialect, number_twins: bool, **options: Any
) -> tuple[pd.DataFrame, Bits | None]:
    """Return a table, by line, and the mask of the fields that its rows lack, (n, columns), if there are any."""
    columns = _header(_checked_beginning(data, name), name, dialect)
    _check_header(columns, name, number_twins)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", pd.errors.ParserWarning)  # of a row with more fields than the header
            table = pd.read_csv(
                io.BytesIO(data),
                keep_default_na=False,
                skipinitialspace=True,
                encoding="utf-8-sig",
                sep=dialect.delimiter,
                index_col=False,
                **options,
            )
    except pd.errors.ParserWarning:
        raise RecordingError(f"{name}: the rows have more fields than the header; give each column a name") from None
    except (pd.errors.ParserError, ValueError) as error:
        reason = " ".join(str(error).replace("Error tokenizing data. C error:", "").split())
        raise RecordingError(f"{name}: not a table of separated values: {reason}") from None
    if len(table.columns) != len(columns):  # a name that holds a line end, or a quotation mark without its pair
        raise RecordingError(
            f"{name}, line 1: has {len(columns)} names of columns where the table has {len(table.columns)}; remove "
            "quotation marks and line ends from the names"
        )
    table.columns = pd.Index(_numbered(columns))
    return _placed(table, data, dialect)


def _placed(table: pd.DataFrame, data: bytes, dialect: Dialect) -> tuple[pd.DataFrame, Bits | None]:
    """Return a table with the lines of its rows as index, and which fields its rows lack; see `_parsed`.

    The rows are only sought where lines and rows may differ, or the last named field of a row is empty.
    """
    named = max((k for k, column in enumerate(map(str, table), 1) if not column.startswith("Unnamed: ")), default=1)
    n_lines = data.count(b"\n") + (not data.endswith(b"\n"))
    if n_lines == len(table) + 1 and not table.iloc[:, named - 1].isna().any():
        return table, None
    line, fields = _rows(data, dialect.delimiter.encode("latin-1", "replace"))  # the parser takes one byte
    if len(line) != len(table) + 1:
        return table, None
    order = np.arange(len(table.columns))
    missing = (order >= fields[1:, None]) & (order < named)
    return table.set_axis(line[1:] - 1), missing if missing.any() else None


def _checked_beginning(data: bytes, name: str) -> str:
    """Return the first lines as text, or say what the bytes are instead; all of them are checked, part by part."""
    found = next((what for magic, what in FORMATS if data.startswith(magic)), None)
    if data.startswith(UTF16):
        found = "UTF-16 text"
    if found is not None:
        raise RecordingError(f"{name}: is {found}, expected a CSV file in UTF-8; export it as such")
    _check_rows(data, name)
    decoder, held = getincrementaldecoder("utf-8-sig")(), 0
    for start in range(0, len(data), BLOCK):
        try:
            decoder.decode(data[start : start + BLOCK], start + BLOCK >= len(data))
        except UnicodeDecodeError as error:
            byte = start - held + error.start
            raise RecordingError(f"{name}: not UTF-8 text (byte {byte}); expected a CSV file") from None
        held = len(decoder.getstate()[0])
    if b"\0" in data:
        line = data.count(b"\n", 0, data.index(b"\0")) + 1
        raise RecordingError(f"{name}, line {line}: contains a null character; the file is damaged or no CSV file")
    return data[:HEADER_BYTES].decode("utf-8-sig", "ignore")


def _header(text: str, name: str, dialect: Dialect) -> list[str]:
    """Return the names of the columns; an empty one becomes `Unnamed: k`, as in pandas."""
    first = re.split(r"[\r\n]", text.lstrip(" \t\r\n".replace(dialect.delimiter, "")), maxsplit=1)[0]
    if not first:
        raise RecordingError(f"{name}, line 1: the file is empty, expected a header with the names of the columns")
    if first.count(dialect.delimiter) >= MAX_COLUMNS:
        raise RecordingError(f"{name}, line 1: has more than {MAX_COLUMNS} columns; keep those that are needed")
    if len(first) > MAX_FIELD:
        raise RecordingError(f"{name}, line 1: has more than {MAX_FIELD:,} characters, expected a header")
    try:
        header = next(csv.reader([first], delimiter=dialect.delimiter))
    except csv.Error as error:
        raise RecordingError(f"{name}, line 1: not a table of separated values: {error}") from None
    return [column.strip() or f"Unnamed: {k}" for k, column in enumerate(header)]


def check_twins(name: str, columns: Sequence[str]) -> None:
    """Raise RecordingError where two columns of a table have one name."""
    twin = next((column for column, count in Counter(columns).items() if count > 1), None)
    if twin is not None:
        raise RecordingError(f"{name}, line 1: column {twin!r} is given twice; rename or remove one")


def _check_header(columns: list[str], name: str, number_twins: bool) -> None:
    if not number_twins:
        check_twins(name, columns)
    mark = next((mark for mark in (";", "\t", "|") if len(columns) == 1 and mark in columns[0]), None)
    if mark is not None:
        shown = "tab" if mark == "\t" else mark
        raise RecordingError(
            f"{name}, line 1: seems to separate columns by {shown!r}: `sonar-gym import` reads it with "
            f"--delimiter {shown!r}, and with --decimal ',' where numbers have a decimal comma"
        )


def _numbered(columns: list[str]) -> list[str]:
    """Return unique names: the k-th repetition of x becomes x.k.

    >>> _numbered(["x", "y", "x", "x"])
    ['x', 'y', 'x.1', 'x.2']
    """
    seen, taken, out = Counter[str](), set(columns), []
    for column in columns:
        name, seen[column] = column, seen[column] + 1
        if seen[column] > 1:
            name = next(f"{column}.{k}" for k in itertools.count(seen[column] - 1) if f"{column}.{k}" not in taken)
            taken.add(name)
        out.append(name)
    return out
