"""The verdict in one word, from the test, the shares and the probabilities of causes."""

from __future__ import annotations

from collections.abc import Sequence

from noise.discrepancy.result import Aspect, Cause, Kind, Location, PValue, Unexplained, Visible
from noise.discrepancy.thresholds import (
    BIAS_TOLERANCE_M,
    EXPLAINED_SHARE,
    FALSE_ALARM,
    LEAST_VISIBLE_M,
    LEAST_VISIBLE_SHARE,
    PARTLY_SHARE,
    SHARE_TOLERANCE,
    SPREAD_TOLERANCE,
)

TOLERANCE = {Aspect.BIAS: BIAS_TOLERANCE_M, Aspect.DETECTION: SHARE_TOLERANCE, Aspect.SPREAD: SPREAD_TOLERANCE}


def differs(p_value: PValue, where: Sequence[Location]) -> bool:
    """Return whether the recording differs by more than two recordings of one sonar."""
    if p_value.value >= FALSE_ALARM:
        return False
    return not where or any(abs(each.size.value) >= TOLERANCE.get(each.aspect, 0.0) for each in where)


def shows_little(visible: Sequence[Visible]) -> bool:
    """Return whether no difference of plausible size could have been seen."""
    limits = {"bias": LEAST_VISIBLE_M, "detection": LEAST_VISIBLE_SHARE}
    found = {each.effect: each.least for each in visible}
    return all(not found.get(name, float("inf")) <= limit for name, limit in limits.items())


def kind_of(causes: Sequence[Cause], together: float, rest: Unexplained) -> Kind:
    """Return the verdict on a recording that differs.

    Args:
        causes: believed causes.
        together: their share of the misfit.
        rest: what they leave.
    """
    if not causes or together < PARTLY_SHARE:
        return Kind.UNEXPLAINED
    if together >= EXPLAINED_SHARE or rest.p_value.value >= FALSE_ALARM:
        return Kind.EXPLAINED
    return Kind.PARTLY_EXPLAINED
