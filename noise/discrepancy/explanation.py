"""What a search came to: the effects, their joint fit, and the intervals of their parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from noise.cells import Batch
from noise.discrepancy.search import Crossed, Search
from noise.fit import Fit, covariance, each_counted, maximise
from noise.stack import CELLS, NUISANCES, Key, Stack

Z90 = 1.6449  # two-sided 90 % of a normal


@dataclass(frozen=True)
class Interval:
    """A parameter with its 90 % interval."""

    value: float
    low: float
    high: float
    unit: str


@dataclass(frozen=True)
class Final:
    """The explanation: its stack with nuisances for scoring, and the fits that its parameters and errors come from.

    The last fit that moved a parameter is the one that counts; its stack is the law of single readings.
    """

    stack: Stack
    fits: tuple[Fit, ...]

    @property
    def single(self) -> Stack:
        """The law of single readings."""
        return self.fits[-1].stack


@dataclass(frozen=True)
class Explained:
    """What the search came to.

    Attributes:
        chosen: effects.
        base: the law without them, cross-fitted; `cross` with them.
        final: the explanation on all open data.
    """

    chosen: list[str]
    base: Crossed
    cross: Crossed
    final: Final

    @property
    def gain(self) -> float:
        """What all effects together gain on cells that they were not fitted to, nats."""
        return float((self.cross.nats - self.base.nats).sum())


def conclude(search: Search, cross: Crossed, chosen: Sequence[str]) -> Final:
    """Return the explanation fitted on discover and confirm together."""
    keys = search.keys(chosen)
    joint = maximise(cross.first.stack, (*keys, *NUISANCES), search.both, 80)
    each = each_counted(joint, keys, search.both)
    if each is joint:
        return Final(joint.stack, (joint,))
    cells = {**each.stack.values, CELLS: joint.stack.values[CELLS]}
    return Final(maximise(replace(each.stack, values=cells), NUISANCES, search.both, 60).stack, (joint, each))


def intervals(final: Final, batch: Batch) -> dict[Key, Interval]:
    """Return the 90 % interval of every parameter that was fitted."""
    out = {}
    for fitted in final.fits:
        spread = np.sqrt(np.diag(covariance(fitted, batch)))
        for key, sd in zip(fitted.free, spread, strict=True):
            p, value = fitted.stack.parameter(key), fitted.stack.get(key)
            low, high = max(value - Z90 * sd, min(p.low, p.null)), min(value + Z90 * sd, max(p.high, p.null))
            out[key] = Interval(value, float(low), float(high), p.unit)
    return out
