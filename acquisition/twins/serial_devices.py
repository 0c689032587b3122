"""Twins on serial lines: an Arduino with the sketch, an HC-SR04 on its pins, a MaxBotix, and ports to reach them by."""

from __future__ import annotations

import binascii
import os
import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

from acquisition.drivers.i2c import SmBus
from acquisition.drivers.maxbotix import MODELS
from acquisition.drivers.serialport import SLICE
from acquisition.twins.simulated_sensor import Ear, TwinClock

SPEED_M_PER_US = 0.01 / 58.0
NO_ECHO_US = 38_000
PUMP = 0.002  # s from look to look at a pseudo-terminal


class Device(Protocol):
    """The far end of a serial line."""

    def feed(self, data: bytes) -> bytes:
        """Take bytes from the host, perhaps none, and return those that are due to it."""


@dataclass
class HcSr04Twin(Ear):
    """An HC-SR04: `pulse` gives its answer in us, or the number of the sketch's trouble.

    Attributes:
        fault: 16 stuck high, 17 no answer, 18 never falls; None for none.
    """

    fault: int | None = None

    def pulse(self) -> tuple[int, int]:
        """Fire; return trouble (0 for none) and pulse, us."""
        if self.fault:
            return self.fault, 0
        return 0, int(self.hear("us")[0]) or NO_ECHO_US


@dataclass
class ArduinoTwin:
    """A Mega with the sketch, answering as the sketch does.

    Attributes:
        bus: what hangs on its I2C pins.
        pulses: the HC-SR04 on its pins 9 and 8.
        mangle: what the cable makes of bytes to the host.
        repeat: answer with the sequence number before.
    """

    bus: SmBus | None = None
    pulses: HcSr04Twin | None = None
    mangle: Callable[[bytes], bytes] = bytes
    repeat: bool = False

    def __post_init__(self) -> None:
        """Start."""
        self._rest = b""
        self._due = b""
        self.reset()

    def reset(self) -> None:
        """Start anew, as a board does that lost its power."""
        self._rest = b""
        self._due += _framed("-- B 01")

    def feed(self, data: bytes) -> bytes:
        """Answer whole lines."""
        *lines, self._rest = (self._rest + data).split(b"\n")
        answers = b"".join(self._answer(line) for line in lines if line)
        due, self._due = self._due + answers, b""
        return self.mangle(due)

    def _answer(self, line: bytes) -> bytes:
        body, _, crc = line[1:].rpartition(b"*")
        if line[:1] != b">" or f"{binascii.crc_hqx(body, 0xFFFF):04X}".encode() != crc:
            return _framed("-- E 21")
        sequence, name, *numbers = body.decode("ascii").split()
        commands: dict[str, Callable[..., tuple[int, str]]] = {
            "V": self._version,
            "W": self._write,
            "R": self._read,
            "S": self._scan,
            "D": self._distance,
        }
        trouble, said = commands[name](*(int(each, 16) for each in numbers)) if name in commands else (34, "")
        if self.repeat:
            sequence = f"{(int(sequence, 16) - 1) % 256:02X}"
        return _framed(f"{sequence} E {trouble:02X}" if trouble else f"{sequence} K{said and ' '}{said}")

    def _version(self) -> tuple[int, str]:
        return 0, "SONARBRIDGE 01"

    def _write(self, address: int, register: int, value: int) -> tuple[int, str]:
        def one(bus: SmBus) -> str:
            bus.write_byte_data(address, register, value)
            return ""

        return self._acknowledged(one)

    def _read(self, address: int, register: int, count: int) -> tuple[int, str]:
        def block(bus: SmBus) -> str:
            return "".join(f"{bus.read_byte_data(address, register + k):02X}" for k in range(count))

        return self._acknowledged(block)

    def _scan(self) -> tuple[int, str]:
        return 0, "".join(f"{address:02X}" for address in range(8, 128) if not self._read(address, 0, 1)[0])

    def _distance(self, trigger: int, echo: int, limit: int) -> tuple[int, str]:
        trouble, pulse = self.pulses.pulse() if self.pulses and (trigger, echo) == (9, 8) else (17, 0)
        return (18 if pulse > limit else trouble), f"{pulse:06X}"

    def _acknowledged(self, transfer: Callable[[SmBus], str]) -> tuple[int, str]:
        try:
            return (0, transfer(self.bus)) if self.bus else (2, "")
        except OSError:
            return 2, ""


@dataclass
class MaxBotixTwin(Ear):
    """A MaxBotix that streams.

    Attributes:
        model: name in `MODELS`.
        mangle: what the cable makes of bytes to the host.
    """

    model: str = "hrlv"
    mangle: Callable[[bytes], bytes] = bytes

    def __post_init__(self) -> None:
        """Begin to stream."""
        super().__post_init__()
        self._next = self.clock()

    def feed(self, data: bytes) -> bytes:
        """Give the lines that have come due; the host has nothing to say."""
        kind = MODELS[self.model]
        due = b""
        while self._next <= self.clock():
            metres = int(self.hear("us")[0]) * SPEED_M_PER_US
            count = min(round(metres / kind.unit_m), kind.silence) or kind.silence
            due += f"R{count:0{kind.digits}d}\r".encode("ascii")
            self._next = max(self._next + kind.period_s, self.clock() - kind.period_s)
        return self.mangle(due)


@dataclass
class TwinPort:
    """A serial port to a device inside this process; time passes while a read waits.

    Attributes:
        device: the far end.
        clock: of both ends.
    """

    device: Device
    clock: TwinClock = field(default_factory=TwinClock)

    def __post_init__(self) -> None:
        """Begin with nothing under way."""
        self._due = b""

    @property
    def in_waiting(self) -> int:
        """How many bytes wait."""
        self._due += self.device.feed(b"")
        return len(self._due)

    def read(self, size: int = 1) -> bytes:
        """Return what there is, or wait."""
        if not self._due:
            self.clock.sleep(SLICE)
        given, self._due = self._due[:size], self._due[size:]
        return given

    def write(self, data: bytes, /) -> int:
        """Send bytes."""
        self._due += self.device.feed(data)
        return len(data)

    def close(self) -> None:
        """Do nothing: there is no file to close."""


class PseudoTerminal:
    """A device behind a pseudo-terminal, so that pyserial itself runs. `path` is what to open.

    A context manager; leaving it, or `unplug`, is pulling the cable.
    """

    def __init__(self, device: Device) -> None:
        import tty  # POSIX only, as pseudo-terminals are

        self._device = device
        self._master, slave = os.openpty()
        tty.setraw(slave)
        os.set_blocking(self._master, False)
        self.path = os.ttyname(slave)
        self._slave = slave  # held open: a host may open the port again and again
        self._pulled = threading.Event()
        self._thread = threading.Thread(target=self._pump, daemon=True)
        self._thread.start()

    def __enter__(self) -> PseudoTerminal:
        return self

    def __exit__(self, *_: object) -> None:
        self.unplug()

    def unplug(self) -> None:
        """Pull the cable."""
        if not self._pulled.is_set():
            self._pulled.set()
            self._thread.join()
            os.close(self._master)
            os.close(self._slave)

    def _pump(self) -> None:
        while not self._pulled.wait(PUMP):
            try:
                data = os.read(self._master, 4096)
            except BlockingIOError:
                data = b""
            if due := self._device.feed(data):
                os.write(self._master, due)


def _framed(body: str) -> bytes:
    return f"<{body}*{binascii.crc_hqx(body.encode('ascii'), 0xFFFF):04X}\n".encode("ascii")
