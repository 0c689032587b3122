"""Who knew what when: seeds that nobody chose, hashes written before answers are opened, a ledger that only grows.

The protocol, trial by trial:

1. A generating process makes the two recordings from a seed that follows from commit, protocol and nonce, and returns
   the answer; only its salted hash goes into the ledger, with the hashes of both files.
2. A diagnosing process is handed the two files. Its verdict goes into the ledger, with its hash.
3. The answer is opened: it goes into the ledger with its salt, so that anybody can check the hash, and is scored.

Every line of the ledger holds the hash of the line before, so no trial can be left out or changed afterwards without
every later line telling. A line is forced to disk before anything else happens; a kill loses the trials at work only.
"""

from __future__ import annotations

import hashlib
import hmac
import json
import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from acquisition import SonarError
from acquisition.io.files import lock, sync_folder

PROTOCOL = "2"
FIRST = "0" * 64  # what stands for the line before the first
SEALED, VERDICT, OPENED = "sealed", "verdict", "opened"


class LedgerError(SonarError):
    """A ledger is broken, of another run, or in use."""


def seed_of(commit: str, seed: int, nonce: str, trial: int) -> str:
    """Return the secret that everything of a trial is drawn from, 64 hexadecimal digits."""
    return hashlib.sha256(f"sonar-gym proof {PROTOCOL}|{commit}|{seed}|{nonce}|{trial}".encode()).hexdigest()


def salt_of(secret: str) -> str:
    """Return the salt of a trial's answer, which cannot be told from its recordings."""
    return hmac.new(secret.encode(), b"salt", hashlib.sha256).hexdigest()[:32]


def written(content: Mapping[str, Any]) -> str:
    """Return one and the same text for the same content."""
    return json.dumps(content, sort_keys=True, separators=(",", ":"))


def hash_of(content: Mapping[str, Any], salt: str = "") -> str:
    """Return the SHA-256 of a content, salted."""
    return hashlib.sha256((salt + written(content)).encode()).hexdigest()


def hash_of_file(path: Path) -> str:
    """Return the SHA-256 of a file."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


@dataclass
class Ledger:
    """An append-only file of what happened, one JSON object a line, each bound to the one before.

    Attributes:
        path: of the file.
        lines: its content.
    """

    path: Path
    lines: list[dict[str, Any]] = field(default_factory=list)
    _handle: int = -1

    @classmethod
    def open(cls, path: Path, settings: Mapping[str, Any]) -> Ledger:
        """Open a ledger of these settings, new or begun; a last line that a kill tore is taken off.

        Raises:
            LedgerError: another process writes it, it is of other settings, or it was changed.
        """
        path.parent.mkdir(parents=True, exist_ok=True)
        handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND, 0o644)
        if not lock(handle):
            os.close(handle)
            raise LedgerError(f"{path}: another process is writing this ledger; wait for it or choose another --out")
        sync_folder(path.parent)
        content = path.read_bytes()
        whole = content[: content.rfind(b"\n") + 1]
        os.ftruncate(handle, len(whole))
        ledger = cls(path, read(whole.decode(), str(path)), handle)
        if not ledger.lines:
            ledger.append("begun", settings=dict(settings))
        elif ledger.lines[0]["settings"] != dict(settings):
            ledger.close()
            raise LedgerError(f"{path}: begun with {written(ledger.lines[0]['settings'])}; choose another --out")
        return ledger

    def append(self, event: str, **content: Any) -> None:
        """Write one line and force it to disk."""
        before = self.lines[-1]["hash"] if self.lines else FIRST
        line = {"event": event, **content, "before": before}
        line["hash"] = hash_of(line)
        os.write(self._handle, (written(line) + "\n").encode())
        os.fsync(self._handle)
        self.lines.append(line)

    def of(self, event: str) -> dict[int, dict[str, Any]]:
        """Return the lines of one kind by trial."""
        return {line["trial"]: line for line in self.lines if line["event"] == event}

    def close(self) -> None:
        """Let go of the file."""
        os.close(self._handle)


def read(text: str, name: str) -> list[dict[str, Any]]:
    """Return the lines of a ledger.

    Raises:
        LedgerError: a line is no JSON, or was changed, left out or put in after it was written.
    """
    before, out = FIRST, []
    for number, raw in enumerate(text.splitlines(), start=1):
        try:
            line = json.loads(raw)
            told = line.pop("hash")
        except (ValueError, KeyError, AttributeError):
            raise LedgerError(f"{name}, line {number}: no line of a ledger") from None
        if line["before"] != before or hash_of(line) != told:
            raise LedgerError(f"{name}, line {number}: changed after it was written, or a line before it is missing")
        before = told
        out.append({**line, "hash": told})
    return out


def check(lines: Iterable[Mapping[str, Any]]) -> None:
    """Check that each opened trial was sealed, then judged, then opened, and that its hashes hold.

    Raises:
        LedgerError: naming the trial.
    """
    sealed: dict[int, str] = {}
    judged: set[int] = set()
    for line in lines:
        trial = line.get("trial", -1)
        if line["event"] == SEALED:
            _once(trial not in sealed, trial, "sealed twice")
            sealed[trial] = line["answer_sha256"]
        elif line["event"] == VERDICT:
            _once(trial in sealed and trial not in judged, trial, "judged before it was sealed, or twice")
            _once(hash_of(line["verdict"]) == line["verdict_sha256"], trial, "its verdict does not match its hash")
            judged.add(trial)
        elif line["event"] == OPENED:
            _once(trial in judged, trial, "opened before it was judged")
            _once(hash_of(line["answer"], line["salt"]) == sealed[trial], trial, "its answer does not match its hash")


def _once(holds: bool, trial: int, told: str) -> None:
    if not holds:
        raise LedgerError(f"trial {trial}: {told}")
