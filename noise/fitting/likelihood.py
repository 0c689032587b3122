"""The log-likelihood of a batch under stacks, without gradients."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch

from acquisition.arrays import Floats
from noise.fitting.batch import Batch
from noise.fitting.stack import NUISANCES, STEPWISE, Key, Stack
from noise.fitting.visit_effects import law_of, log_prob


def log_likelihood(stack: Stack, batch: Batch) -> Floats:
    """Return the prequential log probability of each reading, nats, (n,)."""
    with torch.no_grad():
        model, visits = stack.build()
        return log_prob(law_of(model, batch), visits, batch).numpy()


def log_likelihoods(stacks: Sequence[Stack], batch: Batch) -> Floats:
    """Return the prequential log-likelihood of a batch under each of k stacks of one structure, nats, (k,).

    Stacks that differ in parameters of a continuous law are evaluated at once, which costs as much as two.
    """
    out = np.empty(len(stacks))
    for rows in _alike(stacks):
        out[rows] = _evaluated([stacks[row] for row in rows], batch)
    return out


def _alike(stacks: Sequence[Stack]) -> list[list[int]]:
    """Return groups of rows of stacks that have the same effects, nuisance parameters and stepwise parameters."""
    rows: dict[tuple[object, ...], list[int]] = {}
    for row, stack in enumerate(stacks):
        fixed = [(key, stack.get(key)) for key in _keys(stack) if key in NUISANCES or key[1] in STEPWISE]
        rows.setdefault((tuple(stack.values), *fixed), []).append(row)
    return list(rows.values())


def _keys(stack: Stack) -> list[Key]:
    return [(name, parameter) for name, inner in stack.values.items() for parameter in inner]


def _evaluated(stacks: Sequence[Stack], batch: Batch) -> Floats:
    """Return the log-likelihood under each of k stacks that differ in parameters of a continuous law, nats, (k,)."""
    first = stacks[0]
    moved = [key for key in _keys(first) if any(each.get(key) != first.get(key) for each in stacks)]
    if not moved:
        return np.full(len(stacks), log_likelihood(first, batch).sum())

    def total(numbers: torch.Tensor) -> torch.Tensor:
        model, visits = first.build(moved, numbers)
        return log_prob(law_of(model, batch), visits, batch, exact=True).sum()

    with torch.no_grad():
        values = torch.tensor([[stack.get(key) for key in moved] for stack in stacks], dtype=torch.float64)
        return torch.vmap(total)(values).numpy()


def likeliest(stacks: Sequence[Stack], batch: Batch) -> Stack:
    """Return the stack with the highest likelihood, the first one if several are equal."""
    return stacks[int(np.argmax(log_likelihoods(stacks, batch)))]
