"""Pings, readings and recordings, and the drivers of the sensors. Requires only numpy and pandas.

errors: the exceptions of the project.
ping: `Ping` (the true conditions), `Reading` (the output of the sensor), `EchoStatus`.
name_check: detects another distribution's package `noise`.
brief: short representations. extras: modules that need an extra.
io: recordings, the journal of a session, imports of ROS bags and of other logs.
survey: survey plans, and the sessions that measure them.
drivers: drivers of real sonars.
twins: simulated devices that answer the drivers.
bench: waveform-level simulation of sonar and laboratory.
firmware: the sketch of the Arduino bridge.
"""

import importlib
from typing import TYPE_CHECKING, Any

from acquisition.errors import (
    BoardResetError,
    DeviceError,
    GarbledError,
    MissingExtraError,
    ModelError,
    NoAnswerError,
    OutOfSequenceError,
    RecordingError,
    RecordingNotFoundError,
    SettingError,
    SonarError,
    StaleError,
    UnknownModelError,
    UnpluggedError,
)
from acquisition.name_check import ForeignNameError, foreign
from acquisition.version import __version__ as __version__

try:
    from acquisition.ping import EchoStatus, Ping, Reading, previous
except (ImportError, AttributeError):
    if (_reason := foreign()) is None:
        raise
    raise ForeignNameError(_reason) from None

if TYPE_CHECKING:
    from acquisition.io.given import as_recording
    from acquisition.io.recording import Recording


__all__ = [
    "BoardResetError",
    "DeviceError",
    "EchoStatus",
    "GarbledError",
    "MissingExtraError",
    "ModelError",
    "NoAnswerError",
    "OutOfSequenceError",
    "Ping",
    "Reading",
    "Recording",
    "RecordingError",
    "RecordingNotFoundError",
    "SettingError",
    "SonarError",
    "StaleError",
    "UnknownModelError",
    "UnpluggedError",
    "as_recording",
    "previous",
]


def __getattr__(name: str) -> Any:
    """Import on first use what needs pandas, which takes longer to import than all the rest."""
    if name not in ("Recording", "as_recording"):
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module("acquisition.io.given"), name)


def __dir__() -> list[str]:
    """Return the public names, whether or not they have been imported."""
    return list(__all__)
