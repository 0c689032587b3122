"""Few visits: t tests keep their level, find what is plain, and do not depend on how carefully targets were placed."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import fisher_exact, kstest

from acquisition import Ping, Reading, Recording
from noise.discrepancy.locate.trend import trend_test
from noise.discrepancy.moments.sample import Sample
from noise.discrepancy.moments.scores import with_own_placement
from noise.fitting.batch import Batch
from noise.fitting.stack import PLACEMENT, Stack
from noise.fitting.visit_effects import placement_scatter

MARKS = np.linspace(0.3, 1.5, 10)


def marks(seed, offset=0.0, scale=0.0, placement=0.002, scatter=0.003, pings=30, marks=MARKS, bend=0.0):
    """Return readings of targets at ruler marks, each placed once; `bend` is an error per square metre."""
    rng = np.random.default_rng(seed)
    place = np.repeat(marks + rng.normal(0.0, placement, len(marks)), pings)
    value = place * (1.0 + scale) + bend * place**2 + offset + rng.normal(0.0, scatter, len(place))
    ping = Ping.of(distance=np.repeat(marks, pings))
    ping = replace(ping, time=np.arange(len(place), dtype=float))
    return Batch.of(Recording.of(ping, Reading.of(np.round(value, 3))))


@pytest.fixture(scope="module")
def law():
    return Stack({"travel_time_jitter": {"sigma_m": 0.003}, "visits": {"placement_m": 0.002}})


def p_value(law, recorded, simulated):
    return trend_test(law, law, Sample(recorded, simulated)).p_value.value


def test_p_values_of_ten_marks_measured_twice_are_not_small(law):
    p = [p_value(law, marks(2 * k), marks(2 * k + 1)) for k in range(60)]
    # Bonferroni's p-values are conservative: none of the quantiles lies below that of a uniform variable
    assert kstest(p, "uniform", alternative="greater").pvalue > 0.01


@pytest.mark.parametrize(("offset", "scale"), [(0.012, 0.0), (0.0, 0.015)])
def test_an_offset_and_a_scale_error_are_found_in_ten_marks(law, offset, scale):
    found = trend_test(law, law, Sample(marks(1, offset, scale), marks(2)))
    assert found.p_value.value < 1e-3
    (place,) = found.where
    true = offset + scale * float(MARKS.mean())
    assert place.size.low < true < place.size.high


def test_a_known_law_needs_no_simulated_readings(law):
    assert trend_test(law, law, Sample(marks(3, 0.012), None)).p_value.value < 1e-4
    assert trend_test(law, law, Sample(marks(4), None)).p_value.value > 0.01


def test_shares_that_agree_between_positions_by_chance_are_not_certain(law):
    """One reading lost at each of ten marks, none in the other file: Fisher's exact test knows how rare."""
    recorded, simulated = marks(1), marks(2)
    lost = np.arange(len(recorded)) % (len(recorded) // 10) == 0
    ranges = np.where(lost, 0.0, recorded.reading.range)
    p = trend_test(law, law, Sample(replace(recorded, reading=Reading.of(ranges)), simulated)).p_value.value
    table = [[lost.sum(), (~lost).sum()], [0, len(simulated)]]
    assert p > fisher_exact(table).pvalue


def test_shares_have_the_error_of_the_readings_whatever_share_each_law_expects(law):
    """The recording loses about every other reading of each mark, as its law says, and the simulation none."""
    recorded, corrected = marks(1), law.put([("dropped_reading", "probability")], [0.5])
    ranges = np.where(np.arange(len(recorded)) % 30 < 14, 0.0, recorded.reading.range)
    sample = Sample(replace(recorded, reading=Reading.of(ranges)), marks(2))
    assert trend_test(corrected, law, sample).p_value.value > 0.01


def test_readings_without_any_error_in_reach_have_no_trend(law):
    far = Batch.of(Recording.of(Ping.of(distance=np.repeat(MARKS, 30)), Reading.of(np.full(300, 1e-9))))
    assert trend_test(law, law, Sample(far, None)).p_value.value > 0.01


def test_what_the_law_lacks_at_positions_of_one_file_alone_is_no_difference(law):
    bent = [marks(seed, bend=0.03, marks=at) for seed, at in ((5, MARKS), (6, MARKS + 0.2))]
    assert p_value(law, *bent) > 0.01


@pytest.mark.parametrize(("offset", "scale"), [(0.012, 0.0), (0.0, 0.02)])
def test_marks_need_not_be_shared(law, offset, scale):
    between = MARKS + 0.07
    assert p_value(law, marks(1, offset, scale), marks(2, marks=between)) < 1e-3
    p = [p_value(law, marks(2 * k), marks(2 * k + 1, marks=between)) for k in range(60)]
    assert kstest(p, "uniform", alternative="greater").pvalue > 0.01


def test_beyond_the_marks_of_the_simulation_its_law_is_not_known(law):
    beyond = MARKS + 1.3
    assert p_value(law, marks(1, 0.05, marks=beyond), marks(2)) == 1.0


def in_air_of(batch, temperature_c):
    """Return readings of a sensor that assumes 20 degC, made in other air."""
    far = batch.reading.range * np.sqrt((273.15 + 20.0) / (273.15 + temperature_c))
    ping = replace(batch.ping, covariates={"temperature_c": np.full(len(batch), float(temperature_c))})
    return Batch.of(Recording.of(ping, Reading.of(np.round(far, 3))))


def test_the_sound_speed_of_logged_air_is_no_difference_unless_it_errs_the_other_way(law):
    far = np.linspace(0.5, 5.0, 30)
    warm, cold = (in_air_of(marks(seed, marks=far), at) for seed, at in ((7, 24.0), (8, 14.0)))
    assert p_value(law, warm, cold) > 0.01
    swapped = [replace(a, ping=replace(a.ping, covariates=b.ping.covariates)) for a, b in ((warm, cold), (cold, warm))]
    assert p_value(law, *swapped) < 1e-4


def test_four_marks_tell_nothing(law):
    found = trend_test(law, law, Sample(marks(1, 0.05, marks=MARKS[:4]), marks(2, marks=MARKS[:4])))
    assert found.p_value.value == 1.0
    assert found.visible is None


def test_the_scatter_of_placements_is_that_of_each_file(law):
    many = np.linspace(0.3, 3.0, 300)
    sample = Sample(marks(1, placement=0.006, marks=many), marks(2, placement=0.001, marks=many))
    found = [placement_scatter(each.get(PLACEMENT)) for each in with_own_placement(law, sample)]
    assert found == pytest.approx([0.006, 0.001], rel=0.15)


def test_single_pings_do_not_show_the_scatter_of_placements(law):
    sample = Sample(marks(1, placement=0.006, pings=1), marks(2, pings=1))
    assert [each.get(PLACEMENT) for each in with_own_placement(law, sample)] == [law.get(PLACEMENT)] * 2
