"""Serial ports: what the drivers use of pyserial, and lines read with a deadline."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from acquisition.errors import DeviceError, GarbledError, UnpluggedError

SLICE = 0.02  # s that one read may take: how finely deadlines are kept
MOST = 256  # bytes to take at once
LONGEST = 200  # bytes of a line; longer ones are no line of any device here


class Port(Protocol):
    """The part of `serial.Serial` that is used; a read returns what there is, after at most its own short timeout."""

    @property
    def in_waiting(self) -> int:
        """How many bytes wait."""

    def read(self, size: int = 1) -> bytes:
        """Return up to `size` bytes."""

    def write(self, data: bytes, /) -> int | None:
        """Send bytes."""

    def close(self) -> None:
        """Let go of the port."""


def open_port(path: str, baud: int) -> Port:
    """Open a serial port, for this process alone.

    Raises:
        DeviceError: there is no such port, it may not be used, or somebody else uses it.
    """
    import serial  # only here is a real port needed
    from serial.tools.list_ports import comports

    try:
        port: Port = serial.Serial(path, baud, timeout=SLICE, write_timeout=1.0, exclusive=True)
    except (serial.SerialException, OSError, ValueError) as error:
        there = ", ".join(sorted(each.device for each in comports())) or "none"
        raise DeviceError(
            f"{path}: {error}; serial ports found: {there}; check the USB cable, give one of them with --port, close "
            "the Arduino IDE's monitor, or join the group dialout"
        ) from None
    return port


@dataclass
class Lines:
    """Lines of a port.

    Attributes:
        port: open.
        name: what messages call it.
        end: byte that ends a line.
        clock: of the host.
    """

    port: Port
    name: str
    end: bytes = b"\n"
    clock: Callable[[], float] = time.monotonic

    def __post_init__(self) -> None:
        """Begin with nothing read."""
        self._rest = b""

    def write(self, data: bytes) -> None:
        """Send bytes.

        Raises:
            UnpluggedError: the port is gone.
        """
        try:
            self.port.write(data)
        except OSError as error:  # serial.SerialException is one
            raise self._gone(error) from None

    def next(self, deadline: float) -> bytes | None:
        """Return the next line without its end, or None where none comes until the deadline.

        What came in time counts, however late this computer looks.

        Raises:
            UnpluggedError: the port is gone.
            GarbledError: bytes without end.
        """
        while self.end not in self._rest:
            if len(self._rest) > LONGEST:
                self._rest = b""
                raise GarbledError(f"{self.name}: over {LONGEST} bytes without an end of line; check baud and wires")
            late = self.clock() >= deadline
            self._rest += self._read(at_once=late)
            if late and self.end not in self._rest:
                return None
        line, _, self._rest = self._rest.partition(self.end)
        return line

    def waiting(self) -> list[bytes]:
        """Return the whole lines that have come unasked, and forget half of one."""
        self._rest += self._read(at_once=True)
        *lines, self._rest = self._rest.split(self.end)
        self._rest = self._rest[-LONGEST:]
        return lines

    def drop(self) -> None:
        """Forget what has been read and not used."""
        self._rest = b""

    def _read(self, at_once: bool = False) -> bytes:
        try:
            # without waiting for more than there is: pyserial would wait for 256
            there = self.port.in_waiting
            return self.port.read(min(there or 1, MOST)) if there or not at_once else b""
        except (OSError, TypeError) as error:  # TypeError: pyserial's, when another thread closed the port
            raise self._gone(error) from None

    def _gone(self, error: Exception) -> UnpluggedError:
        return UnpluggedError(f"{self.name}: the port is gone ({error}); check the USB cable and plug it in again")
