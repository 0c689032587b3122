"""Files that are there whole or not at all."""

from __future__ import annotations

import errno
import os
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
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


@contextmanager
def whole_folder(folder: Path) -> Iterator[Path]:
    """Yield an empty folder beside `folder`, and put it in its place once everything in it is written.

    Args:
        folder: to make or replace; it is as it was before where anything fails.
    """
    folder.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=folder.parent, prefix=f".{folder.name}") as beside:
        fresh, old = Path(beside) / "fresh", Path(beside) / "old"
        fresh.mkdir()
        yield fresh
        if folder.exists():
            os.replace(folder, old)
        os.replace(fresh, folder)


def lock(handle: int) -> bool:
    """Keep a file to this process until it ends, however it ends; False where another process has it.

    Args:
        handle: of the open file.
    """
    if sys.platform == "win32":
        import msvcrt

        os.lseek(handle, 2**40, os.SEEK_SET)  # one byte far behind the content: reading stays free
        return _free(lambda: msvcrt.locking(handle, msvcrt.LK_NBLCK, 1))
    import fcntl

    return _free(lambda: fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB))


def _free(take: Callable[[], None]) -> bool:
    try:
        take()
    except (BlockingIOError, PermissionError):
        return False
    except OSError as error:
        if error.errno not in (errno.ENOLCK, errno.EOPNOTSUPP, errno.ENOSYS):
            raise
    return True  # some network disks know no locks: there the user has to take care


def sync_folder(path: Path) -> None:
    """Force the entry of a new file to disk, where the system knows how."""
    if sys.platform == "win32":
        return
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
