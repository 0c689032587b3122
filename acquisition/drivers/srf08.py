"""Driver of the Devantech SRF08 on an I2C bus.

Registers (SRF08 manual; Linux drivers/iio/proximity/srf08.c): 0 command / revision, 1 gain / light, 2 range / first
echo, 2..35 seventeen echoes as unsigned 16-bit numbers, high byte first, 0 for none. While it listens the sensor does
not answer: the bus reads 0xFF or the transfer is not acknowledged. Gain and range live in RAM and cannot be read back,
so they are written, each on its own, before every ping: a sensor that was reset would work at full gain and 11 m.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, Protocol

from acquisition.drivers.driver import Echoes
from acquisition.errors import DeviceError, NoAnswerError, SettingError

COMMAND, GAIN, RANGE = 0, 1, 2
REVISION, LIGHT, ECHOES = 0, 1, 2
COUNT = 17
Output = Literal["inch", "cm", "us"]
RANGING: dict[Output, int] = {"inch": 0x50, "cm": 0x51, "us": 0x52}
# metres a count; microseconds by the constant that the sensor itself uses for centimetres, 58 us/cm
METRES: dict[Output, float] = {"inch": 0.0254, "cm": 0.01, "us": 0.01 / 58.0}
UNLOCK = (0xA0, 0xAA, 0xA5)  # in this order, then the new 8-bit address
FIRST_ADDRESS, LAST_ADDRESS = 0x70, 0x7F
STEP = 256e-6  # s of listening a count of the range register
NOT_ACKNOWLEDGED = (121, 6, 5)  # EREMOTEIO, ENXIO, EIO: what Linux adapters make of a missing acknowledge
RETRIES = 3
POLL = 1e-3  # s
PATIENCE = 0.1  # s beyond listening before the sensor counts as dead


class SmBus(Protocol):
    """The part of `smbus2.SMBus` that is used."""

    def write_byte_data(self, i2c_addr: int, register: int, value: int) -> None:
        """Write one register."""

    def read_byte_data(self, i2c_addr: int, register: int) -> int:
        """Read one register."""

    def i2c_rdwr(self, *i2c_msgs: Any) -> None:
        """Run combined messages of `smbus2.i2c_msg`."""


@dataclass
class Srf08:
    """One SRF08.

    Attributes:
        bus: `smbus2.SMBus` or anything of its shape.
        address: 7-bit, 0x70..0x7F.
        gain: code 0..31 of the amplifier's cap.
        range_register: 0..255; echoes are awaited for (r + 1) * 256 us.
        output: unit in which the sensor counts.
        sleep, clock: of the host; a twin brings its own.
    """

    bus: SmBus
    address: int = 0x70
    gain: int = 31
    range_register: int = 255
    output: Output = "cm"
    sleep: Callable[[float], None] = time.sleep
    clock: Callable[[], float] = time.monotonic

    def __post_init__(self) -> None:
        """Refuse settings that the sensor cannot hold."""
        check_address(self.address)
        _check("gain", self.gain, 31, "code; the manual's table ends at 31")
        _check("range register", self.range_register, 255, "steps of 43 mm")
        if self.output not in RANGING:
            raise SettingError(f"SRF08 output must be one of {', '.join(RANGING)}, got {self.output!r}")

    @classmethod
    def open(cls, bus: int = 1, **settings: Any) -> Srf08:
        """Open the SRF08 on a bus of this machine, /dev/i2c-<bus>.

        Raises:
            DeviceError: there is no such bus, or it may not be used.
        """
        from smbus2 import SMBus  # only here is a real bus needed

        try:
            return cls(SMBus(bus), **settings)
        except OSError as error:
            raise DeviceError(
                f"/dev/i2c-{bus}: {error.strerror or error}; switch I2C on, give another bus, or join the group i2c"
            ) from None

    @property
    def listening(self) -> float:
        """How long the sensor listens after a burst, s."""
        return (self.range_register + 1) * STEP

    def ping(self) -> Echoes:
        """Fire once and return the ranges of up to 17 echoes, m.

        Raises:
            NoAnswerError: the sensor does not acknowledge, or stays busy, or its line reads 0xFF throughout.
        """
        for register, value in ((GAIN, self.gain), (RANGE, self.range_register), (COMMAND, RANGING[self.output])):
            self._write(register, value)
        self._await_end()
        counts = self._counts()
        heard = counts[: counts.index(0)] if 0 in counts else counts
        return Echoes(tuple(count * METRES[self.output] for count in heard), self.light())

    def revision(self) -> int:
        """Return the software revision, 1..254.

        Raises:
            NoAnswerError: the sensor does not answer.
        """
        value = self._retry(lambda: self.bus.read_byte_data(self.address, REVISION))
        if not 0 < value < 0xFF:
            raise NoAnswerError(f"{self}: revision reads {value}, expected 1 to 254: sensor busy or line open")
        return value

    def light(self) -> int:
        """Return the light sensor's value, taken just before the last burst, 0..255."""
        return self._retry(lambda: self.bus.read_byte_data(self.address, LIGHT))

    def move(self, address: int) -> None:
        """Give the sensor another 7-bit address, kept without power. It must be alone on the bus.

        Raises:
            SettingError: not an address of 0x70..0x7F.
        """
        check_address(address)
        for value in (*UNLOCK, address << 1):
            self._write(COMMAND, value)
        self.address = address

    def __str__(self) -> str:
        return f"SRF08 at 0x{self.address:02X}"

    def _write(self, register: int, value: int) -> None:
        self._retry(lambda: self.bus.write_byte_data(self.address, register, value))

    def _retry(self, transfer: Callable[[], Any]) -> Any:
        """Run a transfer, again after a missing acknowledge, a few times."""
        for _ in range(RETRIES):
            try:
                return transfer()
            except OSError as error:
                if error.errno not in NOT_ACKNOWLEDGED:
                    raise DeviceError(f"{self}: the bus failed: {error.strerror or error}; check its wires") from error
                self.sleep(POLL)
        raise NoAnswerError(
            f"{self}: no acknowledge in {RETRIES} tries {POLL * 1e3:g} ms apart; check power, wires and address"
        )

    def _await_end(self) -> None:
        deadline = self.clock() + self.listening + PATIENCE
        self.sleep(self.listening)
        while self._busy():
            if self.clock() >= deadline:
                waited = (self.listening + PATIENCE) * 1e3
                raise NoAnswerError(f"{self}: still busy {waited:.0f} ms after a ping; check power and wires")
            self.sleep(POLL)

    def _busy(self) -> bool:
        try:
            return not 0 < self.bus.read_byte_data(self.address, REVISION) < 0xFF
        except OSError as error:
            if error.errno not in NOT_ACKNOWLEDGED:
                raise DeviceError(f"{self}: the bus failed: {error.strerror or error}; check its wires") from error
            return True

    def _counts(self) -> list[int]:
        block = self._retry(self._block)
        counts = [high << 8 | low for high, low in zip(block[::2], block[1::2], strict=True)]
        if counts[0] == 0xFFFF:
            raise NoAnswerError(f"{self}: echo registers read 0xFFFF: the line was open; check wires and pull-ups")
        return counts

    def _block(self) -> list[int]:
        # an SMBus block ends at 32 bytes, and 34 are wanted in one go
        from smbus2 import i2c_msg

        answer = i2c_msg.read(self.address, 2 * COUNT)
        self.bus.i2c_rdwr(i2c_msg.write(self.address, [ECHOES]), answer)
        return list(bytes(answer.buf[: answer.len]))


def check_address(address: int) -> None:
    """Refuse what is no 7-bit address of an SRF08.

    Raises:
        SettingError: naming limits and value.
    """
    if not FIRST_ADDRESS <= address <= LAST_ADDRESS:
        raise SettingError(
            f"SRF08 address must lie from 0x{FIRST_ADDRESS:02X} to 0x{LAST_ADDRESS:02X} (7 bits), got "
            f"0x{address:02X}: halve an 8-bit address such as 0xE0"
        )


def _check(name: str, value: int, high: int, unit: str) -> None:
    if not 0 <= value <= high or value != int(value):
        raise SettingError(f"SRF08 {name} must be a whole number from 0 to {high}, got {value} ({unit})")
