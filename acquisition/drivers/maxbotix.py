"""Driver of MaxBotix sensors on a serial line: `R`, three or four digits, carriage return, 9600 baud 8N1.

They stream by themselves. So that a reading belongs to the ping that asks for it, what came before is thrown away, and
the line that was under way as well. The greatest value means that nothing was heard.
"""

from __future__ import annotations

import re
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from acquisition.drivers.driver import Echoes
from acquisition.drivers.serialport import Lines, Port, open_port
from acquisition.errors import GarbledError, NoAnswerError, SettingError

BAUD = 9600
PERIODS = 4  # to wait for a line
STUCK = 64  # lines that may wait unread before the line counts as running wild


@dataclass(frozen=True)
class Model:
    """What a family says.

    Attributes:
        digits: after the `R`.
        unit_m: of a count, m.
        silence: count for no echo.
        period_s: from line to line, s.
    """

    digits: int
    unit_m: float
    silence: int
    period_s: float


# from the families' data sheets; a sensor with another greatest value is a row more
MODELS = {
    "lv": Model(3, 0.0254, 254, 0.05),  # LV-MaxSonar-EZ, inches; its line is inverted: use an inverting adapter
    "xl": Model(3, 0.01, 765, 0.1),  # XL-MaxSonar-EZ/-WR, cm
    "xl-long": Model(4, 0.01, 1068, 0.1),  # XL-MaxSonar-WRL, cm
    "hrlv": Model(4, 0.001, 5000, 0.1),  # HRLV-MaxSonar-EZ, mm
    "hrxl": Model(4, 0.001, 5000, 0.15),  # HRXL-MaxSonar-WR, mm
    "hrxl-long": Model(4, 0.001, 9999, 0.15),  # HRXL-MaxSonar-WRL, mm
}


@dataclass
class MaxBotix:
    """One MaxBotix sensor.

    Attributes:
        port: open, at 9600 baud.
        model: name in `MODELS`.
        clock: of the host.
    """

    port: Port
    model: str = "hrlv"
    clock: Callable[[], float] = time.monotonic

    def __post_init__(self) -> None:
        """Refuse a family that is not known."""
        if self.model not in MODELS:
            raise SettingError(f"MaxBotix model must be one of {', '.join(MODELS)}, got {self.model!r}")
        self._kind = MODELS[self.model]
        self._lines = Lines(self.port, str(self), b"\r", self.clock)

    @classmethod
    def open(cls, port: str = "/dev/ttyUSB0", **settings: Any) -> MaxBotix:
        """Open the sensor at a serial port.

        Raises:
            DeviceError: there is no such port, or it may not be used.
        """
        if settings.get("model", "hrlv") not in MODELS:
            raise SettingError(f"MaxBotix model must be one of {', '.join(MODELS)}, got {settings['model']!r}")
        return cls(open_port(port, BAUD), **settings)

    def ping(self) -> Echoes:
        """Return the first range that is begun after this call, m, or none.

        Raises:
            NoAnswerError: no line comes within four periods.
            GarbledError: a line is no reading of this model.
            UnpluggedError: the port is gone.
        """
        deadline = self.clock() + PERIODS * self._kind.period_s
        self._forget(deadline)
        self._line(deadline)  # the one under way
        line = self._line(deadline)
        if not re.fullmatch(rb"R\d{%d}" % self._kind.digits, line):
            raise GarbledError(
                f"{self}: {line[:40]!r} is not R and {self._kind.digits} digits; is the model right, is the line "
                f"inverted, is it at {BAUD} baud?"
            )
        count = int(line[1:])
        if not 0 < count <= self._kind.silence:
            raise GarbledError(f"{self}: reads {count}, expected 1 to {self._kind.silence}: is the model right?")
        return Echoes((count * self._kind.unit_m,) if count < self._kind.silence else ())

    def __str__(self) -> str:
        return f"MaxBotix {self.model}"

    def _forget(self, deadline: float) -> None:
        """Drop what waits, at most until the deadline."""
        for _ in range(STUCK):
            if not self._lines.waiting() or self.clock() >= deadline:
                break
        self._lines.drop()

    def _line(self, deadline: float) -> bytes:
        line = self._lines.next(deadline)
        if line is None:
            raise NoAnswerError(
                f"{self}: no line within {PERIODS * self._kind.period_s:g} s; check power, the TX wire, and that pin 4 "
                "(RX) is open or high"
            )
        return line.lstrip(b"\n")
