"""How kernels are compiled: once a machine, kept beside the package, and anew whenever any of their sources changes.

Numba keeps what it compiled as long as the file of the outermost function is the same. A kernel that calls another
file's kernels would go on with their old text (Numba manual, "Caching of compiled functions", limitations); so what is
older than the newest of the files is dropped before anything is read.
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
    newest = max((age for age in sources if age <= time.time()), default=0.0)  # a wrong clock must not undo every start
    stale = [index for index in indices for age in _ages([index]) if age < newest]
    for index in stale:
        with suppress(OSError):  # another process was faster, or the folder is not ours to write to
            index.unlink()
    return stale


def _ages(files: Iterable[Path]) -> list[float]:
    """Return when files were last written; those that are gone have no age."""
    times = []
    for file in files:
        with suppress(OSError):
            times.append(file.stat().st_mtime)
    return times


drop_stale(HERE)
compiled = njit(cache=True, nogil=True)
