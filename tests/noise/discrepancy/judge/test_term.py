"""The empirical term: what has no name is learned from the difference of two files, and errors of a law are not."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from acquisition import Ping, Reading, Recording
from noise.discrepancy.judge.term import Term, term_of
from noise.discrepancy.moments.sample import Sample
from noise.fitting.batch import Batch
from noise.fitting.stack import PLACEMENT, Stack
from noise.metrics import crps_with_silence
from noise.physical import PhysicalModel
from tests.noise.discrepancy.made import PLACEMENT_M, model_of, recording_of

LOUD = {"sensitivity": {"loss_db": 0.0}}
LAW = Stack.of(model_of(LOUD)).put([PLACEMENT], [PLACEMENT_M])
VISITS, PINGS = 80, 12


def changed(recording, change, seed):
    rng = np.random.default_rng([seed, 3])
    return Recording.of(recording.ping, change(recording.ping, recording.reading, rng))


def moved(reading, by):
    return Reading.of(np.where(reading.echo, reading.range + by, 0.0))


def longer(ping, reading, rng):
    return moved(reading, 0.03 * (ping.distance > 2.0))


def lost(ping, reading, rng):
    return Reading.of(np.where(rng.random(len(ping)) < 0.5 * (np.abs(ping.angle) > 0.2), 0.0, reading.range))


def wider(ping, reading, rng):
    return moved(reading, rng.normal(0.0, 0.015, len(ping)) * (ping.distance < 1.5))


def first_of_visit(ping, reading, rng):
    return moved(reading, 0.03 * (np.arange(len(ping)) % PINGS == 0))


def early(ping, reading, rng):
    hit = (rng.random(len(ping)) < 0.4 * (ping.distance > 2.0)) & reading.echo
    return Reading.of(np.where(hit, np.round(0.6 * reading.range, 3), reading.range))


CHANGES = {"early": early, "shift": longer, "lost": lost, "spread": wider, "order": first_of_visit}


def pair(change, seed=0):
    """Return a sample of a recording with a change, and a simulation without."""
    first, second = (recording_of(LOUD, seed=seed + k, visits=VISITS, pings=PINGS) for k in (0, 100))
    recorded = first if change is None else changed(first, change, seed)
    return Sample(Batch.of(recorded), Batch.of(second))


@cache
def found(change, seed=0) -> Term | None:
    return term_of(LAW, LAW, pair(change, seed), np.random.default_rng(0))


def mean_crps(law, reading):
    return float(np.mean(crps_with_silence(law, reading)))


@pytest.mark.parametrize("change", CHANGES.values(), ids=CHANGES)
def test_what_has_no_name_is_learned_and_holds_in_new_places(change):
    term, before = found(change), LAW.single_ping_model
    assert term is not None
    fresh = Batch.of(changed(recording_of(LOUD, seed=50, visits=VISITS, pings=PINGS), change, 9))
    plain = Batch.of(recording_of(LOUD, seed=50, visits=VISITS, pings=PINGS))
    laws = [model.law(fresh.ping, fresh.past) for model in (before, term.on(before))]
    own = mean_crps(before.law(plain.ping, plain.past), plain.reading)
    worse, better = (mean_crps(law, fresh.reading) for law in laws)
    if change in (longer, first_of_visit):  # the sonar without the change shows what is left at best
        assert worse - better > 0.7 * (worse - own)
    else:
        assert better < worse


def test_a_part_that_gains_nothing_is_left_out():
    assert set(found(longer).parts) <= {"shift", "spread"}
    assert "lost" in found(lost).parts
    assert "shift" not in found(lost).parts


@pytest.mark.parametrize("seed", range(3))
def test_two_recordings_of_one_sonar_hardly_move_a_law(seed):
    term = found(None, 10 + seed)
    if term is not None:
        ping = recording_of(LOUD, seed=60, visits=VISITS, pings=PINGS).ping
        law = term.on(LAW.single_ping_model).law(ping)
        assert np.sqrt(np.mean(law.shift**2)) < 0.001
        assert np.mean(np.abs(law.heard - law.law.echo)) < 0.01


def test_what_a_law_gets_wrong_of_both_files_is_no_part_of_the_term():
    """A law that is wrong by 25 mm everywhere: only the recording's own shift beyond 2 m is learned."""
    offset = {**LOUD, "zero_offset": {"offset_m": 0.025}}
    wrong = Stack.of(model_of(offset)).put([PLACEMENT], [PLACEMENT_M])
    term = term_of(wrong, wrong, pair(longer), np.random.default_rng(0))
    near, far = Ping.of(distance=np.linspace(0.6, 1.7, 20)), Ping.of(distance=np.linspace(2.3, 3.3, 20))
    shift = [term.on(PhysicalModel([])).law(ping).shift.mean() for ping in (near, far)]
    assert shift == pytest.approx([0.0, 0.03], abs=0.006)


def test_no_value_for_a_reading_of_the_recording_comes_from_trees_that_have_seen_its_cluster():
    """Readings that are chance alone: trees follow the chance of the pings that they have seen, and not of others."""
    sample = pair(longer)
    term = term_of(LAW, LAW, sample, np.random.default_rng(0))
    seen = sample.recorded
    crossed = term.cross_fitted(LAW.single_ping_model, seen).law(seen.ping, seen.past)
    whole = term.on(LAW.single_ping_model).law(sample.recorded.ping, sample.recorded.past)
    assert not np.array_equal(crossed.shift, whole.shift)
    error = np.where(sample.recorded.reading.echo, sample.recorded.error, np.nan)
    left = [np.nanmean((error - law.shift) ** 2) for law in (crossed, whole)]
    assert left[0] >= left[1]


def test_where_the_law_of_the_simulation_is_known_the_recording_alone_is_enough():
    recorded = pair(longer).recorded
    term = term_of(LAW, LAW, Sample(recorded, None), np.random.default_rng(0))
    far = Ping.of(distance=np.linspace(2.3, 3.3, 20))
    assert term.on(PhysicalModel([])).law(far).shift.mean() == pytest.approx(0.03, abs=0.004)


def test_what_the_recording_alone_logs_is_an_input():
    """Readings are 30 mm longer in the sun, of which the simulation knows nothing."""
    recording = recording_of(LOUD, seed=0, visits=VISITS, pings=PINGS)
    light = np.repeat(np.random.default_rng(1).uniform(0.0, 1.0, VISITS), PINGS)
    ping = replace(recording.ping, covariates={"light": light})
    recorded = Batch.of(Recording.of(ping, moved(recording.reading, 0.03 * (light > 0.5))))
    sample = Sample(recorded, pair(None).simulated)
    term = term_of(LAW, LAW, sample, np.random.default_rng(0))
    sunny = replace(Ping.of(distance=np.linspace(0.6, 3.3, 20)), covariates={"light": np.full(20, 0.9)})
    assert term.on(PhysicalModel([])).law(sunny).shift.mean() == pytest.approx(0.03, abs=0.006)


@pytest.mark.parametrize("visits", [1, 2, 4])
def test_of_few_visits_little_or_nothing_is_learned(visits):
    files = [Batch.of(recording_of(LOUD, seed=k, visits=visits, pings=60)) for k in range(2)]
    for sample in (Sample(*files), Sample(files[0], None)):
        term = term_of(LAW, LAW, sample, np.random.default_rng(0))
        assert term is None or visits > 1


def test_the_same_generator_gives_the_same_term():
    first, second = found(longer), term_of(LAW, LAW, pair(longer), np.random.default_rng(0))
    ping = Ping.of(distance=np.linspace(0.5, 3.3, 20))
    model = PhysicalModel([])
    np.testing.assert_array_equal(first.on(model).law(ping).shift, second.on(model).law(ping).shift)
