"""The bus under Devantech's sonars: a bus of this machine, or one behind an Arduino."""

from __future__ import annotations

import re
from typing import Any, Protocol

from acquisition.errors import DeviceError

FIRST_SONAR, LAST_SONAR = 0x70, 0x7F


class SmBus(Protocol):
    """The part of `smbus2.SMBus` that is used."""

    def write_byte_data(self, i2c_addr: int, register: int, value: int) -> None:
        """Write one register."""

    def read_byte_data(self, i2c_addr: int, register: int) -> int:
        """Read one register."""

    def i2c_rdwr(self, *i2c_msgs: Any) -> None:
        """Run combined messages of `smbus2.i2c_msg`."""

    def close(self) -> None:
        """Let go of the bus."""


def open_bus(port: str) -> SmBus:
    """Open /dev/i2c-N, or the Arduino on a serial port.

    Raises:
        DeviceError: there is no such port, or it may not be used.
    """
    match = re.fullmatch(r"/dev/i2c-(\d+)", port)
    if not match:
        from acquisition.drivers.arduino import ArduinoBus

        return ArduinoBus.open(port)
    from smbus2 import SMBus  # only here is a real bus needed

    try:
        return SMBus(int(match[1]))
    except OSError as error:
        raise DeviceError(
            f"{port}: {error.strerror or error}; switch I2C on, give another --port, or join the group i2c"
        ) from None


def scan(bus: SmBus) -> list[int]:
    """Return the 7-bit addresses of 0x70..0x7F that answer, by reading register 0 of each."""
    return [address for address in range(FIRST_SONAR, LAST_SONAR + 1) if _answers(bus, address)]


def _answers(bus: SmBus, address: int) -> bool:
    try:
        bus.read_byte_data(address, 0)
    except DeviceError:
        raise
    except OSError:
        return False
    return True
