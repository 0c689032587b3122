"""Estimates: the parameters of the selected effects, fitted to both folds, with intervals that cover."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import norm

from noise.discrepancy.name.hypothesis import Hypothesis
from noise.discrepancy.name.search import Search
from noise.discrepancy.result import LEVEL, Interval
from noise.fitting.batch import Batch
from noise.fitting.fit import Fit, covariance, maximise, refit_without_urn
from noise.fitting.likelihood import log_likelihood
from noise.fitting.stack import NUISANCES, Key, Stack

Z = float(norm.ppf(0.5 + LEVEL / 2.0))
FINEST = 20  # binary digits to which such a parameter is known at best: registers have no more


@dataclass(frozen=True, eq=False)
class Final:
    """The selected hypothesis on both folds.

    Attributes:
        effects: effect ids.
        joint: fit of effects and nuisances, which predicts a reading from those before it in its visit.
        single: the same for single readings, each of which counts once: what a simulator samples.
        batch: readings of the fits.
        fits: the same as they were fitted, at the maximum of the likelihood, where its curvature tells their errors.
        matched: parameters whose difference from the law of the simulation is that of the readings of both files.
    """

    effects: tuple[str, ...]
    joint: Fit
    single: Fit
    batch: Batch
    fits: tuple[Fit, ...]
    matched: frozenset[Key] = frozenset()

    @property
    def stack(self) -> Stack:
        """The joint fit's stack."""
        return self.joint.stack

    def at(self, values: Mapping[Key, float]) -> Final:
        """Return the hypothesis with parameters at values at which the readings of both files agree."""
        joint, single = (replace(fit, stack=fit.stack.at(values)) for fit in (self.joint, self.single))
        return replace(
            self, joint=joint, single=joint if self.single is self.joint else single, matched=frozenset(values)
        )


def conclude(search: Search, found: Hypothesis) -> Final:
    """Return a hypothesis fitted to both folds."""
    batch = search.joined
    keys = search.keys(found.effects)
    joint = maximise(found.stacks[0], (*keys, *search.nuisances), batch, 60)
    single = refit_without_urn(joint, keys, batch) if found.effects else joint
    return Final(found.effects, joint, single, batch, (joint, single) if single is not joint else (joint,))


def intervals(search: Search, final: Final) -> dict[Key, Interval]:
    """Return the interval of every parameter of the effects.

    The variance is that of the recording, robust to dependence within visits, plus that of the simulation: the law of
    the simulation is known no better than its readings allow. Sizes that add, such as offsets, losses and probabilities
    of faults, are those of the difference: what the law of the simulation has, and what its own readings would add, are
    subtracted. Where both files agree at another size than the likelihood's, the distance between the two is an error
    too. Where the curvature says nothing, the likelihood itself gives the interval.
    """
    errors: dict[Key, float] = {}
    moved = {key: final.stack.get(key) - final.fits[0].stack.get(key) for key in final.matched}
    for fit in final.fits:  # the fit of single readings holds those of effects on single pings alone
        errors |= zip(fit.free, np.sqrt(np.diag(covariance(fit, final.batch))).tolist(), strict=True)
    out = {}
    for key, error in errors.items():
        if key in NUISANCES and key[0] not in final.effects:
            continue
        if search.common.parameter(key).jumps:
            out[key] = profiled(final.single.stack, key, final.batch)
            continue
        p, value = final.single.stack.parameter(key), final.single.stack.get(key)
        base, own_error = _in_simulation(search, key, final)
        value, least, most = value - base, min(p.low, p.null) - base, max(p.high, p.null) - base
        spread = Z * float(np.linalg.norm([error, own_error, moved.get(key, 0.0)]))
        low, high = max(value - spread, least), min(value + spread, most)
        out[key] = Interval(value, low, high, p.unit)
        if low <= least and high >= most:  # no curvature: the likelihood is flat within a step of the register
            flat = profiled(final.single.stack, key, final.batch)
            out[key] = Interval(flat.value - base, flat.low - base, flat.high - base, p.unit)
    return out


def profiled(stack: Stack, key: Key, batch: Batch) -> Interval:
    """Return the likelihood interval of a parameter in which the likelihood jumps or is flat, others as they are.

    Steps away from the estimate double until the readings exclude the value.
    """
    p, value = stack.parameter(key), stack.get(key)
    least = float(log_likelihood(stack, batch).sum()) - 0.5 * Z**2

    def end(sign: float) -> float:
        steps = sign * (p.high - p.low) * 2.0 ** np.arange(-FINEST, 1)
        values = np.clip(value + steps, p.low, p.high).tolist()
        excluded = (each for each in values if float(log_likelihood(stack.at({key: each}), batch).sum()) < least)
        return next(excluded, p.low if sign < 0 else p.high)

    return Interval(value, end(-1.0), end(1.0), p.unit)


def _in_simulation(search: Search, key: Key, final: Final) -> tuple[float, float]:
    """Return how far a parameter of a difference lies from its null value in the simulation, and the standard error.

    A place or a width is the recording's own. The probability of a fault is that of the same fault, such as a reading
    stuck at the same value. Where the readings of both files are matched, the difference is that of the laws.
    """
    common, p, effect = search.common, search.common.parameter(key), search.common.known[key[0]]
    if not p.adds:
        return 0.0, 0.0
    if search.simulated is None:
        return common.get(key) - p.null, 0.0
    own = [(key[0], each.name) for each in effect.parameters if effect.by_ping]
    same = common.put(own, [final.single.stack.get(each) for each in own])
    fitted = maximise(same, (key, *search.nuisances), search.simulated, 40)
    fitted = refit_without_urn(fitted, (key,), search.simulated)
    law = common if key in final.matched else fitted.stack
    return law.get(key) - p.null, float(np.sqrt(covariance(fitted, search.simulated)[0, 0]))


def statement(search: Search, name: str, values: Sequence[tuple[Key, Interval]]) -> str:
    """Return the sentence of an effect at its estimated values."""
    found = search.common.values.get(name, {}) | {key[1]: interval.value for key, interval in values}
    return search.common.known[name].unchecked(found).statement()
