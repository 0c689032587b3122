"""The diagnosing process: it is handed a folder with two recordings and returns a verdict. It can open nothing else.

An audit hook, which no code can take off again, refuses every file of the proof but those two, every other process,
the network, the environment's usual holes (/proc), and the modules that know what is concealed. That keeps an honest
program honest; it is no wall against one that was written to break out of it.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Any

from acquisition import Recording
from noise import IdealModel
from noise.discrepancy import Diagnosis, diagnose
from training.proof.desk import ROOT, serve
from training.proof.told import told

SIMULATED, RECORDED = "simulated.csv", "recorded.csv"
FOLLOWING = ("measured-", "anywhere-")  # beginnings of the names of what is measured next
MAKERS = ("generate", "trials", "assess")
FORBIDDEN_MODULES = ("acquisition.bench", *(f"training.proof.{name}" for name in MAKERS))
FORBIDDEN_EVENTS = (
    "subprocess.Popen",
    "os.system",
    "os.exec",
    "os.fork",
    "os.posix_spawn",
    "socket.connect",
    "ctypes.dlopen",
)


class SealError(RuntimeError):
    """The diagnosing process reached for what it must not see."""


class Guard:
    """What the audit hook allows; the folder changes with the trial."""

    def __init__(self) -> None:
        """Allow no folder yet."""
        self.folder: Path | None = None

    def __call__(self, event: str, arguments: tuple[Any, ...]) -> None:
        """Refuse an event that could tell the answer."""
        if self.folder is None:
            return
        if event == "import" and str(arguments[0]).startswith(FORBIDDEN_MODULES):
            raise SealError(f"the diagnosing process may not import {arguments[0]}")
        if event in FORBIDDEN_EVENTS:
            raise SealError(f"the diagnosing process may not {event}")
        if event in ("open", "os.listdir", "os.scandir") and isinstance(arguments[0], str | bytes | Path):
            self.see(arguments[0])

    def see(self, name: str | bytes | Path) -> None:
        """Refuse a path that belongs to the proof and is not one of the two recordings, or that tells of processes."""
        assert self.folder is not None
        path = Path(os.path.realpath(os.fsdecode(name)))
        run = self.folder.parent.parent
        own = path in (self.folder / SIMULATED, self.folder / RECORDED)
        library = path.is_relative_to(ROOT) or path.is_relative_to(sys.prefix)
        of_the_run = path.is_relative_to(run) and not own and not library and not self.may_follow(path)
        if of_the_run or is_maker(path) or path.is_relative_to("/proc"):
            raise SealError(f"the diagnosing process may not look at {path}")

    def may_follow(self, path: Path) -> bool:
        """Tell whether a path is of what the diagnosis asked to measure next."""
        assert self.folder is not None
        return path.parent == self.folder and path.name.startswith(FOLLOWING)


def is_maker(path: Path) -> bool:
    """Tell whether a file is source or byte code of what makes trials; not every import announces itself."""
    proof = ROOT / "training" / "proof"
    parts = {part.split(".")[0] for part in path.parts[len(proof.parts) :]} if path.is_relative_to(proof) else set()
    return path.is_relative_to(ROOT / "acquisition" / "bench") or not parts.isdisjoint(MAKERS)


def examined(folder: Path, without: tuple[str, ...] = ()) -> dict[str, Any]:
    """Diagnose the two recordings of a folder.

    Args:
        folder: holds them.
        without: effects to take out of the catalogue first.
    """
    begun = time.perf_counter()
    found = diagnosed(folder, without)
    return {"verdict": found.to_verdict(), "seconds": round(time.perf_counter() - begun, 2)}


@lru_cache(maxsize=1)
def diagnosed(folder: Path, without: tuple[str, ...]) -> Diagnosis:
    """Return the diagnosis of a folder; it is kept, for what is measured next to be held against it."""
    simulated, recorded = (Recording.load(folder / name) for name in (SIMULATED, RECORDED))
    return diagnose(IdealModel(), recorded, simulated=simulated, seed=0, without=without)


def guarded() -> tuple[Guard, Callable[[dict[str, Any]], dict[str, Any]]]:
    """Return the guard, its hook installed, and the answer to a question."""
    guard = Guard()
    sys.addaudithook(guard)

    def answer(question: dict[str, Any]) -> dict[str, Any]:
        guard.folder = Path(question["folder"]).resolve()
        if question.get("follow"):
            return {"told": told(diagnosed(guard.folder, ()), guard.folder)}
        return examined(guard.folder, tuple(question.get("without", ())))

    return guard, answer


if __name__ == "__main__":
    serve(guarded()[1])
