"""Judgement of a selected hypothesis: which of its effects are believed, and what they leave."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import reduce

import numpy as np

from noise.discrepancy.evidence import Evidence
from noise.discrepancy.judge.accepted import Comparing, Comparison
from noise.discrepancy.judge.decision import decision_model
from noise.discrepancy.judge.shares import Rest, Shares, shares
from noise.discrepancy.locate.location import locate
from noise.discrepancy.locate.orthogonal import Tested
from noise.discrepancy.locate.stability import Stability
from noise.discrepancy.name.alternatives import Place, place_of
from noise.discrepancy.name.estimates import Final, conclude, intervals, statement
from noise.discrepancy.name.hypothesis import Hypothesis
from noise.discrepancy.name.search import Search
from noise.discrepancy.result import Alternative, Cause, Interval, PValue, Unexplained
from noise.discrepancy.thresholds import BELIEVED, FALSE_ALARM, MAX_CAUSES, MIN_SHARE
from noise.fitting.stack import Key, Stack

Steady = Callable[[Comparison, str], Stability]


@dataclass(frozen=True, eq=False)
class Judged:
    """Causes with their probabilities, and the law with those that are believed.

    Attributes:
        causes: selected effects, the believed ones and the greatest shares first.
        believed: ids of those that are believed.
        found: the hypothesis with the believed causes, fitted to each fold.
        final: the same, fitted to both folds.
        places: selected effects and their alternatives.
        evidence: by selected effect.
        together: share of the believed causes.
        share_of_rest: share that they leave.
        after: test of the law with the believed causes.
    """

    causes: tuple[Cause, ...]
    believed: tuple[str, ...]
    found: Hypothesis
    final: Final
    places: tuple[Place, ...]
    evidence: Mapping[str, Evidence]
    together: float
    share_of_rest: Interval
    after: Tested

    @property
    def rest(self) -> Unexplained:
        """What the believed causes leave."""
        where = locate(self.after) if self.after.is_below(FALSE_ALARM) else ()
        return Unexplained(self.share_of_rest, self.after.p_value, where)

    def apart(self, search: Search) -> tuple[list[Stack], Stack]:
        """Return the law with each believed cause alone, that of the greatest share first, and with none."""
        names = [cause.effect for cause in self.causes if cause.effect in self.believed]
        others = [[other for other in names if other != name] for name in names]
        *alone, none = (taken_back(self.final.stack, search, each) for each in (*others, names))
        return alone, none


def taken_back(law: Stack, search: Search, effects: Sequence[str]) -> Stack:
    """Return a law of the recording with some effects as the simulation has them."""
    keys = search.differing(effects)
    return law.put(keys, [search.common.get(key) for key in keys])


@dataclass(eq=False)
class Judgement:
    """What is known of one hypothesis.

    Attributes:
        comparing: compares hypotheses with the recording.
        found: the hypothesis.
        known: judgements of hypotheses that were made before.
        final: its effects fitted to both folds.
        after: test of that law.
        compared: what was tested.
    """

    comparing: Comparing
    found: Hypothesis
    known: dict[Hypothesis, Judgement] = field(default_factory=dict)
    final: Final = field(init=False)
    after: Tested = field(init=False)
    compared: Comparison = field(init=False)

    def __post_init__(self) -> None:
        """Fit and test."""
        self.known[self.found] = self
        self.final = conclude(self.search, self.found)
        self.after, self.compared = self.comparing.least_rejected(self.found.effects, self.final.stack)
        law, other = self.final.stack, self.compared.recorded
        moved = {key: other.get(key) for key in self.search.keys(self.found.effects) if other.get(key) != law.get(key)}
        self.final = self.final.at(moved) if moved else self.final

    @property
    def search(self) -> Search:
        """Readings and candidates."""
        return self.comparing.search

    def of(self, found: Hypothesis) -> Judgement:
        """Return the judgement of another hypothesis."""
        return self.known.get(found) or replace(self, found=found)

    def with_effects(self, effects: Sequence[str]) -> Judgement:
        """Return the judgement of the hypothesis with some of its effects."""
        return self.of(
            reduce(self.search.left_out, (each for each in self.found.effects if each not in effects), self.found)
        )

    def settled(self) -> tuple[Judgement, tuple[Place, ...]]:
        """Return the judgement of a hypothesis of which each effect is the most probable in its place, with the places.

        Effects are selected one after another; what was best alone need not be beside those that followed.
        """
        selected, places, been = self, self.places(), {frozenset(self.found.effects)}
        for _ in range(MAX_CAUSES):  # a bound of the time
            leaders = (place.fits[place.leader] for place in places if place.leader != place.effect)
            other = next((each for each in leaders if frozenset(each.effects) not in been), None)
            if other is None:
                break
            been.add(frozenset(other.effects))
            selected = self.of(other)
            places = selected.places()
        return selected, places

    def places(self) -> tuple[Place, ...]:
        """Return the effects and what may stand in their places."""
        return tuple(self.tested(place_of(self.search, self.found, name)) for name in self.found.effects)

    def tested(self, place: Place) -> Place:
        """Return a place without the effects that the test refutes, unless it refutes all that are worth listing.

        Where a law is wrong for both files, an effect may predict better that mends it a little; the test compares the
        files themselves.
        """
        refuted = {name for name in place.listed if self.of(place.fits[name]).after.is_below(FALSE_ALARM)}
        return place.without(refuted) if refuted and refuted < place.listed.keys() else place

    def accepted(self) -> Judgement:
        """Return the judgement without effects but for which the test would find nothing.

        An effect that predicts better under a law which is wrong for both files may stand for what both have alike.
        Then the recording differs from the simulation with the effect, and does not without it.
        """
        if len(self.found.effects) < 2 or not self.after.is_below(FALSE_ALARM):
            return self
        fewer = [self.search.left_out(self.found, name) for name in self.found.effects]
        tests = [self.comparing.least_rejected(each.effects, each.stacks[0])[0] for each in fewer]
        best = max(range(len(fewer)), key=lambda k: tests[k].p_value.value)
        if tests[best].is_below(FALSE_ALARM):
            return self
        return self.of(fewer[best])


def judge(
    rest: Rest,
    none: Hypothesis,
    found: Hypothesis,
    before: PValue,
    comparing: Comparing,
    stability: Steady,
    rng: np.random.Generator,
) -> Judged:
    """Return the causes of a difference with their probabilities.

    Args:
        rest: readings and candidates, and what a forest knows of them.
        none: hypothesis without differences.
        found: the selected hypothesis.
        before: p-value of the test of the simulation's law.
        comparing: compares hypotheses with the recording.
        stability: tests whether an effect of a law has the same size everywhere.
        rng: draws the bootstrap samples of the shares.
    """
    search = rest.search
    selected, places = Judgement(comparing, found).accepted().settled()
    found = selected.found
    divided = shares(rest, none, found, rng)
    steady = {name: stability(selected.compared, name) for name in found.effects}
    evidence = {p.effect: evidence_of(selected, p, divided, before, steady[p.effect]) for p in places}
    certain = {name: decision_model().probability(each) for name, each in evidence.items()}
    believed = kept(certain, divided)
    final = selected.with_effects(believed)
    known = intervals(search, selected.final)
    if final is not selected:
        known |= intervals(search, final.final)
    causes = [_cause(search, place, certain[place.effect], divided, known) for place in places]
    causes.sort(key=lambda cause: (cause.effect not in believed, -cause.share.value))
    together, left = _divided(divided, [name for name in found.effects if name not in believed])
    return Judged(tuple(causes), believed, final.found, final.final, places, evidence, together, left, final.after)


def kept(certain: Mapping[str, float], divided: Shares) -> tuple[str, ...]:
    """Return the effects that are believed: probable, and not negligible beside the first."""
    first = max(certain, key=lambda name: divided.causes[name].value, default="")
    weighty = (name for name in certain if name == first or divided.causes[name].value >= MIN_SHARE)
    return tuple(name for name in weighty if certain[name] >= BELIEVED)


def _divided(divided: Shares, disbelieved: Sequence[str]) -> tuple[float, Interval]:
    """Return the share of the believed causes and that of the rest, to which disbelieved ones belong."""
    if not disbelieved:
        return divided.together.value, divided.rest
    together = max(0.0, divided.together.value - sum(divided.causes[name].value for name in disbelieved))
    rest, half = 1.0 - together, 0.5 * (divided.together.high - divided.together.low)
    return together, Interval(rest, max(rest - half, 0.0), min(rest + half, 1.0), "1")


def _cause(search: Search, place: Place, certain: float, divided: Shares, known: Mapping[Key, Interval]) -> Cause:
    name, likely = place.effect, place.listed
    own = [(key, value) for key, value in known.items() if key[0] == name]
    alternatives = tuple(Alternative(other, certain * p) for other, p in likely.items() if other != name)
    return Cause(
        name,
        certain * likely[name],
        alternatives,
        divided.causes[name],
        *divided.gains[name],
        {key[1]: value for key, value in own},
        statement(search, name, own),
    )


def evidence_of(selected: Judgement, place: Place, divided: Shares, before: PValue, stable: Stability) -> Evidence:
    """Return what the decision model needs to know of a selected effect."""
    search, found, name = selected.search, selected.found, place.effect
    (gain, error), (lead, lead_error) = divided.gains[name], divided.leads[name]
    return Evidence(
        gain=gain,
        gain_error=error,
        n_pings=sum(len(part) for part in search.parts),
        n_visits=len(found.nats),
        lead_unnamed=lead,
        lead_unnamed_error=lead_error,
        share=divided.causes[name].value,
        rest=divided.rest.value,
        lead=place.lead,
        prior=float(np.mean([stack.log_size_prior(search.common, [name]) for stack in found.stacks])),
        p_before=before.value,
        p_after=selected.after.p_value.value,
        p_stable=stable.p_value.value,
        variation=stable.variation,
        n_effects=len(found.effects),
        catch_all=search.common.known[name].by_ping,
    )
