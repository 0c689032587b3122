"""What was asked, what was heard, and the hardware that heard it. Needs numpy, pandas, pyserial, smbus2 alone."""

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
from acquisition.io.recording import Recording
from acquisition.ping import EchoStatus, Ping, Reading, previous

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
