"""Alternatives: effects that describe the readings as well in the place of a selected one."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np

from noise.discrepancy.name.hypothesis import Hypothesis, weights
from noise.discrepancy.name.search import Search
from noise.discrepancy.thresholds import LISTED


@dataclass(frozen=True, eq=False)
class Place:
    """A selected effect and what may stand in its place.

    Attributes:
        effect: id of the selected effect.
        likely: effect id -> probability of each effect in this place, the selected one first.
        lead: log posterior of the selected effect relative to the best other, nats.
        fits: effect id -> hypothesis with that effect in the place of the selected one.
    """

    effect: str
    likely: dict[str, float]
    lead: float
    fits: dict[str, Hypothesis]

    @property
    def leader(self) -> str:
        """The most probable effect."""
        return max(self.likely, key=self.likely.__getitem__)

    @property
    def listed(self) -> dict[str, float]:
        """The probabilities of the selected effect and of the others that are worth listing."""
        return {name: p for name, p in self.likely.items() if name == self.effect or p >= LISTED}

    def without(self, refuted: Collection[str]) -> Place:
        """Return the place without some of its effects, of which the selected one is listed all the same."""
        total = sum(p for name, p in self.likely.items() if name not in refuted)
        left = {name: p / total for name, p in self.likely.items() if name not in refuted}
        return replace(self, likely={self.effect: 0.0} | left)


def place_of(search: Search, found: Hypothesis, name: str) -> Place:
    """Return the effects in the place of a selected one, each cross-fitted given the other selected effects.

    They are those that came nearest when the effect was selected. They are fitted again where others were selected
    after it, or where the law of the simulation has changed; those that are not far behind have all nuisance parameters
    free at last, as the selected effects had.
    """
    others = {each for each in found.effects if each != name}
    rounds = [effects for effects, tried in search.tried.items() if name in tried]
    if not rounds:  # added first or last, without others in its place
        return Place(name, {name: 1.0}, np.inf, {name: found})
    given = max(rounds, key=lambda effects: (others.issuperset(effects), len(effects)))
    fits = {other: fit for other, fit in search.tried[given].items() if other == name or other not in found.effects}
    if set(given) != others or search.base[given][0] is not search.common:
        without = search.left_out(found, name)
        fits = {other: _beside(search, without, fit, other) for other, fit in fits.items()}
    own = fits.pop(name)
    fits = {other: search.polished(fit) if search.may_lead(fit, own) else fit for other, fit in fits.items()}
    inside = {other: fit for other, fit in fits.items() if search.explains(fit, other)}
    every = {name: found, **inside}
    lead = min((found.value - fit.value for fit in inside.values()), default=np.inf)
    return Place(name, weights(every, search.rng), lead, every)


def _beside(search: Search, without: Hypothesis, fit: Hypothesis, other: str) -> Hypothesis:
    """Return an effect cross-fitted beside others, started at its earlier values."""
    start = without.stacks[0].put(search.keys([other]), [fit.stacks[0].get(key) for key in search.keys([other])])
    return search.crossed(start, without, (*without.effects, other), own_scatter=False)
