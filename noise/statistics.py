"""Robust estimates of location and scale."""

from __future__ import annotations

import numpy as np

from acquisition.arrays import Floats

STD_PER_MAD = 1.4826  # ratio of the standard deviation to the median absolute deviation of a normal distribution
N_DEVIATIONS = 3.0  # limit of winsorising, in robust standard deviations; chosen here


def robust_std(error: Floats) -> float:
    """Return a robust standard deviation about zero, 1.4826 times the median absolute error; NaN for no errors.

    Args:
        error: errors, (n,), signed or absolute.
    """
    return STD_PER_MAD * float(np.median(np.abs(error)))


def winsorised(value: Floats, slack: float = 1e-6) -> Floats:
    """Return values clipped to three robust standard deviations about their median.

    Args:
        value: values, (n,).
        slack: added to the limit, in the unit of the values.
    """
    median = float(np.median(value))
    limit = N_DEVIATIONS * robust_std(value - median) + slack
    return np.clip(value, median - limit, median + limit)
