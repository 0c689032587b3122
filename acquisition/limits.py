"""Limits of settings: written once, in the annotation of a field, and checked in one place.

A field `gain: Annotated[int, Limit(0, 31)]` is checked by `check_settings`, whether its value comes from the command
line, from a mapping or from Python. Pydantic reads the same annotations in the schemas of files.
"""

from __future__ import annotations

import difflib
import itertools
import math
import sys
import types
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, fields
from enum import Enum
from functools import cache
from pathlib import PurePath
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

import numpy as np
from annotated_types import BaseMetadata, Ge, GroupedMetadata, Gt, Le, Lt, MinLen

from acquisition.arrays import Floats, Ints
from acquisition.errors import SettingError, SonarError


@dataclass(frozen=True)
class Limit(GroupedMetadata):
    """Range of valid values of a number.

    Attributes:
        low, high: limits, both included.
        unit: for messages; "" if dimensionless.
        open_low, open_high: the limit itself is excluded.
    """

    low: float = -math.inf
    high: float = math.inf
    unit: str = ""
    open_low: bool = False
    open_high: bool = False

    def __iter__(self) -> Iterator[BaseMetadata]:
        """Yield the limits as Pydantic understands them."""
        if math.isfinite(self.low):
            yield Gt(self.low) if self.open_low else Ge(self.low)
        if math.isfinite(self.high):
            yield Lt(self.high) if self.open_high else Le(self.high)

    def holds(self, value: float) -> bool:
        """Return whether a value is finite, as a float too, and within the limits."""
        value = value.item() if isinstance(value, np.generic) else value  # comparisons of short floats overflow
        above = value > self.low if self.open_low else value >= self.low
        below = value < self.high if self.open_high else value <= self.high
        return above and below and abs(value) <= sys.float_info.max

    def phrase(self, noun: str) -> str:
        """Return what is expected, for a message: "a number from 0 to 1 m"."""
        unit = f" {self.unit}" if self.unit else ""
        above = f"above {self.low:.10g}" if self.open_low else f"of at least {self.low:.10g}"
        below = f"below {self.high:.10g}" if self.open_high else f"at most {self.high:.10g}"
        if not (self.open_low or self.open_high or math.isinf(self.low) or math.isinf(self.high)):
            return f"{noun} from {self.low:.10g} to {self.high:.10g}{unit}"
        parts = [above] * math.isfinite(self.low) + [below] * math.isfinite(self.high)
        return f"{noun} {' and '.join(parts)}{unit}" if parts else noun.replace("a number", "a finite number")


@dataclass(frozen=True)
class OneOf:
    """Marks text that is one of a few names."""

    names: Collection[str]

    def __call__(self, name: str, value: str) -> None:
        """Raise SettingError for another name."""
        check_choice(name, value, list(self.names))

    def __hash__(self) -> int:
        return hash(tuple(self.names))


@dataclass(frozen=True)
class Loadable:
    """Marks text that names something to load, or its place; `load` raises SonarError where there is nothing."""

    load: Callable[[str], object]

    def __call__(self, name: str, value: str) -> None:
        """Raise SettingError where nothing can be loaded."""
        try:
            self.load(value)
        except SonarError as error:
            raise SettingError(f"{name}: {error}") from None


Finite = Annotated[float, Limit()]
Seed = Annotated[int, Limit(0, 2**32 - 1)]
Workers = Annotated[int, Limit(1, 256)]
Count = Annotated[int, Limit(1, 1_000_000)]
Share = Annotated[float, Limit(0.0, 1.0)]
Rate = Annotated[float, Limit(0.0, 1.0, open_low=True)]
Metres = Annotated[float, Limit(0.0, 1000.0, "m")]
PositiveMetres = Annotated[float, Limit(0.0, 1000.0, "m", open_low=True)]
WHOLE = int | np.integer
REAL = WHOLE | float | np.floating  # not a fraction: compiled code knows none
MAX_VALUES = 1_000_000  # of a setting: checking more would take seconds, and a range may be endless in practice
NO_NUMBER = bool | np.timedelta64  # which are also integers
ANY_NUMBER, SEEDS = Limit(), Limit(0, 2**63 - 1)


def as_numbers(name: str, value: Any) -> Floats:
    """Return an array of floats.

    Raises:
        SettingError: the value cannot be one, such as text or rows of unequal lengths.
    """
    try:
        return np.asarray(value, dtype=np.float64)
    except (MemoryError, OverflowError, RuntimeError, TypeError, ValueError):  # as of a tensor with a gradient
        raise SettingError(f"{name}: expected numbers, got {shown(value)}") from None


def as_whole(name: str, numbers: Floats) -> Ints:
    """Return numbers as integers.

    Raises:
        SettingError: one is not a whole number that a float holds exactly.
    """
    if not np.all((np.abs(numbers) < 2**53) & (numbers == np.floor(numbers))):  # also not NaN
        raise SettingError(f"{name}: expected whole numbers, got {shown(numbers)}")
    return numbers.astype(np.int64)


def is_list(value: Any) -> bool:
    """Return whether a value is an array with dimensions or a sequence of a countable length, and not text or bytes.

    >>> [is_list(each) for each in ([1], np.zeros(2), "x", b"x", np.array(1.0), range(10**30))]
    [True, True, False, False, False, False]
    """
    return value.ndim > 0 if isinstance(value, np.ndarray) else _is_sequence(value)


def _is_sequence(value: Any) -> bool:
    if not isinstance(value, Sequence) or isinstance(value, str | bytes | bytearray):
        return False
    try:
        len(value)
    except OverflowError:  # a range may be longer than a length can be
        return False
    return True


def check_number(name: str, value: Any, limit: Limit = ANY_NUMBER, whole: bool = False) -> None:
    """Check one number.

    Args:
        name: of the setting, for the message.
        value: to check.
        limit: its limits.
        whole: only whole numbers are valid.

    Raises:
        SettingError: not a finite number within the limits; the message gives name, limits, unit and value.
    """
    is_number = isinstance(value, WHOLE if whole else REAL) and not isinstance(value, NO_NUMBER)
    if is_number and limit.holds(value):
        return
    noun = "a whole number" if whole else "a number"
    unit = f" {limit.unit}" if limit.unit and is_number else ""
    raise SettingError(f"{name}: expected {limit.phrase(noun)}, got {shown(value)}{unit}")


def shown(value: Any) -> str:
    """Return a value for a message, at most 60 characters."""
    try:
        text = f"{value:.10g}" if isinstance(value, float) else repr(value)
    except ValueError:  # a whole number of more digits than Python converts
        text = f"{type(value).__name__} that is too long to show"
    return text if len(text) <= 60 else f"{text[:57]}..."


def check_settings(settings: Any, name: Callable[[str], str] | None = None) -> None:
    """Check the fields of a dataclass against their annotations; types other than numbers, text and choices pass.

    Args:
        settings: instance of a dataclass.
        name: maps the name of a field to that in messages; by default `Class.field`.

    Raises:
        SettingError: a field is not of its type or outside its limits.
    """
    cls: type = type(settings)
    for field, hint in hints_of(cls):
        _check(f"{cls.__name__}.{field}" if name is None else name(field), getattr(settings, field), hint)


@cache
def hints_of(cls: type) -> tuple[tuple[str, Any], ...]:
    """Return names and annotations of the fields of a dataclass."""
    hints = get_type_hints(cls, include_extras=True)
    return tuple((field.name, hints[field.name]) for field in fields(cls))


def check_value(name: str, value: Any, hint: Any) -> None:
    """Check one value against an annotation, as `check_settings` does.

    Raises:
        SettingError: not of its type or outside its limits.
    """
    _check(name, value, hint)


def _check(name: str, value: Any, hint: Any) -> None:
    limit = ANY_NUMBER
    if get_origin(hint) is Annotated:
        hint, *extras = get_args(hint)
        limit = next((extra for extra in extras if isinstance(extra, Limit)), ANY_NUMBER)
        _check(name, value, hint if limit is ANY_NUMBER else Any)
        for extra in extras:
            if isinstance(extra, OneOf | Loadable):
                extra(name, value)
            elif isinstance(extra, MinLen) and len(value) < extra.min_length:
                raise SettingError(f"{name}: expected at least {extra.min_length} value, got {len(value)}")
    if hint in (int, float):
        check_number(name, value, limit, whole=hint is int)
    elif hint is bool:
        _expect(isinstance(value, bool), name, "true or false", value)
    elif get_origin(hint) is Literal:
        check_choice(name, value, get_args(hint))
    elif get_origin(hint) is tuple:
        _check_tuple(name, value, get_args(hint))
    elif get_origin(hint) in (Union, types.UnionType):
        _check_union(name, value, get_args(hint))
    elif hint is str:
        _expect(isinstance(value, str), name, "text", value)
        _check_unicode(name, value)
    elif isinstance(value, PurePath):
        _check_path(name, value)


def _check_tuple(name: str, value: Any, items: tuple[Any, ...]) -> None:
    _expect(is_list(value), name, "a list", value)
    any_number = items[-1] is Ellipsis
    _expect(any_number or len(value) == len(items), name, f"{len(items)} values", value)
    _expect(len(value) <= MAX_VALUES, name, f"at most {MAX_VALUES} values", value)
    for member, hint in zip(value, itertools.repeat(items[0]) if any_number else items, strict=False):
        _check(name, member, hint)


def _check_union(name: str, value: Any, members: tuple[Any, ...]) -> None:
    """Check a value against the only member besides None; other unions are left to their owner."""
    rest = [member for member in members if member is not type(None)]
    if len(rest) == 1 and value is not None:
        _check(name, value, rest[0])
    elif isinstance(value, PurePath):
        _check_path(name, value)


def _check_path(name: str, path: PurePath) -> None:
    _expect("\0" not in str(path), name, "a path without null characters", str(path))
    _check_unicode(name, str(path))


def _check_unicode(name: str, text: str) -> None:
    """Check that text can be written: bytes of a name that are not UTF-8 are half characters in Python."""
    _expect(not any("\ud800" <= letter <= "\udfff" for letter in text), name, "valid UTF-8 (rename the file)", text)


def check_choice(name: str, value: Any, known: Sequence[Any]) -> None:
    """Check that a value is one of a few.

    Raises:
        SettingError: it is none of them; the message lists them, and the nearest one.
    """
    is_plain = isinstance(value, str | int | Enum)  # an array, for one, cannot be compared as a whole
    if not is_plain or value not in known:
        expected = ", ".join(map(str, known))
        raise SettingError(f"{name}: expected one of {expected}, got {shown(value)}{near(value, known)}")


def near(given: Any, known: Iterable[Any]) -> str:
    """Return "; did you mean ...?" for a misspelt name, or nothing.

    >>> near("gausian", ["ideal", "gaussian"])
    '; did you mean gaussian?'
    """
    found = difflib.get_close_matches(str(given)[:100], [str(name) for name in known], n=1)
    return f"; did you mean {found[0]}?" if found else ""


def _expect(valid: bool, name: str, expected: str, value: Any) -> None:
    if not valid:
        raise SettingError(f"{name}: expected {expected}, got {shown(value)}")
