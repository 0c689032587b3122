"""Driver of an HC-SR04 (trigger and echo wires) behind an Arduino with the bridge's sketch."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

from acquisition.drivers.arduino import Bridge
from acquisition.drivers.driver import Echoes
from acquisition.errors import GarbledError, NoAnswerError, SettingError

METRES_PER_US = 0.01 / 58.0  # as the sensor's manual converts
SHORTEST_US = 100  # 17 mm; the manual claims 2 cm, and a shorter pulse is a spike on the wire
SILENT_US = 30_000  # 5.2 m, more than its 4 m; with no echo the line stays high for 38 ms, 36 ms on an SRF04
LAST_PIN = 69


@dataclass
class HcSr04:
    """One HC-SR04.

    Attributes:
        bridge: the board.
        trigger, echo: its pins.
        limit_us: how long the echo line may stay high before it counts as stuck, us; some clones take 200 ms.
    """

    bridge: Bridge
    trigger: int = 9
    echo: int = 8
    limit_us: int = 250_000

    def __post_init__(self) -> None:
        """Refuse pins that the board does not have to spare."""
        for name, pin in (("trigger", self.trigger), ("echo", self.echo)):
            if not 2 <= pin <= LAST_PIN or pin in (20, 21):
                raise SettingError(f"HC-SR04 {name} pin must be 2 to {LAST_PIN} but not 20 or 21 (I2C), got {pin}")
        if self.trigger == self.echo:
            raise SettingError(f"HC-SR04 trigger and echo must be two pins, got {self.trigger} for both")
        if not SILENT_US < self.limit_us <= 400_000:
            raise SettingError(f"HC-SR04 limit must lie from {SILENT_US + 1} to 400000 us, got {self.limit_us}")

    @classmethod
    def open(cls, port: str = "/dev/ttyACM0", **settings: Any) -> HcSr04:
        """Open the board at a serial port; see `Bridge.open`."""
        bridge = Bridge.open(port)
        try:
            return cls(bridge, **settings)
        except SettingError:
            bridge.close()
            raise

    def ping(self) -> Echoes:
        """Fire once and return the range of the echo, m, or none.

        Raises:
            NoAnswerError: the sensor does not raise its line, or never lowers it.
        """
        said = self.bridge.ask(f"D {self.trigger:X} {self.echo:X} {self.limit_us:X}")
        if not re.fullmatch("[0-9A-F]{6}", said):
            raise GarbledError(f"{self}: {said[:80]!r} is no time of a pulse; upload the sketch anew")
        pulse = int(said, 16)
        if pulse < SHORTEST_US:
            raise NoAnswerError(f"{self}: a pulse of {pulse} us, expected {SHORTEST_US} or more: check 5 V and ground")
        return Echoes((pulse * METRES_PER_US,) if pulse < SILENT_US else ())

    def __str__(self) -> str:
        return f"HC-SR04 on pins {self.trigger} and {self.echo}"
