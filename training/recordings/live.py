"""A picture of each visit while a survey runs: how its readings scatter about the true distance."""

from __future__ import annotations

import numpy as np

from acquisition.ping import CREDENCE_TOLERANCE, EchoStatus
from acquisition.survey.plan import Condition
from acquisition.survey.sources import VisitData

CELLS = 31  # of the picture, from 10 % below the true distance to 10 % above it
LEVELS = " ▁▂▃▄▅▆▇█"


def visit_line(condition: Condition, measured: VisitData) -> str:
    """Return a line on a visit: its condition, a histogram of the readings, their median error, and what is outside.

    The histogram extends over the readings that are right, within 10 % of the true distance.

    Args:
        condition: of the visit.
        measured: its pings and readings.
    """
    reading, true = measured.reading, measured.ping.distance
    error = (reading.range - true)[reading.echo]
    share = error / np.maximum(true[reading.echo], 1e-9)
    right = np.abs(share) <= CREDENCE_TOLERANCE
    count, _ = np.histogram(share[right], CELLS, (-CREDENCE_TOLERANCE, CREDENCE_TOLERANCE))
    level = np.ceil((len(LEVELS) - 1) * count / max(count.max(), 1)).astype(int)
    picture = "".join(LEVELS[k] for k in level)
    middle = f"{1e3 * np.median(error[right]):+5.0f} mm" if right.any() else " " * 8
    place = f"{condition.distance_mm:5.0f} mm {condition.angle_deg:5.1f}° {condition.reflectance:4.2f}"
    counts = f"right {right.sum()}, wrong {(~right).sum()}, no echo {(reading.status == EchoStatus.NO_ECHO).sum()}"
    lost = (~reading.answered).sum()
    silent = f", no answer {lost}" if lost else ""
    return f"{place} |{picture}| {middle}; {counts}{silent} of {len(reading)}"
