"""Sources of pings for a session: the simulated rig, or a sonar with a driver."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from copy import copy
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Protocol

import numpy as np

from acquisition.arrays import Floats
from acquisition.bench.rig import Rig
from acquisition.drivers.driver import SonarDriver
from acquisition.drivers.srf08 import Adjustable
from acquisition.errors import DeviceError, NoAnswerError, SettingError
from acquisition.io.files import read_limited
from acquisition.limits import shown
from acquisition.ping import EchoStatus, Ping, Reading
from acquisition.survey.apply_settings import apply_settings
from acquisition.survey.plan import Condition, SurveyPlan
from acquisition.survey.quantities import SWEEPS

MAX_CHARACTERS = 100  # of a thermometer's file
MAX_FAILED_READS = 3  # in a row, of a thermometer during a survey
DRIFT_STREAM = 2**31  # random stream of the drift; larger than any condition number
TEST_PINGS, TEST_INTERVAL_S = 5, 0.07  # of the connection test before a session


@dataclass(frozen=True)
class VisitData:
    """Pings and readings of one visit.

    Attributes:
        ping: conditions, with the times of the pings.
        reading: readings.
        columns: further logged quantities by column name, each (n,).
    """

    ping: Ping
    reading: Reading
    columns: Mapping[str, Floats] = field(default_factory=dict)


class PingSource(Protocol):
    """Source of the pings of a session."""

    @property
    def simulated(self) -> bool:
        """Whether time stands still between sessions, so that a resumed recording is one uninterrupted run."""

    def check(self) -> bool:
        """Check that the sonar answers; return whether it receives any echo.

        Raises:
            NoAnswerError: the connection failed.
        """

    def measure(self, plan: SurveyPlan, number: int) -> VisitData:
        """Measure one condition of a plan, by its number in the plan's order.

        Raises:
            NoAnswerError: the connection failed; no ping of the condition is valid.
        """


@dataclass(frozen=True)
class RigSource:
    """The simulated rig. Each condition has its own random stream, so a resumed recording equals an unbroken one."""

    rig: Rig
    seed: int = 0
    simulated: bool = True

    def check(self) -> bool:
        """Return True: the rig always answers."""
        return True

    def measure(self, plan: SurveyPlan, number: int) -> VisitData:
        """Simulate one condition at the plan's times."""
        rig = apply_settings(self.rig, plan.condition(number))
        drift = rig.draw_drift(np.random.default_rng([self.seed, DRIFT_STREAM]))
        ping = plan.ping(number)
        registers = rig.ping(ping, np.random.default_rng([self.seed, number]), drift)
        return VisitData(ping, registers.reading(rig.setup), rig.columns(ping, registers))


@dataclass
class DriverSource:
    """A sonar with a driver. A single ping without answer is recorded as such; a failed connection is an error.

    Attributes:
        driver: of the sonar.
        prepare: called with each condition before its pings: writes registers, moves a turntable or places a twin.
        columns: values to log with every ping by column name: constants, or functions such as a thermometer.
        patience: number of consecutive pings without answer at which the connection counts as failed.
        sleep, clock: of the host, s.
        simulated: whether clock and sonar stand still between sessions.
    """

    driver: SonarDriver
    prepare: Callable[[Condition], None] = lambda condition: None
    columns: Mapping[str, float | Callable[[], float]] = field(default_factory=dict)
    patience: int = 10
    sleep: Callable[[float], None] = time.sleep
    clock: Callable[[], float] = time.monotonic
    simulated: bool = False

    def __post_init__(self) -> None:
        """Raise SettingError for an invalid `patience`, and start the clock."""
        if self.patience < 1:
            raise SettingError(f"patience must be at least 1 ping, got {self.patience}")
        self._start = self.clock()
        self._unanswered = 0

    def check(self) -> bool:
        """Send a few test pings; see `PingSource.check`."""
        has_echo = []
        for _ in range(TEST_PINGS):
            try:
                has_echo.append(bool(self.driver.ping().ranges))
            except NoAnswerError as error:
                last = error
            self.sleep(TEST_INTERVAL_S)
        if not has_echo:
            raise NoAnswerError(f"{last} (no answer to {TEST_PINGS} pings: the connection failed)")
        return any(has_echo)

    def measure(self, plan: SurveyPlan, number: int) -> VisitData:
        """Prepare one condition, then ping at the plan's interval."""
        self.prepare(plan.condition(number))
        rows = [self._ping(plan.interval_s) for _ in range(plan.pings)]
        if all(row[1] is None for row in rows):
            self.check()  # fewer pings than `patience`, all without answer: test the connection
        ping = replace(plan.ping(number), time=np.array([row[0] for row in rows]))
        logged = {name: np.array([row[2][name] for row in rows]) for name in self.columns}
        return VisitData(ping, _reading([row[1] for row in rows]), logged)

    def _ping(self, interval_s: float) -> tuple[float, tuple[float, ...] | None, dict[str, float]]:
        """Ping once and wait for the interval; return time, ranges (None: no answer) and logged values."""
        now = self.clock()
        ranges = self._ranges()
        logged = {name: value() if callable(value) else value for name, value in self.columns.items()}
        self.sleep(max(0.0, now + interval_s - self.clock()))
        return now - self._start, ranges, logged

    def _ranges(self) -> tuple[float, ...] | None:
        try:
            ranges = self.driver.ping().ranges
        except NoAnswerError as error:
            self._unanswered += 1
            if self._unanswered >= self.patience:
                count, self._unanswered = self._unanswered, 0
                raise NoAnswerError(f"{error} (no answer to {count} pings in a row: the connection failed)") from None
            return None
        self._unanswered = 0
        return ranges


def _reading(answers: list[tuple[float, ...] | None]) -> Reading:
    n_echoes = max((len(ranges) for ranges in answers if ranges), default=1)
    table = np.zeros((len(answers), n_echoes))
    for row, ranges in zip(table, answers, strict=True):
        row[: len(ranges or ())] = ranges or ()
    status = np.where(table[:, 0] > 0, EchoStatus.ECHO, EchoStatus.NO_ECHO)
    status[[ranges is None for ranges in answers]] = EchoStatus.NO_ANSWER
    return Reading.of(table[:, 0], status, table[:, 1:])


def register_writer(sonar: SonarDriver) -> Callable[[Condition], None]:
    """Return a function that sets the swept registers of a condition, for `DriverSource.prepare`.

    Raises (when called):
        SettingError: the plan sweeps a register that this sonar does not have, or a value that it cannot hold.
    """

    def write(condition: Condition) -> None:
        for name, value in condition.swept:
            if not SWEEPS[name].by_hand:
                if not hasattr(sonar, name):
                    raise SettingError(f"{sonar} has no {SWEEPS[name].label}: remove `sweep.{name}` from the plan")
                setattr(sonar, name, int(value))
                _check_registers(sonar, name)

    return write


def _check_registers(sonar: SonarDriver, name: str) -> None:
    try:
        if isinstance(sonar, Adjustable):
            sonar.check_registers()
    except SettingError as error:
        raise SettingError(f"{error}: change `sweep.{name}` in the plan") from None


def check_sweep(sonar: SonarDriver, plan: SurveyPlan) -> None:
    """Check before the first visit of a plan that the sonar has its registers and values; see `register_writer`."""
    write = register_writer(copy(sonar))
    for condition in plan.conditions:
        write(condition)


@dataclass
class Thermometer:
    """A file with a temperature in thousandths of a degree, as Linux provides for 1-Wire and hwmon thermometers.

    Attributes:
        path: of the file.
        every_s: interval after which the file is read again, s; a DS18B20 needs 0.75 s per conversion.
        clock: of the host, s.
    """

    path: Path
    every_s: float = 10.0
    clock: Callable[[], float] = time.monotonic

    def __post_init__(self) -> None:
        """Read the file once, so that a missing thermometer is an error before the survey."""
        self._value, self._when, self._failed = 0.0, 0.0, 0
        self._read()

    def __call__(self) -> float:
        """Return the temperature, degC; the last one where the file cannot be read now and then, as on a 1-Wire bus.

        Raises:
            DeviceError: the file is missing or has had no valid temperature for a few reads.
        """
        if self.clock() - self._when > self.every_s:
            try:
                self._read()
            except DeviceError:
                self._when, self._failed = self.clock(), self._failed + 1
                if self._failed > MAX_FAILED_READS:
                    raise
        return self._value

    def _read(self) -> None:
        expected = "a thermometer's file, with thousandths of a degree Celsius"
        data = read_limited(self.path, DeviceError, expected)
        try:
            value = int(data[:MAX_CHARACTERS]) / 1000.0
        except ValueError:
            raise DeviceError(
                f"thermometer {self.path}: reads {shown(data[:MAX_CHARACTERS].decode('ascii', 'replace'))}, expected "
                "thousandths of a degree Celsius; check its wires"
            ) from None
        if not -60.0 <= value <= 84.9:  # a DS18B20 returns 85 degC until its first conversion
            raise DeviceError(f"thermometer {self.path}: {value:g} degC, expected -60 to 84.9 degC; check its wires")
        self._value, self._when, self._failed = value, self.clock(), 0
