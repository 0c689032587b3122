"""From a simulation and a recording to a verdict and a corrected model, in one straight line."""

from __future__ import annotations

import os
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
import pandas as pd

from acquisition import Recording, SettingError
from acquisition.limits import OneOf, Seed, check_value, shown
from noise.discrepancy.baseline.emulator import empirical_term
from noise.discrepancy.baseline.sources import Baseline, baseline_of
from noise.discrepancy.evidence import Evidence
from noise.discrepancy.inputs import Progress, Simulator, as_model, as_recording, check_conditions, warnings_of
from noise.discrepancy.judge.decision import decision_model
from noise.discrepancy.judge.held_out import crps, held_out
from noise.discrepancy.judge.shares import Shares, shares
from noise.discrepancy.judge.verdict import differs, kind_of, shows_little
from noise.discrepancy.locate.directed import directed_test
from noise.discrepancy.locate.location import locate
from noise.discrepancy.locate.orthogonal import Tested, orthogonal_test
from noise.discrepancy.locate.power import could_have_seen
from noise.discrepancy.locate.sample import Sample
from noise.discrepancy.name.alternatives import Place, place_of
from noise.discrepancy.name.candidates import log_prior
from noise.discrepancy.name.estimates import Final, conclude, intervals, statement
from noise.discrepancy.name.folds import Folds
from noise.discrepancy.name.search import Hypothesis, Search
from noise.discrepancy.report.next_measurement import next_measurements
from noise.discrepancy.report.words import location as location_in_words
from noise.discrepancy.report.words import summary_of
from noise.discrepancy.result import (
    Alternative,
    BaselineCheck,
    Cause,
    Diagnosis,
    Interval,
    Kind,
    Location,
    PValue,
    Unexplained,
    Verdict,
    Visible,
)
from noise.discrepancy.thresholds import BELIEVED, FALSE_ALARM, LEFT_LEVEL, MIN_SHARE
from noise.effects import CATALOGUE
from noise.fitting.batch import Batch
from noise.fitting.stack import Stack
from noise.fitting.threads import one_thread
from noise.model import SonarModel

NOTHING = Interval(0.0, 0.0, 0.0, "1")


@dataclass(frozen=True, eq=False)
class Data:
    """What a diagnosis works on.

    Attributes:
        baseline: the simulation as a law.
        batch: answered pings of the recording.
        folds: its parts.
        sample: both files side by side.
        seed: from which every generator follows.
        warnings: doubtful properties of the data.
        tell: progress.
    """

    baseline: Baseline
    batch: Batch
    folds: Folds
    sample: Sample
    seed: int
    warnings: tuple[str, ...]
    tell: Progress

    def rng(self, purpose: str) -> np.random.Generator:
        """Return the generator of a purpose; the same seed and purpose give the same numbers."""
        return stream(self.seed, purpose)


def stream(seed: int, purpose: str) -> np.random.Generator:
    """Return a generator that follows from a seed and a purpose."""
    return np.random.default_rng([seed, zlib.crc32(purpose.encode())])


@one_thread()
def diagnose(
    model: SonarModel | Simulator | str | os.PathLike[str],
    recording: Recording | pd.DataFrame | str | os.PathLike[str],
    *,
    simulated: Recording | pd.DataFrame | str | os.PathLike[str] | None = None,
    seed: int = 0,
    progress: Progress | None = None,
    without: Sequence[str] = (),
) -> Diagnosis:
    """Say where a recording differs from a simulation, why, by how much, and correct the simulation.

    Args:
        model: what the simulation uses: a name, the folder of a saved model, a model, or a function
            `simulator(pings, rng) -> readings` (a `Reading`, or ranges in m with 0 for no echo).
        recording: of the real sonar: a `Recording`, a table with its columns, or the path of a CSV file.
        simulated: readings of a simulator, which then stand in the place of `model`.
        seed: of splits, draws and starting points; the same seed gives the same verdict.
        progress: called with a message and the share done.
        without: ids of effects that are known not to differ.

    Raises:
        RecordingError: the recording holds no answered ping.
        SettingError: `without` names an unknown effect, or an input has a wrong type.
    """
    check_value("without", without, tuple[Annotated[str, OneOf(CATALOGUE)], ...])
    check_value("seed", seed, Seed)
    if progress is not None and not callable(progress):
        raise SettingError(f"progress: expected a function (message, share), got {shown(progress)}")
    recorded = as_recording(recording)
    check_conditions(recorded)
    data = _prepared(
        model, recorded, None if simulated is None else as_recording(simulated, "simulation"), seed, progress
    )
    data.tell("comparing", 0.15)
    law = data.baseline.law
    tested = orthogonal_test(law, law, data.sample, data.rng("test"))
    directed = directed_test(law, law, data.sample, data.rng("directed"))
    tested = replace(tested, p_value=either(tested.p_value, directed.p_value))
    where = locate(tested) if tested.p_value.value < FALSE_ALARM else ()
    visible = could_have_seen(law, data.sample, tested, data.rng("power"))
    if differs(tested, where):
        return _different(data, recorded, tested, where, visible, tuple(without))
    return _alike(data, recorded, tested, visible)


def either(first: PValue, second: PValue) -> PValue:
    """Return the p-value of two tests of one hypothesis: twice the smaller (Bonferroni)."""
    n_regressors = first.n_regressors + second.n_regressors
    value = min(1.0, 2.0 * min(first.value, second.value))
    return PValue(value, (min(first.draws, second.draws) + 1) // 2 - 1, n_regressors, first.n_aspects)


def _prepared(
    model: SonarModel | Simulator | str | os.PathLike[str],
    recorded: Recording,
    simulated: Recording | None,
    seed: int,
    progress: Progress | None,
) -> Data:
    tell = progress or (lambda message, share: None)
    tell("describing the simulation", 0.02)
    given = as_model(model)
    baseline = baseline_of(given, recorded, simulated, stream(seed, "baseline"))
    batch = on_register_of(baseline, Batch.of(recorded))
    folds = Folds.of(batch, stream(seed, "folds"))
    warnings = warnings_of(recorded, simulated)
    return Data(baseline, batch, folds, Sample(batch, baseline.readings), seed, warnings, tell)


def on_register_of(baseline: Baseline, batch: Batch) -> Batch:
    """Return the recording on the simulation's register where that has finer steps that divide its own.

    Coarser steps are then a difference that quantisation explains, and not a property of the data.
    """
    fine = baseline.law.resolution if baseline.readings is None else baseline.readings.resolution
    ratio = batch.resolution / fine
    return replace(batch, resolution=fine) if ratio > 1.5 and abs(ratio - round(ratio)) < 1e-6 * ratio else batch


def _alike(data: Data, recorded: Recording, tested: Tested, visible: tuple[Visible, ...]) -> Diagnosis:
    """Return the diagnosis of a recording that does not differ, or shows too little to tell."""
    kind = Kind.TOO_LITTLE_DATA if shows_little(visible) else Kind.NONE
    rest = Unexplained(NOTHING, tested.p_value)
    return _diagnosis(data, recorded, tested, (), visible, kind, (), rest, None, None, ())


def _different(
    data: Data,
    recorded: Recording,
    tested: Tested,
    where: tuple[Location, ...],
    visible: tuple[Visible, ...],
    without: tuple[str, ...],
) -> Diagnosis:
    """Return the diagnosis of a recording that differs."""
    readings = data.baseline.readings
    search = Search(data.baseline.law, data.folds, readings, data.rng("search"), without, data.tell)
    search.is_left = lambda found: is_left(data, search, found)
    _, found = search.run()
    none = search.nothing(found)
    data.tell("weighing", 0.7)
    judged = judge(data, search, none, found, tested)
    data.tell("correcting", 0.9)
    causes_only, corrected = corrected_models(data, recorded, judged)
    rest = judged.rest(data, search.common)
    believed = [cause for cause in judged.causes if cause.effect in judged.believed]
    kind = kind_of(believed, judged.together, rest)
    places = [place for place in judged.places if place.effect in {cause.effect for cause in judged.causes}]
    diagnosis = _diagnosis(
        data, recorded, tested, where, visible, kind, judged.causes, rest, causes_only, corrected, places
    )
    return replace(diagnosis, evidence=judged.evidence, posteriors={p.effect: p.others for p in judged.places})


def is_left(data: Data, search: Search, found: Hypothesis) -> bool:
    """Return whether the orthogonal test finds a difference that a hypothesis leaves."""
    tested = orthogonal_test(found.stacks[0], search.common, data.sample, data.rng("left"))
    return tested.p_value.value < LEFT_LEVEL


@dataclass(frozen=True, eq=False)
class Judged:
    """Causes with their probabilities, and the law with those that are believed.

    Attributes:
        causes: selected effects, the believed ones and the greatest shares first.
        believed: ids of those that are believed.
        final: the hypothesis with the believed causes, fitted to both folds.
        places: selected effects and their alternatives.
        evidence: by selected effect.
        together: share of the believed causes.
        share_of_rest: share that they leave.
        after: test of the corrected law.
    """

    causes: tuple[Cause, ...]
    believed: tuple[str, ...]
    final: Final
    places: tuple[Place, ...]
    evidence: Mapping[str, Evidence]
    together: float
    share_of_rest: Interval
    after: Tested

    def rest(self, data: Data, common: Stack) -> Unexplained:
        """Return what the causes leave."""
        left = self.after.p_value.value < FALSE_ALARM
        where = locate(self.after) if left else ()
        described = location_in_words(where[0]) if where else None
        return Unexplained(self.share_of_rest, self.after.p_value, where, described)


def judge(data: Data, search: Search, none: Hypothesis, found: Hypothesis, tested: Tested) -> Judged:
    """Return the causes of a difference with their probabilities."""
    final = conclude(search, found)
    after = orthogonal_test(final.stack, search.common, data.sample, data.rng("rest"))
    places = tuple(place_of(search, found, name) for name in found.effects)
    divided = shares(search, none, found, after.p_value.value < FALSE_ALARM, data.rng("shares"))
    evidence = {
        place.effect: evidence_of(search, found, place, divided, tested.p_value, after.p_value) for place in places
    }
    model = decision_model()
    likely = {place.effect: place.probabilities(model.temperature) for place in places}
    certain = {name: model.probability(each) for name, each in evidence.items()}
    full, selected, known = final, found, intervals(search, final)
    believed = [name for name in found.effects if certain[name] >= BELIEVED]
    first = max(found.effects, key=lambda name: divided.causes[name].value, default="")
    kept = [name for name in believed if name == first or divided.causes[name].value >= MIN_SHARE]
    for name in [each for each in found.effects if each not in kept]:
        found = search.left_out(found, name)
    if set(kept) != set(final.effects):
        final = conclude(search, found)
        after = orthogonal_test(final.stack, search.common, data.sample, data.rng("rest"))
    together = max(
        0.0, divided.together.value - sum(divided.causes[n].value for n in selected.effects if n not in kept)
    )
    rest = divided.rest if together == divided.together.value else _complement(together, divided.together)
    if final is not full:
        known |= intervals(search, final)
    causes = []
    for name in selected.effects:
        own = [(key, value) for key, value in known.items() if key[0] == name]
        alternatives = tuple(
            Alternative(other, certain[name] * p) for other, p in likely[name].items() if other != name
        )
        gain, error = divided.gains[name]
        causes.append(
            Cause(
                name,
                certain[name] * likely[name][name],
                alternatives,
                divided.causes[name],
                gain,
                error,
                {key[1]: value for key, value in own},
                statement(search, name, own),
            )
        )
    causes.sort(key=lambda cause: (cause.effect not in kept, -cause.share.value))
    return Judged(tuple(causes), tuple(kept), final, places, evidence, together, rest, after)


def _complement(together: float, interval: Interval) -> Interval:
    rest = 1.0 - together
    half = 0.5 * (interval.high - interval.low)
    return Interval(rest, max(rest - half, 0.0), min(rest + half, 1.0), "1")


def evidence_of(
    search: Search, found: Hypothesis, place: Place, divided: Shares, before: PValue, after: PValue
) -> Evidence:
    """Return what the decision model needs to know of a selected effect."""
    gain, error = divided.gains[place.effect]
    return Evidence(
        gain=gain,
        gain_error=error,
        n_pings=sum(len(part) for part in search.parts),
        n_visits=len(found.nats),
        share=divided.causes[place.effect].value,
        rest=divided.rest.value,
        lead=place.lead,
        prior=float(np.mean([log_prior(stack, search.common, [place.effect]) for stack in found.stacks])),
        p_before=before.value,
        p_after=after.value,
        n_effects=len(found.effects),
        catch_all=search.common.known[place.effect].by_ping,
    )


def corrected_models(data: Data, recorded: Recording, judged: Judged) -> tuple[SonarModel | None, SonarModel | None]:
    """Return the model with the causes alone, and the corrected model that is offered; None where there is none.

    What no cause explains joins the corrected model as an empirical term, where that improves unseen visits. A
    correction is offered only if it beats the user's simulation on unseen visits.
    """
    stack = judged.final.single.stack
    causes_only = offered(stack, recorded) if judged.believed else None
    options = [] if causes_only is None else [causes_only]
    if judged.after.p_value.value < FALSE_ALARM:
        learned = empirical_term(judged.final.stack, judged.final.batch, data.rng("empirical"))
        options += [offered(learned, recorded)] if learned is not judged.final.stack else []
    unseen = data.folds.unseen
    scored = sorted(((crps(model, unseen), k) for k, model in enumerate(options)), key=lambda each: each[0])
    best = options[scored[0][1]] if scored and scored[0][0] < crps(data.baseline.before, unseen) else None
    return causes_only, best


def offered(stack: Stack, recorded: Recording) -> SonarModel:
    """Return the model of single pings of a stack, on the recording's register where that is coarser."""
    return replace(stack, resolution=max(stack.resolution, recorded.resolution)).single_ping_model


def _diagnosis(
    data: Data,
    recorded: Recording,
    tested: Tested,
    where: tuple[Location, ...],
    visible: tuple[Visible, ...],
    kind: Kind,
    causes: tuple[Cause, ...],
    rest: Unexplained,
    causes_only: SonarModel | None,
    corrected: SonarModel | None,
    places: Sequence[Place],
) -> Diagnosis:
    base, folds = data.baseline, data.folds
    scores = held_out(base.before, base.emulator, corrected or base.before, folds.both, folds.unseen)
    verdict = Verdict(
        kind,
        summary_of(kind, [cause for cause in causes if cause.believed], where, rest, visible, len(data.batch)),
        tested.p_value,
        where,
        causes,
        rest,
        visible,
        scores,
        next_measurements(places, data.batch, data.rng("next"), decision_model().temperature),
        _baseline_check(data, tested),
        data.warnings,
    )
    unanswered = len(recorded) - len(data.batch)
    return Diagnosis(
        verdict,
        data.batch,
        base.readings,
        folds.is_unseen,
        base.before,
        base.emulator,
        corrected,
        causes_only,
        recorded.name,
        unanswered,
    )


def _baseline_check(data: Data, tested: Tested) -> BaselineCheck:
    """Return whether the emulator describes simulated readings that it was not fitted to."""
    base = data.baseline
    if base.held_out is None:
        return BaselineCheck(True, PValue(1.0, 1), tested.overlap, "the law of the simulation is known exactly")
    checked = orthogonal_test(base.law, base.law, Sample(base.held_out, None), data.rng("check"))
    good = checked.p_value.value >= FALSE_ALARM
    note = "" if good else "the emulator does not fully describe the simulation; the comparison allows for that"
    return BaselineCheck(good, checked.p_value, tested.overlap, note)
