"""Atomic writes of files and folders, file locks and forced writes to disk."""

from __future__ import annotations

import ctypes
import errno
import os
import secrets
import stat
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Any, Literal

from acquisition.errors import SettingError, SonarError
from acquisition.limits import shown

MAX_BYTES = 64 * 1024 * 1024  # of a file of settings
TEXT: dict[str, Any] = {"encoding": "utf-8", "errors": "backslashreplace", "newline": ""}  # a name may not be UTF-8
UNFINISHED: set[str] = set()  # files that this process is writing, which nobody else will remove
DISK_ERRORS = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)


@contextmanager
def _named(path: Path) -> Iterator[None]:
    """Name the file or folder in an error of its disk: a write that fails names none."""
    try:
        yield
    except OSError as error:
        if error.filename is None and error.errno in DISK_ERRORS:
            error.filename = str(path)
        raise


@contextmanager
def _made(folder: Path) -> Iterator[None]:
    """Create a folder and its missing parents; those that are empty are removed again if the block raises."""
    missing = [each for each in (folder, *folder.parents) if not each.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        yield
    except BaseException:
        for each in missing:
            with suppress(OSError):  # not empty: another process uses it
                each.rmdir()
        raise


def write_atomic(path: Path, write: Callable[[IO[Any]], object], binary: bool = False) -> Path:
    """Write a temporary file beside `path`, force it to disk, and rename it to `path`.

    A link remains one, and a file that exists keeps its permissions.

    Args:
        path: file to write; missing parent folders are created.
        write: receives the open file; if it raises, `path` remains unchanged.
        binary: open the file for bytes instead of text.
    """
    check_path(path, "file")
    exists = path.exists()
    target = path.resolve() if exists else path
    temporary = f"{target}{secrets.token_hex(4)}.part"
    with _made(target.parent):
        UNFINISHED.add(temporary)
        try:
            with _named(path), open(temporary, "xb") if binary else open(temporary, "x", **TEXT) as file:
                write(file)
                file.flush()
                os.fsync(file.fileno())
            if exists:
                os.chmod(temporary, stat.S_IMODE(target.stat().st_mode))
            os.replace(temporary, target)
        finally:
            Path(temporary).unlink(missing_ok=True)
            UNFINISHED.discard(temporary)
    return path


def is_folder(path: str | os.PathLike[str]) -> bool:
    """Return whether a path is a folder; False also for text that cannot be a path."""
    try:
        return Path(path).is_dir()
    except (OSError, ValueError):  # too long, or with a null character
        return False


def is_file(path: str | os.PathLike[str]) -> bool:
    """Return whether a path is a file; False also for text that cannot be a path."""
    try:
        return Path(path).is_file()
    except (OSError, ValueError):
        return False


def check_path(path: Path, kind: Literal["file", "folder", "any"] = "any") -> None:
    """Check that a path can be that of a file or folder.

    Raises:
        SettingError: it has a null character, a name that is too long, or is of another kind, such as a device.
    """
    try:
        mode = os.stat(path).st_mode
        found = "folder" if stat.S_ISDIR(mode) else "file" if stat.S_ISREG(mode) else "device or a pipe"
    except FileNotFoundError:
        return
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise SettingError(f"{shown(str(path))}: cannot be a path: {reason}") from None
    if kind not in ("any", found):
        raise SettingError(f"{path}: is a {found}, expected the name of a {kind}")


def read_limited(path: Path, error: type[SonarError], expected: str, max_bytes: int = MAX_BYTES) -> bytes:
    """Return the content of a file on a disk: never that of a device, which may have no end, or of a pipe.

    Args:
        path: of the file.
        error: raised if it is no such file, cannot be read, or is too large.
        expected: what the file should be, for the message.
        max_bytes: largest size.
    """
    try:
        mode, data = path.stat().st_mode, b""
        if stat.S_ISREG(mode):
            with path.open("rb") as file:
                data = file.read(max_bytes + 1)
    except (OSError, ValueError) as failed:  # a null character
        reason = getattr(failed, "strerror", None) or failed
        raise error(f"{path}: cannot be read: {reason}; give {expected}") from None
    if not stat.S_ISREG(mode):
        what = "a folder" if stat.S_ISDIR(mode) else "a device or a pipe"
        raise error(f"{path}: is {what}, expected {expected}")
    if len(data) > max_bytes:
        raise error(f"{path}: has more than {max_bytes // 2**20} MiB, expected {expected}")
    return data


def write_text(path: Path, text: str) -> Path:
    """Write text atomically."""
    return write_atomic(path, lambda file: file.write(text))


def write_bytes(path: Path, data: bytes) -> Path:
    """Write bytes atomically."""
    return write_atomic(path, lambda file: file.write(data), binary=True)


@contextmanager
def whole_folder(folder: Path) -> Iterator[Path]:
    """Yield an empty folder that replaces `folder` when the block ends without an error.

    The old and the new folder change places in one step of the operating system (Linux, macOS), so that a complete one
    stands at the path at every instant. Elsewhere two renames leave an instant between them.

    Args:
        folder: to create or replace; it remains unchanged if the block raises.
    """
    check_path(folder, "folder")
    with _made(folder.parent), tempfile.TemporaryDirectory(dir=folder.parent, prefix=f".{folder.name}") as beside:
        fresh, old = Path(beside) / "fresh", Path(beside) / "old"
        fresh.mkdir()
        with _named(folder):
            yield fresh
            for file in fresh.rglob("*"):
                _sync(file)
        if folder.exists() and not _exchange(fresh, folder):
            os.replace(folder, old)
        if not folder.exists():
            os.replace(fresh, folder)
        sync_folder(folder.parent)


def _sync(path: Path) -> None:
    if path.is_file():
        with path.open("rb+") as file:
            os.fsync(file.fileno())


def _exchange(one: Path, other: Path) -> bool:
    """Let two folders change places in one step; returns whether the operating system could."""
    name, flag = {"linux": ("renameat2", 2), "darwin": ("renameatx_np", 2)}.get(sys.platform, ("", 0))
    swap = getattr(ctypes.CDLL(None), name, None) if name else None
    here = -100 if sys.platform == "linux" else -2  # AT_FDCWD: paths are relative to the working directory
    return swap is not None and swap(here, os.fsencode(one), here, os.fsencode(other), ctypes.c_uint(flag)) == 0


def lock(handle: int) -> bool:
    """Lock a file for this process until it closes the file or ends.

    Args:
        handle: of the open file.

    Returns:
        False if another process holds the lock.
    """
    if sys.platform == "win32":
        import msvcrt

        os.lseek(handle, 2**40, os.SEEK_SET)  # one byte far behind the content, so that others can still read
        return _acquired(lambda: msvcrt.locking(handle, msvcrt.LK_NBLCK, 1))
    import fcntl

    return _acquired(lambda: fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB))


def _acquired(take: Callable[[], None]) -> bool:
    try:
        take()
    except (BlockingIOError, PermissionError):
        return False
    except OSError as error:
        if error.errno not in (errno.ENOLCK, errno.EOPNOTSUPP, errno.ENOSYS):
            raise
    return True  # also on network file systems without locks, where the user must prevent a second writer


def sync_folder(path: Path) -> None:
    """Force a folder's entries to disk, where the operating system supports it."""
    if sys.platform == "win32":
        return
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
