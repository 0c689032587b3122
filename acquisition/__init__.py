"""What was asked, what was heard, and the hardware that heard it. Needs numpy, pandas, pyserial, smbus2 alone."""

from acquisition.errors import (
    DeviceError,
    MissingExtraError,
    ModelError,
    NoAnswerError,
    RecordingError,
    RecordingNotFoundError,
    SettingError,
    SonarError,
    UnknownModelError,
)
from acquisition.ping import EchoStatus, Ping, Reading, previous
from acquisition.recording import Recording

__all__ = [
    "DeviceError",
    "EchoStatus",
    "MissingExtraError",
    "ModelError",
    "NoAnswerError",
    "Ping",
    "Reading",
    "Recording",
    "RecordingError",
    "RecordingNotFoundError",
    "SettingError",
    "SonarError",
    "UnknownModelError",
    "previous",
]
