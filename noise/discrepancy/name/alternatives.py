"""Alternatives: effects that describe the readings as well in the place of a selected one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from noise.discrepancy.name.candidates import at_bound
from noise.discrepancy.name.search import Hypothesis, Search
from noise.discrepancy.thresholds import LISTED
from noise.fitting.stack import Stack


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


def place_of(search: Search, found: Hypothesis, name: str) -> Place:
    """Return the effects in the place of a selected one, each cross-fitted given the other selected effects.

    They are those that came nearest when the effect was selected; where others were selected after it, they are fitted
    again beside these.
    """
    given = next((effects for effects, tried in search.tried.items() if name in tried), None)
    if given is None:  # added first or last, without others in its place
        return Place(name, {}, {name: found.stacks[0]})
    others = tuple(each for each in found.effects if each != name)
    fits = {other: hypothesis for other, hypothesis in search.tried[given].items() if other not in found.effects}
    if set(given) != set(others):
        without = search.left_out(found, name)
        fits = {other: _beside(search, without, fit, other) for other, fit in fits.items()}
    posterior = {other: fit.value - found.value for other, fit in fits.items()}
    inside = {
        other: value
        for other, value in posterior.items()
        if not any(at_bound(stack, search.common, other, search.folds.both) for stack in fits[other].stacks)
    }
    return Place(name, inside, {name: found.stacks[0], **{other: fits[other].stacks[0] for other in inside}})


def _beside(search: Search, without: Hypothesis, fit: Hypothesis, other: str) -> Hypothesis:
    """Return an effect cross-fitted beside others, started at its earlier values."""
    start = without.stacks[0].put(search.keys([other]), [fit.stacks[0].get(key) for key in search.keys([other])])
    return search.crossed(start, without, (*without.effects, other), own_scatter=False)
