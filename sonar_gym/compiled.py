"""The decorator for compiled kernels, with a cache on disk that follows all source files.

Numba reuses a cached kernel while the file of the outermost function is unchanged, even if a kernel that it calls from
another file has changed (Numba manual, "Caching of compiled functions", limitations). Therefore every cache index older
than the newest source file with kernels is removed on import.
"""

from __future__ import annotations

import os
import tempfile
import time
import warnings
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

from numba import config, njit

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


def use_temporary_cache() -> tempfile.TemporaryDirectory[str] | None:
    """Let Numba write its cache to a private temporary folder where it can write to no other, and warn.

    The folder is new for each command, whose worker processes share it, and removed at its end: Numba runs what it
    finds in its cache, so the folder must not be one that another user can prepare.

    Returns:
        The folder, None if it is not needed.
    """
    try:
        njit(cache=True)(_probe)
    except RuntimeError:  # "cannot cache function: no locator available"
        folder = tempfile.TemporaryDirectory(prefix="sonar-gym-numba-")
        config.CACHE_DIR = folder.name  # type: ignore[attr-defined]
        os.environ["NUMBA_CACHE_DIR"] = folder.name  # for worker processes
        warnings.warn(
            f"neither {PACKAGE} nor the home folder can be written: kernels are compiled again at every start, which "
            "takes a minute; set NUMBA_CACHE_DIR to a folder of your own to keep them",
            RuntimeWarning,
            stacklevel=2,
        )
        return folder
    return None


def _probe() -> int:
    return 0


drop_stale(PACKAGE)
TEMPORARY_CACHE = use_temporary_cache()
compiled = njit(cache=True, nogil=True)
