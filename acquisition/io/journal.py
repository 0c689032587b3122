"""The file of a session during recording: complete visits, appended, forced to disk, locked against a second writer.

A visit (all pings of one condition) is written in one append and forced to disk before it counts. When the file is
opened again, everything after the last complete visit is cut off. While a session is unfinished, a file beside the
recording holds its settings and makes `Recording.load` ignore an incomplete last line.
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
from acquisition.io.files import lock, read_limited, sync_folder, write_text
from acquisition.io.recording import unfinished_path

HEADER_START = b"time_s,session,sensor,distance_mm"  # of every file that a session creates
DISK_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


@dataclass
class Journal:
    """An open file of complete visits.

    Attributes:
        path: of the file.
        handle: of the open file.
        visit_pings: number of pings (rows) per visit.
        ends: offsets at which the header and each visit end, bytes; empty if the file has no header.
        table: content of the file when it was opened; None if it had no complete visit.
    """

    path: Path
    handle: int
    visit_pings: int
    ends: list[int]
    table: pd.DataFrame | None

    @classmethod
    @contextmanager
    def open(cls, path: Path, visit_pings: int, resume: bool) -> Iterator[Journal]:
        """Open or create a file and lock it.

        Raises:
            RecordingError: the file exists and `resume` is False, another process is writing it, or it cannot be
                written.
        """
        handle = _open(path, resume)
        try:
            if not lock(handle):
                raise RecordingError(
                    f"{path}: another session is writing to it; wait for it, stop it, or give another file"
                )
            yield cls._from_file(path, handle, visit_pings)
        finally:
            os.close(handle)

    @classmethod
    def _from_file(cls, path: Path, handle: int, visit_pings: int) -> Journal:
        data = path.read_bytes()
        if not (data.startswith(HEADER_START) or HEADER_START.startswith(data)):
            raise RecordingError(f"{path}: was not created by a session; give another file (this one is unchanged)")
        line_ends = np.flatnonzero(np.frombuffer(data, dtype=np.uint8) == ord("\n")) + 1
        ends = [int(end) for end in line_ends[::visit_pings]]
        complete = data[: ends[-1]] if len(ends) > 1 else b""
        try:
            table = pd.read_csv(io.BytesIO(complete), dtype={"session": str}) if complete else None
        except ValueError as error:  # of pandas' parser
            reason = " ".join(str(error).split())
            raise RecordingError(f"{path}: was edited by another program: {reason}; the file is unchanged") from None
        return cls(path, handle, visit_pings, ends if complete else [], table)

    @property
    def n_visits(self) -> int:
        """Number of complete visits."""
        return max(len(self.ends) - 1, 0)

    def begin(self, settings: Mapping[str, Any]) -> None:
        """Cut off an incomplete visit, and save the session's settings or compare them with the saved ones.

        Raises:
            RecordingError: the session was started with other settings; the message names the first difference.
        """
        saved = unfinished_path(self.path)
        resumed = saved.exists() and bool(self.n_visits)
        if resumed:
            _compare(self.path, _load_settings(saved), settings)
        try:
            if not resumed:
                write_text(saved, json.dumps(settings, indent=1))
                sync_folder(self.path.parent)
            self._truncate(self.ends[-1] if self.ends else 0)
        except OSError as error:
            raise RecordingError(self._failure(error)) from error

    def append(self, rows: pd.DataFrame) -> None:
        """Write a visit (and, first, the header) and return when it is on disk.

        Raises:
            RecordingError: the file has other columns, or the disk is full or fails; it keeps its previous content.
        """
        if self.table is not None and list(rows.columns) != list(self.table.columns):
            has, logs = ", ".join(self.table.columns), ", ".join(rows.columns)
            raise RecordingError(
                f"{self.path}: has columns {has}, this session logs {logs}; resume with the original settings, or give "
                "another file"
            )
        header = rows.iloc[:0].to_csv(index=False, lineterminator="\n").encode() if not self.ends else b""
        body = rows.to_csv(index=False, header=False, float_format="%.10g", lineterminator="\n").encode()
        before = self.ends[-1] if self.ends else 0
        try:
            self._write(header + body, before)
        except BaseException as error:  # KeyboardInterrupt, too, must not leave an incomplete visit
            with contextlib.suppress(OSError):
                self._truncate(before)
            if isinstance(error, OSError):
                raise RecordingError(self._failure(error)) from error
            raise
        self.ends += ([len(header)] if header else []) + [before + len(header) + len(body)]

    def drop_last(self) -> None:
        """Remove the last visit, so that it can be measured again."""
        self.ends.pop()
        if len(self.ends) == 1:
            self.ends.clear()
        self._truncate(self.ends[-1] if self.ends else 0)

    def finish(self) -> None:
        """Mark the recording as complete."""
        unfinished_path(self.path).unlink(missing_ok=True)

    def _write(self, data: bytes, at: int) -> None:
        os.lseek(self.handle, at, os.SEEK_SET)
        view = memoryview(data)
        while view:
            view = view[os.write(self.handle, view) :]
        os.fsync(self.handle)

    def _truncate(self, size: int) -> None:
        os.ftruncate(self.handle, size)
        os.fsync(self.handle)

    def _failure(self, error: OSError) -> str:
        reason = error.strerror or str(error)
        advice = "free disk space" if error.errno in DISK_FULL else "check the disk"
        return (
            f"{self.path}: cannot be written: {reason}; {self.n_visits} conditions are complete on disk: "
            f"{advice}, then continue with --resume"
        )


def _open(path: Path, resume: bool) -> int:
    """Open a file for reading and writing; without `resume` it must not exist."""
    flags = os.O_RDWR | os.O_CREAT | getattr(os, "O_BINARY", 0) | (0 if resume else os.O_EXCL)
    try:
        with contextlib.suppress(FileExistsError):  # a file at the folder's path: os.open reports it better
            path.parent.mkdir(parents=True, exist_ok=True)
        if path.exists() and not path.is_file():  # reading /dev/full would never end
            raise RecordingError(f"{path}: is no file on a disk; give another path")
        handle = os.open(path, flags, 0o644)
        sync_folder(path.parent)
        return handle
    except FileExistsError:
        raise RecordingError(f"{path}: exists already; continue it with --resume or give another file") from None
    except OSError as error:
        raise RecordingError(f"{path}: cannot be written: {error.strerror or error}; give another path") from None


def _load_settings(saved: Path) -> dict[str, Any]:
    try:
        return dict(json.loads(read_limited(saved, RecordingError, "the settings of a session")))
    except (RecordingError, RecursionError, ValueError, TypeError) as error:
        raise RecordingError(
            f"{saved}: cannot be read: {' '.join(str(error).split())}; it holds the settings of the session: "
            "make sure that the settings are the same, then delete it and continue with --resume"
        ) from None


def _compare(path: Path, saved: Mapping[str, Any], given: Mapping[str, Any]) -> None:
    given = json.loads(json.dumps(given))  # turns tuples into lists, as in the saved settings
    for name in dict.fromkeys((*saved, *given)):
        if saved.get(name) != given.get(name):
            raise RecordingError(
                f"{path}: was started with {name} {_shorten(saved.get(name))}, not {_shorten(given.get(name))}; "
                "resume with the original settings, or give another file"
            )


def _shorten(value: Any) -> str:
    text = json.dumps(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
