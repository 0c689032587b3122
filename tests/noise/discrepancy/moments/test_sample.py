"""What one file alone has of the past, or more often, is no difference of the sonar."""

from dataclasses import replace

import numpy as np
import pytest

from acquisition import Ping, Reading, Recording
from noise.discrepancy.locate.directed import directed_test
from noise.discrepancy.locate.orthogonal import orthogonal_test
from noise.discrepancy.moments.bootstrap import signs_of
from noise.discrepancy.moments.sample import Sample, condition_columns, stay_in_place
from noise.fitting.batch import Batch
from noise.fitting.stack import Stack

INCH = 0.0254


def averaging(seed, in_order):
    """Return the log of a sonar that reports the mean of its last two ranges, over targets in order or at random."""
    rng = np.random.default_rng(seed)
    place = rng.uniform(0.3, 3.0, 60)
    distance = np.repeat(np.sort(place) if in_order else place, 8)
    range_ = distance + rng.normal(0.0, 0.003, len(distance))
    mean = 0.5 * (range_ + np.r_[range_[:1], range_[:-1]])
    ping = replace(Ping.of(distance=distance), time=np.arange(len(distance), dtype=float))
    return Batch.of(Recording.of(ping, Reading.of(np.round(mean, 3))))


def p_value(law, sample):
    return orthogonal_test(law, law, sample, np.random.default_rng(0)).p_value.value


def test_memory_of_targets_far_away_is_compared_where_both_files_have_such_movements():
    law = Stack({"travel_time_jitter": {"sigma_m": 0.003}, "visits": {"placement_m": 0.002}})
    recorded, simulated = averaging(1, in_order=False), averaging(2, in_order=True)
    assert p_value(law, Sample(recorded, simulated)) < 0.01
    assert p_value(law, Sample.comparable(recorded, simulated)) > 0.01


def test_surveys_of_one_kind_are_compared_almost_whole():
    recorded, simulated = averaging(1, in_order=False), averaging(2, in_order=False)
    sample = Sample.comparable(recorded, simulated)
    assert len(sample.recorded) >= 0.98 * len(recorded)
    assert len(sample.simulated) >= 0.98 * len(simulated)


def test_a_recording_of_single_pings_is_not_left_out():
    every = [averaging(seed, in_order).select(np.arange(480) % 8 == 0) for seed, in_order in ((1, False), (2, True))]
    sample = Sample.comparable(*every)
    assert len(sample.recorded) == len(every[0])


def untimed(seed, shuffled):
    """Return readings on coarse steps, which often repeat, of a survey without times, with its rows in any order."""
    rng = np.random.default_rng(seed)
    distance = np.repeat(rng.choice([0.6, 1.0, 1.6, 2.2], 200), 7)
    angle = np.repeat(np.round(rng.uniform(-0.5, 0.5, 200), 3), 7)
    reading = np.round(distance + np.repeat(rng.normal(0.0, 0.002, 200), 7) + rng.normal(0.0, 0.002, len(distance)), 2)
    row = rng.permutation(len(distance)) if shuffled else np.arange(len(distance))
    return Batch.of(Recording.of(Ping.of(distance=distance[row], angle=angle[row]), Reading.of(reading[row])))


@pytest.mark.parametrize("shuffled", [(True, False), (False, True)], ids=["recording", "simulation"])
@pytest.mark.parametrize("seed", range(3))
def test_rows_without_times_may_stand_in_any_order(seed, shuffled):
    law = Stack({"travel_time_jitter": {"sigma_m": 0.002}, "visits": {"placement_m": 0.002}}, 0.01)
    sample = Sample.comparable(*(untimed(2 * seed + k, each) for k, each in enumerate(shuffled)))
    signs = signs_of(sample.cluster, np.random.default_rng(seed))
    directed = directed_test(law, sample, signs, np.random.default_rng(seed))
    assert abs(sample.follows_more) > 0.5
    assert p_value(law, sample) > 0.01
    assert directed.p_value.value > 0.01


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.slow
def test_nothing_is_left_where_the_law_has_all_spikes(lab, seed):
    rng = np.random.default_rng(seed)
    truth = [{**lab.truth, "spike": {"probability": share, "span_m": 11.0}} for share in (0.1, 0.01)]
    models = [replace_step(lab.model(each)) for each in truth]
    files = [lab.record(model, lab.survey(rng, visits=60), rng) for model in models]
    laws = [Stack.of(model).put([("visits", "placement_m")], [0.003]) for model in models]
    tested = orthogonal_test(laws[0], laws[1], Sample(*files), np.random.default_rng(seed))
    assert tested.p_value.value > 0.01


def replace_step(model):
    """Return a model with a coarse register, whose readings often repeat."""
    return type(model)(model.effects, resolution=INCH)


@pytest.mark.parametrize(("lost", "found"), [(0.0, False), (0.3, True)])
def test_lost_echoes_are_found_on_a_day_of_another_temperature(lab, lost, found):
    rng = np.random.default_rng(5)
    law = lab.model({**lab.truth, "dropped_reading": {"probability": lost}})
    files = []
    for model, mean_c in ((law, 18.0), (lab.model(lab.truth), 15.0)):
        batch = lab.record(model, lab.survey(rng, visits=60), rng)
        temperature = mean_c + np.repeat(rng.normal(0.0, 0.5, 60), 10)[np.argsort(batch.ping.time, kind="stable")]
        files.append(replace(batch, ping=replace(batch.ping, covariates={"temperature_c": temperature})))
    sample = Sample(*files)
    assert sample.of_the_day == ("temperature_c",)
    assert (p_value(lab.exact, sample) < 0.01) == found


@pytest.mark.parametrize(("offset", "found"), [(0.0, False), (0.02, True)])
def test_a_target_that_never_moves_is_compared_on_days_of_other_temperatures(offset, found):
    rng = np.random.default_rng(3)
    law, files = Stack({"travel_time_jitter": {"sigma_m": 0.003}, "visits": {"placement_m": 0.002}}), []
    for change, mean_c in ((offset, 20.0), (0.0, 15.0)):
        temperature = rng.normal(mean_c, 0.5, 1000).round(1)
        ping = Ping.of(distance=np.ones(1000), time=600.0 * np.arange(1000), temperature_c=temperature)
        files.append(Batch.of(Recording.of(ping, Reading.of(np.round(1.0 + change + rng.normal(0.0, 0.003, 1000), 3)))))
    assert Sample(*files).of_the_day == ("temperature_c",)
    assert (p_value(law, Sample(*files)) < 0.01) == found


def test_files_share_their_clusters_where_every_position_is_visited_once():
    recorded, simulated = averaging(1, in_order=False), averaging(1, in_order=True)
    sample = Sample(recorded, simulated)
    assert recorded.n_visits == 60
    for place in np.unique(recorded.ping.distance):
        at = [batch.ping.distance == place for batch in sample.batches]
        assert len(np.unique(sample.cluster[np.concatenate(at)])) == 1


def rounds(rng, physics, changed, held):
    """Return three rounds over 25 positions with an error of the sonar at each, and placements anew or once for all."""
    d, a = (x.ravel() for x in np.meshgrid(np.linspace(0.6, 3.0, 5), np.radians([0.0, 6.0, 9.0, 15.0, 20.0])))
    error = physics - 0.03 * changed * (a == a[10])
    order = np.concatenate([rng.permutation(25) for _ in range(3)])
    placed = rng.normal(0.0, 0.002, 25)[order] if held else rng.normal(0.0, 0.002, 75)
    k = np.repeat(order, 10)
    reading = d[k] + error[k] + np.repeat(placed, 10) + rng.normal(0.0, 0.003, len(k))
    return Batch.of(Recording.of(Ping.of(distance=d[k], angle=a[k]), Reading.of(np.round(reading, 3))))


@pytest.mark.parametrize("held", [(False, False), (True, False), (True, True)])
@pytest.mark.parametrize("changed", [False, True])
def test_what_a_sonar_reads_wrong_at_a_position_is_no_target_that_stays_in_place(changed, held):
    found = 0
    for seed in range(20):
        rng = np.random.default_rng(seed)
        physics = rng.normal(0.0, 0.006, 25)
        found += stay_in_place([rounds(rng, physics, changed, held[0]), rounds(rng, physics, False, held[1])])
    assert found >= 15 if any(held) else found <= (8 if changed else 3)


def test_a_logged_column_does_not_hide_a_condition_of_its_name():
    ping = Ping.of(distance=np.linspace(0.3, 3.0, 40), angle=0.2)
    more = {name: np.arange(40.0) for name in ("distance", "angle", "time", "load_v")}
    batch = Batch.of(Recording.of(replace(ping, covariates=more), Reading.of(ping.distance)))
    found = condition_columns(batch)
    np.testing.assert_allclose(found["distance"], ping.distance)
    np.testing.assert_allclose(found["angle"], ping.angle)
    assert "load_v" in found
    assert "time" not in found
