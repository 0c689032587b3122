"""Checksums of plain data and of files."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any


def canonical(content: Mapping[str, Any]) -> str:
    """Return the only text of a content that is hashed."""
    return json.dumps(content, sort_keys=True, separators=(",", ":"))


def sha256(data: str | bytes) -> str:
    """Return the SHA-256 of text or bytes, 64 hexadecimal digits."""
    return hashlib.sha256(data.encode() if isinstance(data, str) else data).hexdigest()


def sha256_of_files(paths: Iterable[Path]) -> str:
    """Return the SHA-256 of names and contents of files, in the order of their names."""
    return sha256(canonical({path.name: sha256(path.read_bytes()) for path in paths}))
