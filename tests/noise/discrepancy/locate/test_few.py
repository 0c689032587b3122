"""Recordings of few positions: what is plain to see is found, and careless placement or a shared drift is not."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import fisher_exact, kstest

from acquisition import Ping, Reading, Recording
from noise.discrepancy.locate.few import placement_test, register_test, share_test, within_test
from noise.discrepancy.moments.sample import Sample
from noise.discrepancy.result import Aspect
from noise.fitting.batch import Batch
from noise.fitting.stack import Stack

MARKS = np.linspace(0.3, 1.5, 10)
PINGS = 60
INTERVAL_S = 0.1


@pytest.fixture(scope="module")
def law():
    return Stack({"travel_time_jitter": {"sigma_m": 0.003}, "visits": {"placement_m": 0.002}})


def marks(seed, at_mark=0.0, within=0.0, placement=0.002, memory=0.0, step=0.001):
    """Return readings at ruler marks, with an error at each mark, m, and one within each visit, m, (pings,)."""
    rng = np.random.default_rng(seed)
    place = MARKS + rng.normal(0.0, placement, len(MARKS)) + at_mark
    noise = rng.normal(0.0, 0.003, (len(MARKS), PINGS))
    for k in range(1, PINGS):
        noise[:, k] += memory * noise[:, k - 1]
    value = (place[:, None] + noise + within).ravel()
    ping = Ping.of(distance=np.repeat(MARKS, PINGS))
    ping = replace(ping, time=np.arange(len(value)) * INTERVAL_S)
    return Batch.of(Recording.of(ping, Reading.of(np.round(np.round(value / step) * step, 4))))


def with_early(batch, share, seed):
    """Return readings of which a share at each mark, (marks,), comes from half the distance."""
    early = np.random.default_rng(seed).random((len(MARKS), PINGS)) < np.broadcast_to(share, len(MARKS))[:, None]
    ranges = np.where(early.ravel(), 0.5 * batch.ping.distance, batch.reading.range)
    return replace(batch, reading=Reading.of(ranges))


def between(law, recorded, simulated):
    return placement_test(law, law, Sample(recorded, simulated))


def within(law, recorded, simulated, seed=0):
    return within_test(law, law, Sample(recorded, simulated), np.random.default_rng(seed))


@pytest.mark.parametrize("common", [0.0, 0.02, 0.1])
def test_as_many_far_readings_in_both_files_do_not_differ_however_they_vary_between_marks(law, common):
    p = []
    for seed in range(100):
        rng = np.random.default_rng(seed)
        shares = np.minimum(common * rng.gamma(1.0, size=(2, len(MARKS))), 1.0)
        files = [with_early(marks(k), share, k) for k, share in zip((seed, 1000 + seed), shares, strict=True)]
        p.append(share_test(law, law, Sample(*files)).p_value.value)
    assert np.mean(np.array(p) < 0.05) <= 0.05
    assert min(p) > 0.001


def test_one_reading_in_twenty_far_from_every_mark_is_found(law):
    for seed in range(10):
        found = share_test(law, law, Sample(with_early(marks(seed), 0.05, seed), marks(1000 + seed)))
        assert found.p_value.value < 0.01
        (place,) = found.where
        assert place.aspect is Aspect.EARLY
        assert place.size.value == pytest.approx(0.05, abs=0.03)
        back = share_test(law, law, Sample(marks(1000 + seed), with_early(marks(seed), 0.05, seed)))
        assert back.p_value.value == pytest.approx(found.p_value.value)


def test_one_reading_in_twelve_lost_at_every_mark_is_found(law):
    for seed in range(10):
        recorded = marks(seed)
        lost = np.random.default_rng(seed).random(len(recorded)) < 0.08
        silent = replace(recorded, reading=Reading.of(np.where(lost, 0.0, recorded.reading.range)))
        found = share_test(law, law, Sample(silent, marks(1000 + seed)))
        assert found.p_value.value < 0.01
        assert found.where[0].aspect is Aspect.DETECTION
        assert found.where[0].size.low < -lost.mean() < found.where[0].size.high


def test_one_reading_in_five_repeated_at_every_mark_is_found(law):
    for seed in range(10):
        recorded, rng = marks(seed), np.random.default_rng(seed)
        ranges = recorded.reading.range.copy()
        for k in np.flatnonzero((rng.random(len(ranges)) < 0.2) & (np.arange(len(ranges)) % PINGS > 0)):
            ranges[k] = ranges[k - 1]
        table = recorded.ping, Reading.of(ranges)
        found = share_test(law, law, Sample(Batch.of(Recording.of(*table)), marks(1000 + seed)))
        assert found.p_value.value < 0.01
        assert found.where[0].aspect is Aspect.REPEAT


def test_a_sonar_that_loses_nothing_differs_from_a_known_law_that_loses_some(law):
    losing = Stack({**law.values, "dropped_reading": {"probability": 0.03}})
    found = share_test(losing, losing, Sample(marks(1), None))
    assert found.p_value.value < 0.01
    assert found.where[0].size.low < 0.03 < found.where[0].size.high


def test_shares_of_the_few_echoes_among_many_silent_pings_are_no_surer_than_their_number(law):
    """One far reading among six echoes of each mark, and none in the other file: Fisher's exact test knows how rare."""
    recorded, simulated = marks(1), marks(2)
    nth = np.arange(len(recorded)) % PINGS
    near = [np.where(nth < 6, batch.reading.range, 0.0) for batch in (recorded, simulated)]
    near[0][nth == 0] *= 0.5
    files = [replace(recorded, reading=Reading.of(near[0])), replace(simulated, reading=Reading.of(near[1]))]
    table = [[len(MARKS), 5 * len(MARKS)], [0, 6 * len(MARKS)]]
    assert share_test(law, law, Sample(*files)).p_value.value > fisher_exact(table).pvalue


def test_far_readings_of_one_disturbed_visit_are_no_difference(law):
    disturbed = with_early(marks(1), np.eye(len(MARKS))[3] * 0.9, 1)
    assert share_test(law, law, Sample(disturbed, marks(2))).p_value.value > 0.05


def test_marks_that_scatter_as_targets_are_placed_do_not_differ(law):
    p = [between(law, marks(k, placement=0.005), marks(1000 + k, placement=0.001)).p_value.value for k in range(40)]
    assert min(p) > 0.01


def test_errors_of_several_centimetres_at_marks_are_found_although_they_follow_no_line(law):
    wave = 0.03 * np.sin(np.arange(len(MARKS)))
    found = between(law, marks(1, wave), marks(2))
    assert found.p_value.value < 1e-3
    (place,) = found.where
    inside = (place.region["distance"][0] - 1e-6 <= MARKS) & (place.region["distance"][1] + 1e-6 >= MARKS)
    assert place.aspect is Aspect.BIAS
    assert place.size.low < wave[inside].mean() < place.size.high
    assert abs(wave[inside].mean()) > 0.02
    assert between(law, marks(3, wave), marks(4, wave)).p_value.value > 0.01  # the law lacks it in both files


def test_one_misplaced_target_is_no_difference(law):
    assert between(law, marks(1, np.where(np.arange(len(MARKS)) == 4, 0.06, 0.0)), marks(2)).p_value.value > 0.01


def test_early_echoes_at_four_marks_of_ten_are_found_where_they_are(law):
    share = np.where((np.arange(len(MARKS)) >= 1) & (np.arange(len(MARKS)) < 5), 0.4, 0.0)
    found = between(law, with_early(marks(1), share, 3), marks(2))
    assert found.p_value.value < 0.01
    (place,) = found.where
    assert place.aspect is Aspect.EARLY
    assert place.region["distance"] == pytest.approx((MARKS[1], MARKS[4]))
    assert place.size.low < 0.4 < place.size.high


@pytest.mark.parametrize("simulated", [0.0, 0.3])
def test_early_echoes_that_both_files_have_at_other_marks_are_no_difference(law, simulated):
    rng = np.random.default_rng(5)
    shares = [simulated * (rng.random(len(MARKS)) < 0.5) for _ in range(2)]
    files = [with_early(marks(10 + k), each, k) for k, each in enumerate(shares)]
    assert between(law, *files).p_value.value > 0.01


def test_one_disturbed_visit_is_no_difference_and_shares_within_the_tolerance_are_none(law):
    one = np.where(np.arange(len(MARKS)) == 4, 0.5, 0.0)
    assert between(law, with_early(marks(1), one, 1), marks(2)).p_value.value > 0.01
    p = [between(law, with_early(marks(k), 0.02, k), marks(1000 + k)).p_value.value for k in range(40)]
    assert min(p) > 0.01


def test_a_known_law_needs_no_simulated_readings(law):
    assert between(law, marks(1, 0.03 * np.sin(np.arange(len(MARKS)))), None).p_value.value < 1e-3
    assert within(law, marks(1, within=np.linspace(-0.01, 0.01, PINGS)), None).p_value.value < 0.01


@pytest.mark.parametrize("memory", [0.0, 0.7])
def test_p_values_of_two_recordings_of_one_sonar_are_not_small(law, memory):
    p = [within(law, marks(k, memory=memory), marks(1000 + k, memory=memory), k).p_value.value for k in range(30)]
    assert kstest(p, "uniform", alternative="greater").pvalue > 0.01


def test_a_drift_within_each_visit_is_found_and_one_that_both_files_have_is_not(law):
    drift = np.linspace(-0.006, 0.006, PINGS)
    found = within(law, marks(1, within=drift), marks(2))
    assert found.p_value.value < 0.01
    assert found.where[0].aspect is Aspect.BIAS
    assert within(law, marks(3, within=drift), marks(4, within=drift)).p_value.value > 0.01


def test_errors_of_whole_positions_are_no_difference_within_positions(law):
    assert within(law, marks(1, 0.03 * np.sin(np.arange(len(MARKS)))), marks(2)).p_value.value > 0.01


def test_a_coarser_register_is_certain_and_few_readings_on_a_grid_are_not():
    coarse = replace(marks(1, step=0.0127), resolution=0.001)
    assert register_test(coarse).p_value.value < 1e-4
    assert register_test(marks(1)).p_value.value == 1.0
    alike = replace(coarse.select(coarse.visit == 0), resolution=0.001)
    few = len(np.unique(alike.reading.range))
    assert register_test(alike).p_value.value == pytest.approx((0.001 / 0.0127) ** (few - 1), rel=0.1)
