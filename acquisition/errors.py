"""Exceptions of the project; each also derives from the built-in exception that it refines.

A message names the object, the limit, the value with its unit, and a remedy.
"""


class SonarError(Exception):
    """Base class of the errors that a user can act on."""


class RecordingError(SonarError, ValueError):
    """A recording violates its format; the message names file, line, column, value and the expected value."""


class RecordingNotFoundError(SonarError, FileNotFoundError):
    """A requested file does not exist."""

    def __str__(self) -> str:
        """Return the message unchanged; `OSError` would compose its own."""
        return str(self.args[0]) if self.args else ""


class SettingError(SonarError, ValueError):
    """A setting lies outside its limits."""


class UnknownFieldError(SettingError, TypeError):
    """A setting, or a parameter of an effect, does not exist."""


class ModelError(SonarError, ValueError):
    """The files or parameters of a model are invalid."""


class UnknownModelError(ModelError, LookupError):
    """No model has this name or path."""


class SampleOnlyError(ModelError, NotImplementedError):
    """A probability was requested from a model that can only draw samples."""


class MissingExtraError(SonarError, ImportError):
    """The requested function needs an optional dependency that is not installed."""


class DeviceError(SonarError, OSError):
    """The hardware or the connection to it failed."""

    def __str__(self) -> str:
        """Return the message unchanged."""
        return str(self.args[0]) if self.args else ""


class NoAnswerError(DeviceError, TimeoutError):
    """A device did not answer in time; this is a failed connection and not a reading without echo."""


class StaleError(NoAnswerError):
    """A device would return the previous reading as a new one."""


class GarbledError(NoAnswerError):
    """The received data violate the protocol of the device."""


class OutOfSequenceError(NoAnswerError):
    """Only answers to other requests arrived."""


class BoardResetError(NoAnswerError):
    """A board restarted during operation."""


class UnpluggedError(DeviceError):
    """The serial port disappeared."""
