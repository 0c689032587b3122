"""Readings, the physics around a smooth correction, and the basis in which the correction is fitted."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from torch import Tensor

from acquisition.arrays import Floats
from noise.effects import State
from noise.effects.receiver import TravelTimeJitter
from noise.fitting.batch import Batch
from noise.fitting.smooth import (
    DETECTION,
    EARLY,
    LATE,
    SHIFT,
    SPREAD,
    Inputs,
    Sizes,
    Smooth,
    kernel,
    level_centres,
    level_kernel,
    level_scale,
)
from noise.fitting.stack import Stack
from noise.fitting.visit_effects import (
    FLOOR,
    MIN_PROBABILITY,
    VisitEffects,
    direct_median,
    outcome_given_visit,
    outcome_probability,
    placement_scatter,
    single_ping_law,
)
from noise.physical import PhysicalLaw, PhysicalModel
from noise.statistics import robust_std

CENTRES = 60  # of the kernel: more describe no survey of a few hundred positions better
# prior standard deviation of each aspect at strength 1: probits, units of the scatter, log factor, log-odds
PRIOR_SD = {DETECTION: 1.5, SHIFT: 2.0, SPREAD: 0.7, EARLY: 2.0, LATE: 2.0}
TAIL_M = 0.1  # length of a tail that no reading is in
FAR = 5.0  # standard deviations beyond which a reading belongs to a tail
JITTER = 1e-6  # added to the diagonal of the covariance of centres, relative to its greatest eigenvalue
Score = Callable[[PhysicalLaw, VisitEffects, Batch], Tensor]


def single_log_prob(law: PhysicalLaw, visits: VisitEffects, batch: Batch) -> Tensor:
    """Return the log probability of each reading, nats, (n,): of its range as the only one of its visit.

    Echo or no echo is predicted with the earlier pings of the visit, since pings of one position near the threshold
    agree; otherwise a few positions would decide on the detection everywhere.
    """
    single, urn = single_ping_law(law, visits), visits.urn_weight
    count, n_echoes = batch.echo_counts
    n_alike = torch.where(torch.from_numpy(batch.reading.echo), n_echoes, count - n_echoes)
    given = (outcome_given_visit(law, visits, batch) + urn * n_alike) / (1.0 + urn * count)
    expected = torch.clamp(outcome_probability(single, batch), min=MIN_PROBABILITY)
    p = single.probability_tensor(batch.reading) * given / expected
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
        scaled = {head: self.prior_sd[head] * torch.from_numpy(c) for head, c in coefficients.items()}
        alpha = {head: self.root @ c[:m] for head, c in scaled.items()}
        beta = {head: self.level_root @ c[m:] for head, c in scaled.items()}
        return Smooth(old.inputs, old.centres, alpha, old.level_centres, beta, old.sizes)


@dataclass(frozen=True, eq=False)
class Problem:
    """Readings and the physics before and after the correction."""

    stack: Stack
    batch: Batch
    score: Score

    @cached_property
    def visits(self) -> VisitEffects:
        """Visit effects."""
        return self.stack.build()[1]

    @cached_property
    def parts(self) -> tuple[PhysicalModel, PhysicalModel]:
        """The effects before the correction, and those after it."""
        model, own = self.stack.model, (Smooth.stage, Smooth.name)
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
        batch, state = self.batch, self.parts[1].applied(state)
        return PhysicalLaw(state, batch.ping.distance, batch.resolution, self.stack.max_range, batch.origin)

    def log_prob(self, basis: Basis, heads: dict[str, Tensor]) -> Tensor:
        """Return the log probability of each reading under given corrections, nats, (n,)."""
        return self.score(self.law(basis.term.corrected(self.state, heads)), self.visits, self.batch)

    def functions(self, basis: Basis) -> Tensor:
        """Return the basis functions at each ping, (n, p)."""
        if id(basis) not in self._functions:
            self._functions[id(basis)] = basis.functions(self.state)
        return self._functions[id(basis)]

    @cached_property
    def _functions(self) -> dict[int, Tensor]:
        return {}


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
    sigma_m, per_metre = (problem.stack.get((TravelTimeJitter.name, p.name)) for p in TravelTimeJitter.parameters)
    sizes = Sizes(tails, placement, float(problem.visits.level_sd_db), (sigma_m, per_metre))
    term = Smooth(inputs, centres, {}, at, {}, sizes)
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


@dataclass(frozen=True, eq=False)
class Coefficients:
    """Coefficients of basis functions for some aspects.

    Attributes:
        heads: aspects.
        value: coefficients, (p, aspects).
    """

    heads: tuple[str, ...]
    value: Floats

    def of(self, heads: Sequence[str]) -> Floats:
        """Return the coefficients of some aspects, zero where there are none, (p, aspects)."""
        columns = dict(zip(self.heads, self.value.T, strict=True))
        zero = np.zeros(len(self.value))
        return np.stack([columns.get(head, zero) for head in heads], axis=1)
