"""Exchanges, the remedies for the greed of forward selection.

An effect that predicts best may mend what the law lacks of both files. Where they have it alike, another predicts
better, and that is the difference.

Where the effect that predicts best leaves a difference, and another that predicts nearly as well leaves none, the other
is the simpler explanation: more effects would follow the first.

Of two causes that act together, the effect that gains most alone may be a third one which imitates a part of both, and
those selected after it then mend what it gets wrong. Once two effects have followed each other, the pairs of effects
that were tried in the place of the first one are looked at, and replace the two where they predict better.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import Protocol

import numpy as np

from noise.discrepancy.name.common import Pooled, in_simulation, pooled, with_compensation, with_others
from noise.discrepancy.name.hypothesis import Hypothesis, alike, weights
from noise.discrepancy.thresholds import FALSE_ALARM, LEFT_LEVEL, LISTED
from noise.fitting.batch import Batch
from noise.fitting.stack import Key, Stack

N_PAIRS = 3  # that are fitted

Tried = Mapping[str, Hypothesis]


class Rounds(Protocol):
    """What a search knows of its rounds, and how it fits; see `noise.discrepancy.name.search.Search`."""

    common: Stack
    parts: tuple[Batch, ...]
    simulated: Batch | None
    shared: list[str]
    tried: dict[tuple[str, ...], dict[str, Hypothesis]]
    base: dict[tuple[str, ...], tuple[Stack, Hypothesis]]
    rng: np.random.Generator

    @property
    def least_gain(self) -> float:
        """Gain, nats, that is beyond chance."""

    def may_lead(self, found: Hypothesis, best: Hypothesis) -> bool:
        """Return whether a hypothesis may be better than the best on other visits."""

    def refitted(self, starts: Sequence[Stack], effects: Sequence[str]) -> Hypothesis:
        """Return the hypothesis of some effects with all nuisances free, fitted to each part from a start."""

    def is_left(self, found: Hypothesis, level: float, /) -> bool:
        """Return whether the recording differs from a hypothesis, by the orthogonal test at a level."""

    def explains(self, found: Hypothesis, name: str) -> bool:
        """Return whether an effect of a hypothesis explains readings."""

    def keys(self, effects: Sequence[str]) -> tuple[Key, ...]:
        """Return the parameters of effects that the recording can identify."""

    def crossed(self, start: Stack, current: Hypothesis, effects: Sequence[str], own_scatter: bool) -> Hypothesis:
        """Return a hypothesis fitted on both folds."""


def in_both(search: Rounds, tried: Tried, name: str) -> Stack | None:
    """Return the law of the simulation with the best effect of a round where both files have that; None otherwise.

    They have it where the readings of the simulation show it, or where another effect describes both better beside it.

    Args:
        search: its readings and fits.
        tried: hypotheses of the round, by the effect that was added.
        name: of the best effect.
    """
    found, keys, simulated = tried[name], search.keys([name]), search.simulated
    if simulated is None or name in search.shared:
        return None
    law = with_compensation(search.common, keys, found.stacks, simulated)
    if law is not None:
        return law
    own, gain = in_simulation(search.common, keys, found.stacks, simulated)
    both = pooled(own, keys, found.stacks, search.parts, simulated)
    if gain < search.least_gain and not _led_by_another(search, tried, name, both):
        return None
    return with_others(both.law if both.apart < search.least_gain else own, keys, simulated)


def _led_by_another(search: Rounds, tried: Tried, name: str, both: Pooled) -> bool:
    """Return whether another effect describes both files better where these have the best effect of a round alike.

    Beside the other, separate values of the best effect must gain no more than chance: else both differ.

    Args:
        search: its readings and fits.
        tried: hypotheses of the round, by the effect that was added.
        name: of the best effect.
        both: the law of the simulation with that effect as both files have it.
    """
    found, keys = tried[name], search.keys([name])
    values = [both.law.get(key) for key in keys]
    rivals = [fit for other, fit in tried.items() if other != name and search.explains(fit, other)]
    rivals = [fit for fit in rivals if search.may_lead(fit, found)]
    beside = [search.refitted([each.put(keys, values) for each in fit.stacks], fit.effects) for fit in rivals]
    best = max(beside, key=lambda each: each.value, default=found)
    if best.value - both.lost <= found.value:
        return False
    return search.refitted(best.stacks, (*best.effects, name)).value - (best.value - both.lost) < search.least_gain


def sufficient(search: Rounds, found: Hypothesis, given: Hypothesis) -> Hypothesis:
    """Return the selected hypothesis of a round, or where it leaves a difference, a probable one that leaves none.

    Args:
        search: its rounds.
        found: the selected one.
        given: the hypothesis that the round began with.
    """
    tried = {name: fit for name, fit in search.tried[given.effects].items() if search.explains(fit, name)}
    likely = weights(tried, search.rng) if len(tried) > 1 else {}
    rivals = [name for name, p in likely.items() if p >= LISTED and name != found.effects[-1]]
    if not rivals or not search.is_left(found, FALSE_ALARM):
        return found
    rivals.sort(key=lambda name: -likely[name])
    return next((tried[name] for name in rivals if not search.is_left(tried[name], LEFT_LEVEL)), found)


def exchanged(search: Rounds, found: Hypothesis) -> Hypothesis:
    """Return the best of a hypothesis and those with another pair in the place of its last two effects."""
    if len(found.effects) < 2:  # a pair in the place of a single effect would be one effect more
        return found
    given, last = found.effects[:-2], set(found.effects[-2:])
    rivals = [pair for pair in promising(search, given, found.value) if set(pair) != last]
    fits = [_together(search, given, pair) for pair in rivals[:N_PAIRS]]
    good = [fit for fit in fits if all(search.explains(fit, name) for name in fit.effects)]
    return max([found, *good], key=lambda each: each.value)


def promising(search: Rounds, given: tuple[str, ...], value: float) -> list[tuple[str, str]]:
    """Return the pairs of tried effects that would exceed a value if their gains added, the greatest sum first."""
    if given not in search.base or search.base[given][0] is not search.common:
        return []
    base, tried = search.base[given][1], search.tried[given]
    gain = {name: each.value - base.value for name, each in tried.items() if search.explains(each, name)}
    sums = {(one, other): gain[one] + gain[other] for one, other in combinations(sorted(gain), 2)}
    better = (
        pair for pair, total in sums.items() if base.value + total > value and min(gain[name] for name in pair) > 0.0
    )
    apart = [pair for pair in better if not alike(*(tried[name].nats - base.nats for name in pair))]
    return sorted(apart, key=lambda pair: -sums[pair])


def _together(search: Rounds, given: tuple[str, ...], pair: tuple[str, str]) -> Hypothesis:
    """Return two effects that were fitted one by one, fitted together; the one that gained more comes first."""
    tried = search.tried[given]
    first, second = sorted(pair, key=lambda name: -tried[name].value)
    keys = search.keys([second])
    start = tried[first].stacks[0].put(keys, [tried[second].stacks[0].get(key) for key in keys])
    return search.crossed(start, tried[first], (*given, first, second), own_scatter=False)
