"""From a simulation and a recording to a verdict and a corrected model, in one straight line."""

from __future__ import annotations

import os
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property, partial
from typing import Annotated

import numpy as np

from acquisition import Recording, SettingError
from acquisition.arrays import Singles
from acquisition.io.given import RecordingLike, as_recording
from acquisition.limits import OneOf, Seed, check_value, shown
from noise.discrepancy.baseline.forest import Grown, grown
from noise.discrepancy.baseline.sources import Baseline, baseline_of
from noise.discrepancy.inputs import Progress, Simulator, as_model, check_conditions, warnings_of
from noise.discrepancy.judge.accepted import Comparing, Comparison
from noise.discrepancy.judge.correction import Options, empirical_term
from noise.discrepancy.judge.difference import WORSE, difference, transport, worsens
from noise.discrepancy.judge.held_out import Simulation, held_out
from noise.discrepancy.judge.judged import Judged, judge
from noise.discrepancy.judge.shares import Rest
from noise.discrepancy.judge.verdict import differs, kind_of, shows_little
from noise.discrepancy.locate.directed import MIN_VISITS, directed_test, with_trifles
from noise.discrepancy.locate.few import COARSER, placement_test, register_test, share_test, within_test
from noise.discrepancy.locate.location import locate
from noise.discrepancy.locate.orthogonal import Tested, orthogonal_test
from noise.discrepancy.locate.power import could_have_seen, shown_by
from noise.discrepancy.locate.stability import Stability, stability_test
from noise.discrepancy.locate.trend import UNCOMPENSATED, compensation_is_unknown, trend_test
from noise.discrepancy.moments.bootstrap import Found, Greatest, any_of, joint, signs_of
from noise.discrepancy.moments.sample import Sample
from noise.discrepancy.moments.scores import with_own_placement
from noise.discrepancy.name.alternatives import Place
from noise.discrepancy.name.folds import Folds
from noise.discrepancy.name.search import Search
from noise.discrepancy.report.next_measurement import next_measurements
from noise.discrepancy.report.words import location as location_in_words
from noise.discrepancy.report.words import summary_of
from noise.discrepancy.result import (
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
from noise.discrepancy.thresholds import FALSE_ALARM
from noise.effects import CATALOGUE
from noise.effects.medium import TEMPERATURE
from noise.fitting.batch import Batch
from noise.fitting.stack import PLACEMENT, Stack
from noise.fitting.threads import one_thread
from noise.model import SonarModel

COMPENSATIONS = (0.0, 0.5, 1.0)  # shares of the temperature's influence that a sensor may leave
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

    @cached_property
    def simulation(self) -> Simulation:
        """The user's simulation, as what corrections are measured against."""
        return Simulation.of(self.baseline, self.batch, self.rng("simulation"))

    @cached_property
    def forest(self) -> Grown:
        """The readings of both folds as a law."""
        return grown(self.folds.both, self.rng("forest"))


def stream(seed: int, purpose: str) -> np.random.Generator:
    """Return a generator that follows from a seed and a purpose."""
    return np.random.default_rng([seed, zlib.crc32(purpose.encode())])


@one_thread()
def diagnose(
    model: SonarModel | Simulator | str | os.PathLike[str],
    recording: RecordingLike,
    *,
    simulated: RecordingLike | None = None,
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
    own, other = with_own_placement(law, data.sample)
    wider = max(own, other, key=lambda each: each.get(PLACEMENT))
    signs = signs_of(data.sample.cluster, data.rng("signs"))
    tested = on_any_compensation(own, other, data.sample, data, "test", signs)
    directed = directed_test(wider, data.sample, signs, data.rng("directed"), tested)
    whole = Found(joint(Greatest(tested.p_value, tested.greatest), directed))
    found = [whole, *few_positions(own, other, data.sample, data), register_test(data.batch)]
    tested = replace(tested, p_value=any_of(*(each.p_value for each in found)))
    where = located(tested, found) if tested.p_value.value < FALSE_ALARM else ()
    different = differs(tested.p_value, where)
    if not different and where and directed.p_value.value < FALSE_ALARM:  # what else is there beside trifles?
        beside = with_trifles(wider, where)
        also = directed_test(wider, data.sample, signs, data.rng("directed"), tested, beside)
        different = also.p_value.value < FALSE_ALARM
    if different:
        return _different(data, recorded, tested, where, found, tuple(without))
    return _alike(data, recorded, tested, where, _visible(data, own, tested, found))


def _visible(data: Data, law: Stack, tested: Tested, found: Sequence[Found]) -> tuple[Visible, ...]:
    """Return the least sizes that a test of a law shows, or one of the tests of few positions."""
    visible = could_have_seen(law, data.sample, tested, data.rng("power"))
    for each in found:
        visible = least_of(visible, each.visible)
    return visible


def located(tested: Tested, found: Sequence[Found]) -> tuple[Location, ...]:
    """Return where the tests find differences, those of the most significant test first."""
    every = [replace(found[0], where=locate(tested)), *found[1:]]
    return tuple(place for each in sorted(every, key=lambda each: each.p_value.value) for place in each.where)


def least_of(found: tuple[Visible, ...], other: Visible | None) -> tuple[Visible, ...]:
    """Return the least visible sizes with that of another test, where it is the least of its kind."""
    if other is None or any(each.effect == other.effect and each.least <= other.least for each in found):
        return found
    return (other, *(each for each in found if each.effect != other.effect))


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
    return Data(baseline, batch, folds, Sample.comparable(batch, baseline.readings), seed, warnings, tell)


def on_register_of(baseline: Baseline, batch: Batch) -> Batch:
    """Return the recording on the register of the simulation, as far as its readings lie on one.

    Where its steps are coarser, that is a difference which quantisation explains, and not a property of the data: the
    register is as fine as the simulation's, with steps that divide the coarse ones. Where its readings show no steps,
    but most lie on those of the simulation or on these moved by a constant, they have its steps.
    """
    step = baseline.law.resolution if baseline.readings is None else baseline.readings.resolution
    own = batch.resolution
    if own > COARSER * step:
        return replace(batch, resolution=own / np.ceil(own / step))
    moved = batch.moved_to(step) if step > COARSER * own else None
    return batch if moved is None else moved


def _alike(
    data: Data, recorded: Recording, tested: Tested, trifles: tuple[Location, ...], visible: tuple[Visible, ...]
) -> Diagnosis:
    """Return the diagnosis of a recording that differs by nothing or by trifles, or shows too little to tell."""
    kind = Kind.TOO_LITTLE_DATA if shows_little(visible) else Kind.NONE
    rest = Unexplained(NOTHING, tested.p_value, trifles)
    return _diagnosis(data, recorded, tested, (), visible, kind, (), rest, None, None, ())


def _different(
    data: Data,
    recorded: Recording,
    tested: Tested,
    where: tuple[Location, ...],
    found: Sequence[Found],
    without: tuple[str, ...],
) -> Diagnosis:
    """Return the diagnosis of a recording that differs.

    What else could have been seen is told by the test of what the causes leave: the difference itself hides less there.
    """
    search, judged = _judged(data, tested, without)
    visible = _visible(data, judged.final.stack, judged.after, found)
    if not where or (judged.believed and not differs(tested.p_value, where)):  # nothing, or trifles alone
        where = (*shown_by(*judged.apart(search), data.sample, tested, data.rng("shown")), *where)
    data.tell("correcting", 0.9)
    emulator, step_m = data.baseline.emulator, recorded.resolution
    term = empirical_term(judged, search, data.baseline.readings, data.rng("term"))
    options = Options.of(judged, search, data.forest, data.simulation, data.baseline, step_m, term)
    corrected = options.corrected(data.simulation)
    left = judged.rest
    left = replace(left, description=location_in_words(left.where[0]) if left.where else None)
    believed = [cause for cause in judged.causes if cause.effect in judged.believed]
    kind = kind_of(believed, judged.together, left)
    places = [place for place in judged.places if place.effect in {cause.effect for cause in judged.causes}]
    diagnosis = _diagnosis(
        data, recorded, tested, where, visible, kind, judged.causes, left, options.causes_only, corrected, places
    )
    acting, left_out = difference(judged, search, options, emulator, step_m)
    if acting is not None and worsens(acting, data.simulation, data.folds.unseen, data.rng("acting")):
        acting, left_out = None, dict.fromkeys(judged.believed, WORSE)
    simulation, forest, rng = data.simulation, data.baseline.forest, data.rng("transport")
    carrying = transport(search, options, term, corrected, acting, simulation, forest, data.batch, rng)
    acting, left_out = (acting, left_out) if carrying is None else (carrying, {})
    likely = {p.effect: p.likely for p in judged.places}
    return replace(diagnosis, difference=acting, left_out=left_out, evidence=judged.evidence, likely=likely)


def _judged(data: Data, tested: Tested, without: tuple[str, ...]) -> tuple[Search, Judged]:
    """Return the search for causes, and what was found with its probabilities and shares."""
    search = Search(data.baseline.law, data.folds, data.baseline.readings, data.rng("search"), without, data.tell)
    seed = int(data.rng("acting").integers(2**63))
    comparing = Comparing(search, data.sample, data.baseline.emulator, partial(against, data), seed)
    left = cache(lambda found: comparing.p_of_rest(found.effects, found.stacks[0], data.rng("left")))
    search.is_left = lambda found, level: left(found) < level
    _, found = search.run()
    none = search.nothing(found)
    data.tell("weighing", 0.7)
    rest = Rest(search, data.forest, data.baseline.forest)
    return search, judge(rest, none, found, tested.p_value, comparing, partial(steady, data, search), data.rng("judge"))


def against(data: Data, compared: Comparison) -> Tested:
    """Return the test of a law of the recording beside that of the simulation."""
    laws, sample = (compared.recorded, compared.simulated), compared.sample
    tested = on_any_compensation(*laws, sample, data, "rest")
    others = few_positions(*laws, sample, data)
    return replace(tested, p_value=any_of(tested.p_value, *(each.p_value for each in others))) if others else tested


def few_positions(recorded: Stack, simulated: Stack, sample: Sample, data: Data) -> list[Found]:
    """Return the results of the tests for recordings of few positions; none for others."""
    if len(np.unique(sample.cluster)) >= MIN_VISITS:
        return []
    within = within_test(recorded, simulated, sample, data.rng("within"))
    tests = (trend_test, placement_test, share_test)
    return [*(test(recorded, simulated, sample) for test in tests), within]


def steady(data: Data, search: Search, compared: Comparison, name: str) -> Stability:
    """Return the test that an effect of a law of the recording has the same size everywhere."""
    return stability_test(
        compared.recorded, compared.simulated, search.common, compared.sample, name, data.rng("stability")
    )


def on_any_compensation(
    recorded: Stack, simulated: Stack, sample: Sample, data: Data, purpose: str, signs: Singles | None = None
) -> Tested:
    """Return the orthogonal test, on days of another temperature that with the greatest p-value of all compensations.

    Where the simulation does not show whether its sensor allows for the temperature, what follows from that is no
    difference.
    """
    laws = [(recorded, simulated)]
    if TEMPERATURE in sample.of_the_day and compensation_is_unknown(simulated, sample):
        laws = [(recorded.at(each), simulated.at(each)) for each in ({UNCOMPENSATED: s} for s in COMPENSATIONS)]
    tests = [orthogonal_test(*each, sample, data.rng(purpose), signs=signs) for each in laws]
    return max(tests, key=lambda each: each.p_value.value)


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
    scores = held_out(
        data.simulation, base.emulator, corrected or data.simulation.model, data.forest.model, folds.unseen
    )
    verdict = Verdict(
        kind,
        summary_of(kind, causes, where, rest, visible, len(data.batch)),
        tested.p_value,
        where,
        causes,
        rest,
        visible,
        scores,
        next_measurements(places, data.batch, data.rng("next")),
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
