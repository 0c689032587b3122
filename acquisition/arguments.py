"""Arguments of public functions, checked against their annotations, so that an error names the argument."""

from __future__ import annotations

import functools
import inspect
import types
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from io import IOBase
from typing import Annotated, Any, ParamSpec, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np

from acquisition.errors import SettingError
from acquisition.limits import as_numbers, as_whole, check_value, shown

Parameters = ParamSpec("Parameters")
Result = TypeVar("Result")
SCALARS = (bool, int, float, str)


def checked(function: Callable[Parameters, Result]) -> Callable[Parameters, Result]:
    """Return a function that checks its arguments at each call.

    Numbers and text are checked as settings are (`acquisition.limits`); other arguments must be instances of one of the
    annotated classes. What is annotated as an array of float64 or int64 becomes one; an `Iterable` or `Sequence` of a
    class becomes a tuple of its instances. Any other annotation, such as `ArrayLike`, is left to the function.

    Raises:
        SettingError: an argument is of another type, or outside its limits; the message names it.
    """

    @functools.wraps(function)
    def call(*args: Parameters.args, **kwargs: Parameters.kwargs) -> Result:
        kinds = _expected(function)
        given: Any = [_admitted(kind, value) for kind, value in zip(kinds.values(), args, strict=False)]
        named: Any = {name: _admitted(kinds.get(name), value) for name, value in kwargs.items()}
        given += args[len(given) :]
        return function(*given, **named)

    return call


def _admitted(kind: _Kind | None, value: Any) -> Any:
    return value if kind is None or kind.holds(value) else kind.admit(value)


@dataclass(frozen=True)
class _Kind:
    """What an argument must be.

    Attributes:
        name: of the argument, with its function.
        classes: of which it may be an instance without further checks.
        scalars: annotations of numbers and text, whose values are checked.
    """

    name: str
    classes: tuple[type, ...]
    scalars: tuple[Any, ...]

    def holds(self, value: Any) -> bool:
        """Return whether a value is an instance of one of the classes."""
        if isinstance(value, type):  # a class has the methods of a protocol, and is no instance of it
            return any(isinstance(value, cls) for cls in self.classes if not _is_protocol(cls))
        return isinstance(value, self.classes)

    def admit(self, value: Any) -> Any:
        """Return the value; raise SettingError unless it is as one of the scalars."""
        if len(self.scalars) == 1 and set(self.classes) <= {type(None)}:
            check_value(self.name, value, self.scalars[0])
            if _class(self.scalars[0]) is float:
                return float(value)
        elif not isinstance(value, tuple(map(_class, self.scalars))):
            classes = (*self.classes, *map(_class, self.scalars))
            expected = " or ".join("None" if cls is type(None) else cls.__name__ for cls in classes)
            raise SettingError(f"{self.name}: expected {expected}, got {shown(value)}")
        return value


@dataclass(frozen=True)
class _Array(_Kind):
    """An argument that is an array of numbers; `whole` ones are int64."""

    whole: bool

    def admit(self, value: Any) -> Any:
        """Return the value as an array; raise SettingError if it holds anything but numbers."""
        if isinstance(value, np.ndarray) and value.dtype == (np.int64 if self.whole else np.float64):
            return value
        numbers = as_numbers(self.name, value)
        return as_whole(self.name, numbers) if self.whole else numbers


@dataclass(frozen=True)
class _Items(_Kind):
    """An argument that is several instances of a class."""

    item: type

    def admit(self, value: Any) -> Any:
        """Return the value as a tuple; raise SettingError if one item is of another class."""
        has_items = isinstance(value, Iterable) and not (isinstance(value, np.ndarray) and value.ndim == 0)
        items = []
        for each in value if has_items and not isinstance(value, IOBase) else (value,):  # which may have no end
            if not isinstance(each, self.item):
                raise SettingError(f"{self.name}: expected a list of {self.item.__name__}, got {shown(each)} in it")
            items.append(each)
        return tuple(items)


@functools.cache
def _expected(function: Callable[..., Any]) -> Mapping[str, _Kind | None]:
    """Return what the positional and keyword parameters must be, in order; None for one that is not checked."""
    hints, title = get_type_hints(function, include_extras=True), function.__qualname__.replace(".__init__", "")
    named = (p.name for p in inspect.signature(function).parameters.values() if p.kind is not p.VAR_KEYWORD)
    return {name: _kind(f"{title}.{name}", hints[name]) if name in hints else None for name in named}


def _kind(name: str, hint: Any) -> _Kind | None:
    """Return what a hint says if all its members are classes whose instances can be recognised."""
    members = list(_members(hint))
    special = [member for member in members if _number_type(member) or _item(member)]
    rest = [member for member in members if member not in special]
    if len(special) > 1 or complex in rest or not all(map(_is_recognised, map(_class, rest))):
        return None  # complex: of `ArrayLike`
    others = tuple(cls for cls in map(_class, rest) if cls not in SCALARS)
    scalars = tuple(member for member in rest if _class(member) in SCALARS)
    if not special or scalars:
        return None if special else _Kind(name, others, scalars)
    if item := _item(special[0]):
        return _Items(name, others, scalars, item)
    return _Array(name, others, scalars, _number_type(special[0]) is np.int64)


def _number_type(hint: Any) -> type | None:
    """Return the type of the numbers of an array; None for other hints, and for arrays of anything else."""
    found = next(iter(get_args(get_args(hint)[1])), None) if get_origin(hint) is np.ndarray else None
    return found if found in (np.float64, np.int64) else None


def _item(hint: Any) -> type | None:
    """Return the class of the items of an iterable; None for other hints, and for numbers and text."""
    found = get_args(hint)[0] if get_origin(hint) in (Iterable, Sequence) else None
    return found if _is_recognised(found) and found not in SCALARS else None


def _members(hint: Any) -> Iterator[Any]:
    """Yield the members of a union, and those of its unions."""
    if get_origin(hint) in (Union, types.UnionType):
        for member in get_args(hint):
            yield from _members(member)
    else:
        yield hint


def _class(hint: Any) -> Any:
    """Return the class of a hint without its parameters and limits."""
    plain = get_args(hint)[0] if get_origin(hint) is Annotated else hint
    return get_origin(plain) or plain


def _is_protocol(cls: Any) -> bool:
    return bool(getattr(cls, "_is_protocol", False))


def _is_recognised(cls: Any) -> bool:
    unknown = _is_protocol(cls) and not getattr(cls, "_is_runtime_protocol", False)
    return isinstance(cls, type) and cls not in (Any, np.ndarray) and not unknown
