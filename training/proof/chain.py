"""An append-only hash chain of JSON lines: each line holds the SHA-256 of itself and of the line before."""

from __future__ import annotations

import io
import json
import lzma
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from threading import Lock
from typing import Any

from acquisition import SonarError
from acquisition.io.files import lock, read_limited, sync_folder
from training.common.checksum import canonical, sha256

MAX_LEDGER = 256 * 1024 * 1024  # bytes, decompressed; the last line of a longer one is cut short
MAX_LINE = 16 * 1024 * 1024  # bytes of one line; that of a trial has some 40 kB
BEGIN = b'{"'  # of every line
FIRST = "0" * 64  # stands for the hash of the line before the first
Line = dict[str, Any]


class ProofError(SonarError):
    """A ledger is damaged, belongs to other settings, or is in use."""


def linked(event: str, content: Mapping[str, Any], before: str) -> Line:
    """Return a line of a ledger, bound to the line before."""
    line = {"event": event, **content, "before": before}
    return {**line, "hash": sha256(canonical(line))}


@dataclass
class Chain:
    """A ledger that is being written; threads may share it.

    Attributes:
        path: of the file.
        lines: its content.
    """

    path: Path
    lines: list[Line] = field(default_factory=list)
    _handle: int = -1
    _turn: Lock = field(default_factory=Lock)

    @classmethod
    def open(cls, path: Path) -> Chain:
        """Open a new or unfinished ledger; a last line that an interruption cut short is removed.

        Raises:
            ProofError: another process writes it, or it was changed.
        """
        path.parent.mkdir(parents=True, exist_ok=True)
        handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND, 0o644)
        try:
            if not lock(handle):
                raise ProofError(f"{path}: another process writes this ledger; wait for it or give another --out")
            sync_folder(path.parent)
            data = path.read_bytes()
            whole, rest = data[: data.rfind(b"\n") + 1], data[data.rfind(b"\n") + 1 :]
            lines = parse(whole, str(path))
            if not rest.startswith(BEGIN[: len(rest)]):
                raise ProofError(f"{path}: is no ledger that `sonar-gym prove` wrote; give another --out")
            os.ftruncate(handle, len(whole))
        except BaseException:
            os.close(handle)
            raise
        return cls(path, lines, handle)

    def append(self, *events: tuple[str, Mapping[str, Any]]) -> None:
        """Write lines with one system call and force them to disk."""
        with self._turn:
            new: list[Line] = []
            for event, content in events:
                before = (new or self.lines)[-1]["hash"] if new or self.lines else FIRST
                new.append(json.loads(canonical(linked(event, content, before))))
            data = "".join(canonical(line) + "\n" for line in new).encode()
            length = os.fstat(self._handle).st_size
            try:
                while data:
                    data = data[os.write(self._handle, data) :]
                os.fsync(self._handle)
            except BaseException:  # the disk is full: another thread must not write behind half a line
                os.ftruncate(self._handle, length)
                raise
            self.lines.extend(new)

    def of(self, event: str) -> dict[int, Line]:
        """Return the lines of an event by trial."""
        with self._turn:
            return of_event(self.lines, event)

    def close(self) -> None:
        """Release the file."""
        os.close(self._handle)


def of_event(lines: Sequence[Line], event: str) -> dict[int, Line]:
    """Return the lines of an event by trial."""
    return {line["trial"]: line for line in lines if line["event"] == event}


def load(path: Path) -> list[Line]:
    """Read a ledger, compressed by xz or not.

    Raises:
        ProofError: the file is missing, or a line was changed, removed, repeated or moved.
    """
    try:
        data = read_limited(path, ProofError, "a ledger that `sonar-gym prove` wrote", MAX_LEDGER)
        data = lzma.LZMADecompressor().decompress(data, MAX_LEDGER) if path.suffix == ".xz" else data
    except (EOFError, lzma.LZMAError) as error:
        raise ProofError(f"{path}: cannot be read ({error}); give a ledger that `sonar-gym prove` wrote") from None
    return parse(data, str(path))


def parse(data: bytes, name: str) -> list[Line]:
    """Return the lines of a ledger.

    The text of each line must be the canonical one, so that no byte can change without notice.

    Raises:
        ProofError: a line was changed, removed, repeated or moved; the end of the file cannot be seen from here.
    """
    if data and not data.endswith(b"\n"):
        raise ProofError(f"{name}: the last line is cut short")
    before, lines = FIRST, []
    for number, raw in enumerate(io.BytesIO(data), 1):
        line = _line(raw[:-1]) if len(raw) <= MAX_LINE else None
        if line is None or line != linked(line["event"], _content(line), before):
            raise ProofError(f"{name}, line {number}: it was changed, or a line before it was changed or removed")
        before = line["hash"]
        lines.append(line)
    return lines


def _line(raw: bytes) -> Line | None:
    try:
        line = json.loads(raw)
        valid = isinstance(line, dict) and "event" in line and canonical(line).encode() == raw
    except (ValueError, RecursionError):
        return None
    return line if valid else None


def _content(line: Line) -> Line:
    return {name: value for name, value in line.items() if name not in ("event", "before", "hash")}
