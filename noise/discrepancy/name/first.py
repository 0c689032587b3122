"""What is fitted before effects compete: a coarser register, and a threshold of the receiver."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from typing import Protocol

import numpy as np

from acquisition.arrays import Floats
from acquisition.io.grid import greatest_step
from noise.discrepancy.locate.few import COARSER
from noise.discrepancy.name.candidates import DESIGN
from noise.discrepancy.name.folds import Folds
from noise.discrepancy.name.hypothesis import Hypothesis, standard_error
from noise.effects.receiver import MAX_STEP_M
from noise.fitting.batch import Batch, share_without_echo
from noise.fitting.likelihood import likeliest
from noise.fitting.stack import Key, Stack
from noise.fitting.starts import nuisance_starts, starting_points

REGISTERS, STEP = ("quantisation", "truncation"), "step_m"
THRESHOLD = "sensitivity"  # without it nothing that weakens an echo can silence it
FEW_MISSED = 0.005  # share of silent pings below which no threshold shows; chosen here


class Fits(Protocol):
    """Readings, candidates and fits of a search; see `noise.discrepancy.name.search.Search`."""

    common: Stack
    folds: Folds
    parts: tuple[Batch, ...]
    pings: Floats
    screen: Batch
    names: tuple[str, ...]
    without: tuple[str, ...]
    rng: np.random.Generator

    @property
    def nuisances(self) -> tuple[Key, ...]:
        """Nuisance parameters that are free on each fold."""

    @property
    def least_gain(self) -> float:
        """Gain, nats, that is beyond chance."""

    def crossed(self, start: Stack, current: Hypothesis, effects: Sequence[str], own_scatter: bool) -> Hypothesis:
        """Return a hypothesis fitted on both folds."""

    def best(self, starts: Sequence[Sequence[Stack]], free: Sequence[Key], effects: Sequence[str]) -> Hypothesis:
        """Return the hypothesis of some effects of the best fit to each part."""


def with_register(search: Fits, none: Hypothesis) -> Hypothesis:
    """Return the hypothesis of a coarser register, where all readings lie on its steps.

    That they do is a fact, and needs no fit. Readings on coarse steps repeat each other; a law without the steps takes
    them for repeated, and from there no small step leads to one with them.
    """
    fine, batch = search.common.resolution, search.folds.both
    names = [name for name in REGISTERS if name in search.names]
    grids = [each for each in {batch.grid_m, coarsest(batch)} if COARSER * fine < each <= MAX_STEP_M]
    found = [none]
    for name, grid in product(names, sorted(grids)):
        law, pairs = search.common.at({(name, STEP): grid}), zip(none.stacks, search.parts, strict=True)
        starts = [[near.at({(name, STEP): grid}), *nuisance_starts(law, part)] for near, part in pairs]
        found.append(search.best(starts, search.nuisances, (name,)))
    best = max(found, key=lambda each: each.value)
    return best if best.value > none.value + search.least_gain else none


def coarsest(batch: Batch) -> float:
    """Return the greatest step, m, on whose multiples all readings lie, if only because their targets do; 0 if unknown.

    Readings may be off by half a step of the register in which others stored them.
    """
    value = np.unique(batch.reading.range[batch.reading.echo]) - batch.origin
    if batch.grid_m <= 0.0 or len(value) < 2:
        return 0.0
    step = greatest_step(value, 0.5 * batch.grid_m, COARSER * batch.grid_m)
    return batch.grid_m if step is None else step


def with_threshold(search: Fits, current: Hypothesis) -> Hypothesis:
    """Return the hypothesis with a threshold of the receiver, where that gains beyond chance.

    What weakens an echo can silence it only near a threshold; one by one, neither would be found. It is sought where
    pings are silent although the law of the simulation hears everything.
    """
    known = THRESHOLD in search.common.values or THRESHOLD in search.without
    if known or share_without_echo(search.folds.first) <= FEW_MISSED:
        return current
    starts = starting_points(current.stacks[0], THRESHOLD, search.screen, search.rng, DESIGN, search.parts[0])
    best = likeliest(starts, search.screen)
    found = search.crossed(best, current, (*current.effects, THRESHOLD), own_scatter=False)
    gain = found.nats - current.nats
    good = gain.sum() > max(search.least_gain, 2.0 * standard_error(gain, search.pings))
    return found if good else current
