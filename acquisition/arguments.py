"""Arguments of public functions, checked against their annotations, so that an error names the argument."""

from __future__ import annotations

import functools
import inspect
import types
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ParamSpec, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np

from acquisition.errors import SettingError
from acquisition.limits import check_value, shown

Parameters = ParamSpec("Parameters")
Result = TypeVar("Result")
SCALARS = (bool, int, float, str)


def checked(function: Callable[Parameters, Result]) -> Callable[Parameters, Result]:
    """Return a function that checks its arguments at each call.

    Numbers and text are checked as settings are (`acquisition.limits`); other arguments must be instances of one of the
    annotated classes. Annotations of any other kind, such as `ArrayLike` and `Callable`, are left to the function.

    Raises:
        SettingError: an argument is of another type, or outside its limits; the message names it.
    """

    @functools.wraps(function)
    def call(*args: Parameters.args, **kwargs: Parameters.kwargs) -> Result:
        expected = _expected(function)
        for kind, value in zip(expected.values(), args, strict=False):
            if kind is not None and not isinstance(value, kind.classes):
                kind.check(value)
        for name, value in kwargs.items():
            kind = expected.get(name)
            if kind is not None and not isinstance(value, kind.classes):
                kind.check(value)
        return function(*args, **kwargs)

    return call


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

    def check(self, value: Any) -> None:
        """Raise SettingError unless the value is as one of the scalars."""
        if len(self.scalars) == 1 and set(self.classes) <= {type(None)}:
            check_value(self.name, value, self.scalars[0])
        elif not isinstance(value, tuple(map(_class, self.scalars))):
            classes = (*self.classes, *map(_class, self.scalars))
            expected = " or ".join("None" if cls is type(None) else cls.__name__ for cls in classes)
            raise SettingError(f"{self.name}: expected {expected}, got {shown(value)}")


@functools.cache
def _expected(function: Callable[..., Any]) -> Mapping[str, _Kind | None]:
    """Return what the positional and keyword parameters must be, in order; None for one that is not checked."""
    hints, title = get_type_hints(function, include_extras=True), function.__qualname__.replace(".__init__", "")
    named = (p.name for p in inspect.signature(function).parameters.values() if p.kind is not p.VAR_KEYWORD)
    return {name: _kind(f"{title}.{name}", hints[name]) if name in hints else None for name in named}


def _kind(name: str, hint: Any) -> _Kind | None:
    """Return what a hint says if all its members are classes whose instances can be recognised."""
    members = list(_members(hint))
    if not all(map(_is_recognised, map(_class, members))):
        return None
    others = tuple(cls for cls in map(_class, members) if cls not in SCALARS)
    return _Kind(name, others, tuple(member for member in members if _class(member) in SCALARS))


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


def _is_recognised(cls: Any) -> bool:
    is_protocol = getattr(cls, "_is_protocol", False) and not getattr(cls, "_is_runtime_protocol", False)
    return isinstance(cls, type) and cls not in (Any, np.ndarray) and not is_protocol
