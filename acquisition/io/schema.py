"""Files of settings (JSON, TOML) against a schema: unknown, missing and impossible fields are named."""

from __future__ import annotations

import math
from functools import cache
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, TypeAdapter, ValidationError

from acquisition.errors import ModelError, SonarError
from acquisition.io.files import is_file, read_limited
from acquisition.limits import shown

MAX_DEPTH = 5  # names of a place in a message
MAX_PARTS = 1_000_000  # lists, objects and texts of a file, each of which takes many times its length in memory


class Schema(BaseModel):
    """Base of the schemas: no unknown fields, no conversion between types, no NaN and no infinity."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)


@cache
def _adapter(schema: Any) -> TypeAdapter[Any]:
    return TypeAdapter(schema)


def read_json(path: Path, schema: Any, error: type[SonarError] = ModelError) -> dict[str, Any]:
    """Return the content of a JSON file that fits a schema, as plain data, without the fields that are not given.

    Args:
        path: of the file.
        schema: subclass of `Schema`, or a union of them.
        error: raised for a file that does not fit.
    """
    if not is_file(path):
        raise error(f"{path.parent}: contains no {path.name}; give the folder as it was saved")
    content = read_limited(path, error, "a file of settings")
    if sum(map(content.count, (b"{", b"[", b'"'))) > 2 * MAX_PARTS:
        raise error(f"{path}: holds more than {MAX_PARTS:,} lists, objects and texts; give a file of settings")
    return validated(content, schema, str(path), error)


def validated(content: bytes | dict[str, Any], schema: Any, place: str, error: type[SonarError]) -> dict[str, Any]:
    """Return JSON text, or plain data, that fits a schema; see `read_json`.

    Args:
        content: text or data.
        schema: to fit.
        place: where it comes from, for the message.
        error: raised if it does not fit; the message names the first field that does not.
    """
    adapter = _adapter(schema)
    try:
        fits = adapter.validate_json(content) if isinstance(content, bytes) else adapter.validate_python(content)
    except ValidationError as failed:
        raise error(f"{place}: {_reason(failed)}; it is damaged or of another version") from None
    found: dict[str, Any] = adapter.dump_python(fits, exclude_unset=True)
    endless = _not_finite(found)
    if endless is not None:
        raise error(f"{place}: {_shortened(endless)}: not a finite number; it is damaged or of another version")
    return found


def _not_finite(data: Any, *names: str) -> list[str] | None:
    """Return the names that lead to a NaN or infinity in plain data: a schema does not look into free fields."""
    if isinstance(data, float):
        return None if math.isfinite(data) else list(names)
    if isinstance(data, list) and _holds_finite_numbers(data):  # the long ones
        return None
    parts = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list | tuple) else ()
    return next(filter(None, (_not_finite(part, *names, str(name)) for name, part in parts)), None)


def _holds_finite_numbers(data: list[Any]) -> bool:
    kinds = set(map(type, data))
    return kinds <= {int} or (kinds == {float} and all(map(math.isfinite, data)))


def _shortened(names: list[str]) -> str:
    return ".".join(names if len(names) <= MAX_DEPTH else ["...", *names[-MAX_DEPTH:]])


def _reason(failed: ValidationError) -> str:
    first = failed.errors(include_url=False)[0]
    where = _shortened([str(name) for name in first["loc"]])
    text = first["msg"][0].lower() + first["msg"][1:]
    if first["type"] == "json_invalid":
        return f"not JSON: {text.removeprefix('invalid JSON: ')}"
    value = "" if first["type"] in ("missing", "extra_forbidden") else f", got {shown(first['input'])}"
    return f"{where or 'content'}: {text}{value}"
