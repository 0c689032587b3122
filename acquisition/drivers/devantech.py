"""Common part of the drivers of Devantech's I2C sonars: commands, waiting, addresses.

Registers (manuals of SRF02, SRF08, SRF10; Linux drivers/iio/proximity/srf08.c): 0 command / revision; from 2 on the
echoes as unsigned 16-bit numbers, high byte first, 0 for none. A listening sensor does not answer: the bus reads 0xFF
or the transfer is not acknowledged.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

from acquisition.drivers.driver import Echoes
from acquisition.drivers.i2c import FIRST_ADDRESS, LAST_ADDRESS, SmBus, open_bus, scan
from acquisition.errors import DeviceError, GarbledError, NoAnswerError, SettingError, StaleError

COMMAND, GAIN, RANGE = 0, 1, 2
REVISION, ECHOES = 0, 2
Output = Literal["inch", "cm", "us"]
RANGING: dict[Output, int] = {"inch": 0x50, "cm": 0x51, "us": 0x52}
# metres per count; microseconds are converted as in the sensor's own cm output, 58 us/cm
METRES: dict[Output, float] = {"inch": 0.0254, "cm": 0.01, "us": 0.01 / 58.0}
GENERAL_CALL = 0
UNLOCK = (0xA0, 0xAA, 0xA5)  # in this order, followed by the new 8-bit address
STEP_S = 256e-6  # listening time per count of the range register
# EREMOTEIO, ENXIO, EIO, ETIMEDOUT: errors of adapters for a missing acknowledge and a clock that is held too long
NOT_ACKNOWLEDGED = (121, 6, 5, 110)
MAX_TRIES = 3
POLL_S = 1e-3
MIN_CHECKED_S = 0.02  # listening time from which a check over a slow serial port still finds the sensor busy
SPACING_S = 0.065  # between pings, so that distant echoes of the first do not reach the second (SRF08 manual)
REACH_FACTOR, REACH_MARGIN_M = 1.05, 0.1  # tolerance for the clocks and offsets of real units
PATIENCE_S = 0.1  # after the listening time before the sensor counts as dead


@dataclass
class Devantech:
    """One sonar on an I2C bus.

    Attributes:
        bus: `smbus2.SMBus` or an object with its methods, such as an `ArduinoBus`.
        address: 7-bit, 0x70..0x7F.
        output: unit of the sensor's counts.
        sleep, clock: of the host, or of a twin, s.
    """

    bus: SmBus
    address: int = 0x70
    output: Output = "cm"
    sleep: Callable[[float], None] = time.sleep
    clock: Callable[[], float] = time.monotonic

    name: ClassVar[str]
    count: ClassVar[int] = 1  # number of echoes

    def __post_init__(self) -> None:
        """Raise SettingError for invalid settings."""
        check_address(self.address, self.name)
        if self.output not in RANGING:
            raise SettingError(f"{self.name} output must be one of {', '.join(RANGING)}, got {self.output!r}")

    @classmethod
    def open(cls, port: str = "/dev/i2c-1", **settings: Any) -> Any:
        """Open the sonar on an I2C bus of this machine or of an Arduino with the bridge sketch.

        Args:
            port: /dev/i2c-N, or the serial port of an Arduino such as /dev/ttyACM0.
            **settings: attributes of the class.

        Raises:
            DeviceError: the port does not exist or is not accessible.
        """
        bus = open_bus(port)
        try:
            return cls(bus, **settings)
        except SettingError:
            bus.close()
            raise

    @property
    def listening_s(self) -> float:
        """Listening time after a burst, s."""
        return 256 * STEP_S

    def settings(self) -> Iterator[tuple[int, int]]:
        """Yield registers and values to write before each ping."""
        return iter(())

    def ping(self) -> Echoes:
        """Fire once and return the ranges of the echoes, m.

        Raises:
            NoAnswerError: the sensor does not acknowledge, stays busy, did not become busy, or its line reads 0xFF.
        """
        self.fire()
        return self.fetch()

    def fire(self) -> None:
        """Write the settings, fire, and check that the sensor received the command.

        Raises:
            NoAnswerError: the sensor does not acknowledge.
            StaleError: it did not become busy: the command was lost, and the registers hold the previous echoes.
        """
        self.write_settings()
        send_command([self], lambda: self.write(COMMAND, RANGING[self.output]))

    def write_settings(self) -> None:
        """Write the settings, one register at a time."""
        for register, value in self.settings():
            self.write(register, value)

    def became_busy(self, sent: float) -> bool:
        """Return whether the sensor received the ranging command of time `sent`; False if it is too late to know.

        Raises:
            StaleError: the sensor answers although it should be listening.
        """
        if self.listening_s < MIN_CHECKED_S or not self._idle():
            return True
        if self.clock() - sent >= self.listening_s:
            return False
        raise StaleError(
            f"{self}: answers right after a ranging command, expected {self.listening_s * 1e3:.0f} ms without answer: "
            "the command was lost, and the echoes are those of the previous ping; check SDA, SCL and their pull-ups"
        )

    def fetch(self) -> Echoes:
        """Wait until the sensor stops listening and return the echoes, m; after `fire` or `fire_all`.

        Raises:
            NoAnswerError: the sensor stays busy, or its line reads 0xFF.
            GarbledError: an echo lies beyond the maximum range.
        """
        self.wait_until_idle()
        counts = self.counts()
        echoes = counts[: counts.index(0)] if 0 in counts else counts
        ranges = tuple(count * METRES[self.output] for count in echoes)
        self._check_reach(ranges)
        return Echoes(ranges, self.light())

    def revision(self) -> int:
        """Return the software revision, 1..254.

        Raises:
            NoAnswerError: the sensor does not answer.
        """
        value = self.retry(lambda: self.bus.read_byte_data(self.address, REVISION))
        if not 0 < value < 0xFF:
            raise NoAnswerError(f"{self}: revision reads {value}, expected 1 to 254: sensor busy or line open")
        return int(value)

    def light(self) -> int | None:
        """Return the value of the light sensor; None without a light sensor."""
        return None

    def set_address(self, address: int) -> None:
        """Set another 7-bit address, which the sensor stores permanently.

        All sonars on the bus would accept it, so there must be exactly one.

        Raises:
            SettingError: the address is not in 0x70..0x7F, or another sonar is on the bus.
            NoAnswerError: the sensor does not answer at its old or at its new address.
        """
        check_address(address, self.name)
        self.revision()
        others = [found for found in scan(self.bus) if found != self.address]
        if others:
            listed = ", ".join(f"0x{found:02X}" for found in others)
            raise SettingError(f"{self}: to change its address it must be alone on the bus, also found {listed}")
        for value in (*UNLOCK, address << 1):
            self.write(COMMAND, value)
        self.address = address
        self.revision()

    def __str__(self) -> str:
        return f"{self.name} at 0x{self.address:02X}"

    def write(self, register: int, value: int) -> None:
        """Write one register; see `retry`."""
        self.retry(lambda: self.bus.write_byte_data(self.address, register, value))

    def retry(self, transfer: Callable[[], Any]) -> Any:
        """Run a transfer; repeat it a few times after a missing acknowledge."""
        for _ in range(MAX_TRIES):
            try:
                return transfer()
            except OSError as error:
                self._check_error(error)
                self.sleep(POLL_S)
        raise NoAnswerError(
            f"{self}: no acknowledge in {MAX_TRIES} tries {POLL_S * 1e3:g} ms apart; {self._found()}"
            "; check power, wires and address"
        )

    def wait_until_idle(self) -> None:
        """Wait until the sensor answers again, at most the listening time plus 0.1 s.

        Raises:
            NoAnswerError: the sensor stays busy.
        """
        deadline = self.clock() + self.listening_s + PATIENCE_S
        self.sleep(self.listening_s)
        while self._busy():
            if self.clock() >= deadline:
                waited = (self.listening_s + PATIENCE_S) * 1e3
                raise NoAnswerError(f"{self}: still busy {waited:.0f} ms after a ping; check power and wires")
            self.sleep(POLL_S)

    def counts(self) -> list[int]:
        """Return the `count` echo registers.

        Raises:
            NoAnswerError: they read as an open line.
        """
        data = self.retry(lambda: self.read_registers(ECHOES, 2 * self.count))
        counts = [high << 8 | low for high, low in zip(data[::2], data[1::2], strict=True)]
        if 0xFFFF in counts:
            raise NoAnswerError(f"{self}: echo registers read 0xFFFF: the line was open; check wires and pull-ups")
        return counts

    def read_registers(self, register: int, size: int) -> list[int]:
        """Return registers in one transfer; an SMBus block is limited to 32 bytes, and up to 34 are needed."""
        from smbus2 import i2c_msg

        answer = i2c_msg.read(self.address, size)
        self.bus.i2c_rdwr(i2c_msg.write(self.address, [register]), answer)
        return list(bytes(answer.buf[: answer.len]))

    def _check_reach(self, ranges: tuple[float, ...]) -> None:
        """Raise GarbledError for an impossible range, from a bit error or a range register lost in a reset."""
        reach = REACH_FACTOR * self.listening_s * 1e6 * METRES["us"] + REACH_MARGIN_M
        if ranges and max(ranges) > reach:
            raise GarbledError(
                f"{self}: echo at {max(ranges):.2f} m, beyond its set maximum of {reach:.2f} m: the sensor was "
                "reset or a bit was corrupted; check its power and the pull-ups"
            )

    def _idle(self) -> bool:
        """Return whether the sensor answers right after a command; checks twice, because a read can fail by itself."""
        for _ in range(2):
            self.sleep(POLL_S)
            if not self._busy():
                return True
        return False

    def _busy(self) -> bool:
        try:
            return not 0 < self.bus.read_byte_data(self.address, REVISION) < 0xFF
        except OSError as error:
            self._check_error(error)
            return True

    def _check_error(self, error: OSError) -> None:
        """Raise DeviceError unless the error is a missing acknowledge."""
        if isinstance(error, DeviceError):
            raise error
        if error.errno not in NOT_ACKNOWLEDGED:
            raise DeviceError(f"{self}: the bus failed: {error.strerror or error}; check its wires") from error

    def _found(self) -> str:
        try:
            found = [f"0x{address:02X}" for address in scan(self.bus)]
        except DeviceError:
            found = []
        return f"found {', '.join(found)} instead" if found else "no sonar answers on this bus"


def fire_all(sonars: Sequence[Devantech]) -> None:
    """Fire all sonars of a bus simultaneously by a general call; then call `fetch` for each.

    Raises:
        SettingError: no sonars, or several output units.
        NoAnswerError: no sonar acknowledges, or one did not receive the command.
    """
    if len({sonar.output for sonar in sonars}) != 1:
        raise SettingError("a general call is one command: give sonars of one bus, all with the same output")
    for sonar in sonars:
        sonar.write_settings()
    first = sonars[0]
    send_command(
        sonars, lambda: first.retry(lambda: first.bus.write_byte_data(GENERAL_CALL, COMMAND, RANGING[first.output]))
    )


def send_command(sonars: Sequence[Devantech], send: Callable[[], object]) -> None:
    """Send a ranging command and check that the sonars received it; repeat if this host was too slow to check.

    Raises:
        StaleError: a sonar did not receive it.
        NoAnswerError: the host was too slow each time.
    """
    clock = sonars[0].clock
    for _ in range(MAX_TRIES):
        sent = clock()
        send()
        if all(sonar.became_busy(sent) for sonar in sonars):
            return
        sonars[0].sleep(SPACING_S)
    raise NoAnswerError(
        f"{sonars[0]}: this computer was {MAX_TRIES} times too slow to check a ranging command, which is possible for "
        f"{sonars[0].listening_s * 1e3:.0f} ms only; reduce its load or raise the range register"
    )


def check_address(address: int, name: str) -> None:
    """Raise SettingError unless the address is a 7-bit address of these sonars."""
    if not FIRST_ADDRESS <= address <= LAST_ADDRESS:
        raise SettingError(
            f"{name} address must lie from 0x{FIRST_ADDRESS:02X} to 0x{LAST_ADDRESS:02X} (7 bits), got "
            f"0x{address:02X}: halve an 8-bit address such as 0xE0"
        )


def check_register(name: str, value: int, high: int, unit: str) -> None:
    """Raise SettingError unless the value is a whole number from 0 to `high`."""
    if not 0 <= value <= high or value != int(value):
        raise SettingError(f"{name} must be a whole number from 0 to {high}, got {value} ({unit})")
