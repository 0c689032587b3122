"""The file of a session: whole cells, appended, forced to disk, and kept from a second writer.

A cell is written in one append and forced to disk before it counts. Whatever is behind the last whole cell is cut off
when the file is opened again. While a session is unfinished, a file beside it holds what it was begun with, and tells
`Recording.load` that the last line may be torn.
"""

from __future__ import annotations

import contextlib
import errno
import io
import json
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from acquisition.errors import RecordingError
from acquisition.io.files import lock, sync_folder, write_text
from acquisition.io.recording import unfinished

HEAD = b"time_s,session,sensor,distance_mm"  # of every file that a session begins
FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


@dataclass
class Journal:
    """An open file of whole cells.

    Attributes:
        path: of the file.
        handle: of the open file.
        pings: rows a cell.
        ends: where in the file the header and each cell ends, bytes; empty where there is not even a header.
        table: what was in the file when it was opened; None where there was no whole cell.
    """

    path: Path
    handle: int
    pings: int
    ends: list[int]
    table: pd.DataFrame | None

    @classmethod
    @contextmanager
    def open(cls, path: Path, pings: int, resume: bool) -> Iterator[Journal]:
        """Open or begin a file and keep it to this process.

        Raises:
            RecordingError: the file is there and `resume` was not asked for, another process is writing it, or it
                cannot be written at all.
        """
        handle = _opened(path, resume)
        try:
            if not lock(handle):
                raise RecordingError(
                    f"{path}: another session is writing to it; wait for it, stop it, or give another file"
                )
            yield cls._taken_up(path, handle, pings)
        finally:
            os.close(handle)

    @classmethod
    def _taken_up(cls, path: Path, handle: int, pings: int) -> Journal:
        data = path.read_bytes()
        if not (data.startswith(HEAD) or HEAD.startswith(data)):
            raise RecordingError(f"{path}: was not begun by a session; give another file, nothing in it was changed")
        line_ends = np.flatnonzero(np.frombuffer(data, dtype=np.uint8) == ord("\n")) + 1
        ends = [int(end) for end in line_ends[::pings]]
        whole = data[: ends[-1]] if len(ends) > 1 else b""
        try:
            table = pd.read_csv(io.BytesIO(whole), dtype={"session": str}) if whole else None
        except ValueError as error:  # of pandas' parser
            told = " ".join(str(error).split())
            raise RecordingError(f"{path}: was not written by a session alone: {told}; nothing was changed") from None
        return cls(path, handle, pings, ends if whole else [], table)

    @property
    def cells(self) -> int:
        """How many whole cells there are."""
        return max(len(self.ends) - 1, 0)

    def begin(self, settings: Mapping[str, Any]) -> None:
        """Cut a torn tail off and keep what the session is begun with, or compare it with what is kept.

        Raises:
            RecordingError: the session was begun with other settings; the first that differs is named.
        """
        kept = unfinished(self.path)
        if kept.exists() and self.cells:
            _compare(self.path, _begun_with(kept), settings)
        try:
            if not (kept.exists() and self.cells):
                write_text(kept, json.dumps(settings, indent=1))
                sync_folder(self.path.parent)
            self._cut(self.ends[-1] if self.ends else 0)
        except OSError as error:
            raise RecordingError(self._failure(error)) from error

    def append(self, rows: pd.DataFrame) -> None:
        """Write a cell, with the header before the first, and do not return before it is on disk.

        Raises:
            RecordingError: the disk is full or fails; the file is as it was before.
        """
        header = rows.iloc[:0].to_csv(index=False, lineterminator="\n").encode() if not self.ends else b""
        body = rows.to_csv(index=False, header=False, float_format="%.10g", lineterminator="\n").encode()
        before = self.ends[-1] if self.ends else 0
        try:
            self._write(header + body, before)
        except BaseException as error:  # Ctrl-C too leaves no part of a cell behind
            with contextlib.suppress(OSError):
                self._cut(before)
            if isinstance(error, OSError):
                raise RecordingError(self._failure(error)) from error
            raise
        self.ends += ([len(header)] if header else []) + [before + len(header) + len(body)]

    def drop_last(self) -> None:
        """Take the last cell back, so that it can be measured again."""
        self.ends.pop()
        if len(self.ends) == 1:
            self.ends.clear()
        self._cut(self.ends[-1] if self.ends else 0)

    def finish(self) -> None:
        """Tell everybody that the recording is complete."""
        unfinished(self.path).unlink(missing_ok=True)

    def _write(self, data: bytes, at: int) -> None:
        os.lseek(self.handle, at, os.SEEK_SET)
        view = memoryview(data)
        while view:
            view = view[os.write(self.handle, view) :]
        os.fsync(self.handle)

    def _cut(self, size: int) -> None:
        os.ftruncate(self.handle, size)
        os.fsync(self.handle)

    def _failure(self, error: OSError) -> str:
        reason = error.strerror or str(error)
        advice = "make room" if error.errno in FULL else "check the disk"
        return (
            f"{self.path}: cannot be written: {reason}; {self.cells} conditions are on disk and whole: "
            f"{advice}, then go on with --resume"
        )


def _opened(path: Path, resume: bool) -> int:
    """Open a file for reading and writing; without `resume` only one that is not there yet."""
    flags = os.O_RDWR | os.O_CREAT | getattr(os, "O_BINARY", 0) | (0 if resume else os.O_EXCL)
    try:
        with contextlib.suppress(FileExistsError):  # a file in the place of the folder: opening tells it better
            path.parent.mkdir(parents=True, exist_ok=True)
        handle = os.open(path, flags, 0o644)
        sync_folder(path.parent)
        return handle
    except FileExistsError:
        raise RecordingError(f"{path}: is there already; go on with it (--resume) or give another file") from None
    except OSError as error:
        raise RecordingError(f"{path}: cannot be written: {error.strerror or error}; give another place") from None


def _begun_with(kept: Path) -> dict[str, Any]:
    try:
        return dict(json.loads(kept.read_text(encoding="utf-8")))
    except (OSError, ValueError, TypeError) as error:
        raise RecordingError(
            f"{kept}: cannot be read: {' '.join(str(error).split())}; it holds what the session was begun with: "
            "make sure that the settings are the same, then delete it and go on with --resume"
        ) from None


def _compare(path: Path, kept: Mapping[str, Any], given: Mapping[str, Any]) -> None:
    given = json.loads(json.dumps(given))  # as what is kept: tuples are lists
    for name in dict.fromkeys((*kept, *given)):
        if kept.get(name) != given.get(name):
            raise RecordingError(
                f"{path}: was begun with {name} {_told(kept.get(name))}, not {_told(given.get(name))}; "
                "resume with the settings it was begun with, or give another file"
            )


def _told(value: Any) -> str:
    text = json.dumps(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
