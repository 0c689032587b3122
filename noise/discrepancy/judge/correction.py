"""The corrected model: the causes, with what they leave as an empirical term, or a forest of the recording.

What no cause explains joins the corrected model as an empirical term, where that predicts better; where the recording's
own readings under similar conditions predict better than any law, they are the corrected model. A correction is offered
only if its CRPS is less than that of the user's simulation beyond chance, on visits that the model has not seen: those
that nothing was fitted to, and those of each fold by the causes fitted to the other fold, by the empirical term
fitted without their conditions, or by trees that lack them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from acquisition.arrays import Floats
from noise.composed import with_differences
from noise.discrepancy.baseline.emulator import learner_pings
from noise.discrepancy.baseline.forest import AnalogueForest, Grown
from noise.discrepancy.judge.held_out import Simulation, crps_of_each, log_score
from noise.discrepancy.judge.judged import Judged
from noise.discrepancy.name.hypothesis import Hypothesis
from noise.discrepancy.name.search import Search
from noise.fitting.batch import Batch
from noise.fitting.learn_smooth import Learned
from noise.fitting.stack import Stack
from noise.model import SonarModel


@dataclass(frozen=True, eq=False)
class Option:
    """A model that may be offered.

    Attributes:
        model: the model.
        scored: visits that it has not seen, and its CRPS there, m, (n,).
        nats: its log score there, nats, (n,) each; empty where it is no law with causes.
    """

    model: SonarModel
    scored: tuple[tuple[Batch, Floats], ...]
    nats: tuple[Floats, ...] = ()

    @property
    def crps(self) -> float:
        """Mean CRPS, m."""
        return float(np.mean(np.concatenate([crps for _, crps in self.scored])))

    def is_better_than(self, other: Option) -> bool:
        """Return whether the CRPS is less than that of another model beyond chance, on what nothing was fitted to."""
        return Simulation(other.model).is_beaten(self.scored[0])


@dataclass(frozen=True, eq=False)
class Options:
    """Models that may be offered.

    Attributes:
        with_causes: the law with the believed causes alone; None where none is believed.
        with_term: the same with an empirical term; None where there is none.
        on_simulation: the causes on what stands for the simulation; None where that is the emulator.
        forest: a forest of the recording.
    """

    with_causes: Option | None
    with_term: Option | None
    on_simulation: Option | None
    forest: Option

    @property
    def causes_only(self) -> SonarModel | None:
        """The model with the believed causes alone; None where none is believed."""
        return None if self.with_causes is None else self.with_causes.model

    @classmethod
    def of(cls, judged: Judged, search: Search, forest: Grown, before: Simulation, step_m: float) -> Options:
        """Return the options of a judged hypothesis.

        Args:
            judged: the hypothesis.
            search: readings and candidates.
            forest: of the recording.
            before: the user's simulation.
            step_m: step of the recording's register.
        """
        unseen, with_causes, with_term, on_simulation = search.folds.unseen, None, None, None
        if judged.believed:
            folds = _by_fold(search, judged.found, step_m) if len(search.parts) > 1 else ()
            with_causes = _scored(offered(judged.final.single.stack, step_m), unseen, folds)
            on_simulation = _on_simulation(judged, search, before.model, step_m)
        learned = judged.learned
        if learned is not None and learned.left_out is not None:
            parts = _by_part(search, learned, step_m) if len(search.parts) > 1 else ()
            with_term = _scored(offered(learned.stack, step_m), unseen, parts)
        own = Option(forest.model, ((unseen, crps_of_each(forest.model, unseen)), (forest.batch, forest.crps)))
        return cls(with_causes, with_term, on_simulation, own)

    def corrected(self, before: Simulation) -> SonarModel | None:
        """Return the corrected model; None where none gains on the simulation.

        Laws with causes hold under other conditions too, and a forest of readings under their own alone.
        """
        laws = [each for each in (self.with_causes, self.on_simulation, self.with_term) if each is not None]
        best = min(laws, key=lambda option: option.crps, default=self.forest)
        if best is not self.forest and self.forest.is_better_than(best):
            best = self.forest
        return next((each.model for each in (best, self.forest) if before.is_beaten(*each.scored)), None)


def offered(stack: Stack, step_m: float) -> SonarModel:
    """Return the model of single pings of a stack, on a register of at least a step."""
    return replace(stack, resolution=max(stack.resolution, step_m)).single_ping_model


def _scored(model: SonarModel, unseen: Batch, crossed: tuple[tuple[Batch, SonarModel], ...]) -> Option:
    pairs = ((unseen, model), *crossed)
    scored = tuple((batch, crps_of_each(each, batch)) for batch, each in pairs)
    return Option(model, scored, tuple(log_score(each, batch) for batch, each in pairs))


def _by_fold(search: Search, found: Hypothesis, step_m: float) -> tuple[tuple[Batch, SonarModel], ...]:
    """Return the readings of each fold, and the causes fitted to the other."""
    parts = search.folds.divided(learner_pings(search.joined))
    return tuple((part, offered(stack, step_m)) for part, stack in zip(parts, reversed(found.stacks), strict=True))


def _on_simulation(judged: Judged, search: Search, model: SonarModel, step_m: float) -> Option | None:
    """Return the causes acting on what stands for the simulation; None where that is the law they were found beside.

    What that law gets wrong of the simulation does not enter such a model.
    """
    if not isinstance(model, AnalogueForest):
        return None
    base = replace(model, resolution=max(model.resolution, step_m))
    stacks = (judged.final.single.stack, *reversed(judged.found.stacks))
    pairs = [
        with_differences(base, search.common.effects, {name: stack.effects[name] for name in judged.believed})
        for stack in stacks
    ]
    if any(left_out for _, left_out in pairs):
        return None
    whole, *folds = (composed for composed, _ in pairs)
    parts = search.folds.divided(learner_pings(search.joined)) if len(search.parts) > 1 else ()
    return _scored(whole, search.folds.unseen, tuple(zip(parts, folds, strict=False)))


def _by_part(search: Search, learned: Learned, step_m: float) -> tuple[tuple[Batch, SonarModel], ...]:
    """Return the readings of each part, and the empirical term fitted without them."""
    assert learned.left_out is not None
    few = learner_pings(search.joined)
    part = learned.left_out.of(few)
    terms = enumerate(learned.left_out.terms)
    return tuple((few.select(part == k), offered(learned.stack.with_term(term), step_m)) for k, term in terms)
