"""What a session measures with: the waveform rig, or a sonar behind a driver and somebody who moves the reflector."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from acquisition.bench.rig import Rig
from acquisition.drivers.driver import Driver
from acquisition.errors import DeviceError, NoAnswerError, SettingError
from acquisition.ping import EchoStatus, Ping, Reading
from acquisition.survey.apply_settings import arranged
from acquisition.survey.plan import Cell, Plan
from acquisition.survey.quantities import SWEEPS

Floats = NDArray[np.float64]
DRIFT_STREAM = 2**31  # a stream of randomness that no cell number reaches
TESTS, TEST_S = 5, 0.07  # pings before a session, and s from one to the next


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

    def check(self) -> bool:
        """Make sure that the sonar answers; tell whether it hears anything.

        Raises:
            NoAnswerError: the wire is dead.
        """

    def measure(self, plan: Plan, number: int) -> Measured:
        """Measure one cell of a plan, by its number in the plan's order.

        Raises:
            NoAnswerError: the wire is dead; nothing of the cell is to be kept.
        """


@dataclass(frozen=True)
class RigSource:
    """The waveform rig. Every cell has randomness of its own, so a resumed recording is the same as an unbroken one."""

    rig: Rig
    seed: int = 0
    simulated: bool = True

    def check(self) -> bool:
        """Tell that the rig always answers."""
        return True

    def measure(self, plan: Plan, number: int) -> Measured:
        """Record one cell at the time that the plan gives it."""
        rig = arranged(self.rig, plan.cell(number))
        drift = rig.draw_drift(np.random.default_rng([self.seed, DRIFT_STREAM]))
        ping = plan.ping(number)
        registers = rig.ping(ping, np.random.default_rng([self.seed, number]), drift)
        return Measured(ping, registers.reading(rig.setup), rig.columns(ping, registers))


@dataclass
class DriverSource:
    """A sonar behind a driver. Single pings without an answer are written down as such; a dead wire is an error.

    Attributes:
        driver: the sonar.
        prepare: called with each cell before it is measured: registers to write, a turntable, a twin's `place`.
        columns: what to log beside every ping, under its column's name: settings, a thermometer's value.
        patience: pings in a row without an answer after which the wire counts as dead.
        sleep, clock: of the host.
        simulated: whether clock and sonar stand still between sessions.
    """

    driver: Driver
    prepare: Callable[[Cell], None] = lambda cell: None
    columns: Mapping[str, float | Callable[[], float]] = field(default_factory=dict)
    patience: int = 10
    sleep: Callable[[float], None] = time.sleep
    clock: Callable[[], float] = time.monotonic
    simulated: bool = False

    def __post_init__(self) -> None:
        """Start counting time."""
        if self.patience < 1:
            raise SettingError(f"patience must be at least 1 ping, got {self.patience}")
        self._began = self.clock()
        self._unanswered = 0

    def check(self) -> bool:
        """Ping a few times; see `Source.check`."""
        heard = []
        for _ in range(TESTS):
            try:
                heard.append(bool(self.driver.ping().ranges))
            except NoAnswerError as error:
                last = error
            self.sleep(TEST_S)
        if not heard:
            raise NoAnswerError(f"{last} ({TESTS} pings, no answer: this is no silence)")
        return any(heard)

    def measure(self, plan: Plan, number: int) -> Measured:
        """Have the cell arranged, then ping at the plan's interval."""
        self.prepare(plan.cell(number))
        rows = [self._ping(plan.interval_s) for _ in range(plan.pings)]
        if all(row[1] is None for row in rows):
            self.check()  # fewer pings than patience, but not one answer: dead, unless it answers now
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
                count, self._unanswered = self._unanswered, 0
                raise NoAnswerError(f"{error} ({count} pings in a row, no answer: this is no silence)") from None
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


def told(sonar: Driver) -> Callable[[Cell], None]:
    """Return what tells a sonar the registers of each cell, for `DriverSource.prepare`.

    Raises (when called):
        SettingError: the plan sweeps a register that this sonar does not have.
    """

    def tell(cell: Cell) -> None:
        for name, value in cell.swept:
            if not SWEEPS[name].by_hand:
                if not hasattr(sonar, name):
                    raise SettingError(f"{sonar} has no {SWEEPS[name].what}: take `sweep.{name}` out of the plan")
                setattr(sonar, name, int(value))

    return tell


@dataclass
class Thermometer:
    """A file that holds a temperature in thousandths of a degree, as Linux shows 1-Wire and hwmon thermometers.

    Attributes:
        path: of the file.
        every_s: how long a value is good for; a DS18B20 takes 0.75 s for one.
        clock: of the host.
    """

    path: Path
    every_s: float = 10.0
    clock: Callable[[], float] = time.monotonic

    def __post_init__(self) -> None:
        """Read it once, so that a missing thermometer is told before the survey."""
        self._read()

    def __call__(self) -> float:
        """Return the temperature, degC.

        Raises:
            DeviceError: there is no such file, or it holds something else.
        """
        if self.clock() - self._when > self.every_s:
            self._read()
        return self._value

    def _read(self) -> None:
        try:
            value = int(self.path.read_text(encoding="ascii")) / 1000.0
        except (OSError, ValueError) as error:
            raise DeviceError(f"thermometer {self.path}: {error}; expected thousandths of a degree Celsius") from None
        if not -60.0 <= value <= 84.9:  # a DS18B20 shows 85 degC until it has measured
            raise DeviceError(f"thermometer {self.path}: {value:g} degC, expected -60 to 84.9 degC; check its wires")
        self._value, self._when = value, self.clock()
