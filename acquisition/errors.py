"""One tree of errors; each class is also the builtin it refines, so existing handlers keep working.

A message names the thing, the limit, the value with its unit, and what to do.
"""


class SonarError(Exception):
    """Any error of this project that a user can act on."""


class RecordingError(SonarError, ValueError):
    """A recording breaks its format; the message names file, line, column, value and what was expected."""


class RecordingNotFoundError(SonarError, FileNotFoundError):
    """A file that was asked for is not there."""

    def __str__(self) -> str:
        """Return the message as written: `OSError` would otherwise compose its own."""
        return str(self.args[0]) if self.args else ""


class SettingError(SonarError, ValueError):
    """A setting lies outside its stated limits."""


class ModelError(SonarError, ValueError):
    """A model's files or parameters cannot be used."""


class UnknownModelError(ModelError, LookupError):
    """No model of that name or path."""


class SampleOnlyError(ModelError, NotImplementedError):
    """A model that can only be drawn from was asked for a probability."""


class MissingExtraError(SonarError, ImportError):
    """An optional dependency is needed for what was asked."""


class DeviceError(SonarError, OSError):
    """The hardware, or the wire to it, failed."""

    def __str__(self) -> str:
        """Return the message as written."""
        return str(self.args[0]) if self.args else ""


class NoAnswerError(DeviceError, TimeoutError):
    """A device did not answer in time: a dead wire, never to be taken for silence."""


class StaleError(NoAnswerError):
    """A device would give an old reading for a new one."""


class GarbledError(NoAnswerError):
    """What came over the wire is not what a device says."""


class OutOfSequenceError(NoAnswerError):
    """Only answers to other questions came."""


class BoardResetError(NoAnswerError):
    """A board started anew in the middle of its work."""


class UnpluggedError(DeviceError):
    """The port is gone."""
