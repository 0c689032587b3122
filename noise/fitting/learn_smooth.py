"""Fit of a smooth correction to readings: maximum a posteriori, with strengths chosen on unseen conditions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from scipy.optimize import minimize
from torch import Tensor

from acquisition.arrays import Floats, Ints
from noise.effects.state import number
from noise.fitting.batch import Batch
from noise.fitting.smooth import HEADS, Smooth
from noise.fitting.smooth_basis import Basis, Coefficients, Problem, Score, basis_of
from noise.fitting.stack import Stack

STRENGTHS = (0.1, 0.4, 1.5)  # factors of the prior standard deviation that cross-validation chooses from
FOLDS = 4
ITERATIONS, FOLD_ITERATIONS = 60, 12
TOLERANCE = 1e-6  # relative, of the log-likelihood: 0.01 nats in 10,000
Strengths = dict[str, float]


def maximised(
    problem: Problem, basis: Basis, strengths: Strengths, start: Coefficients, iterations: int
) -> Coefficients:
    """Return the coefficients with the highest posterior density, by L-BFGS.

    Args:
        problem: readings and physics.
        basis: basis functions.
        strengths: standard deviation of the prior of each aspect, in units of `Basis.prior_sd`.
        start: coefficients to begin from.
        iterations: limit.
    """
    heads, functions = tuple(strengths), problem.functions(basis)
    sd = number([basis.prior_sd[head] for head in heads])
    precision = np.array([1.0 / strength**2 for strength in strengths.values()])
    first = start.of(heads)

    def objective(c: Floats) -> tuple[float, Tensor, Floats]:
        eta = (functions @ torch.from_numpy(c) * sd).requires_grad_()
        total = problem.log_prob(basis, dict(zip(heads, eta.unbind(-1), strict=True))).sum()
        (slope,) = torch.autograd.grad(total, eta)
        slope = torch.nan_to_num(slope, nan=0.0, posinf=0.0, neginf=0.0) * sd
        value = float(-total.detach()) + 0.5 * float(np.sum(precision * c**2))
        return value, slope, -(functions.T @ slope).numpy() + precision * c

    # step sizes from the squared scores, an estimate of the curvature
    scale = 1.0 / np.sqrt((functions.T**2 @ objective(first)[1] ** 2).numpy() + precision)

    def scaled(y: Floats) -> tuple[float, Floats]:
        value, _, gradient = objective(first + y.reshape(first.shape) * scale)
        return (value, (gradient * scale).ravel()) if np.isfinite(value) else (1e15, np.zeros(y.size))

    found = minimize(
        scaled,
        np.zeros(first.size),
        jac=True,
        method="L-BFGS-B",
        options={"maxiter": iterations, "ftol": TOLERANCE, "gtol": 1e-2, "maxcor": 15},
    )
    return Coefficients(heads, first + found.x.reshape(first.shape) * scale)


def learn_smooth(
    stack: Stack,
    batch: Batch,
    kind: type[Smooth],
    inputs: Sequence[Sequence[str]],
    score: Score,
    rng: np.random.Generator,
) -> Stack:
    """Return the stack with a smooth correction, or unchanged where none improves unseen conditions.

    The inputs and the strength of each aspect's prior, zero included, are chosen by cross-validation over conditions.

    Args:
        stack: law without a correction of this kind.
        batch: readings.
        kind: `Smooth` or `Empirical`.
        inputs: alternative sets of inputs; see `noise.fitting.smooth.column`.
        score: log probability of each reading.
        rng: chooses centres and folds.
    """
    problem, folds = Problem(stack.without_term(kind.name), kind, batch, score), _folds(batch, rng)
    bases = [basis_of(problem, names, rng) for names in inputs]
    choices = [chosen(problem, basis, folds) for basis in bases]
    best = int(np.argmax([choice.gain for choice in choices]))
    basis, strengths = bases[best], choices[best].strengths
    if not strengths:
        return problem.stack
    found = maximised(problem, basis, strengths, basis.none, ITERATIONS)
    return problem.stack.with_term(basis.with_weights(dict(zip(found.heads, found.value.T, strict=True))))


def _folds(batch: Batch, rng: np.random.Generator) -> Ints:
    """Return the fold of each ping, (n,); pings of one condition share it."""
    conditions, which = np.unique(batch.condition, return_inverse=True)
    return rng.permutation(np.arange(len(conditions)) % FOLDS)[which]


@dataclass(frozen=True, eq=False)
class CrossFit:
    """Coefficients without each fold, and the log-likelihood of each visit of the folds under them, nats."""

    fits: tuple[Coefficients, ...]
    nats: Floats

    def gain(self, other: CrossFit) -> float:
        """Return the gain over another, nats, less one standard error over visits."""
        gain = self.nats - other.nats
        return float(gain.sum() - np.sqrt(len(gain)) * gain.std())


@dataclass(frozen=True)
class Choice:
    """Strengths of the aspects, and their gain on unseen conditions, nats."""

    strengths: Strengths
    gain: float


def chosen(problem: Problem, basis: Basis, folds: Ints) -> Choice:
    """Return the strength of each aspect that predicts unseen conditions best, by coordinate ascent.

    An aspect joins if its gain exceeds one standard error, since few positions decide on detection at the threshold.
    """
    pairs = [(problem.select(folds != k), problem.select(folds == k)) for k in np.unique(folds)]

    def cross_fit(strengths: Strengths, start: CrossFit | None = None) -> CrossFit:
        starts = start.fits if start else (basis.none,) * len(pairs)
        fits = [
            maximised(train, basis, strengths, c, FOLD_ITERATIONS) if strengths else c
            for (train, _), c in zip(pairs, starts, strict=True)
        ]
        nats = [predicted(test, basis, c) for (_, test), c in zip(pairs, fits, strict=True)]
        return CrossFit(tuple(fits), np.concatenate(nats))

    none = cross_fit({})
    best, strengths = none, Strengths()
    for head in HEADS:
        tried = [({**strengths, head: size}, cross_fit({**strengths, head: size}, best)) for size in STRENGTHS]
        other, found = max(tried, key=lambda each: float(each[1].nats.sum()))
        if found.gain(best) > 0.0:
            best, strengths = found, other
    return Choice(strengths, float((best.nats - none.nats).sum()))


def predicted(problem: Problem, basis: Basis, coefficients: Coefficients) -> Floats:
    """Return the log-likelihood of each visit under given coefficients, nats, (n_visits,)."""
    with torch.no_grad():
        nats = problem.log_prob(basis, coefficients.scaled(problem.functions(basis), basis))
    return problem.batch.visit_sums(nats.numpy())
