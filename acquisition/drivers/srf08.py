"""Drivers of the Devantech SRF08, SRF10 and SRF02.

Gain and range registers are volatile and cannot be read back. The drivers write them before every ping, one at a time,
because a sensor that was reset would use full gain and a range of 11 m.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import ClassVar

from acquisition.drivers.devantech import (
    COMMAND,
    ECHOES,
    GAIN,
    METRES,
    RANGE,
    STEP_S,
    Devantech,
    Output,
    check_register,
    send_command,
)

LIGHT = 1
ANN: dict[Output, int] = {"inch": 0x53, "cm": 0x54, "us": 0x55}
N_GATES, FIRST_GATE = 32, 4  # of 2048 us each, from register 4 on


@dataclass(frozen=True)
class Gates:
    """Result of a ping in ANN mode.

    Attributes:
        first: range of the first echo, m; None without an echo.
        values: registers of the 32 gates of 2048 us (353 mm), 0 without an echo.
    """

    first: float | None
    values: tuple[int, ...]


@dataclass
class Adjustable(Devantech):
    """A sonar with registers for gain and range.

    Attributes:
        gain: code of the maximum gain, 0..`max_gain`.
        range_register: 0..255; the sonar listens for (r + 1) * 256 us.
    """

    gain: int = 16
    range_register: int = 255

    max_gain: ClassVar[int]

    def __post_init__(self) -> None:
        """Raise SettingError for invalid settings."""
        super().__post_init__()
        self.check_registers()

    def check_registers(self) -> None:
        """Raise SettingError for a gain or range that the registers cannot hold."""
        table_end = f"code; the manual's table ends at {self.max_gain}"
        check_register(f"{self.name} gain", self.gain, self.max_gain, table_end)
        check_register(f"{self.name} range register", self.range_register, 255, "steps of 43 mm")

    @property
    def listening_s(self) -> float:
        """Listening time after a burst, s."""
        return (self.range_register + 1) * STEP_S

    def settings(self) -> Iterator[tuple[int, int]]:
        """Yield gain and range."""
        yield GAIN, self.gain
        yield RANGE, self.range_register


@dataclass
class Srf08(Adjustable):
    """One SRF08: 17 echoes, 32 gain codes, a light sensor."""

    gain: int = 31

    name: ClassVar[str] = "SRF08"
    count: ClassVar[int] = 17
    max_gain: ClassVar[int] = 31

    def light(self) -> int:
        """Return the light sensor's value just before the last burst, 0..255."""
        return int(self.retry(lambda: self.bus.read_byte_data(self.address, LIGHT)))

    def gates(self) -> Gates:
        """Fire once in ANN mode, which ignores the gain and always listens for 65.5 ms.

        Raises:
            NoAnswerError: see `ping`.
        """
        whole = replace(self, range_register=255)  # listens for as long as this mode
        self.write(RANGE, 255)
        send_command([whole], lambda: self.write(COMMAND, ANN[self.output]))
        whole.wait_until_idle()
        first = self.counts()[0]
        values = self.retry(lambda: self.read_registers(FIRST_GATE, N_GATES))
        return Gates(first * METRES[self.output] if first else None, tuple(values))


@dataclass
class Srf10(Adjustable):
    """One SRF10: one echo, 17 gain codes, no light sensor."""

    name: ClassVar[str] = "SRF10"
    max_gain: ClassVar[int] = 16


@dataclass
class Srf02(Devantech):
    """One SRF02: one transducer, one echo, automatic gain and range."""

    name: ClassVar[str] = "SRF02"

    def min_range(self) -> float:
        """Return the smallest measurable range, m: the end of the ringing, which the sensor calibrates.

        The sensor states it in the unit of its last ranging: call `ping` first.

        Raises:
            NoAnswerError: the sensor does not answer.
        """
        high, low = self.retry(lambda: self.read_registers(ECHOES + 2, 2))
        return (high << 8 | low) * METRES[self.output]
