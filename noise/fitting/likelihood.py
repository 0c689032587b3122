"""The log-likelihood of a batch under stacks, without gradients."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import torch
from scipy.special import logsumexp
from torch import Tensor

from acquisition.arrays import Floats
from noise.fitting.batch import Batch
from noise.fitting.stack import NUISANCES, STEPWISE, Key, Stack
from noise.fitting.visit_effects import VisitEffects, law_of, log_prob
from noise.physical import PhysicalModel

Measure = Callable[[PhysicalModel, VisitEffects], Tensor]
AROUND_M: Floats = 1e-3 * 2.0 ** np.arange(11.0)  # from an end of a range, 1 mm to 1 m
N_ENDS = 16  # of a range, that are tried among those which the readings allow
EXCLUDED = 20.0  # nats below the likeliest


def log_likelihood(stack: Stack, batch: Batch) -> Floats:
    """Return the prequential log probability of each reading, nats, (n,)."""
    with torch.no_grad():
        model, visits = stack.build()
        return log_prob(law_of(model, batch), visits, batch).numpy()


def at_each(stack: Stack, keys: Sequence[Key], values: Floats, measure: Measure) -> Floats:
    """Return a quantity of a law and its visit effects at each of k parameter values, (k, ...).

    All are computed at once where the law is continuous in the parameters, which costs as much as two.

    Args:
        stack: the other parameters.
        keys: p parameters.
        values: of these parameters, (k, p).
        measure: computes the quantity; no step of it depends on values.
    """

    def at(numbers: Tensor) -> Tensor:
        return measure(*stack.build(keys, numbers))

    with torch.no_grad():
        given = torch.as_tensor(values, dtype=torch.float64)
        one_by_one = not keys or any(key[1] in STEPWISE for key in keys)
        return (torch.stack([at(row) for row in given]) if one_by_one else torch.vmap(at)(given)).numpy()


def log_likelihoods(stacks: Sequence[Stack], batch: Batch) -> Floats:
    """Return the prequential log-likelihood of a batch under each of k stacks, nats, (k,)."""

    def total(model: PhysicalModel, visits: VisitEffects) -> Tensor:
        return log_prob(law_of(model, batch), visits, batch, exact=True).sum()

    out = np.empty(len(stacks))
    for rows in _alike(stacks):
        first, group = stacks[rows[0]], [stacks[row] for row in rows]
        moved = [key for key in _keys(first) if any(each.get(key) != first.get(key) for each in group)]
        out[rows] = at_each(first, moved, np.array([[each.get(key) for key in moved] for each in group]), total)
    return out


def predictive(stack: Stack, keys: Sequence[Key], own: Batch, other: Batch) -> Floats:
    """Return the log predictive probability of each of other readings, given those before it, nats, (n,).

    Where the likelihood jumps, as at the end of a range, it says only between which readings the end lies, and the
    likeliest end is at the farthest of them. A single reading beyond it would then refute the effect. The end is
    integrated over, with a flat prior where the readings that it was fitted to allow it.

    Args:
        stack: fitted to `own`.
        keys: parameters that were fitted.
        own: readings that the stack was fitted to.
        other: readings to predict.
    """
    jumping = [key for key in keys if stack.parameter(key).jumps and key[1] not in STEPWISE]
    if not jumping:
        return log_likelihood(stack, other)
    key = jumping[0]
    values, weight = _ends(stack, key, own)

    def nats(model: PhysicalModel, visits: VisitEffects) -> Tensor:
        return log_prob(law_of(model, other), visits, other, exact=True)

    each = at_each(stack, [key], values[:, None], nats)
    before = weight[:, None] + np.cumsum(each, axis=1) - each
    return np.asarray(logsumexp(before + each, axis=0) - logsumexp(before, axis=0))


def _ends(stack: Stack, key: Key, batch: Batch) -> tuple[Floats, Floats]:
    """Return values of a parameter in which the likelihood jumps, and their log posterior weights, (k,) each."""
    p, here = stack.parameter(key), stack.get(key)

    def at(values: Floats) -> tuple[Floats, Floats]:
        inside = np.unique(np.clip(values, p.low, p.high))
        return inside, log_likelihoods([stack.at({key: value}) for value in inside.tolist()], batch)

    values, nats = at(np.r_[here - AROUND_M, here, here + AROUND_M])
    good = np.flatnonzero(nats > nats.max() - EXCLUDED)
    ends = values[max(good[0] - 1, 0)], values[min(good[-1] + 1, len(values) - 1)]
    values, nats = at(np.r_[values[good], np.linspace(*ends, N_ENDS)])
    return values, nats + np.log(np.gradient(values))


def _alike(stacks: Sequence[Stack]) -> list[list[int]]:
    """Return groups of rows of stacks that have the same effects and nuisance parameters."""
    rows: dict[tuple[object, ...], list[int]] = {}
    for row, stack in enumerate(stacks):
        nuisances = [stack.get(key) for key in _keys(stack) if key in NUISANCES]
        rows.setdefault((tuple(stack.values), *nuisances), []).append(row)
    return list(rows.values())


def _keys(stack: Stack) -> list[Key]:
    return [(name, parameter) for name, inner in stack.values.items() for parameter in inner]


def likeliest(stacks: Sequence[Stack], batch: Batch) -> Stack:
    """Return the stack with the highest likelihood, the first one if several are equal."""
    return stacks[int(np.argmax(log_likelihoods(stacks, batch)))]
