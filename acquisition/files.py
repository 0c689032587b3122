"""Files that are there whole or not at all."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any


def write_atomic(path: Path, write: Callable[[IO[Any]], None], binary: bool = False) -> Path:
    """Write a file beside `path`, force it to disk, and put it in the place of `path`.

    Args:
        path: whose folder is made where it is missing.
        write: is given the open file; when it fails, `path` is as it was before.
        binary: whether it writes bytes.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=path.name, suffix=".part")
    try:
        with os.fdopen(handle, "wb") if binary else os.fdopen(handle, "w", encoding="utf-8", newline="") as file:
            write(file)
            file.flush()
            os.fsync(file.fileno())
        os.chmod(temporary, 0o644)
        os.replace(temporary, path)
    finally:
        Path(temporary).unlink(missing_ok=True)
    return path


def write_text(path: Path, text: str) -> Path:
    """Write text, whole or not at all."""
    return write_atomic(path, lambda file: _all(file, text))


def write_bytes(path: Path, data: bytes) -> Path:
    """Write bytes, whole or not at all."""
    return write_atomic(path, lambda file: _all(file, data), binary=True)


def _all(file: IO[Any], content: str | bytes) -> None:
    file.write(content)
