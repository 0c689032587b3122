"""Tables of credence on disk, in the user's cache folder, under a key of everything that they depend on."""

from __future__ import annotations

import hashlib
import os
import pickle
from collections.abc import Callable
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from acquisition.arrays import Floats

ROOMS = ("parking", "sensing", "control")  # whose sources the tables depend on


def folder() -> Path:
    """Return the cache folder, which `SONAR_GYM_CACHE` overrides."""
    base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return Path(os.environ.get("SONAR_GYM_CACHE") or base / "sonar-gym")


@lru_cache(maxsize=1)
def _sources() -> bytes:
    """Return a digest of the sources that the tables depend on."""
    root, total = Path(__file__).parents[1], hashlib.sha256()
    for file in sorted(file for room in ROOMS for file in (root / room).glob("*.py")):
        total.update(file.read_bytes())
    return total.digest()


def stored(key: tuple[Any, ...], make: Callable[[], Floats]) -> Floats:
    """Return an array from disk, or make and store it; nothing is stored if the key cannot be pickled.

    Args:
        key: everything that the array depends on, such as the model with its weights.
        make: computes the array.
    """
    try:
        name = hashlib.sha256(_sources() + pickle.dumps(key)).hexdigest()[:32]
    except (pickle.PicklingError, TypeError, AttributeError):
        return make()
    path = folder() / f"credence-{name}.npy"
    with suppress(OSError, ValueError, EOFError):
        found: Floats = np.load(path, allow_pickle=False)
        return found
    value = make()
    with suppress(OSError):  # a read-only home folder costs the time of the computation only
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary = path.with_suffix(f".{os.getpid()}.tmp")
        with temporary.open("wb") as file:
            np.save(file, value)
        temporary.replace(path)
    return value
