"""What is diagnosed: labelled trials of the generators, hard cases, and halves of real recordings."""

from __future__ import annotations

import os
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from acquisition import Recording
from training.diagnosis.generators.ensemble import kinds_of, make_trial
from training.diagnosis.generators.hard import HARD
from training.diagnosis.generators.trial import Trial, TrueCause
from training.diagnosis.judging import real

HARD_CASE, REAL, TIMED = "hard", "real", "timed"
TIMED_PINGS = (2_000, 10_000, 133_100)  # sizes for which the design states a time
RECORDINGS = Path(os.environ.get("SONAR_GYM_SHARED", Path(__file__).resolve().parents[4] / "shared")) / "recordings"


@dataclass(frozen=True)
class Task:
    """One recording to diagnose.

    Attributes:
        family: of generators, or `HARD_CASE`, `REAL` or `TIMED`.
        kind: of trial, or the name of the case.
        number: of the trial within its family and kind.
        seed: of all random numbers.
        pings: approximate number in each recording.
    """

    family: str
    kind: str
    number: int
    seed: int
    pings: int

    @property
    def id(self) -> str:
        """Name of the task, which fixes its data."""
        return f"{self.family}/{self.kind}/{self.number}/seed {self.seed}/{self.pings} pings"

    def rng(self) -> np.random.Generator:
        """Return the source of the randomness of the task; it depends on the task alone."""
        return np.random.default_rng([self.seed, self.number, zlib.crc32(f"{self.family}/{self.kind}".encode())])


@dataclass(frozen=True, eq=False)
class Case:
    """Recordings of a simulated and a real sonar with the answer.

    Attributes:
        simulated, recorded: what the diagnosis gets.
        causes: true causes.
        fault: plain description of a difference that is in no catalogue; "" otherwise.
        fresh: recording, simulation and second recording under other conditions; empty where there are none.
    """

    simulated: Recording
    recorded: Recording
    causes: tuple[TrueCause, ...] = ()
    fault: str = ""
    fresh: tuple[Recording, ...] = field(default=())


def trials(families: Sequence[str], kinds: Sequence[str], n: int, seed: int, pings: int) -> list[Task]:
    """Return n tasks of each family and kind, in turn, so that an unfinished run holds about equally many of each."""
    pairs = [(family, kind) for family in families for kind in kinds if kind in kinds_of(family)]
    return [Task(family, kind, k, seed, pings) for k in range(n) for family, kind in pairs]


def hard_cases(seed: int, pings: int) -> list[Task]:
    """Return the hard cases, the real recordings that are there, and one trial of each size that is timed."""
    tasks = [Task(HARD_CASE, name, 0, seed, pings) for name in HARD]
    tasks += [Task(REAL, name, 0, seed, pings) for name in real.cases(RECORDINGS)]
    return tasks + [Task(TIMED, "single", 0, seed, size) for size in TIMED_PINGS]


def case_of(task: Task) -> Case:
    """Return the recordings and the answer of a task."""
    rng = task.rng()
    if task.family == REAL:
        simulated, recorded, causes = real.planted(RECORDINGS, task.kind, rng)
        return Case(simulated, recorded, causes)
    if task.family == HARD_CASE:
        return _case(HARD[task.kind](rng))
    family = "rig" if task.family == TIMED else task.family
    return _case(make_trial(family, task.kind, rng, pings=task.pings))


def _case(trial: Trial) -> Case:
    fresh = (trial.fresh, trial.fresh_simulated, trial.fresh_again)
    return Case(trial.simulated, trial.recorded, trial.causes, trial.fault, fresh)
