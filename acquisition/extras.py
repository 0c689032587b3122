"""Modules that need an extra: imported by name on first use, from packages that do not require them."""

from __future__ import annotations

import importlib
import os
from importlib.util import find_spec
from typing import Any, Protocol

from acquisition.errors import MissingExtraError
from acquisition.name_check import ForeignNameError, check_names, foreign


class FigureLike(Protocol):
    """A matplotlib figure, which notebooks show; matplotlib itself is an extra."""

    def savefig(self, fname: str | os.PathLike[str], /) -> None:
        """Write the figure as a picture of the kind that the name ends in."""


def load_extra(module: str, extra: str) -> Any:
    """Import and return a module.

    Args:
        module: full name.
        extra: that provides what the module needs.

    Raises:
        ForeignNameError: a file of the user's shadows the package.
        MissingExtraError: a package that it needs is not installed.
    """
    check_names(module.partition(".")[0])
    try:
        return importlib.import_module(module)
    except ImportError as error:
        if (reason := foreign()) is not None:
            raise ForeignNameError(reason) from None
        if not isinstance(error, ModuleNotFoundError):
            raise
        raise _missing(error.name, extra) from None


def require(package: str, extra: str) -> None:
    """Raise MissingExtraError unless a package is installed.

    Args:
        package: name by which it is imported.
        extra: that provides it.
    """
    if find_spec(package) is None:
        raise _missing(package, extra)


def _missing(package: str | None, extra: str) -> MissingExtraError:
    return MissingExtraError(f"this needs the package {package!r}: pip install 'sonar-gym[{extra}]'")
