"""Driver of the HC-SR04 (trigger and echo pins) connected to an Arduino with the bridge sketch."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from acquisition.drivers.arduino import Bridge, check_pin, opened_at
from acquisition.drivers.driver import Echoes
from acquisition.errors import NoAnswerError, SettingError

METRES_PER_US = 0.01 / 58.0  # conversion in the sensor's manual
MIN_PULSE_US = 100  # 17 mm; the manual specifies 2 cm, a shorter pulse is a voltage spike
NO_ECHO_US = 30_000  # 5.2 m, beyond its 4 m; without an echo the line stays high for 38 ms (36 ms on an SRF04)


@dataclass
class HcSr04:
    """One HC-SR04.

    Attributes:
        bridge: the Arduino.
        trigger, echo: pins of the Arduino.
        limit_us: time after which a high echo line counts as stuck, us; some clones need 200 ms.
    """

    bridge: Bridge
    trigger: int = 9
    echo: int = 8
    limit_us: int = 250_000

    def __post_init__(self) -> None:
        """Raise SettingError for invalid pins or an invalid limit."""
        check_pin("HC-SR04 trigger", self.trigger)
        check_pin("HC-SR04 echo", self.echo)
        if self.trigger == self.echo:
            raise SettingError(f"HC-SR04 trigger and echo must be two pins, got {self.trigger} for both")
        if not NO_ECHO_US < self.limit_us <= 400_000:
            raise SettingError(f"HC-SR04 limit must lie from {NO_ECHO_US + 1} to 400000 us, got {self.limit_us}")

    @classmethod
    def open(cls, port: str = "/dev/ttyACM0", **settings: Any) -> HcSr04:
        """Open the Arduino at a serial port; see `Bridge.open`."""
        opened: HcSr04 = opened_at(cls, port, settings)
        return opened

    def ping(self) -> Echoes:
        """Fire once and return the range of the echo, m, if there is one.

        Raises:
            NoAnswerError: the echo line does not rise or does not fall.
        """
        pulse = self.bridge.pulse_us(f"D {self.trigger:X} {self.echo:X} {self.limit_us:X}", str(self))
        if pulse < MIN_PULSE_US:
            raise NoAnswerError(f"{self}: a pulse of {pulse} us, expected {MIN_PULSE_US} or more: check 5 V and ground")
        return Echoes((pulse * METRES_PER_US,) if pulse < NO_ECHO_US else ())

    def __str__(self) -> str:
        return f"HC-SR04 on pins {self.trigger} and {self.echo}"
