"""Numbers with units as text: lengths below 1 m in mm, probabilities in %, never an exponent or a signed zero."""

from __future__ import annotations

import math
from collections.abc import Mapping

from noise.discrepancy.result import Interval, Range

PERCENT = ("probability", "presence", "share", "error", "logged_share")  # dimensionless parameters that are shares
UNITS = {"degC": "°C", "1": "", "deg": "°"}
DEG = 180.0 / math.pi
# column -> words before the bounds, factor to the printed unit, printed unit
COLUMNS = {
    "distance": ("at", 1.0, "m"),
    "angle": ("at angles of", DEG, "°"),
    "incidence": ("at incidence angles of", DEG, "°"),
    "reflectance": ("at reflectances of", 1.0, ""),
    "interval_s": ("at intervals of", 1000.0, "ms"),
    "temperature_c": ("at temperatures of", 1.0, "°C"),
    "humidity_pct": ("at a humidity of", 1.0, "%"),
    "abs_angle": ("at angles to either side of", DEG, "°"),
    "range_rate_mps": ("at range rates of", 1.0, "m/s"),
    "movement": ("after movements of", 1000.0, "mm"),
    "order": ("at places in the visit of", 1.0, ""),
    "run": ("in session", 1.0, "(counted from 0)"),
    "period_s": ("with a period of", 1.0, "s"),
}
# values of the column "previous_reading": what the ping before read
PREVIOUS = {-2: "nothing", -1: "something before the target", 0: "the target", 1: "something behind the target"}


TIMES = ((7200.0, 60.0, "min"), (172_800.0, 3600.0, "h"), (math.inf, 86_400.0, "days"))  # up to s, unit in s, name


def time_unit(longest_s: float) -> tuple[float, str]:
    """Return the factor from s to the unit in which times up to a length are printed, and its name."""
    return next((1.0 / seconds, unit) for upto, seconds, unit in TIMES if longest_s <= upto)


def plain(value: float, digits: int = 2) -> str:
    """Return a number with the given significant digits, without exponent and without the sign of a zero.

    >>> plain(-0.00001234), plain(1234.6), plain(-0.0)
    ('-0.000012', '1,235', '0')
    """
    if not math.isfinite(value):
        return "unknown"
    if value == 0:
        return "0"
    places = max(0, digits - 1 - math.floor(math.log10(abs(value))))
    text = f"{value:,.{places}f}"
    text = text.rstrip("0").rstrip(".") if "." in text else text
    return "0" if text.strip("-0.,") == "" else text


def _scale(size: float, unit: str, percent: bool) -> tuple[float, str]:
    """Return the factor and the unit in which a value is printed, by the size of the value."""
    if unit == "m" and size < 1.0:
        return 1000.0, " mm"
    if unit == "1" and percent:
        return 100.0, " %"
    printed = UNITS.get(unit, unit)
    return 1.0, printed if printed in ("", "°") else f" {printed}"


def quantity(value: float, unit: str, percent: bool = True, digits: int = 2) -> str:
    """Return a value with its unit; a dimensionless value in % unless `percent` is False.

    >>> quantity(0.0152, "m"), quantity(0.083, "1"), quantity(24.1, "degC")
    ('15 mm', '8.3 %', '24 °C')
    """
    factor, printed = _scale(abs(value), unit, percent)
    return plain(factor * value, digits) + printed if math.isfinite(value) else "unknown"


def with_interval(found: Interval, percent: bool = True) -> str:
    """Return a value with its interval.

    >>> with_interval(Interval(0.015, 0.014, 0.016, "m"))
    '15 mm (14 to 16 mm)'
    """
    return f"{estimate(found, percent)} ({bounds(found, percent)})"


def estimate(found: Interval, percent: bool = True) -> str:
    """Return a value with its unit and as many digits as its interval, so that it lies in what is printed of that.

    >>> estimate(Interval(1.234, 1.233, 1.235, "m"))
    '1.234 m'
    """
    return quantity(found.value, found.unit, percent, _digits(found))


def bounds(found: Interval, percent: bool = True) -> str:
    """Return the interval of a value, with enough digits to show its width."""
    if not (math.isfinite(found.low) and math.isfinite(found.high)):
        return "interval unknown"
    factor, printed = _scale(abs(found.value), found.unit, percent)
    low, high = (plain(factor * bound, _digits(found)) for bound in (found.low, found.high))
    return f"{low} to {high}{printed}"


def _digits(found: Interval) -> int:
    """Return how many significant digits show the width of an interval."""
    size, width = max(abs(found.low), abs(found.high)), found.high - found.low
    return min(6, max(2, 1 + math.ceil(math.log10(size / width)))) if 0 < width < size else 2


def parameter(name: str, found: Interval) -> str:
    """Return a parameter's value with its interval; shares in %."""
    return with_interval(found, name in PERCENT)


def readable(name: str, unit: str) -> str:
    """Return a parameter's name as words, without the unit at its end.

    >>> readable("temperature_c", "degC"), readable("rate_k_per_h", "K/h")
    ('temperature', 'rate')
    """
    suffix = "_" + unit.lower().replace("/", "_per_").replace("degc", "c")
    return name.removesuffix(suffix).replace("_", " ")


def span(column: str, between: Range) -> str:
    """Return a range of one column as words.

    >>> span("distance", (0.7, 2.0)), span("angle", (0.35, float("inf")))
    ('at 0.7 to 2 m', 'at angles of more than 20°')
    """
    if column == "previous_reading":
        read = [text for value, text in PREVIOUS.items() if between[0] <= value <= between[1]]
        return f"after pings that read {' or '.join(read)}"
    words, factor, unit = COLUMNS.get(column, (f"where {column} is", 1.0, ""))
    if column == "time":
        words, (factor, unit) = (
            "at times of",
            time_unit(max((abs(t) for t in between if math.isfinite(t)), default=0.0)),
        )
    low, high = (factor * bound for bound in between)
    unit = unit if unit in ("", "°") else f" {unit}"
    if not math.isfinite(low):
        return f"{words} less than {plain(high)}{unit}" if math.isfinite(high) else ""
    if not math.isfinite(high):
        return f"{words} more than {plain(low)}{unit}"
    digits = 2 if high - low > 0.05 * max(abs(low), abs(high)) else 4
    ends = dict.fromkeys((plain(low, digits), plain(high, digits)))  # one of a single value
    return f"{words} {' to '.join(ends)}{unit}"


def place(region: Mapping[str, Range]) -> str:
    """Return a region as words; "everywhere" where nothing is restricted."""
    parts = [text for text in (span(column, between) for column, between in region.items()) if text]
    return " and ".join(parts) or "everywhere"
