"""Compilation of kernels by numba, with a cache that is invalidated when any source file changes.

Numba checks only the file of the outermost function. A kernel that calls kernels of another file would keep their old
version (Numba manual, "Caching of compiled functions", limitations). So caches that are older than the newest source
file are removed before they are read.
"""

from __future__ import annotations

import time
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

from numba import njit

HERE = Path(__file__).parent


def drop_stale(folder: Path) -> list[Path]:
    """Remove the indices of compiled kernels below a folder that are older than the source of any of them.

    Args:
        folder: of the package; Numba writes to the `__pycache__` beside each module.

    Returns:
        What was removed. Without its index, Numba compiles a kernel again.
    """
    indices = list(folder.glob("**/__pycache__/*.nbi"))
    sources = _ages({index.parent.parent / f"{index.name.split('.')[0]}.py" for index in indices})
    newest = max(
        (age for age in sources if age <= time.time()), default=0.0
    )  # a future time stamp must not invalidate the cache at every start
    stale = [index for index in indices for age in _ages([index]) if age < newest]
    for index in stale:
        with suppress(OSError):  # removed by another process, or the folder is read-only
            index.unlink()
    return stale


def _ages(files: Iterable[Path]) -> list[float]:
    """Return the modification times of files that exist."""
    times = []
    for file in files:
        with suppress(OSError):
            times.append(file.stat().st_mtime)
    return times


drop_stale(HERE)
compiled = njit(cache=True, nogil=True)
