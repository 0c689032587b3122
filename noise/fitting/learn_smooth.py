"""Fit of a smooth correction to readings: maximum a posteriori, with strengths chosen on unseen conditions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from scipy.optimize import minimize
from torch import Tensor

from acquisition.arrays import Floats, Ints
from noise.effects.state import number
from noise.fitting.batch import Batch
from noise.fitting.smooth import HEADS, Smooth
from noise.fitting.smooth_basis import Basis, Coefficients, Problem, Score, basis_of
from noise.fitting.stack import LeftOut, Stack

STRENGTHS = (0.1, 0.4, 1.5)  # factors of the prior standard deviation that cross-validation chooses from
FOLDS = 4
ITERATIONS = 60
STEP = 0.1  # of a correction, in standard deviations of its prior, over which the curvature is measured
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


@dataclass(frozen=True, eq=False)
class Learned:
    """A law with a smooth correction.

    Attributes:
        stack: the law; without a correction where none improves unseen conditions.
        gain: log-likelihood that the correction gains on each visit when its condition is left out, nats, (n_visits,).
        left_out: the corrections without each fold; None where there is none.
    """

    stack: Stack
    gain: Floats
    left_out: LeftOut | None = None


def learn_smooth(
    stack: Stack,
    batch: Batch,
    inputs: Sequence[Sequence[str]],
    score: Score,
    rng: np.random.Generator,
    heads: Sequence[str] = HEADS,
) -> Learned:
    """Learn a smooth correction of a law.

    The inputs and the strength of each aspect's prior, zero included, are chosen by cross-validation over conditions.

    Args:
        stack: law; a correction that it has is replaced.
        batch: readings.
        inputs: alternative sets of inputs; see `noise.fitting.smooth.column`.
        score: log probability of each reading.
        rng: chooses centres and folds.
        heads: aspects that may be corrected.
    """
    problem, folds = Problem(stack.without_term(Smooth.name), batch, score), _folds(batch, rng)
    bases = [basis_of(problem, names, rng) for names in inputs]
    crossed = [cross_fitted(problem, basis, folds, heads) for basis in bases]
    best = int(np.argmax([each.gain.sum() for each in crossed]))
    basis, chosen = bases[best], crossed[best]
    if not chosen.strengths:
        return Learned(problem.stack, np.zeros(batch.n_visits))
    kept = tuple(chosen.strengths)
    start = Coefficients(kept, np.mean(list(chosen.folds.values()), axis=1).T)
    found = maximised(problem, basis, chosen.strengths, start, ITERATIONS)
    term = basis.with_weights(dict(zip(kept, found.value.T, strict=True)))
    terms = [basis.with_weights({head: chosen.folds[head][k] for head in kept}) for k in range(FOLDS)]
    part = np.full(int(batch.condition.max()) + 1, -1)
    part[batch.condition] = folds
    return Learned(problem.stack.with_term(term), chosen.gain, LeftOut(tuple(terms), part))


def _folds(batch: Batch, rng: np.random.Generator) -> Ints:
    """Return the fold of each ping, (n,); pings of one condition share it."""
    conditions, which = np.unique(batch.condition, return_inverse=True)
    return rng.permutation(np.arange(len(conditions)) % FOLDS)[which]


@dataclass(frozen=True, eq=False)
class CrossFitted:
    """Strengths that predict unseen conditions best.

    Attributes:
        strengths: of the aspects that are corrected.
        gain: log-likelihood that each visit gains when its fold is left out, nats, (n_visits,).
        folds: coefficients of each corrected aspect without each fold, (folds, p).
    """

    strengths: Strengths
    gain: Floats
    folds: dict[str, Floats]


def cross_fitted(problem: Problem, basis: Basis, folds: Ints, heads: Sequence[str] = HEADS) -> CrossFitted:
    """Return the strength of each aspect that predicts unseen conditions best, by coordinate ascent.

    An aspect joins if its gain exceeds one standard error, since few positions decide on detection at the threshold.
    Its coefficients are those of two Newton steps: what an approximate fit predicts on unseen conditions is a fair,
    and slightly low, estimate of what a fit would.
    """
    ascent = _Ascent(problem, basis, folds)
    none = best = ascent.nats({})
    eta: dict[str, Floats] = {}
    kept: dict[str, Floats] = {}
    strengths: Strengths = {}
    for head in heads:
        zero = np.zeros((FOLDS, ascent.functions.shape[1]))
        tried = [(size, value) for size, value in zip(STRENGTHS, ascent.step(eta, head, zero, STRENGTHS), strict=True)]
        scored = [ascent.nats({**eta, head: ascent.left_out(value)}) for _, value in tried]
        k = int(np.argmax([nats.sum() for nats in scored]))
        size, value = tried[k]
        if _exceeds(scored[k] - best):
            (again,) = ascent.step(eta, head, value, (size,))
            nats = ascent.nats({**eta, head: ascent.left_out(again)})
            value, best = (again, nats) if nats.sum() > scored[k].sum() else (value, scored[k])
            eta[head], kept[head], strengths[head] = ascent.left_out(value), value, size
    return CrossFitted(strengths, best - none, kept)


def _exceeds(gain: Floats) -> bool:
    """Return whether the sum over visits exceeds its standard error."""
    return float(gain.sum()) > float(np.sqrt(len(gain)) * gain.std())


@dataclass(frozen=True, eq=False)
class _Ascent:
    """Newton steps on the readings of all folds but one, for each fold."""

    problem: Problem
    basis: Basis
    folds: Ints

    @cached_property
    def functions(self) -> Floats:
        """Basis functions at each ping, (n, p)."""
        return self.problem.functions(self.basis).numpy()

    def left_out(self, value: Floats) -> Floats:
        """Return the correction of each ping by the coefficients of its own fold, (n,), of (folds, p)."""
        return np.einsum("np,np->n", self.functions, value[self.folds])

    def nats(self, eta: Mapping[str, Floats]) -> Floats:
        """Return the log-likelihood of each visit under given corrections, nats, (n_visits,)."""
        with torch.no_grad():
            heads = {head: self.basis.prior_sd[head] * torch.from_numpy(value) for head, value in eta.items()}
            return self.problem.batch.visit_sums(self.problem.log_prob(self.basis, heads).numpy())

    def slope(self, eta: Mapping[str, Floats], head: str) -> Floats:
        """Return the derivative of the log-likelihood by the correction of each ping, (n,)."""
        tensors = {name: torch.from_numpy(value) for name, value in eta.items()}
        tensors[head].requires_grad_()
        heads = {name: self.basis.prior_sd[name] * value for name, value in tensors.items()}
        (slope,) = torch.autograd.grad(self.problem.log_prob(self.basis, heads).sum(), tensors[head])
        return torch.nan_to_num(slope, nan=0.0, posinf=0.0, neginf=0.0).numpy()

    def step(self, eta: Mapping[str, Floats], head: str, start: Floats, strengths: Sequence[float]) -> list[Floats]:
        """Return the coefficients after a Newton step from a start, (folds, p), for each strength of the prior.

        Derivatives are those at the correction of each ping by its own fold, so that all folds share them. The
        curvature is that of a change of all readings of a visit together, from a difference of derivatives.
        """
        own = self.left_out(start)
        slope = self.slope({**eta, head: own}, head)
        curvature = np.maximum((slope - self.slope({**eta, head: own + STEP}, head)) / STEP, 0.0)
        out = [start.copy() for _ in strengths]
        for k in range(len(start)):
            rows = self.folds != k
            part = self.functions[rows]
            matrix, vector = part.T @ (curvature[rows, None] * part), part.T @ slope[rows]
            for value, strength in zip(out, strengths, strict=True):
                precision = np.eye(part.shape[1]) / strength**2
                value[k] += np.linalg.solve(matrix + precision, vector - start[k] / strength**2)
        return out
