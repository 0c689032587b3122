"""The grid on which readings lie: the step of the sensor's register, also where a log has rounded its multiples."""

from __future__ import annotations

import numpy as np

from acquisition.arrays import Floats

COMMON_MM = (25.4, 10.0)  # inch output and cm output
ROUNDED_MM = 0.5  # half of the step of readings in whole mm, the most common ones
LOGGED_MM = 0.051  # half of the step of readings written to 0.1 mm, and the error of their sums
FINEST_MM = 2.0  # a finer step cannot be told from that of the log
ROUNDING = 1e-6  # relative, of the error of a rounding
MAX_CHANCE = 1e-4  # probability of a coincidental grid below which a grid is accepted; chosen here


def step_of(echo_mm: Floats, distance_mm: Floats) -> float | None:
    """Return the step of which all sorted distinct readings are multiples, mm; None where there is none."""
    common = next((step for step in COMMON_MM if len(echo_mm) and _on_grid(echo_mm, step, LOGGED_MM)), None)
    found = _other_step(echo_mm) if common is None else common * _common_divisor(np.rint(echo_mm / common))
    placed = found is not None and _on_grid(distance_mm, found, LOGGED_MM)
    return common if found is None or placed else found


def shifted_step(reading_mm: Floats, distance_mm: Floats, finer_mm: float) -> float | None:
    """Return the step of which all differences of readings are multiples, mm; None where there is none.

    A shifted grid may begin anywhere, so that a common step must be improbable as a coincidence too, for readings that
    lie on a finer grid anyway. Where the targets stand on such a grid themselves, only different readings of one target
    tell of the sensor's.
    """
    beyond, apart = np.unique(reading_mm - reading_mm.min()), np.unique(distance_mm - distance_mm.min())
    step = step_of(beyond, apart)
    if step is None:
        return None
    different = np.unique(np.stack([distance_mm, reading_mm]), axis=1).shape[1]
    coincidences = different - len(apart) if _on_grid(apart, step, LOGGED_MM) else len(beyond) - 1
    return step if (finer_mm / step) ** float(coincidences) < MAX_CHANCE else None


def _on_grid(value: Floats, step: float, tolerance: float) -> bool:
    """Return whether values are multiples of a step, within a tolerance."""
    return bool(np.all(np.abs(value - np.rint(value / step) * step) < tolerance))


def _common_divisor(count: Floats) -> int:
    """Return the greatest common divisor of distinct whole numbers; 1 where it may be a coincidence."""
    divisor = max(1, int(np.gcd.reduce(count.astype(np.int64))))
    return divisor if divisor ** -(len(count) - 1.0) < MAX_CHANCE else 1


def _other_step(value: Floats) -> float | None:
    """Return the step of which all sorted distinct values, mm, are multiples; None where it may be a coincidence.

    Values in whole millimetres are multiples of a whole number, or were rounded after the quantisation.
    """
    if len(value) < 2:
        return None
    if _on_grid(value, 1.0, 1e-6):
        divisor = _common_divisor(np.rint(value))
        return float(divisor) if divisor > 1 else _rounded_step(value)
    gaps = np.diff(value)
    gap = float(gaps[gaps < 1.5 * gaps.min() + 1e-9].mean())  # between grid neighbours; rounding errors cancel
    for step in (_refine_step(value, gap / k) for k in (1, 2, 3) if gap / k >= FINEST_MM - LOGGED_MM):
        chance = (2.0 * LOGGED_MM / max(step, FINEST_MM)) ** (len(value) - 1)  # one gap determined the step
        if step >= FINEST_MM and chance < MAX_CHANCE and _on_grid(value, step, LOGGED_MM):
            return step
    return None


def _rounded_step(value: Floats) -> float | None:
    """Return the step of which all sorted distinct whole numbers are rounded multiples; None for a coincidence.

    Those that begin with 0 are differences from the least reading, which was rounded too.
    """
    both = 1.0 if value[0] > 0.0 else 2.0
    rounded, finest = both * ROUNDED_MM, both * FINEST_MM
    step = greatest_step(value[value > 0.0], rounded, finest)
    if step is None:
        return None
    tried = value[-1] / finest  # at most: each is another number of steps to the greatest value
    return step if tried * (2.0 * rounded / step) ** (len(value) - 1) < MAX_CHANCE else None


def greatest_step(value: Floats, rounded: float, finest: float) -> float | None:
    """Return the greatest step of which all sorted distinct positive values are rounded multiples; None without one.

    Args:
        value: the values; of fewer than two, nothing follows.
        rounded: greatest error of the rounding.
        finest: least step.
    """
    if len(value) < 2:
        return None
    error = rounded * (1.0 + ROUNDING)
    # no step is greater than the least difference
    fewest, most = value[-1] / (np.diff(value).min() + 2.0 * rounded), value[-1] / finest
    for count in np.arange(np.ceil(fewest), most):
        index = np.maximum(np.rint(value * count / value[-1]), 1.0)
        low, high = float(((value - error) / index).max()), float(((value + error) / index).min())
        if low <= high:
            return 0.5 * (low + high)
    return None


def _refine_step(value: Floats, step: float) -> float:
    """Fit the step by recursive least squares to multiples of increasing size, which each update makes countable."""
    product = square = 0.0
    for multiple in value:
        count = np.rint(multiple / step)
        product, square = product + count * multiple, square + count**2
        step = product / square if square > 0 else step
    return float(step)
