"""The corrected model: the causes, with what they leave as an empirical term, or a forest of the recording.

What no cause explains joins the corrected model as an empirical term (see `term`) where that predicts better; where the
recording's own readings under similar conditions predict better than any law, they are the corrected model. A
correction is offered only if its CRPS is less than that of the user's simulation on visits that the model has not seen:
those that nothing was fitted to, and those of each fold by the causes fitted to the other fold, or by trees that lack
them. It must be less beyond chance; but where silence counts, the CRPS varies from visit to visit much more than what
small changes of the range gain. Causes that predict better than the law without them, in the CRPS and in the log score,
an empirical term that predicts better beyond chance than the law without it and than the model that stands for the
simulation, and causes that do on this model, whose own errors cancel, need only do no harm (`improves`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from acquisition.arrays import Floats, Ints
from acquisition.ping import CREDENCE_TOLERANCE
from noise.composed import with_differences
from noise.discrepancy.baseline.forest import AnalogueForest, Grown
from noise.discrepancy.baseline.sources import Baseline
from noise.discrepancy.judge.held_out import (
    Simulation,
    beyond_chance,
    crps_of_each,
    improves,
    log_score,
    part_of_place,
)
from noise.discrepancy.judge.judged import Judged, taken_back
from noise.discrepancy.judge.term import Term, term_of
from noise.discrepancy.moments.sample import Sample
from noise.discrepancy.name.search import Search
from noise.fitting.batch import Batch
from noise.fitting.stack import Stack
from noise.model import SonarModel

Scored = tuple[tuple[Batch, Floats], ...]  # readings, and the CRPS of each, m, (n,)


@dataclass(frozen=True, eq=False)
class Option:
    """A model that may be offered.

    Attributes:
        model: the model.
        score: visits that it has not seen, and its CRPS there for a tolerance or none; see `crps_with_silence`.
        nats: its log score there, nats, (n,) each; empty where it is no law with causes.
    """

    model: SonarModel
    score: Callable[[float | None], Scored]
    nats: tuple[Floats, ...] = ()

    @cached_property
    def scored(self) -> Scored:
        """Visits that it has not seen, and its CRPS there, m, (n,)."""
        return self.score(None)

    @property
    def crps(self) -> float:
        """Mean CRPS, m."""
        return float(np.mean(np.concatenate([crps for _, crps in self.scored])))

    def is_better_than(self, other: Option) -> bool:
        """Return whether the CRPS is less than that of another model beyond chance, on visits that neither has seen."""
        pairs = zip(self.scored, other.scored, strict=False)
        return beyond_chance(np.concatenate([batch.unit_sums(crps - own) for (batch, own), (_, crps) in pairs]))

    def beats(self, model: Callable[[Batch], SonarModel]) -> bool:
        """Return whether the CRPS is less than that of the models of the same visits, beyond chance."""
        batches = [batch for batch, _ in self.scored]
        return self.is_better_than(option_of([model(batch) for batch in batches], batches))


@dataclass(frozen=True, eq=False)
class Options:
    """Models that may be offered.

    Attributes:
        with_causes: the law with the believed causes alone; None where none is believed.
        with_term: the simulation's law with the believed causes and the empirical term; None where that gains nothing
            beyond chance.
        on_simulation: the causes on what stands for the simulation; None where that is the emulator.
        with_both: the same with the empirical term; None where that gains nothing beyond chance.
        forest: a forest of the recording.
        causes_gain: whether the law with causes predicts better than the emulator.
        without: the law with the causes taken back, and all else as the recording has it.
        shared: the law of the simulation with the believed causes.
    """

    with_causes: Option | None
    with_term: Option | None
    on_simulation: Option | None
    with_both: Option | None
    forest: Option
    causes_gain: bool
    without: SonarModel
    shared: SonarModel

    @property
    def is_sure_of_term(self) -> bool:
        """Whether a model with the empirical term is better beyond chance than the same without it."""
        return self.with_term is not None or self.with_both is not None

    @property
    def causes_only(self) -> SonarModel | None:
        """The model with the believed causes alone; None where none is believed."""
        return None if self.with_causes is None else self.with_causes.model

    @classmethod
    def of(
        cls,
        judged: Judged,
        search: Search,
        forest: Grown,
        before: Simulation,
        base: Baseline,
        step_m: float,
        term: Term | None,
    ) -> Options:
        """Return the options of a judged hypothesis.

        Args:
            judged: the hypothesis.
            search: readings and candidates.
            forest: of the recording.
            before: the user's simulation.
            base: the simulation as a law. What is to hold in other places is scored without simulated readings of a
                visit's own place.
            step_m: step of the recording's register.
            term: empirical term; None where there is none.
        """
        parts, with_causes, gain = _parts(search), None, False
        stacks = _stacks(judged)
        places = [part_of_place(base.law, part, base.readings) for part in parts]
        shared = [shared_law(search, each, judged.believed) for each in stacks]
        taken = taken_back(stacks[0], search, judged.believed)
        law, without, whole = (offered(each, step_m) for each in (stacks[0], taken, shared[0]))
        if judged.believed:
            with_causes = replace(_law_option(elsewhere(stacks, places, step_m), parts), model=law)
            gain = gains(with_causes, _law_option(elsewhere([base.law] * len(stacks), places, 0.0), parts))
        on_simulation, with_both = _on_simulation(judged, search, before, step_m, term, parts)
        with_term = _with_term(term, elsewhere(shared, places, step_m), parts, whole)
        grown = _crossed(forest, search, parts)
        return cls(with_causes, with_term, on_simulation, with_both, grown, gain, without, whole)

    def corrected(self, before: Simulation) -> SonarModel | None:
        """Return the corrected model; None where none gains on the simulation.

        Laws hold under other conditions too, and what rests on a forest of readings under their own alone. What is less
        general is preferred only where it is better beyond chance.
        """
        laws = _best(self.with_causes, self.with_term)
        forests = _best(self.on_simulation, self.with_both, self.forest)
        preferred = [*forests, *laws] if laws and forests[0].is_better_than(laws[0]) else [*laws, *forests]
        offered = next((each for each in preferred if before.is_beaten(*each.scored)), None)
        if offered is None:
            sure = [each for each in preferred if self._is_sure(each, before)]
            offered = next((each for each in sure if _improves_on(before, each)), None)
        return None if offered is None else offered.model

    def _is_sure(self, option: Option, before: Simulation) -> bool:
        """Return whether an option is certain for another reason than its CRPS beside that of the simulation."""
        if option is self.with_causes:
            return self.causes_gain
        return option is not self.forest and option.beats(before.elsewhere)


def _best(*options: Option | None) -> list[Option]:
    """Return the options that there are, that of the least CRPS first."""
    return sorted((each for each in options if each is not None), key=lambda option: option.crps)


def _improves_on(before: Simulation, option: Option) -> bool:
    gain, near = before.gain(*option.scored), before.near.gain(*option.score(CREDENCE_TOLERANCE))
    return improves(gain, near, before.error(*option.scored))


def gains(law: Option, emulator: Option) -> bool:
    """Return whether a law with causes predicts visits that it has not seen better than the emulator.

    It does in the mean CRPS and in the log score. That the gain is no chance, the probability of the causes says: with
    few visits a second test of the same readings would reject what is certain.
    """
    nats = sum(float((own - other).sum()) for own, other in zip(law.nats, emulator.nats, strict=True))
    return law.crps < emulator.crps and nats > 0.0


def _law_option(models: Sequence[SonarModel], parts: Sequence[Batch]) -> Option:
    """Return the option of a law for each part, with its log scores there."""
    nats = tuple(log_score(model, part) for model, part in zip(models, parts, strict=False))
    return replace(option_of(models, parts), nats=nats)


def elsewhere(stacks: Sequence[Stack], places: Sequence[Ints], step_m: float) -> list[SonarModel]:
    """Return the model of each part as it is without simulated readings of the places of its visits.

    Args:
        stacks: law of each part.
        places: see `part_of_place`, of each part, (n,).
        step_m: least step of the register, m.
    """
    return [offered(law.by_part(place), step_m) for law, place in zip(stacks, places, strict=False)]


def offered(stack: Stack, step_m: float) -> SonarModel:
    """Return the model of single pings of a stack, on a register of at least a step."""
    return replace(stack, resolution=max(stack.resolution, step_m)).single_ping_model


def _parts(search: Search) -> tuple[Batch, ...]:
    """Return the visits that nothing was fitted to, and those of each fold, where there are two."""
    return (search.folds.unseen, *search.parts) if len(search.parts) > 1 else (search.folds.unseen,)


def option_of(models: Sequence[SonarModel], parts: Sequence[Batch]) -> Option:
    """Return an option: the model, and its scores on each part by the model that was not fitted to it."""
    pairs = list(zip(models, parts, strict=False))
    return Option(models[0], lambda tolerance: tuple((batch, crps_of_each(m, batch, tolerance)) for m, batch in pairs))


def _crossed(found: Grown, search: Search, parts: tuple[Batch, ...]) -> Option:
    """Return an option whose scores on the folds are those by trees that lack each visit."""
    whole = option_of([found.model], parts)
    if len(parts) == 1:
        pieces = [np.ones(len(found.batch), dtype=bool)]
    else:
        first = search.folds.in_first(found.batch)
        pieces = [first, ~first]
    batches = [found.batch.select(rows) for rows in pieces]

    def score(tolerance: float | None) -> Scored:
        crps = found.crps if tolerance is None else found.crps_within(tolerance)
        own = [crps[rows] for rows in pieces]
        return (*whole.score(tolerance), *zip(batches, own, strict=True))

    return Option(found.model, score)


def _stacks(judged: Judged) -> tuple[Stack, ...]:
    """Return the law with the believed causes fitted to both folds, and to the fold that each part is not in."""
    return (judged.final.single.stack, *judged.found.stacks[::-1])


def shared_law(search: Search, law: Stack, effects: Sequence[str]) -> Stack:
    """Return the law of the simulation with the causes of a law of the recording: nuisances are no differences."""
    keys = search.differing(effects)
    return search.common.put(keys, [law.get(key) for key in keys])


def empirical_term(judged: Judged, search: Search, readings: Batch | None, rng: np.random.Generator) -> Term | None:
    """Return what the believed causes leave, without a name.

    Args:
        judged: the causes.
        search: the recording's readings; of visits that no estimate may use, none is.
        readings: of the simulation; None where its law is known exactly.
        rng: divides clusters into folds, and grows trees.
    """
    law = shared_law(search, judged.final.stack, judged.believed)
    return term_of(law, search.common, Sample.comparable(search.folds.both, readings), rng)


def _with_term(
    term: Term | None, models: Sequence[SonarModel], parts: Sequence[Batch], whole: SonarModel
) -> Option | None:
    """Return the option of a model with the empirical term; None where that is not better beyond chance.

    Args:
        term: the term; None where there is none.
        models: models that predict the parts.
        parts: visits.
        whole: the model for all conditions.
    """
    if term is None:
        return None
    fitted = [term.cross_fitted(model, part) for model, part in zip(models, parts, strict=False)]
    found = replace(option_of(fitted, parts), model=term.on(whole))
    return found if found.is_better_than(option_of(models, parts)) else None


def _on_simulation(
    judged: Judged, search: Search, before: Simulation, step_m: float, term: Term | None, parts: Sequence[Batch]
) -> tuple[Option | None, Option | None]:
    """Return the causes on what stands for the simulation, and the same with the term; None where it is the emulator.

    What the emulator gets wrong of the simulation does not enter such a model. It is to predict other places than those
    of the simulation, so it predicts the recording without what it knows of its places.
    """
    if not isinstance(before.model, AnalogueForest):
        return None, None
    coarse = replace(before.model, resolution=max(before.model.resolution, step_m))
    whole, other = (_with_causes(judged, search, each) for each in (coarse, before.elsewhere(search.folds.both)))
    if not whole:
        return None, None
    causes = replace(option_of(other, parts), model=whole[0]) if judged.believed else None
    return causes, _with_term(term, other, parts, whole[0])


def _with_causes(judged: Judged, search: Search, base: SonarModel) -> list[SonarModel]:
    """Return a model with the believed causes of each law, if there are any; none where one cannot act on it."""
    if not judged.believed:
        return [base] * len(_stacks(judged))
    effects = [{name: stack.effects[name] for name in judged.believed} for stack in _stacks(judged)]
    pairs = [with_differences(base, search.common.effects, each) for each in effects]
    return [] if any(left_out for _, left_out in pairs) else [composed for composed, _ in pairs]
