"""Twins of serial devices (Arduino with the sketch, HC-SR04 on its pins, MaxBotix) and the ports to access them."""

from __future__ import annotations

import binascii
import os
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

from acquisition.drivers.i2c import SmBus
from acquisition.drivers.maxbotix import MODELS
from acquisition.drivers.serialport import READ_TIMEOUT_S
from acquisition.twins.simulated_sensor import SimulatedSensor, TwinClock

SPEED_M_PER_US = 0.01 / 58.0
NO_ECHO_US = 38_000
POLL_S = 0.002  # between reads of a pseudo-terminal


@dataclass
class HostClock(TwinClock):
    """Time of the host, s, for twins at a real port."""

    def __call__(self) -> float:
        """Return the time, s."""
        return time.monotonic()

    def sleep(self, seconds: float) -> None:
        """Wait."""
        time.sleep(seconds)


class Device(Protocol):
    """A device at the other end of a serial line."""

    def feed(self, data: bytes) -> bytes:
        """Receive bytes from the host, possibly none, and return the bytes for the host."""


@dataclass
class HcSr04Twin(SimulatedSensor):
    """A simulated HC-SR04.

    Attributes:
        fault: error number of the sketch: 16 stuck high, 17 no rise, 18 no fall; None without a fault.
    """

    fault: int | None = None

    def pulse(self) -> tuple[int, int]:
        """Fire; return error number (0 for none) and pulse duration, us."""
        if self.fault:
            return self.fault, 0
        return 0, int(self.fire("us")[0]) or NO_ECHO_US


@dataclass
class ArduinoTwin:
    """A simulated Arduino Mega with the sketch.

    Attributes:
        bus: sensor on its I2C pins.
        pulses: HC-SR04 on its pins 9 and 8.
        pwm: PW output of a MaxBotix on its pin 8.
        corrupt: changes the bytes to the host, as a faulty cable does.
        repeat: answer with the previous sequence number.
        version: answer to the request for name and version.
    """

    bus: SmBus | None = None
    pulses: HcSr04Twin | None = None
    pwm: MaxBotixTwin | None = None
    corrupt: Callable[[bytes], bytes] = bytes
    repeat: bool = False
    version: str = "SONARBRIDGE 01"

    def __post_init__(self) -> None:
        """Start the board."""
        self._buffer = b""
        self._due = b""
        self.reset()

    def reset(self) -> None:
        """Restart, as after a loss of power."""
        self._buffer = b""
        self._due += _framed("-- B 01")

    def feed(self, data: bytes) -> bytes:
        """Answer complete lines."""
        *lines, self._buffer = (self._buffer + data).split(b"\n")
        answers = b"".join(self._answer(line) for line in lines if line)
        due, self._due = self._due + answers, b""
        return self.corrupt(due)

    def _answer(self, line: bytes) -> bytes:
        body, _, crc = line[1:].rpartition(b"*")
        if line[:1] != b">" or f"{binascii.crc_hqx(body, 0xFFFF):04X}".encode() != crc:
            return _framed("-- E 21")
        sequence, name, *numbers = body.decode("ascii").split()
        commands: dict[str, Callable[..., tuple[int, str]]] = {
            "V": self._version,
            "W": self._write,
            "R": self._read,
            "D": self._distance,
            "P": self._pulse,
        }
        error, result = commands[name](*(int(each, 16) for each in numbers)) if name in commands else (34, "")
        if self.repeat:
            sequence = f"{(int(sequence, 16) - 1) % 256:02X}"
        return _framed(f"{sequence} E {error:02X}" if error else f"{sequence} K{result and ' '}{result}")

    def _version(self) -> tuple[int, str]:
        return 0, self.version

    def _write(self, address: int, register: int, value: int) -> tuple[int, str]:
        def transfer(bus: SmBus) -> str:
            bus.write_byte_data(address, register, value)
            return ""

        return self._run(transfer)

    def _read(self, address: int, register: int, count: int) -> tuple[int, str]:
        def transfer(bus: SmBus) -> str:
            return "".join(f"{bus.read_byte_data(address, register + k):02X}" for k in range(count))

        return self._run(transfer)

    def _distance(self, trigger: int, echo: int, limit: int) -> tuple[int, str]:
        error, pulse = self.pulses.pulse() if self.pulses and (trigger, echo) == (9, 8) else (17, 0)
        return (18 if pulse > limit else error), f"{pulse:06X}"

    def _pulse(self, pin: int, limit: int) -> tuple[int, str]:
        width = self.pwm.pulse() if self.pwm and pin == 8 else 0
        return (0 if 0 < width <= limit else 18 if width else 17), f"{width:06X}"

    def _run(self, transfer: Callable[[SmBus], str]) -> tuple[int, str]:
        try:
            return (0, transfer(self.bus)) if self.bus else (2, "")
        except OSError:
            return 2, ""


@dataclass
class MaxBotixTwin(SimulatedSensor):
    """A simulated MaxBotix, which transmits continuously.

    Attributes:
        model: name in `MODELS`.
        corrupt: changes the bytes to the host, as a faulty cable does.
    """

    model: str = "hrlv"
    corrupt: Callable[[bytes], bytes] = bytes

    def __post_init__(self) -> None:
        """Start to transmit."""
        super().__post_init__()
        self._next = self.clock()

    def feed(self, data: bytes) -> bytes:
        """Return the lines that are due; input is ignored."""
        line_format = MODELS[self.model]
        due = b""
        while self._next <= self.clock():
            due += f"R{self._count():0{line_format.digits}d}\r".encode("ascii")
            self._next = max(self._next + line_format.period_s, self.clock() - line_format.period_s)
        return self.corrupt(due)

    def pulse(self) -> int:
        """Return the width of the next pulse on the PW output, us."""
        return round(self._count() * MODELS[self.model].pulse_us)

    def _count(self) -> int:
        """Fire; return the count that the sensor reports."""
        family = MODELS[self.model]
        count = round(int(self.fire("us")[0]) * SPEED_M_PER_US / family.unit_m) or family.no_echo
        return min(max(count, family.nearest), family.no_echo)


@dataclass
class TwinPort:
    """A serial port to a device in this process; waiting reads advance the clock.

    Attributes:
        device: the device at the port.
        clock: of device and host, s.
    """

    device: Device
    clock: TwinClock = field(default_factory=TwinClock)

    def __post_init__(self) -> None:
        """Start with an empty buffer."""
        self._due = b""

    @property
    def in_waiting(self) -> int:
        """Number of available bytes."""
        self._due += self.device.feed(b"")
        return len(self._due)

    def read(self, size: int = 1) -> bytes:
        """Return up to `size` bytes; wait for the read timeout if there are none."""
        if not self._due:
            self.clock.sleep(READ_TIMEOUT_S)
        data, self._due = self._due[:size], self._due[size:]
        return data

    def write(self, data: bytes, /) -> int:
        """Send bytes."""
        self._due += self.device.feed(data)
        return len(data)

    def close(self) -> None:
        """Do nothing: there is no file to close."""


class PseudoTerminal:
    """A device at a pseudo-terminal, for tests of the drivers with pyserial; `path` is the port to open.

    The end of the context, or `unplug`, closes the port like an unplugged cable.
    """

    def __init__(self, device: Device) -> None:
        import tty  # POSIX only

        self._device = device
        self._master, slave = os.openpty()
        tty.setraw(slave)
        os.set_blocking(self._master, False)
        self.path = os.ttyname(slave)
        self._slave = slave  # stays open, so that a host can open the port repeatedly
        self._unplugged = threading.Event()
        self._thread = threading.Thread(target=self._forward, daemon=True)
        self._thread.start()

    def __enter__(self) -> PseudoTerminal:
        return self

    def __exit__(self, *_: object) -> None:
        self.unplug()

    def unplug(self) -> None:
        """Close the port."""
        if not self._unplugged.is_set():
            self._unplugged.set()
            self._thread.join()
            os.close(self._master)
            os.close(self._slave)

    def _forward(self) -> None:
        while not self._unplugged.wait(POLL_S):
            try:
                data = os.read(self._master, 4096)
            except BlockingIOError:
                data = b""
            if due := self._device.feed(data):
                os.write(self._master, due)


def _framed(body: str) -> bytes:
    return f"<{body}*{binascii.crc_hqx(body.encode('ascii'), 0xFFFF):04X}\n".encode("ascii")
