"""Short representations: what a notebook prints of an object fits into two lines."""

from __future__ import annotations

from dataclasses import MISSING, Field, fields
from typing import Any

MAX_REPR, MAX_VALUE = 200, 60  # characters


def shortened(text: str, longest: int = MAX_REPR) -> str:
    """Return a text of limited length; what is left out is an ellipsis.

    >>> shortened("a long text", 9)
    'a long...'
    """
    return text if len(text) <= longest else f"{text[: longest - 3]}..."


def brief(self: Any) -> str:
    """Return the fields of a dataclass that differ from their defaults; arrays by type and shape."""
    shown = (
        f"{field.name}={_value(value)}" for field in fields(self) if _differs(field, value := getattr(self, field.name))
    )
    return shortened(f"{type(self).__name__}({', '.join(shown)})")


def _value(value: Any) -> str:
    shape = getattr(value, "shape", None)
    return f"{value.dtype} {shape}" if isinstance(shape, tuple) else shortened(repr(value), MAX_VALUE)


def _differs(field: Field[Any], value: Any) -> bool:
    if not field.repr:
        return False
    default = field.default_factory() if field.default_factory is not MISSING else field.default
    return hasattr(value, "shape") or value != default
