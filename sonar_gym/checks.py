"""Checks of settings that are given as mappings or numbers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any, TypeVar

from acquisition import SettingError
from acquisition.errors import UnknownFieldError
from acquisition.limits import near, shown

Settings = TypeVar("Settings")


def settings_of(cls: type[Settings], given: Any) -> Settings:
    """Return settings as given, from a mapping of their fields, or with their defaults for None.

    Raises:
        SettingError: a field is unknown or missing, or `given` is neither settings nor a mapping.
    """
    if given is None or isinstance(given, Mapping):
        given = {} if given is None else given
        check_fields(cls, given)
        try:
            return cls(**given)
        except TypeError as error:  # a missing field, or a value of a wrong type
            raise SettingError(f"{cls.__name__}: {error}") from None
    if not isinstance(given, cls):
        raise _no_settings(cls, given)
    return given


def _no_settings(cls: type, given: Any) -> SettingError:
    return SettingError(f"{cls.__name__}: expected {cls.__name__} or a mapping of its fields, got {shown(given)}")


def check_fields(cls: type, given: Mapping[str, Any]) -> None:
    """Raise SettingError for what is no mapping, and for a name that is no field of a dataclass."""
    if not isinstance(given, Mapping):
        raise _no_settings(cls, given)
    known = [field.name for field in fields(cls)]
    for name in given:
        if name not in known:
            raise UnknownFieldError(
                f"{cls.__name__}: unknown field {name!r}; expected {', '.join(known)}{near(name, known)}"
            )
