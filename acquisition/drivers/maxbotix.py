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

from acquisition.drivers.arduino import PATIENCE_S, Bridge, check_pin, opened_at
from acquisition.drivers.driver import Echoes
from acquisition.drivers.serialport import LineReader, Port, open_port
from acquisition.errors import GarbledError, NoAnswerError, SettingError

BAUD = 9600
TIMEOUT_PERIODS = 4
# widths of a pulse without an echo, relative to the nominal one: the clocks of sensor and board differ by 1 to 2 %
FULL_PULSE = (0.98, 1.03)
MAX_PULSE_S = 0.48 * PATIENCE_S  # the sketch may wait so long twice: for the pulse, and for its end
MAX_DISCARDS = 64  # reads of waiting lines before a ping; more means that the line does not pause


@dataclass(frozen=True)
class OutputFormat:
    """Serial output of a sensor family.

    Attributes:
        digits: number of digits after the `R`.
        unit_m: of a count, m.
        no_echo: smallest count that means no echo.
        period_s: time between lines, s.
        nearest: smallest count; closer targets are reported at it.
        pulse_us: width of the pulse on the PW output, us per count.
        largest: largest count, which means no echo too; 0 for `no_echo`.
    """

    digits: int
    unit_m: float
    no_echo: int
    period_s: float
    nearest: int
    pulse_us: float
    largest: int = 0

    def echoes(self, count: int, sensor: str) -> Echoes:
        """Return the range of a count, m, if there is an echo.

        Raises:
            GarbledError: the count is not one of this model; the message names the sensor.
        """
        largest = self.largest or self.no_echo
        if not 0 < count <= largest:
            raise GarbledError(f"{sensor}: reads {count}, expected 1 to {largest}: check the model")
        return Echoes((count * self.unit_m,) if count < self.no_echo else ())

    def timed_echoes(self, width_us: float, sensor: str) -> Echoes:
        """Return the range of a pulse on the PW output, m, if there is an echo; see `echoes`."""
        low, high = FULL_PULSE
        is_full = low <= width_us / (self.no_echo * self.pulse_us) <= high
        return self.echoes(self.no_echo if is_full else round(width_us / self.pulse_us), sensor)


# from the data sheets of the families; for a sensor with another largest value, add a row
MODELS = {
    "lv": OutputFormat(
        3, 0.0254, 254, 0.05, 6, 147.0, largest=255
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
        limit_us = round(1e6 * min(2.0 * self._format.period_s, MAX_PULSE_S))
        width_us = self.bridge.pulse_us(f"P {self.echo:X} {limit_us:X}", str(self))
        return self._format.timed_echoes(width_us, str(self))

    def __str__(self) -> str:
        return f"MaxBotix {self.model} on pin {self.echo}"


def _check_model(model: str) -> None:
    if model not in MODELS:
        raise SettingError(f"MaxBotix model must be one of {', '.join(MODELS)}, got {model!r}")
