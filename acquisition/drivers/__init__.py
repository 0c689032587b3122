"""Drivers of real sonars, one module a device, and twins that stand in for the devices on the same wire."""

from acquisition.drivers.driver import Driver, Echoes
from acquisition.drivers.srf08 import Srf08

# name -> driver of a device of that kind; each has `open` to reach one on this machine
DRIVERS = {
    "srf08": Srf08,
}

__all__ = ["DRIVERS", "Driver", "Echoes", "Srf08"]
