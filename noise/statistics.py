"""How far values usually lie from their middle, whatever a few of them do."""

from __future__ import annotations

import numpy as np

from noise.law import Floats

NORMAL = 1.4826  # standard deviations of a normal in its median absolute deviation
USUAL = 3.0  # usual deviations, beyond which a value is pulled in; ours


def robust_std(error: Floats) -> float:
    """Return the standard deviation of errors about zero as their median size has it; of none, nan.

    Args:
        error: (n,), signed or not.
    """
    return NORMAL * float(np.median(np.abs(error)))


def winsorised(value: Floats, more: float = 1e-6) -> Floats:
    """Return values with what lies farther than three usual deviations from their middle pulled in.

    Args:
        value: (n,).
        more: allowed besides, in the unit of the values.
    """
    middle = float(np.median(value))
    limit = USUAL * robust_std(value - middle) + more
    return np.clip(value, middle - limit, middle + limit)
