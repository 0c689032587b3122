"""Pings, readings and recordings, and the drivers of the sensors. Requires only numpy, pandas, pyserial and smbus2.

errors: the exceptions of the project.
ping: `Ping` (the true conditions), `Reading` (the output of the sensor), `EchoStatus`.
name_check: detects another distribution's package `noise`.
io: recordings, the journal of a session, imports of ROS bags and of other logs.
survey: survey plans, and the sessions that measure them.
drivers: drivers of real sonars.
twins: simulated devices that answer the drivers.
bench: waveform-level simulation of sonar and laboratory.
firmware: the sketch of the Arduino bridge.
"""

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
from acquisition.ping import EchoStatus, Ping, Reading, previous

if TYPE_CHECKING:
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
    "previous",
]


def __getattr__(name: str) -> Any:
    """Import `Recording` on first use: it needs pandas, which takes longer to import than all the rest."""
    if name == "Recording":
        from acquisition.io.recording import Recording

        return Recording
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
