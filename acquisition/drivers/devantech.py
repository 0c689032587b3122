"""What Devantech's I2C sonars have in common: commands, waiting, addresses.

Registers (manuals of SRF02, SRF08, SRF10; Linux drivers/iio/proximity/srf08.c): 0 command / revision, from 2 on the
echoes as unsigned 16-bit numbers, high byte first, 0 for none. While it listens a sensor does not answer: the bus reads
0xFF or the transfer is not acknowledged.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

from acquisition.drivers.driver import Echoes
from acquisition.drivers.i2c import SmBus, open_bus, scan
from acquisition.errors import DeviceError, GarbledError, NoAnswerError, SettingError, StaleError

COMMAND, GAIN, RANGE = 0, 1, 2
REVISION, ECHOES = 0, 2
Output = Literal["inch", "cm", "us"]
RANGING: dict[Output, int] = {"inch": 0x50, "cm": 0x51, "us": 0x52}
# metres a count; microseconds by the constant that the sensor itself uses for centimetres, 58 us/cm
METRES: dict[Output, float] = {"inch": 0.0254, "cm": 0.01, "us": 0.01 / 58.0}
GENERAL_CALL = 0
UNLOCK = (0xA0, 0xAA, 0xA5)  # in this order, then the new 8-bit address
FIRST_ADDRESS, LAST_ADDRESS = 0x70, 0x7F
STEP = 256e-6  # s of listening a count of the range register
# EREMOTEIO, ENXIO, EIO, ETIMEDOUT: what adapters make of a missing acknowledge and of a clock held too long
NOT_ACKNOWLEDGED = (121, 6, 5, 110)
RETRIES = 3
POLL = 1e-3  # s
TELLING = 0.02  # s of listening from which a look over a slow serial port still meets a busy sensor
SPACING = 0.065  # s between two pings, so that the second does not hear the first's far echoes (SRF08 manual)
REACH, SPARE_M = 1.05, 0.1  # share and m by which clocks and zeros of real units may differ
PATIENCE = 0.1  # s beyond listening before the sensor counts as dead


@dataclass
class Devantech:
    """One sonar on an I2C bus.

    Attributes:
        bus: `smbus2.SMBus` or anything of its shape, such as an `ArduinoBus`.
        address: 7-bit, 0x70..0x7F.
        output: unit in which the sensor counts.
        sleep, clock: of the host; a twin brings its own.
    """

    bus: SmBus
    address: int = 0x70
    output: Output = "cm"
    sleep: Callable[[float], None] = time.sleep
    clock: Callable[[], float] = time.monotonic

    name: ClassVar[str]
    count: ClassVar[int] = 1  # echoes

    def __post_init__(self) -> None:
        """Refuse settings that the sensor cannot hold."""
        check_address(self.address, self.name)
        if self.output not in RANGING:
            raise SettingError(f"{self.name} output must be one of {', '.join(RANGING)}, got {self.output!r}")

    @classmethod
    def open(cls, port: str = "/dev/i2c-1", **settings: Any) -> Any:
        """Open the sonar on an I2C bus of this machine, or behind an Arduino with the bridge's sketch.

        Args:
            port: /dev/i2c-N, or the serial port of an Arduino such as /dev/ttyACM0.
            **settings: the class's attributes.

        Raises:
            DeviceError: there is no such port, or it may not be used.
        """
        bus = open_bus(port)
        try:
            return cls(bus, **settings)
        except SettingError:
            bus.close()
            raise

    @property
    def listening(self) -> float:
        """How long the sensor listens after a burst, s."""
        return 256 * STEP

    def settings(self) -> Iterator[tuple[int, int]]:
        """Return registers and values to write before each ping."""
        return iter(())

    def ping(self) -> Echoes:
        """Fire once and return the ranges of the echoes, m.

        Raises:
            NoAnswerError: the sensor does not acknowledge, stays busy, never went busy, or its line reads 0xFF.
        """
        self.fire()
        return self.fetch()

    def fire(self) -> None:
        """Write the settings, fire, and make sure that the sensor took the command.

        Raises:
            NoAnswerError: the sensor does not acknowledge.
            StaleError: it acknowledged and did not go busy: the command was lost, and its echoes are old ones.
        """
        self.prepare()
        command([self], lambda: self.write(COMMAND, RANGING[self.output]))

    def prepare(self) -> None:
        """Write the settings, each on its own."""
        for register, value in self.settings():
            self.write(register, value)

    def went_busy(self, began: float) -> bool:
        """Tell whether a ranging command arrived that was given at `began`; False where it is too late to tell.

        Raises:
            StaleError: the sensor answers, as it does not while it listens.
        """
        if self.listening < TELLING or not self._idle():
            return True
        if self.clock() - began >= self.listening:
            return False
        raise StaleError(
            f"{self}: answers at once after a ranging command, expected {self.listening * 1e3:.0f} ms of silence: "
            "the command was lost, and its echoes are those of the ping before; check SDA, SCL and their pull-ups"
        )

    def fetch(self) -> Echoes:
        """Await the end of listening and return the echoes, m; after `fire` or `fire_all`.

        Raises:
            NoAnswerError: the sensor stays busy, or its line reads 0xFF throughout.
            GarbledError: an echo lies beyond what the sensor was told to listen to.
        """
        self.await_end()
        counts = self.counts()
        heard = counts[: counts.index(0)] if 0 in counts else counts
        ranges = tuple(count * METRES[self.output] for count in heard)
        self._refuse_beyond(ranges)
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
        """Return the light sensor's value, where there is one."""
        return None

    def move(self, address: int) -> None:
        """Give the sensor another 7-bit address, kept without power.

        Every sonar of the bus would take it, so exactly one may be there.

        Raises:
            SettingError: not an address of 0x70..0x7F, or another sonar is on the bus.
            NoAnswerError: the sensor is not there, or does not answer at its new address.
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
        """Write one register, again after a missing acknowledge."""
        self.retry(lambda: self.bus.write_byte_data(self.address, register, value))

    def retry(self, transfer: Callable[[], Any]) -> Any:
        """Run a transfer, again after a missing acknowledge, a few times."""
        for _ in range(RETRIES):
            try:
                return transfer()
            except OSError as error:
                self._refuse_failure(error)
                self.sleep(POLL)
        raise NoAnswerError(
            f"{self}: no acknowledge in {RETRIES} tries {POLL * 1e3:g} ms apart; {self._found()}"
            "; check power, wires and address"
        )

    def await_end(self) -> None:
        """Wait until the sensor answers again, at most as long as it listens and 0.1 s.

        Raises:
            NoAnswerError: it does not.
        """
        deadline = self.clock() + self.listening + PATIENCE
        self.sleep(self.listening)
        while self._busy():
            if self.clock() >= deadline:
                waited = (self.listening + PATIENCE) * 1e3
                raise NoAnswerError(f"{self}: still busy {waited:.0f} ms after a ping; check power and wires")
            self.sleep(POLL)

    def counts(self) -> list[int]:
        """Return the echo registers, `count` of them.

        Raises:
            NoAnswerError: they read as an open line does.
        """
        block = self.retry(lambda: self.block(ECHOES, 2 * self.count))
        counts = [high << 8 | low for high, low in zip(block[::2], block[1::2], strict=True)]
        if 0xFFFF in counts:
            raise NoAnswerError(f"{self}: echo registers read 0xFFFF: the line was open; check wires and pull-ups")
        return counts

    def block(self, register: int, size: int) -> list[int]:
        """Return registers in one go: an SMBus block ends at 32 bytes, and up to 34 are wanted."""
        from smbus2 import i2c_msg

        answer = i2c_msg.read(self.address, size)
        self.bus.i2c_rdwr(i2c_msg.write(self.address, [register]), answer)
        return list(bytes(answer.buf[: answer.len]))

    def _refuse_beyond(self, ranges: tuple[float, ...]) -> None:
        """Refuse what cannot have been heard: a flipped bit, or a range register lost by a reset."""
        reach = REACH * self.listening * 1e6 * METRES["us"] + SPARE_M
        if ranges and max(ranges) > reach:
            raise GarbledError(
                f"{self}: echo at {max(ranges):.2f} m, but it was told to listen up to {reach:.2f} m: the sensor was "
                "reset or a bit flipped; check its power and the pull-ups"
            )

    def _idle(self) -> bool:
        """Tell whether the sensor answers just after a command; two looks, for a look may fail of itself."""
        for _ in range(2):
            self.sleep(POLL)
            if not self._busy():
                return True
        return False

    def _busy(self) -> bool:
        try:
            return not 0 < self.bus.read_byte_data(self.address, REVISION) < 0xFF
        except OSError as error:
            self._refuse_failure(error)
            return True

    def _refuse_failure(self, error: OSError) -> None:
        """Let a missing acknowledge pass, and tell of anything worse."""
        if isinstance(error, DeviceError):
            raise error
        if error.errno not in NOT_ACKNOWLEDGED:
            raise DeviceError(f"{self}: the bus failed: {error.strerror or error}; check its wires") from error

    def _found(self) -> str:
        try:
            found = [f"0x{address:02X}" for address in scan(self.bus)]
        except DeviceError:
            found = []
        return f"found {', '.join(found)} instead" if found else "no sonar's address answers on this bus"


def fire_all(sonars: Sequence[Devantech]) -> None:
    """Fire all sonars of one bus at once by the general call, in the first one's unit; then `fetch` from each.

    Raises:
        SettingError: no sonars, or they count in several units.
        NoAnswerError: nobody acknowledges, or one of them did not take the command.
    """
    if len({sonar.output for sonar in sonars}) != 1:
        raise SettingError("a general call is one command: give sonars of one bus, all with the same output")
    for sonar in sonars:
        sonar.prepare()
    first = sonars[0]
    command(
        sonars, lambda: first.retry(lambda: first.bus.write_byte_data(GENERAL_CALL, COMMAND, RANGING[first.output]))
    )


def command(sonars: Sequence[Devantech], give: Callable[[], object]) -> None:
    """Give a ranging command and make sure that the sonars took it; again where this host was too slow to see that.

    Raises:
        StaleError: one of them did not take it.
        NoAnswerError: the host was too slow each time.
    """
    clock = sonars[0].clock
    for _ in range(RETRIES):
        began = clock()
        give()
        if all(sonar.went_busy(began) for sonar in sonars):
            return
        sonars[0].sleep(SPACING)
    raise NoAnswerError(
        f"{sonars[0]}: this computer was {RETRIES} times too slow to see whether it took a ranging command, which "
        f"shows for {sonars[0].listening * 1e3:.0f} ms only; lessen its load or raise the range register"
    )


def check_address(address: int, name: str) -> None:
    """Refuse what is no 7-bit address of these sonars.

    Raises:
        SettingError: naming limits and value.
    """
    if not FIRST_ADDRESS <= address <= LAST_ADDRESS:
        raise SettingError(
            f"{name} address must lie from 0x{FIRST_ADDRESS:02X} to 0x{LAST_ADDRESS:02X} (7 bits), got "
            f"0x{address:02X}: halve an 8-bit address such as 0xE0"
        )


def check(name: str, value: int, high: int, unit: str) -> None:
    """Refuse what a register cannot hold.

    Raises:
        SettingError: naming limits, value and unit.
    """
    if not 0 <= value <= high or value != int(value):
        raise SettingError(f"{name} must be a whole number from 0 to {high}, got {value} ({unit})")
