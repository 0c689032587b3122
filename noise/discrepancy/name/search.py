"""Forward selection of the effects in which a recording differs from its simulation.

A hypothesis is a set of effects whose parameters differ between the two. It is fitted on each of two folds of the
recorded visits and scored on the other. The exponential of a gain on visits that nothing was fitted to is an e-value
(Wasserman et al. 2020, universal inference), so that a gain beyond log(number of candidates / level) is not chance.

The simulation shares every parameter that does not differ. What the law of the simulation lacks, and both files have
alike, gains on simulated readings too: such an effect joins the law of the simulation, and only what differs from its
value there is a difference.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import reduce

import numpy as np

from acquisition.arrays import Floats
from noise.discrepancy.baseline.forest import MAX_PINGS
from noise.discrepancy.name.candidates import (
    Starts,
    as_in,
    candidate_names,
    explains_nothing,
    gains_of,
    keys_of,
    leading,
    log_prior,
    starts_of_each,
    with_sampled_bounds,
)
from noise.discrepancy.name.common import acts_on_target, scatters_alike, with_nuisances
from noise.discrepancy.name.exchange import exchanged, in_both, sufficient
from noise.discrepancy.name.first import with_register, with_threshold
from noise.discrepancy.name.folds import Folds, with_simulated_offset
from noise.discrepancy.name.hypothesis import Hypothesis, first_kinds, may_lead, standard_error
from noise.discrepancy.thresholds import FALSE_ALARM, FIRST_GAIN, LEFT_LEVEL, MAX_CAUSES, MIN_SHARE
from noise.fitting.batch import Batch
from noise.fitting.fit import Fit, Scales, highest, maximise
from noise.fitting.likelihood import predictive
from noise.fitting.stack import JITTER, LEVEL_SD, NUISANCES, OF_A_KIND, SPREAD, Key, Stack
from noise.fitting.starts import nuisance_starts

# sizes that trade accuracy for time; none of them decides about an effect
SCREEN_PINGS, SIMULATED_PINGS = 800, 2000
NARROWED = 0.8  # ratio of scatters below which an effect has explained what stretched them
N_SCREENED = 6  # kinds of candidates that are fitted, and cross-fitted unless they are far behind, in a round
ENOUGH = 1.0  # nats that a local fit must gain for another to follow: an eighth of what an effect must gain
SHORT, LONG = 6, 14  # iterations of a fit that ranks candidates, and of one that goes on to be cross-fitted
ROUNDS = 2 * MAX_CAUSES  # of a search, those that only change what both files have alike included
MISSED = 3.0  # nats by which other nuisance parameters must predict better for a round to be repeated with them


@dataclass(eq=False)
class Search:
    """Search for the effects in which a recording differs.

    Attributes:
        common: law of the simulation with what both files have alike.
        folds: recorded visits.
        simulated: simulated readings; None where the law of the simulation is known exactly.
        rng: generator of the starting points.
        without: effects that are known not to differ.
        tell: called with a message and the share done.
        is_left: whether the recording differs from a hypothesis, by the tests at a level; if not, none joins.
        shared: effects that joined the common law.
        tried: cross-fitted hypotheses of each round, by the effects that were given and the effect that was added.
        base: the law of the simulation and the hypothesis that each round began with, by its effects.
    """

    common: Stack
    folds: Folds
    simulated: Batch | None
    rng: np.random.Generator
    without: tuple[str, ...] = ()
    tell: Callable[[str, float], None] = lambda message, share: None
    is_left: Callable[[Hypothesis, float], bool] = lambda found, level: True
    shared: list[str] = field(default_factory=list)
    tried: dict[tuple[str, ...], dict[str, Hypothesis]] = field(default_factory=dict)
    base: dict[tuple[str, ...], tuple[Stack, Hypothesis]] = field(default_factory=dict)
    _scales: dict[int, Scales] = field(default_factory=dict)
    _null: tuple[Stack, Hypothesis] | None = None
    _without: dict[tuple[Hypothesis, str], Hypothesis] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Thin the readings by visit, and restrict periods to those that the sampling resolves."""
        self.common = self._familiar(with_sampled_bounds(self.common, self.folds.both))
        self.joined = self.folds.both.thin(MAX_PINGS)
        if self.simulated is not None:
            self.joined = with_simulated_offset(self.joined, self.common, self.simulated)
            self.simulated = self.simulated.thin(SIMULATED_PINGS)
        self.parts = self.folds.divided(self.joined)
        self.screen = self.parts[0].thin(SCREEN_PINGS)
        self.names = candidate_names(self.common, self.folds.both, self.without)
        self.pings = np.concatenate([part.unit_sums(np.ones(len(part))) for part in self.parts])

    def _familiar(self, common: Stack) -> Stack:
        """Return the law of the simulation with its nuisance parameters as the expectation for the recording."""
        return replace(common, familiar={key: common.get(key) for key in OF_A_KIND if self.simulated is not None})

    @property
    def nuisances(self) -> tuple[Key, ...]:
        """Nuisance parameters that are free on each fold.

        Visits of one kind of survey scatter alike in level: where there are simulated readings, these tell how much,
        and a fit to few visits that all are heard or missed would tell anything.
        """
        return tuple(key for key in NUISANCES if self.simulated is None or key != LEVEL_SD)

    @property
    def least_gain(self) -> float:
        """Gain on unseen visits, nats, that no candidate reaches by chance but with probability `FALSE_ALARM`."""
        return float(np.log(len(self.names) / FALSE_ALARM))

    def worthwhile(self, current: Hypothesis) -> float:
        """Return the gain, nats, that one more effect needs.

        A search begins where a test has found a difference. The first effect need not prove it again for each
        candidate, nor that it repeats itself, only that it describes it.
        """
        return self.needed(current, self.null()) if current.effects else FIRST_GAIN

    def needed(self, current: Hypothesis, nothing: Hypothesis) -> float:
        """Return the gain, nats, of one more effect that is beyond chance, and no trifle beside what is explained."""
        return max(self.least_gain, MIN_SHARE * (current.value - nothing.value))

    def run(self) -> tuple[Hypothesis, Hypothesis]:
        """Return the hypothesis without differences and the selected one."""
        current = with_threshold(self, with_register(self, self.renewed(self.null())))
        for _ in range(ROUNDS):
            if len(current.effects) >= MAX_CAUSES or (current.effects and not self.is_left(current, LEFT_LEVEL)):
                break
            self.tell(f"searching, {len(current.effects)} found", 0.2 + 0.1 * len(current.effects))
            found = self.round(current)
            if found is None:
                break
            joined = found.effects == current.effects  # an effect joined the common law
            current = found if joined else self.renewed(self.accepted(sufficient(self, found, current), current))
        return self.null(), self.with_scatter(current)

    def accepted(self, found: Hypothesis, before: Hypothesis) -> Hypothesis:
        """Return a hypothesis with what its last effect makes needless left out: others, or that effect itself.

        An effect that only led to other nuisance parameters is left out, and what was found without these parameters
        too, where no effect at all is better with them.
        """
        without = self.left_out(found, found.effects[-1])
        if without.value <= before.value + MISSED:
            return self.pruned(exchanged(self, found))
        null = reduce(self.left_out, without.effects, without)
        return null if null.value > self.null().value + MISSED else without

    def renewed(self, found: Hypothesis) -> Hypothesis:
        """Return a hypothesis with both files at the likeliest nuisance parameters that are known."""
        if not found.effects:
            self._null = self.common, found
        if self.simulated is None:
            return found
        law = with_nuisances(self.common, self.keys(found.effects), found.stacks, self.parts, self.simulated)
        if law is self.common:
            return found
        self.common = self._familiar(law)
        return self.rebased(found)

    def null(self) -> Hypothesis:
        """Return the hypothesis that only nuisances differ; it is fitted once for each common law."""
        if self._null is None or self._null[0] is not self.common:
            starts = [nuisance_starts(self.common, part) for part in self.parts]
            if self._null is not None:  # from their values under the common law before
                known = [[stack.get(key) for key in self.nuisances] for stack in self._null[1].stacks]
                starts = [[self.common.put(self.nuisances, values) for values in known]] * len(self.parts)
            self._null = self.common, self.best(starts, self.nuisances)
        return self._null[1]

    def scored(self, effects: Sequence[str], stacks: Sequence[Stack]) -> Hypothesis:
        """Return a fitted hypothesis with its log-likelihood on the other folds.

        With one part, estimates are scored on their own readings, and half the logarithm of the number of visits is
        subtracted for each (Schwarz 1978, BIC).
        """
        nats = np.concatenate(list(map(Batch.unit_sums, self.parts, self.predictions(effects, stacks))))
        prior = float(np.mean([log_prior(stack, self.common, effects, self.joined) for stack in stacks]))
        if len(self.parts) == 1:
            prior -= 0.5 * len(self.keys(effects)) * np.log(len(nats))
        return Hypothesis(tuple(effects), tuple(stacks), nats, prior)

    def predictions(self, effects: Sequence[str], stacks: Sequence[Stack]) -> list[Floats]:
        """Return the log probability of each reading of each part by the law fitted to the other, nats, (n,) each."""
        keys, pairs = self.keys(effects), zip(reversed(stacks), reversed(self.parts), self.parts, strict=True)
        return [predictive(stack, keys, own, part) for stack, own, part in pairs]

    def crossed(self, start: Stack, current: Hypothesis, effects: Sequence[str], own_scatter: bool) -> Hypothesis:
        """Return a hypothesis fitted on both folds.

        Args:
            start: values of the effects to start from.
            current: hypothesis that it is compared with; its nuisances are the start on each fold.
            effects: effects that differ.
            own_scatter: whether the nuisances start from those of `start` instead.
        """
        keys = self.keys(effects)
        free = (*keys, *self.nuisances) if own_scatter else (*keys, *SPREAD)
        stacks: list[Stack] = []
        for near, part in zip(current.stacks, self.parts, strict=True):
            begin = start if own_scatter else near.put(keys, [start.get(key) for key in keys])
            start = self.fitted(begin, free, part, 40).stack
            stacks.append(start)
        return self.scored(effects, stacks)

    def polished(self, found: Hypothesis) -> Hypothesis:
        """Return a hypothesis with all nuisances fitted anew, so that the next effect gains nothing from them."""
        pairs = zip(found.stacks, self.parts, strict=True)
        starts = [[*found.stacks, *self.shared_first(stack, found.effects, part)] for stack, part in pairs]
        return self.best(starts, (*self.keys(found.effects), *self.nuisances), found.effects)

    def shared_first(self, stack: Stack, effects: Sequence[str], batch: Batch) -> list[Stack]:
        """Return effects fitted with the nuisances of the simulation, which a recording shares by default.

        In a fit of all at once an effect may come to stand for the scatter of most readings, or seem to gain little
        beside nuisances that stand for it. Empty where no simulated readings tell them, or the stack's are like theirs.
        """
        if self.simulated is None or stack.log_nuisance_prior() > -MISSED:
            return []
        begin = stack.at({key: value for key, value in self.common.familiar.items() if key in self.nuisances})
        return [self.fitted(begin, self.keys(effects), batch, LONG).stack]

    def fitted(self, start: Stack, free: Sequence[Key], batch: Batch, iterations: int) -> Fit:
        """Return the local maximum from a start; the scales of nuisances are measured once for each batch."""
        return maximise(start, free, batch, iterations, ENOUGH, self._scales.setdefault(id(batch), {}))

    def with_scatter(self, current: Hypothesis) -> Hypothesis:
        """Return the hypothesis with the scatter of single pings as a difference too, where that gains beyond chance.

        Every fit frees the scatter, so that outliers do not pass for other effects; here it is held at the value of the
        simulation instead. What a fit gets wrong of an effect on the target's echo scatters too, so that beside such
        effects the scatter must gain more than they do: then it is what differs, and they describe its tails.
        """
        if JITTER in self.without or scatters_alike(current.stacks, self.common, self.parts):
            return current
        also = replace(current, effects=(*current.effects, JITTER))
        gain = also.nats - self.left_out(also, JITTER).nats
        moving = [name for name in current.effects if acts_on_target(name, current.stacks, self.common, self.parts)]
        effects = float((current.nats - reduce(self.left_out, moving, current).nats).sum())
        needed = max(self.least_gain, 2.0 * standard_error(gain, self.pings), effects)
        return self.pruned(also) if gain.sum() > needed else current

    def held_scatter(self, found: Hypothesis) -> Hypothesis:
        """Return a hypothesis fitted with the scatter of single pings at its value in the simulation."""
        held = [key for key in SPREAD if key[0] == JITTER]
        free = (*self.keys(found.effects), *(key for key in self.nuisances if key not in held))
        values = [self.common.get(key) for key in held]
        pairs = zip(found.stacks, self.parts, strict=True)
        starts = [[near] if found.effects else [near, *nuisance_starts(self.common, p)] for near, p in pairs]
        return self.best([[start.put(held, values) for start in each] for each in starts], free, found.effects)

    def best(self, starts: Sequence[Sequence[Stack]], free: Sequence[Key], effects: Sequence[str] = ()) -> Hypothesis:
        """Return the likeliest hypothesis of some effects: the best fit to each part, or those from the same start."""
        pairs = zip(starts, self.parts, strict=True)
        fits = [[self.fitted(start, free, part, 40) for start in each] for each, part in pairs]
        alike = [[each.stack for each in row] for row in zip(*fits, strict=False)]  # a part may have more starts
        every = [self.scored(effects, stacks) for stacks in ([highest(each).stack for each in fits], *alike)]
        return max(every, key=lambda each: each.value)

    def nothing(self, found: Hypothesis) -> Hypothesis:
        """Return the hypothesis that nothing differs of what a hypothesis says may differ."""
        if JITTER not in found.effects:
            return self.null()
        return self.left_out(found, JITTER) if len(found.effects) == 1 else self.held_scatter(self.null())

    def keys(self, effects: Sequence[str]) -> tuple[Key, ...]:
        """Return the parameters of effects that the recording can identify."""
        every = (key for name in effects for key in keys_of(self.common, name, self.folds.both))
        return tuple(key for key in every if key not in SPREAD)  # the scatter is free in every fit

    def differing(self, effects: Sequence[str]) -> tuple[Key, ...]:
        """Return the parameters of effects, and those of the scatter where it is one of them."""
        return (*self.keys(effects), *(SPREAD if JITTER in effects else ()))

    def round(self, current: Hypothesis) -> Hypothesis | None:
        """Return the hypothesis with the effect that gains most; None when no gain is beyond chance.

        Effects that explain nothing, however much they gain, do not keep others from being tried.
        """
        tried: dict[str, Hypothesis] = {}
        names = [name for name in self.names if name not in current.effects]
        points = starts_of_each(names, current.stacks[0], self.common, self.screen, self.parts[0], self.rng)
        fits, winner = dict[str, Fit](), None
        while winner is None:
            left = {name: each for name, each in points.items() if name not in tried}
            more = {name: self.met(fit, current, name) for name, fit in self.screened(current, left, fits).items()}
            tried |= more
            winner = self.winner(current, tried)
            if all(self.explains(each, name) for name, each in more.items()):
                break
        self.tried[current.effects], self.base[current.effects] = tried, (self.common, current)
        common = None if winner is None else in_both(self, tried, winner)
        if winner is None or common is None:
            return tried.get(winner or "")
        self.common, self.shared = self._familiar(common), [*self.shared, winner]
        return self.rebased(current)

    def explains(self, found: Hypothesis, name: str) -> bool:
        """Return whether an effect of a hypothesis explains readings, by `explains_nothing`."""
        return not any(explains_nothing(stack, self.common, name, self.folds.both) for stack in found.stacks)

    def screened(self, current: Hypothesis, points: Mapping[str, Starts], fits: dict[str, Fit]) -> dict[str, Fit]:
        """Return the most promising candidates, fitted to the screen, best first; `fits` holds known and new fits."""
        stack = current.stacks[0]
        here = self.fitted(stack, (*self.keys(current.effects), *SPREAD), self.screen, 15).nats
        value, share = {}, len(self.screen) / self.pings.sum()
        for name in first_kinds(gains_of(points, stack, self.screen), N_SCREENED):
            if name not in fits:
                fits[name] = highest(self._refined(start, current, name, SHORT) for start in points[name][1])
            # a gain within the screen that is too small even for all visits cannot be one on unseen visits
            if (fits[name].nats - here) / share > self.worthwhile(current):
                value[name] = fits[name].nats + fits[name].stack.log_size_prior(self.common, [name])
        near = leading(sorted(value, key=value.__getitem__, reverse=True), fits, self.screen, self.least_gain)
        return {name: self._refined(fits[name].stack, current, name, LONG) for name in near}

    def _refined(self, start: Stack, current: Hypothesis, name: str, iterations: int) -> Fit:
        """Return one more effect fitted to the screen together with those before it."""
        return self.fitted(start, (*self.keys([*current.effects, name]), *SPREAD), self.screen, iterations)

    def met(self, fit: Fit, current: Hypothesis, name: str) -> Hypothesis:
        """Return one more effect, cross-fitted from the present scatter, a narrower one, or that of the simulation.

        Where the law of the simulation has changed, it is fitted from what it was before too.
        """
        effects = (*current.effects, name)
        narrow = any(fit.stack.get(key) < NARROWED * current.stacks[0].get(key) for key in (SPREAD[0], SPREAD[2]))
        found = [self.crossed(fit.stack, current, effects, narrow)]
        for other in self.shared_first(fit.stack, effects, self.screen):
            found.append(self.crossed(other, current, effects, own_scatter=True))
        before = self.tried.get(current.effects, {}).get(name)
        if before is not None:
            found.append(self.refitted(self.on_present_law(before), effects))
        return max(found, key=lambda each: each.value)

    def refitted(self, starts: Sequence[Stack], effects: Sequence[str]) -> Hypothesis:
        """Return the hypothesis of some effects with all nuisances free, fitted to each part from a start."""
        free, pairs = (*self.keys(effects), *self.nuisances), zip(starts, self.parts, strict=True)
        return self.scored(effects, [self.fitted(start, free, part, 40).stack for start, part in pairs])

    def on_present_law(self, found: Hypothesis) -> list[Stack]:
        """Return the present law of the simulation at the free parameters of each fit of a hypothesis."""
        free = (*self.keys(found.effects), *self.nuisances)
        return [self.common.put(free, [stack.get(key) for key in free]) for stack in found.stacks]

    def winner(self, current: Hypothesis, tried: dict[str, Hypothesis]) -> str | None:
        """Return the effect of greatest gain beyond chance.

        Those that may lead are compared with the nuisance parameters that suit each, not those of none, and must gain
        with these too.
        """
        needed = current.value + self.worthwhile(current)
        good = {name: fit for name, fit in tried.items() if fit.value > needed and self.explains(fit, name)}
        best = max(good.values(), key=lambda each: each.value, default=current)
        rivals = {name: self.polished(fit) for name, fit in good.items() if self.may_lead(fit, best)}
        tried |= rivals
        inside = (name for name, fit in rivals.items() if fit.value > needed and self.explains(fit, name))
        return max(inside, key=lambda name: rivals[name].value, default=None)

    def may_lead(self, found: Hypothesis, best: Hypothesis) -> bool:
        """Return whether a hypothesis may be better than the best on other visits."""
        return may_lead(best.value - found.value, best.nats - found.nats, self.least_gain)

    def rebased(self, current: Hypothesis) -> Hypothesis:
        """Return a hypothesis fitted anew on a changed common law, from its own nuisances and from those of none."""
        none, keys = self.null(), self.keys(current.effects)
        if not current.effects:
            return none
        free = (*keys, *self.nuisances)
        own = self.on_present_law(current)
        effects = [[stack.get(key) for key in keys] for stack in current.stacks]
        starts = [[law.put(keys, each), *own] for law, each in zip(none.stacks, effects, strict=True)]
        return self.best(starts, free, current.effects)

    def pruned(self, current: Hypothesis) -> Hypothesis:
        """Return the hypothesis without the effects that a later one made needless, or a trifle beside it."""
        for name in current.effects[:-1]:
            without = self.left_out(current, name)
            if current.value - without.value < self.needed(without, self.nothing(current)):
                current = without
        return current

    def left_out(self, current: Hypothesis, name: str) -> Hypothesis:
        """Return a hypothesis fitted anew without one of its effects; the last answers are known."""
        if (current, name) not in self._without:
            self._without[current, name] = self._fitted_without(current, name)
        return self._without[current, name]

    def _fitted_without(self, current: Hypothesis, name: str) -> Hypothesis:
        others = tuple(each for each in current.effects if each != name)
        if name == JITTER:
            return self.held_scatter(replace(current, effects=others) if others else self.null())
        found = self.refitted([as_in(stack, self.common, name) for stack in current.stacks], others)
        return found if others else max(self.null(), found, key=lambda each: each.value)
