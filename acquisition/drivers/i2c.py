"""I2C buses of Devantech sonars: a bus of this machine, or the bus of an Arduino."""

from __future__ import annotations

import re
from typing import Any, Protocol

from acquisition.errors import DeviceError

FIRST_ADDRESS, LAST_ADDRESS = 0x70, 0x7F  # of Devantech sonars


class SmBus(Protocol):
    """The methods of `smbus2.SMBus` that the drivers use."""

    def write_byte_data(self, i2c_addr: int, register: int, value: int) -> None:
        """Write one register."""

    def read_byte_data(self, i2c_addr: int, register: int) -> int:
        """Read one register."""

    def i2c_rdwr(self, *i2c_msgs: Any) -> None:
        """Run combined messages of `smbus2.i2c_msg`."""

    def close(self) -> None:
        """Close the bus."""


def open_bus(port: str) -> SmBus:
    """Open /dev/i2c-N, or the Arduino at a serial port.

    Raises:
        DeviceError: the port does not exist or is not accessible.
    """
    match = re.fullmatch(r"/dev/i2c-(\d+)", port)
    if not match:
        from acquisition.drivers.arduino import ArduinoBus

        return ArduinoBus.open(port)
    from smbus2 import SMBus  # imported only for a real bus

    try:
        return SMBus(int(match[1]))
    except OSError as error:
        raise DeviceError(
            f"{port}: {error.strerror or error}; enable I2C, give another --port, or join the group i2c"
        ) from None


def scan(bus: SmBus) -> list[int]:
    """Return the 7-bit addresses in 0x70..0x7F that answer a read of register 0."""
    return [address for address in range(FIRST_ADDRESS, LAST_ADDRESS + 1) if _answers(bus, address)]


def _answers(bus: SmBus, address: int) -> bool:
    try:
        bus.read_byte_data(address, 0)
    except DeviceError:
        raise
    except OSError:
        return False
    return True
