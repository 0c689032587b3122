"""The decorator for compiled kernels, with a cache on disk that follows all source files.

Numba reuses a cached kernel while the file of the outermost function is unchanged, even if a kernel that it calls from
another file has changed (Numba manual, "Caching of compiled functions", limitations). Therefore every cache index older
than the newest source file with kernels is removed on import.
"""

from __future__ import annotations

import time
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

from numba import njit

PACKAGE = Path(__file__).parent


def drop_stale(folder: Path) -> list[Path]:
    """Remove the cache indices of kernels that are older than the newest source file of any kernel.

    Args:
        folder: folder of the package; Numba writes to the `__pycache__` next to each module.

    Returns:
        The removed indices. Without its index, Numba compiles a kernel again.
    """
    indices = list(folder.glob("**/__pycache__/*.nbi"))
    sources = _modified({index.parent.parent / f"{index.name.split('.')[0]}.py" for index in indices})
    # a modification time in the future must not empty the cache at every start
    newest = max((time_s for time_s in sources if time_s <= time.time()), default=0.0)
    stale = [index for index in indices for time_s in _modified([index]) if time_s < newest]
    for index in stale:
        with suppress(OSError):  # already removed by another process, or the folder is read-only
            index.unlink()
    return stale


def _modified(files: Iterable[Path]) -> list[float]:
    """Return the modification times of files, s; missing files are skipped."""
    found = []
    for file in files:
        with suppress(OSError):
            found.append(file.stat().st_mtime)
    return found


drop_stale(PACKAGE)
compiled = njit(cache=True, nogil=True)
