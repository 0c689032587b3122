"""Whether where stays lie is a smooth function of a condition: a bent rail, a worn scale, anything no effect follows.

How a target was put down is a matter of each stay; what follows from a condition is alike for neighbours in it. So
stays are laid in the order of a condition, and neighbours are compared (von Neumann 1941). No shape is assumed: a wave
that averages out over every wide interval shows as well as a bend.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import norm

from acquisition.arrays import Floats
from noise.discrepancy.locate.locate import Finding
from noise.discrepancy.locate.scan import by_block
from noise.fitting.batch import Batch
from noise.fitting.stack import Stack
from noise.statistics import winsorised

FEWEST = 20  # stays, below which neighbours tell nothing; ours
WEIGHTS = np.array([1.0, 0.5, 0.25])  # of the first, second and third neighbour: waves may be short; ours
KNOTS = 8.0  # of the smooth part of a law that stands for a simulation, which errs smoothly too; ours
LEAST_M = 0.0015  # by which positions are off, below which it is the ruler's matter or the log's; ours
HALF = 0.5  # of a shift that neighbours share: more is a course along their condition; ours
MISFIT = 0.1  # of a shift's own spread: what is left beside it may be the law's; ours
NOT_ASKED = ("time_s",)  # air drifts, and that is no riddle; what drifts has its own effects


@dataclass(frozen=True)
class Smooth:
    """How much neighbours in a condition agree.

    Attributes:
        n_visits: number of them.
        share: of the variance of where stays lie, that neighbours share, by condition.
        size_m: standard deviation of where stays lie, m.
        tied: whether each lies so far from the simulation's own under the same condition, where no law errs.
    """

    n_visits: int
    share: dict[str, float]
    size_m: float
    tied: bool = False

    def finding(self, usual: Smooth | None) -> Finding:
        """Return the strongest of it as a finding, beyond what a simulation's own stays share; p = 1 without any.

        Args:
            usual: the same of the simulation that the law stands for; None where the law is the simulation.
        """
        excess = {name: share - self._expected(usual, name) for name, share in self.share.items()}
        if not excess:
            return Finding("smooth", {}, 0.0, "m", 1.0, 0.0)
        name = max(excess, key=lambda each: excess[each])
        z = excess[name] * float(np.sqrt(self.n_visits) * WEIGHTS.sum() / np.linalg.norm(WEIGHTS))
        size = self.size_m * float(np.sqrt(np.clip(excess[name], 0.0, 1.0)))
        p = min(1.0, len(excess) * float(norm.sf(z))) if size >= LEAST_M else 1.0
        return Finding("smooth", {}, size, "m", p, 0.5 * max(z, 0.0) ** 2, (name, 0.0))

    def _expected(self, usual: Smooth | None, name: str) -> float:
        """Return what the law's own errors make of this variance: they are so many mm, whatever else scatters."""
        if usual is None or self.tied or self.size_m == 0.0:
            return 0.0
        own = max(usual.share.get(name, 0.0), 0.0) + KNOTS / max(usual.n_visits, 1)
        # their square, were they known exactly; but nulls of targets put down with less care then stand out too often
        return own * min(usual.size_m / self.size_m, 1.0)


def wrong_form(finding: Finding, before: Stack, after: Stack, batch: Batch) -> bool:
    """Tell whether neighbours agree along the very condition that an explanation's own shift goes along.

    What is left then is no other cause somewhere else: the shift does not have the form that the explanation gives it.

    Args:
        finding: of `Smooth.finding`.
        before: the law without the explanation.
        after: with it.
        batch: readings, whole stays.
    """
    if finding.place is None:
        return False
    shift = winsorised((after.expected(batch) - before.expected(batch))[batch.starts])
    course = _shared(shift[np.argsort(by_block(batch)[finding.place[0]], kind="stable")])
    return course > HALF and finding.size > MISFIT * float(shift.std())


def smooth(stack: Stack, batch: Batch) -> Smooth:
    """Return how much neighbours in each condition agree about where their stays lie.

    Args:
        stack: the law.
        batch: readings, whole stays.
    """
    offset, twin = lying(stack, batch), _twins(batch)
    tied = float(np.mean(~np.isnan(twin))) > HALF
    if tied:
        # one simulated stay may answer for several: what they share would pass for neighbours that agree
        offset = _one_a_cell(offset - twin, batch)
    told = ~np.isnan(offset)
    if told.sum() < FEWEST:
        return Smooth(int(told.sum()), {}, 0.0)
    value = winsorised(offset[told], batch.resolution)
    columns = {name: column[told] for name, column in by_block(batch).items() if name not in NOT_ASKED}
    share = {name: _shared(value[np.argsort(column, kind="stable")]) for name, column in columns.items()}
    return Smooth(len(value), share, float(value.std()), tied)


def _twins(batch: Batch) -> Floats:
    """Return how far the simulation's own readings lie from its law under each stay's condition, m, nan if unknown."""
    return np.full(batch.n_visits, np.nan) if batch.simulated_offset is None else batch.simulated_offset[batch.starts]


def _one_a_cell(value: Floats, batch: Batch) -> Floats:
    """Return means over the stays of each cell, at its first stay that has a value, nan elsewhere, (blocks,)."""
    out, told = np.full(len(value), np.nan), np.flatnonzero(~np.isnan(value))
    _, first, cell = np.unique(batch.condition[batch.starts][told], return_index=True, return_inverse=True)
    out[told[first]] = np.bincount(cell, value[told]) / np.bincount(cell)
    return out


def lying(stack: Stack, batch: Batch) -> Floats:
    """Return how far each stay lies from where a law expects it, m, nan where less than two echoes tell, (blocks,)."""
    error = batch.reading.range - stack.expected(batch)
    near = batch.is_target(error)
    rows = (stay[near[stay]] for stay in batch.visit_rows)
    return np.array([np.median(error[row]) if len(row) > 1 else np.nan for row in rows])


def _shared(value: Floats) -> float:
    """Return the mean correlation of a sequence with its neighbours; 0 is what chance gives."""
    value = value - value.mean()
    total = float((value**2).sum())
    if total == 0.0:
        return 0.0
    each = [float((value[lag:] * value[:-lag]).sum()) / total for lag in range(1, len(WEIGHTS) + 1)]
    return float(np.average(each, weights=WEIGHTS)) + 1.0 / len(value)
