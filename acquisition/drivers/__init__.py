"""Drivers of real sonars, one module a device, and twins that stand in for the devices on the same wire."""

from typing import Any

from acquisition.drivers.arduino import ArduinoBus, Bridge
from acquisition.drivers.devantech import fire_all
from acquisition.drivers.driver import Driver, Echoes
from acquisition.drivers.hcsr04 import HcSr04
from acquisition.drivers.i2c import scan
from acquisition.drivers.maxbotix import MaxBotix
from acquisition.drivers.srf08 import Srf02, Srf08, Srf10

# name -> driver of a device of that kind; each has `open(port, **settings)` to reach one on this machine
DRIVERS: dict[str, Any] = {
    "srf08": Srf08,
    "srf10": Srf10,
    "srf02": Srf02,
    "hcsr04": HcSr04,
    "maxbotix": MaxBotix,
}

__all__ = [
    "DRIVERS",
    "ArduinoBus",
    "Bridge",
    "Driver",
    "Echoes",
    "HcSr04",
    "MaxBotix",
    "Srf02",
    "Srf08",
    "Srf10",
    "fire_all",
    "scan",
]
