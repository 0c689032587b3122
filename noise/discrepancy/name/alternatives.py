"""Alternatives: effects that describe the readings as well in the place of a selected one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from noise.discrepancy.thresholds import LISTED
from noise.discrepancy.name.candidates import at_bound, log_prior, starts_of
from noise.discrepancy.name.estimates import Final
from noise.discrepancy.name.search import ROUGH, Search
from noise.fitting.batch import Batch
from noise.fitting.fit import Fit, highest, log_likelihood, maximise
from noise.fitting.stack import SPREAD, Key, Stack

N_ALTERNATIVES = 5  # effects that are fitted in the place of a selected one
COMPARED_PINGS = 1500


@dataclass(frozen=True, eq=False)
class Place:
    """A selected effect and what may stand in its place.

    Attributes:
        effect: id of the selected effect.
        others: effect id -> log posterior relative to the selected effect, nats.
        stacks: effect id -> fitted stack with that effect in the place of the selected one.
    """

    effect: str
    others: dict[str, float]
    stacks: dict[str, Stack]

    @property
    def lead(self) -> float:
        """Log posterior of the selected effect relative to the best other, nats."""
        return -max(self.others.values(), default=-np.inf)

    def probabilities(self, temperature: float) -> dict[str, float]:
        """Return the probability of each effect in this place, the selected one first.

        Args:
            temperature: factor by which log posteriors overstate evidence, since no law is exactly true.
        """
        names = [self.effect, *self.others]
        log = np.array([0.0, *self.others.values()]) / temperature
        weight = np.exp(log - log.max())
        shares = weight / weight.sum()
        return {name: float(p) for name, p in zip(names, shares, strict=True) if name == self.effect or p >= LISTED}


def place_of(search: Search, final: Final, name: str) -> Place:
    """Return the effects in the place of a selected one, each fitted given the other selected effects."""
    batch = final.batch.thin(COMPARED_PINGS)
    others = tuple(each for each in final.effects if each != name)
    own = _fitted(search, [final.stack], final.effects, batch)
    without = _without(search, final.stack, name)
    stacks, posterior = {}, {}
    here = _log_posterior(search, own, name, batch)
    for other, starts in _promising(search, without, final.effects, batch).items():
        fit = _fitted(search, starts, (*others, other), batch)
        if not at_bound(fit.stack, search.common, other, batch):
            stacks[other] = fit.stack
            posterior[other] = _log_posterior(search, fit, other, batch) - here
    return Place(name, posterior, {name: own.stack, **stacks})


def _without(search: Search, stack: Stack, name: str) -> Stack:
    """Return a stack in which one effect has the values of the common law."""
    if name not in search.common.values:
        return stack.without(name)
    keys: list[Key] = [(name, p.name) for p in stack.known[name].parameters]
    return stack.put(keys, [search.common.get(key) for key in keys])


def _promising(search: Search, stack: Stack, chosen: Sequence[str], batch: Batch) -> dict[str, list[Stack]]:
    """Return the best starting points of the effects that are likeliest before a fit."""
    grid = batch.thin(len(search.grid))
    ranked = []
    for name in search.names:
        if name not in chosen:
            starts = starts_of(stack, name, grid, batch, search.rng)
            nats = [float(log_likelihood(each, grid).sum()) for each in starts]
            order = np.argsort(nats)[::-1][:2]
            ranked.append((nats[order[0]], name, [starts[k] for k in order]))
    ranked.sort(key=lambda each: -each[0])
    return {name: starts for _, name, starts in ranked[:N_ALTERNATIVES]}


def _fitted(search: Search, starts: Sequence[Stack], effects: Sequence[str], batch: Batch) -> Fit:
    free = (*search.keys(effects), *SPREAD)
    return highest(maximise(start, free, batch, 25, ROUGH) for start in starts)


def _log_posterior(search: Search, fit: Fit, name: str, batch: Batch) -> float:
    """Return log-likelihood plus log prior, nats, with half a log of the number of visits for each parameter."""
    n_parameters = len(search.keys([name]))
    return fit.nats + log_prior(fit.stack, search.common, [name]) - 0.5 * n_parameters * float(np.log(batch.n_visits))
