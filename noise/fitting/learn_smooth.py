"""Fit of a smooth correction to readings: maximum a posteriori, its strength and aspects chosen on unseen conditions."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.optimize import minimize
from torch import Tensor

from acquisition.arrays import Floats, Ints
from noise.effects import State
from noise.effects.state import number
from noise.fitting.batch import Batch
from noise.fitting.smooth import (
    DETECTION,
    EARLY,
    HEADS,
    LATE,
    SHIFT,
    SPREAD,
    Inputs,
    Smooth,
    kernel,
    level_centres,
    level_kernel,
    level_scale,
)
from noise.fitting.stack import Stack
from noise.fitting.visit_effects import (
    FLOOR,
    VisitEffects,
    direct_median,
    log_prob,
    placement_scatter,
    single_ping_law,
)
from noise.physical import PhysicalLaw, PhysicalModel
from noise.statistics import robust_std

CENTRES = 60  # of the kernel: more describe no survey of a few hundred positions better
STRENGTHS = (0.3, 1.0, 3.0)  # factors of the prior standard deviation that cross-validation chooses from
FOLDS = 4
ITERATIONS, FOLD_ITERATIONS = 60, 25
# prior standard deviation of each aspect at strength 1: probits, units of the scatter, log factor, log-odds
PRIOR_SD = {DETECTION: 1.5, SHIFT: 2.0, SPREAD: 0.7, EARLY: 2.0, LATE: 2.0}
TAIL_M = 0.1  # length of a tail that no reading is in
FAR = 5.0  # standard deviations beyond which a reading belongs to a tail
JITTER = 1e-6  # added to the diagonal of the covariance of centres, relative to its greatest eigenvalue

Score = Callable[[PhysicalLaw, VisitEffects, Batch], Tensor]


def single_log_prob(law: PhysicalLaw, visits: VisitEffects, batch: Batch) -> Tensor:
    """Return the log probability of each reading as the only one of its visit, nats, (n,), with the usual floor."""
    p = single_ping_law(law, visits).probability_tensor(batch.reading)
    floor = torch.from_numpy(np.where(batch.reading.echo, FLOOR / law.last_step, FLOOR))
    return torch.log((1.0 - 2.0 * FLOOR) * p + floor)


@dataclass(frozen=True, eq=False)
class Basis:
    """Basis functions with unit normal coefficients, p of them.

    Attributes:
        term: correction without weights.
        root, level_root: inverse square roots of the covariances of the centres, (m, m') and (l, l').
        prior_sd: standard deviation of each aspect, by aspect.
    """

    term: Smooth
    root: Tensor
    level_root: Tensor
    prior_sd: dict[str, float]

    def functions(self, state: State) -> Tensor:
        """Return the basis functions at each ping, (n, p)."""
        x, level = self.term.inputs.standardised(state.conditions), self.term.level(state)
        by_condition, by_level = kernel(x, self.term.centres), level_kernel(level, self.term.level_centres)
        return torch.cat([by_condition @ self.root, by_level @ self.level_root], dim=1)

    def with_weights(self, coefficients: dict[str, Floats]) -> Smooth:
        """Return the correction with given coefficients, (p,) for each aspect."""
        m, old = self.root.shape[1], self.term
        scaled = {head: self.prior_sd[head] * number(c) for head, c in coefficients.items()}
        alpha = {head: self.root @ c[:m] for head, c in scaled.items()}
        beta = {head: self.level_root @ c[m:] for head, c in scaled.items()}
        sizes = old.tails_m, old.placement_m
        return type(old)(old.inputs, old.centres, alpha, old.level_centres, beta, *sizes)


@dataclass(frozen=True, eq=False)
class Problem:
    """Readings and the physics before and after the correction."""

    stack: Stack
    kind: type[Smooth]
    batch: Batch
    score: Score

    @cached_property
    def visits(self) -> VisitEffects:
        """Visit effects."""
        return self.stack.build()[1]

    @cached_property
    def parts(self) -> tuple[PhysicalModel, PhysicalModel]:
        """The effects before the correction, and those after it."""
        model, own = self.stack.model, (self.kind.stage, self.kind.name)
        before = [effect for effect in model.effects if (effect.stage, effect.name) < own]
        after = [effect for effect in model.effects if (effect.stage, effect.name) > own]
        first, last = (PhysicalModel(part, model.resolution, model.max_range) for part in (before, after))
        return first, last

    @cached_property
    def state(self) -> State:
        """State before the correction."""
        with torch.no_grad():
            return self.parts[0].state(self.batch.conditions)

    def law(self, state: State) -> PhysicalLaw:
        """Return the law that follows from a corrected state."""
        batch = self.batch
        return PhysicalLaw(self.parts[1].applied(state), batch.ping.distance, batch.resolution, self.stack.max_range)

    def log_prob(self, basis: Basis, heads: dict[str, Tensor]) -> Tensor:
        """Return the log probability of each reading under given corrections, nats, (n,)."""
        return self.score(self.law(basis.term.corrected(self.state, heads)), self.visits, self.batch)

    def select(self, rows: NDArray[np.bool_]) -> Problem:
        """Return the problem for some visits."""
        return replace(self, batch=self.batch.select(rows))


def basis_of(problem: Problem, names: Sequence[str], rng: np.random.Generator) -> Basis:
    """Return the basis for a problem.

    Args:
        problem: readings and physics.
        names: candidate inputs; those that vary are used.
        rng: chooses the centres.
    """
    state, batch = problem.state, problem.batch
    inputs, at = Inputs.of(names, batch.conditions), level_centres(level_scale(state))
    centres = _centres(inputs.standardised(batch.conditions), rng)
    with torch.no_grad():
        law, placement = problem.law(state), placement_scatter(float(problem.visits.placement_m))
    scatter, tails = _sizes(law, batch, placement)
    term = problem.kind(inputs, centres, {}, at, {}, tails, placement)
    prior = {head: sd * (scatter if head == SHIFT else 1.0) for head, sd in PRIOR_SD.items()}
    return Basis(term, _inverse_root(kernel(centres, centres)), _inverse_root(level_kernel(at, at)), prior)


def _centres(x: Tensor, rng: np.random.Generator) -> Tensor:
    """Return at most `CENTRES` conditions of a sample, (m, d)."""
    unique = torch.unique(torch.round(x, decimals=6), dim=0)
    if len(unique) <= CENTRES:
        return unique
    return unique[torch.from_numpy(np.sort(rng.choice(len(unique), CENTRES, replace=False)))]


def _inverse_root(covariance: Tensor) -> Tensor:
    """Return U / sqrt(S) of a covariance U S U', without directions that rounding dominates, (m, m')."""
    value, vector = torch.linalg.eigh(covariance)
    large = value > JITTER * value[-1]
    return vector[:, large] / torch.sqrt(value[large])


def _sizes(law: PhysicalLaw, batch: Batch, placement: float) -> tuple[float, tuple[float, float]]:
    """Return the scatter of readings about the law, m, and the mean lengths of early and late tails, m."""
    middle, variance = (x.numpy() for x in direct_median(law))
    error = (batch.reading.range - middle)[batch.reading.echo]
    near = batch.is_target(batch.reading.range - middle)[batch.reading.echo]
    expected = float(np.sqrt(np.mean(variance) + placement**2))
    scatter = max(robust_std(error[near]) if near.any() else 0.0, expected)
    early, late = (-error[error < -FAR * scatter], error[error > FAR * scatter])
    return scatter, tuple(float(each.mean()) if len(each) else TAIL_M for each in (early, late))  # type: ignore[return-value]


def maximised(
    problem: Problem, basis: Basis, strength: float, heads: Sequence[str], start: Floats | None, iterations: int
) -> Floats:
    """Return the coefficients with the highest posterior density, (p, aspects), by L-BFGS.

    Args:
        problem: readings and physics.
        basis: basis functions.
        strength: standard deviation of the prior, in units of `Basis.prior_sd`.
        heads: aspects to correct.
        start: coefficients, (p, aspects); zero by default.
        iterations: limit.
    """
    functions, sd = basis.functions(problem.state), number([basis.prior_sd[head] for head in heads])
    first = np.zeros((functions.shape[1], len(heads))) if start is None else start

    def objective(c: Floats) -> tuple[float, Tensor, Floats]:
        eta = (functions @ torch.from_numpy(c) * sd).requires_grad_()
        total = problem.log_prob(basis, dict(zip(heads, eta.unbind(-1), strict=True))).sum()
        (slope,) = torch.autograd.grad(total, eta)
        slope = torch.nan_to_num(slope, nan=0.0, posinf=0.0, neginf=0.0) * sd
        value = float(-total.detach()) + 0.5 * float(np.sum(c**2)) / strength**2
        return value, slope, -(functions.T @ slope).numpy() + c / strength**2

    # step sizes from the squared scores, an estimate of the curvature
    squared = (functions.T**2 @ objective(first)[1] ** 2).numpy()
    scale = 1.0 / np.sqrt(squared + 1.0 / strength**2)

    def scaled(y: Floats) -> tuple[float, Floats]:
        value, _, gradient = objective(first + y.reshape(first.shape) * scale)
        return (value, (gradient * scale).ravel()) if np.isfinite(value) else (1e15, np.zeros(y.size))

    options = {"maxiter": iterations, "ftol": 1e-6, "gtol": 1e-2, "maxcor": 15}
    found = minimize(scaled, np.zeros(first.size), jac=True, method="L-BFGS-B", options=options)
    return first + found.x.reshape(first.shape) * scale


def predicted(problem: Problem, basis: Basis, coefficients: Floats, heads: Sequence[str]) -> Floats:
    """Return the log-likelihood of each visit under given coefficients, nats, (n_visits,)."""
    with torch.no_grad():
        sd = number([basis.prior_sd[head] for head in heads])
        eta = basis.functions(problem.state) @ torch.from_numpy(coefficients) * sd
        nats = problem.log_prob(basis, dict(zip(heads, eta.unbind(-1), strict=True)))
    return problem.batch.visit_sums(nats.numpy())


def learn_smooth(
    stack: Stack, batch: Batch, kind: type[Smooth], names: Sequence[str], score: Score, rng: np.random.Generator
) -> Stack:
    """Return the stack with a smooth correction, or unchanged where none improves unseen conditions.

    Cross-validation by condition chooses the strength of the prior, then drops every aspect without which the
    predictions of unseen conditions are no worse.

    Args:
        stack: law without a correction of this kind.
        batch: readings.
        kind: `Smooth` or `Empirical`.
        names: candidate inputs; see `noise.fitting.smooth.column`.
        score: log probability of each reading.
        rng: chooses centres and folds.
    """
    problem = Problem(stack.without_term(kind.name), kind, batch, score)
    basis = basis_of(problem, names, rng)
    folds = _folds(batch, rng)
    strength, heads = _chosen(problem, basis, folds)
    if not heads:
        return problem.stack
    best = maximised(problem, basis, strength, heads, None, ITERATIONS)
    return problem.stack.with_term(basis.with_weights(dict(zip(heads, best.T, strict=True))))


def _folds(batch: Batch, rng: np.random.Generator) -> Ints:
    """Return the fold of each ping, (n,); pings of one condition share it."""
    conditions, which = np.unique(batch.condition, return_inverse=True)
    return rng.permutation(np.arange(len(conditions)) % FOLDS)[which]


def _chosen(problem: Problem, basis: Basis, folds: Ints) -> tuple[float, list[str]]:
    """Return the strength of the prior and the aspects that predict unseen conditions best."""
    heads = list(HEADS)
    pairs = [(problem.select(folds != k), problem.select(folds == k)) for k in np.unique(folds)]
    best, found, fits = -np.inf, STRENGTHS[0], [None] * len(pairs)
    start: list[Floats | None] = list(fits)
    chosen: list[Floats] = []
    for strength in STRENGTHS:
        trained = [
            maximised(train, basis, strength, heads, c, FOLD_ITERATIONS)
            for (train, _), c in zip(pairs, start, strict=True)
        ]
        start = list(trained)
        nats = sum(float(predicted(t, basis, c, heads).sum()) for (_, t), c in zip(pairs, trained, strict=True))
        if nats <= best:
            break
        best, found, chosen = nats, strength, trained
    return found, _useful(pairs, basis, chosen, heads, best)


def _useful(
    pairs: Sequence[tuple[Problem, Problem]], basis: Basis, fits: Sequence[Floats], heads: list[str], best: float
) -> list[str]:
    """Return the aspects without which unseen conditions are predicted worse, dropped one at a time."""
    while heads:
        nats = {}
        for head in heads:
            keep = [k for k, other in enumerate(heads) if other != head]
            rest = [heads[k] for k in keep]
            nats[head] = sum(
                float(predicted(test, basis, fit[:, keep], rest).sum())
                for (_, test), fit in zip(pairs, fits, strict=True)
            )
        worst = max(nats, key=lambda head: nats[head])
        if nats[worst] < best:
            break
        best, fits = nats[worst], [np.delete(fit, heads.index(worst), axis=1) for fit in fits]
        heads = [head for head in heads if head != worst]
    return heads
