"""Readings as values of ROS messages.

`sensor_msgs/Range.range` follows REP 117: the range of an echo; +Inf without an echo; -Inf for an echo nearer than
`min_range`; NaN without an answer. Credence has no field there. It travels in a `diagnostic_msgs/DiagnosticStatus` with
the same stamp, whose `values` are `credence` (0 to 1, given the reading), `status` (a key of `STATUS`) and `range_m`.
"""

from __future__ import annotations

import numpy as np

from acquisition import EchoStatus, Reading
from acquisition.arguments import checked
from acquisition.arrays import Floats

RANGE_TYPE = "sensor_msgs/msg/Range"
DIAGNOSTIC_TYPE = "diagnostic_msgs/msg/DiagnosticArray"
ULTRASOUND = 0  # radiation_type
MIN_RANGE = 0.03  # m; SRF08 (Devantech)
CREDENCE_TOPIC = "credence"  # below the topic of the ranges
OK, WARN = 0, 1  # levels of a DiagnosticStatus; an answer that failed is a warning
STATUS = {"no echo": EchoStatus.NO_ECHO, "echo": EchoStatus.ECHO, "no answer": EchoStatus.NO_ANSWER}
NAMES = {status: name for name, status in STATUS.items()}


@checked
def range_values(reading: Reading, min_range: float) -> Floats:
    """Return the values of `Range.range`, m, (n,).

    >>> range_values(Reading.of([1.0, 0.0, 0.0, 0.01], [1, 0, 2, 1]), 0.03).tolist()
    [1.0, inf, nan, -inf]
    """
    value = np.where(reading.range < min_range, -np.inf, reading.range)
    value = np.where(reading.status == EchoStatus.NO_ECHO, np.inf, value)
    return np.where(reading.status == EchoStatus.NO_ANSWER, np.nan, value)


@checked
def ideal_distances(value: Floats, min_range: float, max_range: float) -> Floats:
    """Return true distances of ideal ranges, m, (n,): infinite for nothing in range, NaN for no measurement.

    A maximum range of 0 or below is not stated. What is too close to measure is at `min_range`.

    >>> ideal_distances(np.array([1.0, np.inf, -np.inf, np.nan, 4.0]), 0.02, 4.0).tolist()
    [1.0, inf, 0.02, nan, inf]
    """
    beyond = value >= max_range if max_range > 0.0 else np.isposinf(value)
    return np.where(beyond, np.inf, np.where(value < min_range, max(min_range, 0.0), value))


@checked
def diagnostics(reading: Reading, credence: Floats) -> list[tuple[int, str, dict[str, str]]]:
    """Return level, message and values of the `DiagnosticStatus` of each reading."""
    rows = zip(reading.range, reading.status, credence, strict=True)
    return [
        (
            WARN if status == EchoStatus.NO_ANSWER else OK,
            NAMES[EchoStatus(status)],
            {"credence": f"{given:.6g}", "status": NAMES[EchoStatus(status)], "range_m": f"{range_:.6g}"},
        )
        for range_, status, given in rows
    ]
