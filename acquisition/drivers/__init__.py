"""Drivers of real sonars.

driver: the protocol of a driver, and `Echoes`, the answer to a ping.
devantech: common part of the Devantech drivers.
srf08: SRF08, SRF10 and SRF02.
hcsr04: HC-SR04 connected to an Arduino.
maxbotix: MaxBotix sensors with serial output, or with their PW output at an Arduino.
arduino: the Arduino bridge and its I2C bus.
i2c: I2C buses.
serialport: serial ports.
"""

from typing import Any

from acquisition.drivers.arduino import ArduinoBus, Bridge
from acquisition.drivers.devantech import fire_all
from acquisition.drivers.driver import Echoes, SonarDriver
from acquisition.drivers.hcsr04 import HcSr04
from acquisition.drivers.i2c import scan
from acquisition.drivers.maxbotix import MaxBotix, MaxBotixPwm
from acquisition.drivers.srf08 import Srf02, Srf08, Srf10

# name -> driver class, each with a class method `open(port, **settings)`
DRIVERS: dict[str, Any] = {
    "srf08": Srf08,
    "srf10": Srf10,
    "srf02": Srf02,
    "hcsr04": HcSr04,
    "maxbotix": MaxBotix,
    "maxbotix-pwm": MaxBotixPwm,
}

__all__ = [
    "DRIVERS",
    "ArduinoBus",
    "Bridge",
    "Echoes",
    "HcSr04",
    "MaxBotix",
    "MaxBotixPwm",
    "SonarDriver",
    "Srf02",
    "Srf08",
    "Srf10",
    "fire_all",
    "scan",
]
