"""Greedy search of the catalogue: every effect scored given what is chosen, and believed only across unseen cells.

Winning a round is easy; stopping is the problem. An effect is added only if its gain is *cross-fitted* (fitted on one
part of the cells, scored on the other, both ways), exceeds `Rules.least_nats` and its standard error over blocks, and
survives leaving out the block that speaks for it most. Under the null such a gain is negative on average; beyond 6 nats
it lies with probability 0.0005 for one parameter, so the greatest of some thirty stays below 2 %.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TypeVar

import numpy as np

from acquisition.arrays import Floats
from noise.discrepancy.common.rules import Attempt, Rules, spread_over_blocks
from noise.discrepancy.common.unseen import unseen
from noise.discrepancy.common.workers import ALONE, Workers
from noise.effects import CATALOGUE
from noise.fitting.batch import Batch, share_without_echo
from noise.fitting.fit import Fit, Scales, highest, log_likelihood, maximise
from noise.fitting.stack import JITTER, NUISANCES, SPREAD, Key, Stack
from noise.fitting.starts import nuisance_start, robust_scatter, starting_points

Progress = Callable[[str, float], None]
T = TypeVar("T")
R = TypeVar("R")
Points = list[tuple[float, Stack]]  # log likelihood on the grid batch and starting point, best first
THRESHOLD = "sensitivity"
STEPS = 5  # of a climb that only ranks candidates
STRETCHED = 2.0  # times the scatter of most readings; ours
ROUGH = 3.0  # nats: a first climb that gains less is not refined, since the candidate will not win


@dataclass(frozen=True)
class Crossed:
    """A hypothesis fitted on either part and scored on the other.

    Attributes:
        first, second: the fits.
        nats: of each block of the discover part, then of the confirm part.
    """

    first: Fit
    second: Fit
    nats: Floats


@dataclass
class Search:
    """State of a search: data, base, and the record of everything tried.

    Attributes:
        base: the given model with its nuisances; effects in it are candidates too, with their values as null.
        discover, confirm: the two parts; `both` together.
        seed: of the quasi-random starts.
        rules: see `Rules`.
        attempts: the record, in words.
        fits, grids: of every round, by the effects that were given: what was fitted, and where everything began.
        progress: called with a message and a share done.
        never: effects that are not to be named.
        workers: that share out fits.
        usual_m: scatter of most readings about the middle of their cell, m.
    """

    base: Stack
    discover: Batch
    confirm: Batch
    both: Batch
    seed: int = 0
    rules: Rules = field(default_factory=Rules)
    progress: Progress | None = None
    attempts: list[Attempt] = field(default_factory=list)
    fits: dict[tuple[str, ...], dict[str, Fit]] = field(default_factory=dict)
    grids: dict[tuple[str, ...], dict[str, Points]] = field(default_factory=dict)
    never: tuple[str, ...] = ()
    workers: Workers = ALONE
    usual_m: float = field(init=False)
    _clocked: dict[str, bool] = field(default_factory=dict)
    _scales: dict[Batch, Scales] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Cut the batches to size."""
        self.grid = self.discover.thin(self.rules.grid_pings)
        self.screen = self.discover.thin(self.rules.screen_pings)
        self.discover = self.discover.thin(self.rules.full_pings)
        self.confirm = self.confirm.thin(self.rules.full_pings)
        self.both = self.both.thin(self.rules.full_pings)
        self.usual_m = robust_scatter(self.discover)

    def each(self, job: Callable[[Search, str, T], R], items: Mapping[str, T]) -> dict[str, R]:
        """Return what a job makes of every item, by name, each with a search of its own: in any order, on any machine.

        Args:
            job: called with a search of these readings, a name and its item.
            items: by name.
        """
        found = self.workers.map(partial(_apart, self.bare(), job), list(items.items()))
        return dict(zip(items, found, strict=True))

    def bare(self) -> Search:
        """Return the same search without what it has found and whom it tells, and with measures of its own."""
        own = copy(self)
        own.progress, own.attempts, own.fits, own.grids = None, [], {}, {}
        own._scales = {batch: dict(scales) for batch, scales in self._scales.items()}
        return own

    def candidates(self) -> list[str]:
        """Return every effect of the catalogue that can be named; scatter alone is a nuisance."""
        able = [name for name, kind in CATALOGUE.items() if self.both.resolution <= kind.coarsest_step_m]
        able = [name for name in able if name not in (JITTER, *self.never)]
        return [name for name in able if self.discover.timed or not self._uses_time(name)]

    def _uses_time(self, name: str) -> bool:
        """Tell whether an effect looks at the clock, which says nothing where no time was logged."""
        if name not in self._clocked:
            few = self.grid.select(self.grid.visit < 2)
            conditions = replace(few.conditions, time=few.conditions.time.requires_grad_())
            state = Stack({name: {}}, extra=self.base.extra).model.state(conditions)
            moved = [state.offset, *(part for path in state.paths for part in (path.length, path.lag))]
            self._clocked[name] = any(part.requires_grad for part in moved)
        return self._clocked[name]

    def keys(self, names: Sequence[str]) -> tuple[Key, ...]:
        """Return the parameters of effects that these readings can tell."""
        logged = self.both.ping.covariates
        known = ((name, p) for name in names for p in self.base.known[name].parameters)
        return tuple((name, p.name) for name, p in known if p.identifiable(logged))

    def tell(self, message: str, share: float) -> None:
        """Report progress, where anybody listens."""
        if self.progress is not None:
            self.progress(message, share)

    def reset(self, stack: Stack, name: str) -> Stack:
        """Return the stack with an effect back at what the given model says of it."""
        stack = stack.without(name)
        if name in self.base.values:
            stack = replace(stack, values={**stack.values, name: dict(self.base.values[name])})
        return stack

    def tried(self, stack: Stack, chosen: Sequence[str], name: str, batch: Batch | None = None) -> Fit:
        """Return the best fit of one more effect on the screening batch, from the best points of its grid."""
        return self.climbed(self.points(stack, name), chosen, name, batch)

    def points(self, stack: Stack, name: str) -> Points:
        """Return the starting points of an effect with their log likelihoods on the grid batch, best first."""
        rng = np.random.default_rng([self.seed, zlib.crc32(name.encode())])
        starts = starting_points(stack, name, self.grid, rng, whole=self.discover)
        scored = [(float(log_likelihood(s, self.grid).sum()), k, s) for k, s in enumerate(starts)]
        # a sharp law sees no point of a coarse grid: a few steps from the present values show where it would go
        stepped = maximise(starts[0], self.keys([name]), self.grid, STEPS, np.inf)
        scored.append((stepped.nats, len(starts), stepped.stack))
        scored.sort(key=lambda item: (-item[0], item[1]))
        return [(nats, s) for nats, _, s in scored]

    def climbed(self, points: Points, chosen: Sequence[str], name: str, batch: Batch | None = None) -> Fit:
        """Return the best climb from the two best points; from one, where nothing beat the present values."""
        free = (*self.keys([*chosen, name]), *SPREAD)
        batch = self.screen if batch is None else batch
        starts = [stack for _, stack in points[: 1 if points[0][1].values.get(name) == self.present(name) else 2]]
        fits = [maximise(stack, free, batch, 25, ROUGH, self.scales(batch)) for stack in starts]
        if self.strays_stretch(points[0][1], name):
            free = (*self.keys([*chosen, name]), *NUISANCES)
            fits.append(maximise(self.tight(points, name), free, batch, 25, ROUGH, self.scales(batch)))
        return highest(fits)

    def tight(self, points: Points, name: str) -> Stack:
        """Return the effect as it usually starts, with the scatter that most readings of a cell have.

        From a scatter that strays have stretched no climb leads back, nor from cells that are taken to repeat
        themselves because all but the strays are alike.
        """
        stack = nuisance_start(points[0][1], self.discover)
        usual = [(p.starts or (p.null,))[0] for p in self.base.known[name].parameters]
        keys = [(name, p.name) for p in self.base.known[name].parameters]
        return stack.put([*keys, (JITTER, "sigma_m")], [*usual, self.usual_m])

    def strays_stretch(self, stack: Stack, name: str) -> bool:
        """Tell whether an effect strikes single pings, and the scatter is far wider than that of most readings."""
        usual = max(self.usual_m, 0.5 * self.both.resolution)  # on a coarse register most readings of a cell are alike
        return self.base.known[name].by_ping and stack.get((JITTER, "sigma_m")) > STRETCHED * usual

    def scales(self, batch: Batch) -> Scales:
        """Return the scales of nuisances that were measured on a batch."""
        return self._scales.setdefault(batch, {})

    def present(self, name: str) -> dict[str, float]:
        """Return the values at which an effect does what the given model says of it."""
        held = self.base.values.get(name, {})
        return {p.name: held.get(p.name, p.null) for p in self.base.known[name].parameters}

    def cross(
        self, stack: Stack, chosen: Sequence[str], nuisances: Sequence[Key] = NUISANCES, near: Crossed | None = None
    ) -> Crossed:
        """Fit a hypothesis on either part, score it on the other.

        Args:
            stack: values of the chosen effects to begin from; of everything else too, where `near` is not given.
            chosen: effects of the hypothesis.
            nuisances: what is free besides.
            near: the hypothesis that it will be compared with: what both share begins where that one ended, so that
                the difference is the effect's and not that of another summit among the nuisances.
        """
        keys = self.keys(chosen)
        free = (*keys, *nuisances)
        start = stack if near is None else _carried(near.first.stack, stack, keys)
        first = maximise(start, free, self.discover, scales=self.scales(self.discover))
        start = first.stack if near is None else _carried(near.second.stack, first.stack, (*keys, *NUISANCES))
        # how readings scatter and what cells share is a property of the sonar: the smaller part, a dozen cells at
        # times, would say it all too exactly, and be wrong of a single careless cell by dozens of nats
        second = maximise(start, keys, self.confirm) if keys else self._as_it_is(start)
        on_discover = unseen(second, keys, self.confirm, self.discover, first, self.seed)
        on_confirm = unseen(first, keys, self.discover, self.confirm, second, self.seed)
        return Crossed(first, second, np.r_[on_discover, on_confirm])

    def crossed_with(self, stack: Stack, chosen: Sequence[str], name: str, current: Crossed) -> Crossed:
        """Return one more effect, cross-fitted from where the others ended.

        One that strikes single pings is tried from the scatter of its own climb as well, and taken from there if it
        still gains as much when the others are given that scatter too: the summit must be the effect's.
        """
        crossed = self.cross(stack, [*chosen, name], near=current)
        if not self.strays_stretch(current.first.stack, name):
            return crossed
        own = self.cross(stack, [*chosen, name])
        if own.first.nats < crossed.first.nats + ROUGH:
            return crossed
        without = self.without([*chosen, name], own, name)
        more = max(0.0, float((without.nats - current.nats).sum()))
        return own if float((own.nats - crossed.nats).sum()) > more else crossed

    def climbs(self, grids: Mapping[str, Points], chosen: Sequence[str]) -> dict[str, Fit]:
        """Return the best fit on the screening batch of each of several effects beside the chosen ones."""
        return self.each(lambda search, name, points: search.climbed(points, chosen, name), grids)

    def met(self, fit: Fit, chosen: Sequence[str], name: str, current: Crossed) -> tuple[Crossed, Fit]:
        """Return one more effect cross-fitted, and the better of its fits on the screening batch."""
        crossed = self.crossed_with(fit.stack, chosen, name, current)
        return crossed, self.best_seen(fit, crossed, [*chosen, name])

    def best_seen(self, fit: Fit, crossed: Crossed, effects: Sequence[str]) -> Fit:
        """Return the better of a climb on the screening batch and one from where a cross-fit of the same ended.

        A quick climb from a coarse grid may stop short of the summit that the whole part shows, and a rival that cannot
        be told from what is chosen would look far off.
        """
        return max(fit, self.screened(crossed.first.stack, effects), key=lambda each: each.nats)

    def screened(self, start: Stack, effects: Sequence[str], enough: float = ROUGH) -> Fit:
        """Return effects fitted together on the screening batch; `enough` as in `maximise`."""
        return maximise(start, (*self.keys(effects), *SPREAD), self.screen, 25, enough, self.scales(self.screen))

    def _as_it_is(self, stack: Stack) -> Fit:
        """Return a hypothesis without anything to fit on the smaller part."""
        return Fit(stack, (), float(log_likelihood(stack, self.confirm).sum()))

    def contribution(self, chosen: Sequence[str], cross: Crossed, name: str) -> tuple[Floats, Crossed]:
        """Return what one effect adds to the others, nats by block, and the explanation without it.

        From a scatter that the effect has made narrow no climb may lead back: without it, that of the law that the
        search began from is tried as well.
        """
        others = [other for other in chosen if other != name]
        loose = _carried(self.reset(cross.first.stack, name), self.base, NUISANCES)
        tries = (self.without(chosen, cross, name), self.cross(loose, others))
        without = max(tries, key=lambda each: float(each.nats.sum()))
        return cross.nats - without.nats, without

    def without(self, chosen: Sequence[str], cross: Crossed, name: str) -> Crossed:
        """Return an explanation fitted anew without one of its effects."""
        first, second = (replace(fit, stack=self.reset(fit.stack, name)) for fit in (cross.first, cross.second))
        return self.cross(first.stack, [n for n in chosen if n != name], near=Crossed(first, second, cross.nats))

    def round(self, chosen: list[str], current: Crossed) -> tuple[str, Crossed] | None:
        """Return the effect that gains most given the chosen ones, or None when none is believed."""
        stack = current.first.stack
        here = float(log_likelihood(stack, self.grid).sum())
        open_ = [name for name in self.candidates() if name not in chosen]
        grids = self.each(lambda search, name, at: search.points(at, name), dict.fromkeys(open_, stack))
        order = sorted(open_, key=lambda name: -grids[name][0][0])
        start = self.screened(stack, chosen)
        # a grid sees no stray in a scatter that strays have stretched: what may have stretched it is fitted as well
        near = [n for k, n in enumerate(order) if k < self.rules.fitted or self.strays_stretch(stack, n)]
        fits = self.climbs({name: grids[name] for name in near}, chosen)
        self.fits[tuple(chosen)], self.grids[tuple(chosen)] = fits, grids
        screened = {name: fit.nats - start.nats for name, fit in fits.items()}
        best = sorted(screened, key=lambda name: -screened[name])
        good = {name: fits[name] for name in best[: self.rules.crossed] if screened[name] > 1.0}
        met = self.each(lambda search, name, fit: search.met(fit, chosen, name, current), good)
        crossed = {name: both[0] for name, both in met.items()}
        fits |= {name: both[1] for name, both in met.items()}
        winner = self._judge(chosen, current, screened, crossed)
        rest = {name: grids[name][0][0] - here for name in order if name not in fits}
        self.attempts += [Attempt(name, tuple(chosen), gain) for name, gain in rest.items()]
        return None if winner is None else (winner, crossed[winner])

    def _judge(
        self, chosen: Sequence[str], current: Crossed, screened: dict[str, float], crossed: dict[str, Crossed]
    ) -> str | None:
        """Return the believed effect of greatest gain and write down what became of every one that was fitted."""
        gains = {name: c.nats - current.nats for name, c in crossed.items()}
        good = [name for name in gains if self.rules.believes(name, gains[name], not chosen)]
        winner = self.simplest(good, gains)
        for name, nats in screened.items():
            gain = gains.get(name)
            decision = "added" if name == winner else "gained less" if name in good else "not more than chance"
            total, error = (np.nan, np.nan) if gain is None else (float(gain.sum()), spread_over_blocks(gain))
            self.attempts.append(Attempt(name, tuple(chosen), nats, total, error, decision))
        return winner

    def simplest(self, good: Sequence[str], gains: dict[str, Floats]) -> str | None:
        """Return the effect of fewest parameters among those that gain as much as the best, within chance."""
        if not good:
            return None
        best = max(good, key=lambda name: gains[name].sum())
        behind = {name: gains[best] - gains[name] for name in good}
        close = [n for n in good if behind[n].sum() <= max(self.rules.tie_nats, spread_over_blocks(behind[n]))]
        return min(close, key=lambda name: (len(self.keys([name])), behind[name].sum()))

    def run(self) -> tuple[list[str], Crossed, Crossed]:
        """Return chosen effects, the cross-fitted base, and the cross-fitted explanation."""
        base = current = self.cross(self.base, [])
        chosen: list[str] = []
        if self.needs_a_threshold():
            chosen, current = self.with_threshold(current)
        chosen, current = self.extended(chosen, current)
        return chosen, base, current

    def extended(self, chosen: list[str], current: Crossed) -> tuple[list[str], Crossed]:
        """Return an explanation to which effects were added one by one while any is believed."""
        while len(chosen) < self.rules.most_effects:
            self.tell(f"searching, {len(chosen)} found", 0.1 + 0.6 * len(chosen) / (self.rules.most_effects + 1))
            found = self.round(chosen, current)
            if found is None:
                break
            chosen, current = [*chosen, found[0]], found[1]
            chosen, current = self.prune(chosen, current)
        return chosen, self.refreshed(chosen, current)

    def refreshed(self, chosen: Sequence[str], current: Crossed) -> Crossed:
        """Fit each early effect afresh, now that what it had to stand in for is explained otherwise."""
        for name in chosen[:-1]:
            others = [other for other in chosen if other != name]
            start = self.points(self.reset(current.first.stack, name), name)
            crossed = self.cross(self.climbed(start, others, name).stack, chosen, near=current)
            if crossed.nats.sum() > current.nats.sum():
                current = crossed
        return current

    def needs_a_threshold(self) -> bool:
        """Tell whether echoes are missed although the model hears everything: then no loss of level can show."""
        return THRESHOLD not in (*self.base.values, *self.never) and share_without_echo(self.discover) > 0.005

    def with_threshold(self, base: Crossed) -> tuple[list[str], Crossed]:
        """Give the receiver a threshold before anything else is weighed, where that is believed.

        What weakens an echo (tilt, distance, air) can silence it only near a threshold, and an ideal sonar has none:
        one by one, neither would be found.
        """
        fitted = self.climbed(self.points(base.first.stack, THRESHOLD), [], THRESHOLD)
        crossed = self.cross(fitted.stack, [THRESHOLD], near=base)
        gain = crossed.nats - base.nats
        good = self.rules.believes(THRESHOLD, gain, first=True)
        told = "added first: echoes are missed" if good else "not more than chance"
        self.attempts.append(Attempt(THRESHOLD, (), np.nan, float(gain.sum()), spread_over_blocks(gain), told))
        return ([THRESHOLD], crossed) if good else ([], base)

    def prune(self, chosen: list[str], current: Crossed) -> tuple[list[str], Crossed]:
        """Drop what a later effect made needless."""
        for name in list(chosen[:-1]):
            others = [n for n in chosen if n != name]
            without = self.without(chosen, current, name)
            loss = current.nats - without.nats
            if loss.sum() < self.rules.keep_nats:
                nats, error = float(loss.sum()), spread_over_blocks(loss)
                self.attempts.append(Attempt(name, tuple(others), np.nan, nats, error, "dropped again"))
                chosen, current = others, without
        return chosen, current


def _apart(search: Search, job: Callable[[Search, str, T], R], item: tuple[str, T]) -> R:
    """Do a job with a search of its own: what it measures on the way is seen by no other job."""
    return job(search.bare(), *item)


def _carried(shared: Stack, own: Stack, keys: Sequence[Key]) -> Stack:
    """Return one stack with the values that another has at some keys."""
    return shared.put(keys, [own.get(key) for key in keys])
