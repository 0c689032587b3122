"""Two effects that only show together: where each shifts readings against the other, alone neither gains anything.

A search that adds one effect at a time stops before such a pair, or takes a third that is a little like both. So what
every effect does to where the target's echo is read, to first order, is laid beside where the stays lie, and all pairs
are solved at once. The few that do much better than any single effect are fitted, and believed like everything else:
across unseen cells, the pair against what stands without it and either of the two given the other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from acquisition.arrays import Floats
from noise.discrepancy.checks.smooth import lying
from noise.discrepancy.common.rules import Attempt, spread_over_blocks
from noise.discrepancy.name.search import Crossed, Search
from noise.fitting.batch import Batch
from noise.fitting.fit import MIN_RESTART_GAIN
from noise.fitting.stack import Key, Stack
from noise.fitting.starts import MIN_SHIFT_M, slope, target_echo
from noise.statistics import winsorised

FEWEST = 12  # stays, below which two shifts are not told apart; ours
PROMISING = 6.0  # nats, to first order, beyond the best single effect, to be fitted; ours
KNOWN_M = 1e-4  # no closer is it known where a stay lies; ours
FITTED = 6  # pairs that are fitted, of those that promise most
CROSSED = 2  # of those, the ones that are cross-fitted
TWINS = 0.05  # of what one pair comes to, by which another differs: less, and one of them is enough; ours


@dataclass(frozen=True)
class Shifts:
    """What effects do to where stays lie.

    Attributes:
        lie: how far off each stay lies, m, (stays,).
        count: of parameters that each effect has at all.
        keys: parameters of each effect that move it.
        slopes: of stays on those parameters, times the width of their bounds, m, (stays, keys) of each effect.
    """

    lie: Floats
    count: dict[str, int]
    keys: dict[str, tuple[Key, ...]]
    slopes: dict[str, Floats]

    def solved(self, names: Sequence[str]) -> tuple[float, Floats, Floats]:
        """Return what is left over of where stays lie, m^2, parameters in widths of their bounds, and their work, m."""
        design = np.concatenate([self.slopes[name] for name in names], axis=1)
        sizes = np.linalg.lstsq(design, self.lie, rcond=1e-6)[0]
        work = design @ sizes
        return float(((self.lie - work) ** 2).sum() + len(work) * KNOWN_M**2), sizes, work

    def applied(self, stack: Stack, pair: Pair) -> Stack:
        """Return a stack with a pair's parameters where they solve for where the stays lie."""
        keys = [key for name in pair.names for key in self.keys[name]]
        widths = [stack.parameter(key).high - stack.parameter(key).low for key in keys]
        return stack.put(keys, [stack.get(k) + w * s for k, w, s in zip(keys, widths, pair.sizes, strict=True)])


@dataclass(frozen=True)
class Pair:
    """Two effects that may only show together.

    Attributes:
        names: ids.
        sizes: of their parameters that shift readings, in widths of their bounds.
        work: what they do to where stays lie, m, (stays,).
        nats: gained beyond the best single effect, to first order, one a parameter taken off.
    """

    names: tuple[str, str]
    sizes: Floats
    work: Floats
    nats: float


def shifts(search: Search, stack: Stack, chosen: Sequence[str]) -> Shifts | None:
    """Return what every effect that was not chosen does to where stays lie; None where too few tell."""
    batch = search.discover
    lie = lying(stack, batch) - (
        0.0 if batch.simulated_offset is None else np.nan_to_num(batch.simulated_offset[batch.starts])
    )
    told = ~np.isnan(lie)
    if told.sum() < FEWEST:
        return None
    # what moves a stay shows at its first ping
    first = batch.select(batch.count == 0)
    expected = target_echo(stack, first)
    count, keys, slopes = dict[str, int](), dict[str, tuple[Key, ...]](), dict[str, Floats]()
    for name in search.candidates():
        if name in chosen:
            continue
        own = {key: _moved(stack, key, first, expected)[told] for key in search.keys([name])}
        own = {key: move for key, move in own.items() if np.abs(move).max() > MIN_SHIFT_M}
        if own:
            count[name] = len(search.keys([name]))
            keys[name], slopes[name] = tuple(own), np.stack(list(own.values()), axis=1)
    return Shifts(winsorised(lie[told]), count, keys, slopes)


def _moved(stack: Stack, key: Key, batch: Batch, expected: Floats) -> Floats:
    """Return by how much a parameter would move each ping between its bounds, were it linear, m, (n,)."""
    p = stack.parameter(key)
    return (p.high - p.low) * slope(stack, key, batch, expected)


def promising(found: Shifts, known: Sequence[str] = ()) -> list[Pair]:
    """Return pairs that promise most beyond what any single effect does, no two that come to the same.

    Args:
        found: what every effect does.
        known: effects that are tried together already: no pair comes to the same as they.
    """
    single = {name: found.solved([name])[0] for name in found.slopes}
    if not single:
        return []
    least, n = min(single.values()), len(found.lie)
    pairs = []
    for names in combinations(found.slopes, 2):
        left, sizes, work = found.solved(names)
        more = 0.5 * n * float(np.log(least / left))
        nats = more - sum(found.count[name] for name in names) + 1
        if nats > PROMISING and np.abs(sizes).max() <= 1.0:
            pairs.append(Pair(names, sizes, work, nats))
    kept: list[Pair] = []
    tried = [found.solved(own)[2]] if (own := [name for name in known if name in found.slopes]) else []
    for pair in sorted(pairs, key=lambda each: -each.nats):
        if len(kept) < FITTED and not any(_alike(pair.work, work) for work in tried):
            kept.append(pair)
            tried.append(pair.work)
    return kept


def _alike(one: Floats, other: Floats) -> bool:
    """Tell whether two courses of shifts, m, (stays,), come to the same."""
    return float(np.linalg.norm(one - other)) < TWINS * float(np.linalg.norm(other))


def best_pair(
    search: Search, chosen: Sequence[str], current: Crossed, known: Sequence[str] = ()
) -> tuple[list[str], Crossed] | None:
    """Return chosen effects with a pair that is believed beside them, cross-fitted; None without any.

    Args:
        search: its readings.
        chosen: effects that are there already.
        current: the explanation with them.
        known: effects that are tried together already.
    """
    found = shifts(search, current.first.stack, chosen)
    if found is None:
        return None
    pairs = {pair.names: pair for pair in promising(found, known)}
    starts = {" + ".join(names): (names, found.applied(current.first.stack, pair)) for names, pair in pairs.items()}
    fits = search.each(lambda one, _, start: one.screened(start[1], [*chosen, *start[0]], MIN_RESTART_GAIN), starts)
    best = sorted(fits, key=lambda name: -fits[name].nats)[:CROSSED]
    tried = [([*chosen, *starts[name][0]], fits[name].stack) for name in best]
    met = [(effects, search.cross(stack, effects, near=current)) for effects, stack in tried]
    good = [(effects, crossed) for effects, crossed in met if _believed(search, effects, crossed, current)]
    return max(good, key=lambda each: float(each[1].nats.sum())) if good else None


def _believed(search: Search, effects: list[str], crossed: Crossed, current: Crossed) -> bool:
    """Tell whether a pair, the last two effects, is believed, and either given the other; write down that it was tried.

    Two effects at once are twice as much to be wrong about.
    """
    pair = effects[-2:]
    total = crossed.nats - current.nats
    good = float(total.sum()) > 2.0 * search.rules.least_nats
    gains = {name: search.contribution(effects, crossed, name)[0] for name in pair} if good else {}
    good = good and all(search.rules.believes(name, gain) for name, gain in gains.items())
    decision = "believed as one of a pair" if good else "not more than chance, as a pair"
    for name in pair:
        given = tuple(other for other in effects if other != name)
        gain = gains.get(name, total)
        search.attempts.append(Attempt(name, given, np.nan, float(gain.sum()), spread_over_blocks(gain), decision))
    return good


def with_pairs(search: Search, chosen: list[str], base: Crossed, current: Crossed) -> tuple[list[str], Crossed]:
    """Return an explanation in which pairs were tried: in place of what was chosen one by one, and beside it.

    Args:
        search: its readings.
        chosen: effects found one by one.
        base: the law without any.
        current: the explanation with them.
    """
    afresh = best_pair(search, [], base, known=chosen)
    if afresh is not None:
        effects, crossed = search.extended(*afresh)
        more = search.rules.tie_nats * max(len(effects) - len(chosen), 0)
        if float((crossed.nats - current.nats).sum()) > more:
            chosen, current = effects, crossed
    if not chosen or len(chosen) + 2 > search.rules.most_effects:
        return chosen, current
    beside = best_pair(search, chosen, current)
    return (chosen, current) if beside is None else search.extended(*beside)
