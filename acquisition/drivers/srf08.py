"""Driver of the Devantech SRF08.

Gain and range live in RAM and cannot be read back, so they are written, each on its own, before every ping: a sensor
that was reset would work at full gain and 11 m. Register 1 reads the light, taken just before the last burst.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

from acquisition.drivers.devantech import COMMAND, ECHOES, GAIN, METRES, RANGE, STEP, Devantech, Output, check, command

LIGHT = 1
ANN: dict[Output, int] = {"inch": 0x53, "cm": 0x54, "us": 0x55}
GATES, FIRST_GATE = 32, 4  # of 2048 us each, from register 4 on


@dataclass(frozen=True)
class Gates:
    """What ANN mode gives.

    Attributes:
        first: range of the first echo, m; None where nothing was heard.
        heard: of each of the 32 gates of 2048 us (353 mm), what its register holds: 0 for nothing.
    """

    first: float | None
    heard: tuple[int, ...]


@dataclass
class Adjustable(Devantech):
    """What has registers of gain and range.

    Attributes:
        gain: code 0..`greatest_gain` of the amplifier's cap.
        range_register: 0..255; echoes are awaited for (r + 1) * 256 us.
    """

    gain: int = 16
    range_register: int = 255

    greatest_gain: ClassVar[int]

    def __post_init__(self) -> None:
        """Refuse settings that the sensor cannot hold."""
        super().__post_init__()
        ends = f"code; the manual's table ends at {self.greatest_gain}"
        check(f"{self.name} gain", self.gain, self.greatest_gain, ends)
        check(f"{self.name} range register", self.range_register, 255, "steps of 43 mm")

    @property
    def listening(self) -> float:
        """How long the sensor listens after a burst, s."""
        return (self.range_register + 1) * STEP

    def settings(self) -> Iterator[tuple[int, int]]:
        """Return gain and range."""
        yield GAIN, self.gain
        yield RANGE, self.range_register


@dataclass
class Srf08(Adjustable):
    """One SRF08: 17 echoes, 32 gains, a light sensor."""

    gain: int = 31

    name: ClassVar[str] = "SRF08"
    count: ClassVar[int] = 17
    greatest_gain: ClassVar[int] = 31

    def light(self) -> int:
        """Return the light sensor's value, taken just before the last burst, 0..255."""
        return int(self.retry(lambda: self.bus.read_byte_data(self.address, LIGHT)))

    def gates(self) -> Gates:
        """Fire once in ANN mode, which knows no gain and always listens for 65.5 ms.

        Raises:
            NoAnswerError: as `ping`.
        """
        self.write(RANGE, 255)
        command([self], lambda: self.write(COMMAND, ANN[self.output]))
        self.sleep(256 * STEP)
        self.await_end()
        first = self.counts()[0]
        heard = self.retry(lambda: self.block(FIRST_GATE, GATES))
        return Gates(first * METRES[self.output] if first else None, tuple(heard))


@dataclass
class Srf10(Adjustable):
    """One SRF10: one echo, 17 gains, no light."""

    name: ClassVar[str] = "SRF10"
    greatest_gain: ClassVar[int] = 16


@dataclass
class Srf02(Devantech):
    """One SRF02: one transducer, one echo, gain and range of its own choosing."""

    name: ClassVar[str] = "SRF02"

    def shortest(self) -> float:
        """Return the least range it can tell at present, m: its tuned end of ringing.

        Raises:
            NoAnswerError: the sensor does not answer.
        """
        high, low = self.retry(lambda: self.block(ECHOES + 2, 2))
        return (high << 8 | low) * METRES[self.output]
