"""Survey plans in TOML files; error messages name file, key, value and limit.

Values are given as a list or as a range with both ends: `distances_mm = {from = 200, to = 3000, step = 200}`.
"""

from __future__ import annotations

import tomllib
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from acquisition.errors import SettingError
from acquisition.io.files import read_limited
from acquisition.limits import check_number, near, shown
from acquisition.survey.plan import MAX_CONDITIONS, PLANS, SurveyPlan

KEYS = tuple(field.name for field in fields(SurveyPlan))
REQUIRED = ("distances_mm", "angles_deg")
LISTS = ("distances_mm", "angles_deg", "reflectances", "incidences_deg")
RANGE_KEYS = ("from", "to", "step")
KINDS: dict[str, tuple[type, ...]] = {
    "pings": (int,),
    "seed": (int,),
    "interval_s": (int, float),
    "move_s": (int, float),
    "facing": (bool,),
    "order": (str,),
}
NAMES = {int: "a whole number", float: "a number", bool: "true or false", str: "text"}


def find_plan(name: str) -> SurveyPlan:
    """Return a built-in plan by name, or the plan in a TOML file.

    Raises:
        SettingError: neither exists, or the file is not a valid plan.
    """
    if name in PLANS:
        return PLANS[name]
    if not name.endswith(".toml"):
        raise SettingError(
            f"plan {name!r}: expected one of {', '.join(PLANS)}, or the path of a .toml file{near(name, PLANS)}"
        )
    return load_plan(Path(name))


def load_plan(path: Path) -> SurveyPlan:
    """Read a plan.

    Raises:
        SettingError: the file is missing or not TOML, a key is unknown, or a value lies outside its limits.
    """
    try:
        content = tomllib.loads(read_limited(path, SettingError, "a plan (TOML)").decode())
    except (ValueError, RecursionError) as error:  # of its syntax, of bytes, of long numbers, of nested lists
        raise SettingError(f"{path}: not TOML: {error}") from None
    try:
        return SurveyPlan(**_settings(content))
    except SettingError as error:
        raise SettingError(f"{path}, {error}") from None


def _settings(content: dict[str, Any]) -> dict[str, Any]:
    for key in content:
        if key not in KEYS:
            raise SettingError(f"{key}: unknown key, expected one of {', '.join(KEYS)}")
    for key in REQUIRED:
        if key not in content:
            raise SettingError(f"{key}: is missing; a plan needs {' and '.join(REQUIRED)}")
    return {key: _value(key, value) for key, value in content.items()}


def _value(key: str, value: Any) -> Any:
    if key in LISTS:
        return _axis(key, value)
    if key == "sweep":
        _expect(isinstance(value, dict), key, "a table of quantities", value)
        return {name: _axis(f"sweep.{name}", values) for name, values in value.items()}
    kinds = KINDS[key]
    fits = isinstance(value, kinds) and isinstance(value, bool) == (bool in kinds)
    _expect(fits, key, NAMES[kinds[-1]], value)
    return value


def _axis(key: str, value: Any) -> tuple[float, ...]:
    """Return the values of a list or a range."""
    if isinstance(value, dict):
        return _range(key, value)
    _expect(isinstance(value, list), key, "a list of numbers or {from, to, step}", value)
    return tuple(_number(key, item) for item in value)


def _range(key: str, given: dict[str, Any]) -> tuple[float, ...]:
    _expect(set(given) == set(RANGE_KEYS), key, "{from, to, step}", given)
    start, stop, step = (_number(f"{key}.{name}", given[name]) for name in RANGE_KEYS)
    _expect(step > 0, f"{key}.step", "a number above 0", step)
    steps = np.floor((stop - start) / step + 1e-9)  # infinite where the step is tiny
    _expect(0 <= steps < MAX_CONDITIONS, key, f"a range of 1 to {MAX_CONDITIONS} values", given)
    return tuple(float(value) for value in np.round(start + step * np.arange(int(steps) + 1), 9))


def _number(key: str, value: Any) -> float:
    check_number(key, value)
    return float(value)


def _expect(valid: bool, key: str, expected: str, value: Any) -> None:
    if not valid:
        raise SettingError(f"{key}: expected {expected}, got {shown(value)}")
