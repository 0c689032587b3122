"""Drivers of MaxBotix sensors: serial output, `R`, three or four digits, carriage return; 9600 baud 8N1.

The sensors transmit continuously. So that a reading belongs to the ping that requests it, the driver discards all
waiting data and the line in progress. The largest value means no echo.
"""

from __future__ import annotations

import re
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from acquisition.drivers.arduino import Bridge, check_pin, opened_at
from acquisition.drivers.driver import Echoes
from acquisition.drivers.serialport import LineReader, Port, open_port
from acquisition.errors import GarbledError, NoAnswerError, SettingError

BAUD = 9600
TIMEOUT_PERIODS = 4
MAX_DISCARDS = 64  # reads of waiting lines before a ping; more means that the line does not pause


@dataclass(frozen=True)
class OutputFormat:
    """Serial output of a sensor family.

    Attributes:
        digits: number of digits after the `R`.
        unit_m: of a count, m.
        no_echo: count that means no echo.
        period_s: time between lines, s.
        nearest: smallest count; closer targets are reported at it.
        pulse_us: width of the pulse on the PW output, us per count.
    """

    digits: int
    unit_m: float
    no_echo: int
    period_s: float
    nearest: int
    pulse_us: float

    def echoes(self, count: int, sensor: str) -> Echoes:
        """Return the range of a count, m, if there is an echo.

        Raises:
            GarbledError: the count is not one of this model; the message names the sensor.
        """
        if not 0 < count <= self.no_echo:
            raise GarbledError(f"{sensor}: reads {count}, expected 1 to {self.no_echo}: check the model")
        return Echoes((count * self.unit_m,) if count < self.no_echo else ())


# from the data sheets of the families; for a sensor with another largest value, add a row
MODELS = {
    "lv": OutputFormat(
        3, 0.0254, 254, 0.05, 6, 147.0
    ),  # LV-MaxSonar-EZ, inches; inverted line: use an inverting adapter
    "xl": OutputFormat(3, 0.01, 765, 0.1, 20, 58.0),  # XL-MaxSonar-EZ/-WR, cm
    "xl-long": OutputFormat(4, 0.01, 1068, 0.1, 20, 58.0),  # XL-MaxSonar-WRL, cm
    "hrlv": OutputFormat(4, 0.001, 5000, 0.1, 300, 1.0),  # HRLV-MaxSonar-EZ, mm
    "hrxl": OutputFormat(4, 0.001, 5000, 0.15, 300, 1.0),  # HRXL-MaxSonar-WR, mm
    "hrxl-long": OutputFormat(4, 0.001, 9999, 0.15, 500, 1.0),  # HRXL-MaxSonar-WRL, mm
}


@dataclass
class MaxBotix:
    """One MaxBotix sensor.

    Attributes:
        port: open, at 9600 baud.
        model: name in `MODELS`.
        clock: of the host, s.
    """

    port: Port
    model: str = "hrlv"
    clock: Callable[[], float] = time.monotonic

    def __post_init__(self) -> None:
        """Raise SettingError for an unknown family."""
        _check_model(self.model)
        self._format = MODELS[self.model]
        self._lines = LineReader(self.port, str(self), b"\r", self.clock)

    @classmethod
    def open(cls, port: str = "/dev/ttyUSB0", **settings: Any) -> MaxBotix:
        """Open the sensor at a serial port.

        Raises:
            DeviceError: the port does not exist or is not accessible.
        """
        _check_model(settings.get("model", "hrlv"))
        return cls(open_port(port, BAUD), **settings)

    def ping(self) -> Echoes:
        """Return the first range whose line starts after this call, m, if there is an echo.

        Raises:
            NoAnswerError: no line arrives within four periods.
            GarbledError: a line is not a reading of this model.
            UnpluggedError: the port disappeared.
        """
        deadline = self.clock() + TIMEOUT_PERIODS * self._format.period_s
        self._discard_waiting(deadline)
        self._line(deadline)  # the line in progress
        line = self._line(deadline)
        if not re.fullmatch(rb"R\d{%d}" % self._format.digits, line):
            raise GarbledError(
                f"{self}: {line[:40]!r} is not R and {self._format.digits} digits; check the model, whether the line "
                f"is inverted, and the baud rate, {BAUD}"
            )
        count = int(line[1:])
        return self._format.echoes(count, str(self))

    def __str__(self) -> str:
        return f"MaxBotix {self.model}"

    def _discard_waiting(self, deadline: float) -> None:
        for _ in range(MAX_DISCARDS):
            if not self._lines.waiting() or self.clock() >= deadline:
                break
        self._lines.drop()

    def _line(self, deadline: float) -> bytes:
        line = self._lines.next(deadline)
        if line is None:
            raise NoAnswerError(
                f"{self}: no line within {TIMEOUT_PERIODS * self._format.period_s:g} s; check power, the TX wire, and "
                "that pin 4 (RX) is open or high"
            )
        return line.lstrip(b"\n")


@dataclass
class MaxBotixPwm:
    """The PW output of a MaxBotix at a pin of an Arduino with the sketch.

    Attributes:
        bridge: the Arduino.
        model: name in `MODELS`.
        echo: pin of the Arduino.
    """

    bridge: Bridge
    model: str = "hrlv"
    echo: int = 8

    def __post_init__(self) -> None:
        """Raise SettingError for an unknown family or an invalid pin."""
        _check_model(self.model)
        check_pin("MaxBotix echo", self.echo)
        self._format = MODELS[self.model]

    @classmethod
    def open(cls, port: str = "/dev/ttyACM0", **settings: Any) -> MaxBotixPwm:
        """Open the Arduino at a serial port; see `Bridge.open`."""
        opened: MaxBotixPwm = opened_at(cls, port, settings)
        return opened

    def ping(self) -> Echoes:
        """Return the range of the next pulse that begins after this call, m, if there is an echo.

        Raises:
            NoAnswerError: no pulse begins or ends within two periods.
            GarbledError: the pulse is longer than any of this model.
        """
        limit_us = round(2e6 * self._format.period_s)
        count = round(self.bridge.pulse_us(f"P {self.echo:X} {limit_us:X}", str(self)) / self._format.pulse_us)
        return self._format.echoes(count, str(self))

    def __str__(self) -> str:
        return f"MaxBotix {self.model} on pin {self.echo}"


def _check_model(model: str) -> None:
    if model not in MODELS:
        raise SettingError(f"MaxBotix model must be one of {', '.join(MODELS)}, got {model!r}")
