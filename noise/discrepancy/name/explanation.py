"""What a search came to: the effects, their joint fit, and the intervals of their parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from noise.discrepancy.name.search import Crossed, Search
from noise.effects.medium import AIR_SD_K, TEMPERATURE
from noise.fitting.batch import Batch
from noise.fitting.fit import Fit, covariance, maximise, refit_without_urn
from noise.fitting.stack import NUISANCES, Key, Stack

Z90 = 1.6449  # two-sided 90 % of a normal
AIR: Key = ("sound_speed", "temperature_c")


@dataclass(frozen=True)
class Interval:
    """A parameter with its 90 % interval."""

    value: float
    low: float
    high: float
    unit: str


@dataclass(frozen=True)
class Final:
    """The explanation, fitted to all open data: jointly with what cells share, and with every reading counted.

    Where cells repeat themselves the two differ: the second, if there is one, is the law of single readings, and what
    parameters are told from; the first predicts readings of a cell from those before, and is what scores compare.
    """

    fits: tuple[Fit, ...]

    @property
    def stack(self) -> Stack:
        """The explanation with its nuisances, for scoring."""
        return self.fits[0].stack

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
    joint = maximise(cross.first.stack, (*keys, *NUISANCES), search.both, 80, scales=search.scales(search.both))
    each = refit_without_urn(joint, keys, search.both)
    return Final((joint,) if each is joint else (joint, each))


def intervals(final: Final, batch: Batch, law: Stack, own: Batch | None) -> dict[Key, Interval]:
    """Return the 90 % interval of every parameter that was fitted.

    A law that only stands for a simulation errs, and is known no better than its readings are many: what it seems to
    find in them counts as nothing, and how surely it does adds to the interval. That holds for parameters that may
    lie on either side of nothing. Air that no thermometer was in adds what half a kelvin of it would have made of each.

    Args:
        final: the explanation.
        batch: the readings that it was fitted to.
        law: what the search started from.
        own: readings of the simulation that it stands for; None for a law that is the simulation, and where the two
            are held against each other position by position.
    """
    out = {}
    for fitted in final.fits:
        known = np.sqrt(np.diag(covariance(fitted, batch)))
        for key, sd in zip(fitted.free, np.hypot(known, _by_air(fitted, batch)), strict=True):
            p, value = fitted.stack.parameter(key), fitted.stack.get(key)
            if own is not None and key not in NUISANCES and p.low < p.null < p.high:
                found, error = _found_in(own, law, key)
                value, sd = float(np.clip(value - found, p.low, p.high)), float(np.hypot(sd, error))
            low, high = max(value - Z90 * sd, min(p.low, p.null)), min(value + Z90 * sd, max(p.high, p.null))
            out[key] = Interval(value, float(low), float(high), p.unit)
    return out


def _by_air(fitted: Fit, batch: Batch) -> NDArray[np.float64]:
    """Return how far each free parameter goes with the temperature of air that nobody measured, one sd of it, (p,)."""
    if TEMPERATURE in batch.ping.covariates:
        return np.zeros(len(fitted.free))
    if AIR in fitted.free:  # it takes up all of what the air does
        return np.array([AIR_SD_K if key == AIR else 0.0 for key in fitted.free])
    warmer = fitted.stack.put([AIR], [fitted.stack.get(AIR) + AIR_SD_K])
    again = maximise(warmer, fitted.free, batch, 40).stack
    return np.array([again.get(key) - fitted.stack.get(key) for key in fitted.free])


def _found_in(own: Batch, stack: Stack, key: Key) -> tuple[float, float]:
    """Return by how much a law would have a parameter otherwise for the readings it stands for, and how surely."""
    fitted = maximise(stack, (key, *NUISANCES), own, 80)
    return fitted.stack.get(key) - stack.get(key), float(np.sqrt(covariance(fitted, own)[0, 0]))
