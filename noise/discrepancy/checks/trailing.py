"""Whether readings trail behind a target that moves: late stamps, a filter, a slow sensor.

While the target stands a delay does not show; where a robot drives, each reading lies towards where the target was a
moment before, by as much as it has moved since. So errors are held against movement from ping to ping: of what goes
with the place, as much is met on the way there as on the way back.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.stats import t

from acquisition.arrays import Floats
from noise.discrepancy.locate.locate import Finding
from noise.fitting.batch import Batch
from noise.fitting.stack import Stack
from noise.statistics import winsorised

FEWEST = 12  # stretches of a way, below which nothing is told; ours
LEAST_PINGS = 0.1  # that readings may trail or lead: a law that errs a little does as much; ours


@dataclass(frozen=True)
class Trailing:
    """How far readings trail.

    Attributes:
        pings: by how many intervals between pings.
        error: its standard error over stretches of the way.
        stretches: number of them; 0 where the target always stood.
        interval_s: usual time between pings; nan where none was logged.
    """

    pings: float
    error: float
    stretches: int
    interval_s: float

    def finding(self, usual: Trailing | None) -> Finding | None:
        """Return it as a finding everywhere, in s, or in pings where no time was logged; None where too little moved.

        Args:
            usual: the same of the simulation that the law stands for; None where the law is the simulation.
        """
        if self.stretches < FEWEST:
            return None
        own = Trailing(0.0, 0.0, 0, np.nan) if usual is None else usual
        more, error = self.pings - own.pings, float(np.hypot(self.error, own.error))
        z = max(abs(more) - LEAST_PINGS, 0.0) / error if error > 0.0 else 0.0
        p = min(1.0, float(2.0 * t.sf(z, self.stretches - 1)))
        timed = np.isfinite(self.interval_s)
        size, unit = (more * self.interval_s, "s") if timed else (more, "1")
        return Finding("trailing", {}, size, unit, max(p, 1e-300), 0.5 * z**2)


def trailing(stack: Stack, batch: Batch) -> Trailing:
    """Return how far readings trail behind a moving target.

    Args:
        stack: the law of single readings.
        batch: readings, whole stays.
    """
    told = batch.reading.echo & (batch.count > 0) & ~batch.stationary[batch.visit]
    if stack.model.remembers:  # what a law repeats is its own
        told &= ~batch.repeats
    if len(np.unique(batch.visit[told])) < FEWEST:
        return Trailing(0.0, 0.0, 0, np.nan)
    middle = stack.direct(batch)[0]  # a law that repeats would lean by itself
    moved = np.r_[0.0, middle[:-1] - middle[1:]]  # towards where the target was
    error = winsorised((batch.reading.range - middle)[told], batch.resolution)
    return _slope(error - np.median(error), moved[told], batch.visit[told], _interval(batch))


def _slope(error: Floats, moved: Floats, block: np.ndarray, interval_s: float) -> Trailing:
    """Return the slope of errors on movement, its standard error by blocks."""
    total = float((moved**2).sum())
    slope = float((error * moved).sum()) / total
    pull = pd.Series((error - slope * moved) * moved).groupby(block).sum()
    return Trailing(slope, float(np.sqrt((pull**2).sum())) / total, len(pull), interval_s)


def _interval(batch: Batch) -> float:
    """Return the usual time between pings of one stretch, s; nan where none was logged."""
    return float(np.median(np.diff(batch.ping.time)[batch.count[1:] > 0])) if batch.timed else float("nan")
