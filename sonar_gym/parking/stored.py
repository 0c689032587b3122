"""Tables of credence on disk: shipped ones, and others in the user's cache folder.

The cache has a key of everything that a table depends on, the sources included. A shipped table has a key of its task
and of the weights of its model and of the agent that drives, so that one that is out of date is not found and counted
anew. After a change of the environment's sources `sonar-gym make-credence` makes all again.
"""

from __future__ import annotations

import hashlib
import json
import os
import pickle
from collections.abc import Callable
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from acquisition import SonarError
from acquisition.arrays import Floats
from acquisition.version import __version__
from noise import save_model

# Files that the tables depend on: the environment, the driving agent with its weights, and the laws
SOURCES = (
    "sonar_gym/*.py",
    *(f"sonar_gym/{room}/**/*.py" for room in ("control", "parking", "sensing", "street")),
    "sonar_gym/weights/parking/*",
    "noise/*.py",
    "noise/effects/**/*.py",
    "noise/learned/**/*.py",
)
WEIGHTS = Path(__file__).parents[1] / "weights"
SHIPPED = WEIGHTS / "credence.npz"
AGENT = WEIGHTS / "parking" / "weights.safetensors"  # of the agent that drives


def folder() -> Path:
    """Return the cache folder, which `SONAR_GYM_CACHE` overrides."""
    base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return Path(os.environ.get("SONAR_GYM_CACHE") or base / "sonar-gym")


@lru_cache(maxsize=1)
def _sources() -> bytes:
    """Return a digest of the sources that the tables depend on, and of the version, for those of other packages."""
    total = hashlib.sha256(__version__.encode())
    for file in source_files():
        total.update(file.read_bytes())
    return total.digest()


def source_files() -> list[Path]:
    """Return the files that the tables depend on, in order."""
    root = Path(__file__).parents[2]
    return sorted(file for pattern in SOURCES for file in root.glob(pattern))


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


@lru_cache(maxsize=1)
def _agent() -> str:
    """Return a digest of the weights of the agent that drives."""
    return hashlib.sha256(AGENT.read_bytes()).hexdigest()[:16]


@lru_cache(maxsize=16)
def fingerprint(model: Any) -> str:
    """Return a digest of a model as it is saved, without its notes (`about`); empty if it cannot be saved."""
    with TemporaryDirectory() as folder:
        try:
            saved = save_model(model, Path(folder) / "model")
        except (SonarError, AttributeError, TypeError):
            return ""
        text = json.loads((saved / "model.json").read_text(encoding="utf-8"))
        text.pop("about", None)
        weights = saved / "weights.safetensors"
        data = json.dumps(text, sort_keys=True).encode() + (weights.read_bytes() if weights.exists() else b"")
        return hashlib.sha256(data).hexdigest()[:16]


def shipped_key(model: Any, task: Any) -> str:
    """Return the name of a shipped table; latencies, names and a period that all sonars share do not change it."""
    places = [(m.x, m.y, m.heading_deg, m.cone_deg, m.phase_s, m.height_m) for m in task.mounts]
    driver = _agent() if task.driver == "agent" else task.driver
    in_turn = len({m.phase_s for m in task.mounts}) > 1
    periods = ([m.period_s for m in task.mounts],) if in_turn else ()  # the previous bursts are heard, too
    parts = task.streets, task.car, places, task.max_range, driver, task.crosstalk, *periods
    return f"{fingerprint(model)}-{hashlib.sha256(repr(parts).encode()).hexdigest()[:16]}"


@lru_cache(maxsize=1)
def _shipped_tables() -> dict[str, Floats]:
    if not SHIPPED.exists():
        return {}
    with np.load(SHIPPED, allow_pickle=False) as file:
        return dict(zip(file["keys"].tolist(), file["tables"].astype(np.float64), strict=True))


def shipped(model: Any, task: Any) -> Floats | None:
    """Return the shipped credence of a model's readings in a task, (s, BINS); None if there is none."""
    table = _shipped_tables().get(shipped_key(model, task))
    return None if table is None else table[: len(task.mounts)]
