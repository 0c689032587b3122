"""What a session measures with: the waveform rig, or a sonar behind a driver and somebody who moves the reflector."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from acquisition.bench.rig import Rig
from acquisition.drivers.driver import Driver
from acquisition.errors import NoAnswerError
from acquisition.ping import EchoStatus, Ping, Reading
from acquisition.plan import Cell, Plan

Floats = NDArray[np.float64]
DRIFT_STREAM = 2**31  # a stream of randomness that no cell number reaches


@dataclass(frozen=True)
class Measured:
    """What a cell gave: conditions with the times they were met at, readings, and what was logged beside them."""

    ping: Ping
    reading: Reading
    columns: Mapping[str, Floats] = field(default_factory=dict)


class Source(Protocol):
    """Whatever a session measures with."""

    @property
    def simulated(self) -> bool:
        """Whether its time stands still between sessions, so that a resumed recording is one uninterrupted run."""

    def measure(self, plan: Plan, number: int) -> Measured:
        """Measure one cell of a plan, by its number in the plan's order."""


@dataclass(frozen=True)
class RigSource:
    """The waveform rig. Every cell has randomness of its own, so a resumed recording is the same as an unbroken one."""

    rig: Rig
    seed: int = 0
    simulated: bool = True

    def measure(self, plan: Plan, number: int) -> Measured:
        """Record one cell at the time that the plan gives it."""
        drift = self.rig.draw_drift(np.random.default_rng([self.seed, DRIFT_STREAM]))
        ping = plan.ping(number)
        registers = self.rig.ping(ping, np.random.default_rng([self.seed, number]), drift)
        return Measured(ping, registers.reading(self.rig.setup), self.rig.columns(ping, registers))


@dataclass
class DriverSource:
    """A sonar behind a driver; a dead wire is written down as no answer and the survey goes on.

    Attributes:
        driver: the sonar.
        arrange: called with each cell before it is measured: an operator's prompt, a turntable, a twin's `place`.
        columns: what to log beside every ping, under its column's name: settings, a thermometer's value.
        patience: pings in a row without an answer after which the survey stops rather than fill with nothing.
        sleep, clock: of the host.
        simulated: whether clock and sonar stand still between sessions.
    """

    driver: Driver
    arrange: Callable[[Cell], None] = lambda cell: None
    columns: Mapping[str, float | Callable[[], float]] = field(default_factory=dict)
    patience: int = 100
    sleep: Callable[[float], None] = time.sleep
    clock: Callable[[], float] = time.monotonic
    simulated: bool = False

    def __post_init__(self) -> None:
        """Start counting time."""
        self._began = self.clock()
        self._unanswered = 0

    def measure(self, plan: Plan, number: int) -> Measured:
        """Have the cell arranged, then ping at the plan's interval."""
        self.arrange(plan.cell(number))
        rows = [self._ping(plan.interval_s) for _ in range(plan.pings)]
        ping = replace(plan.ping(number), time=np.array([row[0] for row in rows]))
        logged = {name: np.array([row[2][name] for row in rows]) for name in self.columns}
        return Measured(ping, _reading([row[1] for row in rows]), logged)

    def _ping(self, interval_s: float) -> tuple[float, tuple[float, ...] | None, dict[str, float]]:
        """Ping once, take its due of time, and return when, what was heard (None: no answer) and what was logged."""
        now = self.clock()
        heard = self._hear()
        logged = {name: value() if callable(value) else value for name, value in self.columns.items()}
        self.sleep(max(0.0, now + interval_s - self.clock()))
        return now - self._began, heard, logged

    def _hear(self) -> tuple[float, ...] | None:
        try:
            ranges = self.driver.ping().ranges
        except NoAnswerError as error:
            self._unanswered += 1
            if self._unanswered >= self.patience:
                raise NoAnswerError(f"{error} ({self._unanswered} pings in a row; the cells before are kept)") from None
            return None
        self._unanswered = 0
        return ranges


def _reading(heard: list[tuple[float, ...] | None]) -> Reading:
    depth = max((len(ranges) for ranges in heard if ranges), default=1)
    table = np.zeros((len(heard), depth))
    for row, ranges in zip(table, heard, strict=True):
        row[: len(ranges or ())] = ranges or ()
    status = np.where(table[:, 0] > 0, EchoStatus.ECHO, EchoStatus.NO_ECHO)
    status[[ranges is None for ranges in heard]] = EchoStatus.NO_ANSWER
    return Reading.of(table[:, 0], status, table[:, 1:])
