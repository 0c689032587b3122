"""Checks of settings that are given as mappings or numbers."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import fields
from typing import Any, TypeVar

import numpy as np

from acquisition import SettingError
from acquisition.errors import UnknownFieldError
from acquisition.limits import as_numbers, near, shown

Settings = TypeVar("Settings")


def settings_of(cls: type[Settings], given: Any, name: str = "") -> Settings:
    """Return settings as given, from a mapping of their fields, or with their defaults for None.

    Args:
        cls: class of the settings.
        given: the settings.
        name: of the argument, for the message; that of the class by default.

    Raises:
        SettingError: a field is unknown or missing, or `given` is neither settings nor a mapping.
    """
    if given is None or isinstance(given, Mapping):
        given = {} if given is None else given
        check_fields(cls, given, name)
        with named(cls, name):
            return cls(**given)
    if not isinstance(given, cls):
        raise _no_settings(cls, given, name)
    return given


@contextmanager
def named(cls: type, name: str) -> Iterator[None]:
    """Raise errors of the fields of a class, which it names as its own, with the name of an argument."""
    name = name or cls.__name__
    try:
        yield
    except SettingError as error:
        raise SettingError(str(error).replace(f"{cls.__name__}.", f"{name}.", 1)) from None
    except TypeError as error:  # a missing field, or a value of a wrong type
        raise SettingError(f"{name}: {error}") from None


def _no_settings(cls: type, given: Any, name: str) -> SettingError:
    expected = f"{cls.__name__} or a mapping of its fields"
    return SettingError(f"{name or cls.__name__}: expected {expected}, got {shown(given)}")


def check_fields(cls: type, given: Mapping[str, Any], name: str = "") -> None:
    """Raise SettingError for what is no mapping, and for a name that is no field of a dataclass."""
    if not isinstance(given, Mapping):
        raise _no_settings(cls, given, name)
    known = [one.name for one in fields(cls)]
    for field in given:
        if field not in known:
            raise UnknownFieldError(
                f"{name or cls.__name__}: unknown field {field!r}; expected {', '.join(known)}{near(field, known)}"
            )


def check_options(options: Any) -> None:
    """Raise SettingError for options of a reset that are no mapping."""
    if not (options is None or isinstance(options, Mapping)):
        raise SettingError(f"options: expected a mapping, got {shown(options)}")


def check_observation(
    observation: Any, shapes: Mapping[str, tuple[int, ...] | None], name: str = "observation"
) -> None:
    """Raise SettingError for what is no mapping, or lacks finite numbers of some shapes; None stands for any shape."""
    if not isinstance(observation, Mapping):
        raise SettingError(f"{name}: expected a mapping of {', '.join(shapes)}, got {shown(observation)}")
    for key, shape in shapes.items():
        if key not in observation:
            raise SettingError(f"{name}: {key} is missing; it has {', '.join(map(str, observation))}")
        number = as_numbers(f"{name}[{key!r}]", observation[key])
        if shape not in (None, number.shape):
            raise SettingError(f"{name}[{key!r}] has shape {number.shape}, expected {shape}")
        if not np.isfinite(number).all():
            raise SettingError(f"{name}[{key!r}]: expected finite numbers, got {shown(observation[key])}")
