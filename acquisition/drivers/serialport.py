"""Serial ports: the part of pyserial that the drivers use, and a line reader with deadlines."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from acquisition.errors import DeviceError, GarbledError, UnpluggedError

READ_TIMEOUT_S = 0.02  # of one read, and so the resolution of deadlines
MAX_READ = 256  # bytes per read
MAX_LINE = 200  # bytes; no device here sends longer lines


class Port(Protocol):
    """The part of `serial.Serial` that the drivers use; a read returns the available bytes or times out."""

    @property
    def in_waiting(self) -> int:
        """Number of available bytes."""

    def read(self, size: int = 1) -> bytes:
        """Return up to `size` bytes."""

    def write(self, data: bytes, /) -> int | None:
        """Send bytes."""

    def close(self) -> None:
        """Close the port."""


def open_port(path: str, baud: int) -> Port:
    """Open a serial port exclusively.

    Raises:
        DeviceError: the port does not exist, is not accessible, or is in use.
    """
    import serial  # imported only for a real port
    from serial.tools.list_ports import comports

    try:
        port: Port = serial.Serial(path, baud, timeout=READ_TIMEOUT_S, write_timeout=1.0, exclusive=True)
    except (serial.SerialException, OSError, ValueError) as error:
        available = ", ".join(sorted(each.device for each in comports())) or "none"
        raise DeviceError(
            f"{path}: {error}; serial ports found: {available}; check the USB cable, give one of them with --port, "
            "close the serial monitor of the Arduino IDE, or join the group dialout"
        ) from None
    return port


@dataclass
class LineReader:
    """Reader of the lines of a port.

    Attributes:
        port: open.
        name: of the device, for messages.
        end: byte that terminates a line.
        clock: of the host, s.
    """

    port: Port
    name: str
    end: bytes = b"\n"
    clock: Callable[[], float] = time.monotonic

    def __post_init__(self) -> None:
        """Start with an empty buffer."""
        self._buffer = b""

    def write(self, data: bytes) -> None:
        """Send bytes.

        Raises:
            UnpluggedError: the port disappeared.
        """
        try:
            self.port.write(data)
        except OSError as error:  # base class of serial.SerialException
            raise self._unplugged(error) from None

    def next(self, deadline: float) -> bytes | None:
        """Return the next line without its terminator, or None if none arrives until the deadline.

        Bytes that arrived in time count even if this host reads them later.

        Raises:
            UnpluggedError: the port disappeared.
            GarbledError: too many bytes without a terminator.
        """
        while self.end not in self._buffer:
            if len(self._buffer) > MAX_LINE:
                self._buffer = b""
                raise GarbledError(
                    f"{self.name}: over {MAX_LINE} bytes without an end of line; check the baud rate and the wires"
                )
            late = self.clock() >= deadline
            self._buffer += self._read(at_once=late)
            if late and self.end not in self._buffer:
                return None
        line, _, self._buffer = self._buffer.partition(self.end)
        return line

    def waiting(self) -> list[bytes]:
        """Return the complete lines that have arrived; an incomplete line remains in the buffer."""
        self._buffer += self._read(at_once=True)
        *lines, self._buffer = self._buffer.split(self.end)
        self._buffer = self._buffer[-MAX_LINE:]
        return lines

    def drop(self) -> None:
        """Clear the buffer."""
        self._buffer = b""

    def _read(self, at_once: bool = False) -> bytes:
        try:
            # request no more than available: pyserial would wait for all MAX_READ bytes
            available = self.port.in_waiting
            return self.port.read(min(available or 1, MAX_READ)) if available or not at_once else b""
        except (OSError, TypeError) as error:  # pyserial raises TypeError if another thread closed the port
            raise self._unplugged(error) from None

    def _unplugged(self, error: Exception) -> UnpluggedError:
        return UnpluggedError(f"{self.name}: the port disappeared ({error}); check the USB cable and plug it in again")
