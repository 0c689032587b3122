"""A hypothesis is compared with a recording so that errors of the law, which both files have, do not reject it."""

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from noise.discrepancy.judge.accepted import Comparing, Comparison, least_greatest
from noise.discrepancy.locate.orthogonal import orthogonal_test
from noise.discrepancy.moments.sample import Sample
from noise.fitting.stack import Stack
from tests.noise.discrepancy.locate.test_stability import LAW, survey

OFFSET, SCALE, LOST = ("zero_offset", "offset_m"), ("clock_scale", "error"), ("dropped_reading", "probability")
TRUE_M = 0.012
PERIOD_M, DEPTH_M = 0.03, 0.006  # of an error that no law has: readings crowd at some ranges


def crowded(distance):
    """Return the error of a sonar whose readings crowd at some ranges, m."""
    return DEPTH_M * np.sin(2.0 * np.pi * distance / PERIOD_M)


def comparing(recorded, simulated, keys):
    """Return what compares a recording with a simulation of the same sonar that differs by a few parameters."""
    search = SimpleNamespace(common=LAW, differing=lambda effects: keys, folds=SimpleNamespace(both=recorded))

    def test(compared: Comparison):
        return orthogonal_test(compared.recorded, compared.simulated, compared.sample, np.random.default_rng(0))

    return Comparing(search, Sample(recorded, simulated), LAW.single_ping_model, test, 0)


def moved(seed=1):
    return survey(seed, offset=lambda distance: TRUE_M + crowded(distance))


@pytest.fixture(scope="module")
def files():
    """A recording that is longer than its simulation by `TRUE_M`, and the simulation; neither is like the law."""
    return moved(), survey(2, offset=crowded)


@pytest.mark.parametrize("factor", [0.6, 1.2, 1.6])
def test_a_size_that_the_likelihood_misses_is_found_by_comparison(files, factor):
    compares = comparing(*files, [OFFSET])
    wrong = LAW.at({OFFSET: factor * TRUE_M})
    assert compares.test(compares.acted(["zero_offset"], wrong)).is_below(0.01)
    tested, found = compares.least_rejected(["zero_offset"], wrong)
    assert not tested.is_below(0.1)
    assert found.recorded.get(OFFSET) == pytest.approx(TRUE_M, abs=0.0005)


def test_another_cause_is_rejected_at_every_size_near_its_own(files):
    distance = files[0].ping.distance
    law = LAW.at({SCALE: TRUE_M * float(np.mean(distance) / np.mean(distance**2))})
    assert comparing(*files, [SCALE]).least_rejected(["clock_scale"], law)[0].is_below(0.01)


def test_nuisances_that_differ_by_the_fit_alone_do_not_reject_a_right_cause(files):
    wide = LAW.at({OFFSET: TRUE_M, ("travel_time_jitter", "sigma_m"): 0.006})
    compares = comparing(*files, [OFFSET])
    assert compares.test(Comparison(wide, LAW, compares.sample)).is_below(0.01)
    assert not compares.least_rejected(["zero_offset"], wide)[0].is_below(0.1)


def test_causes_act_on_the_simulations_own_readings():
    simulated = survey(2, offset=crowded)
    acted = comparing(moved(), simulated, [OFFSET]).acted(["zero_offset"], LAW.at({OFFSET: TRUE_M}))
    before, after = simulated.reading.range, acted.sample.simulated.reading.range
    assert after == pytest.approx(before + TRUE_M, abs=1e-9)  # a multiple of the register's step


def test_readings_are_lost_as_often_as_the_cause_says():
    simulated = survey(2)
    acted = comparing(survey(1, lost=0.3), simulated, [LOST]).acted(["dropped_reading"], LAW.at({LOST: 0.3}))
    echo = acted.sample.simulated.reading.echo
    assert float(echo.mean()) == pytest.approx(0.7, abs=4.0 * np.sqrt(0.21 / len(echo)))
    assert np.array_equal(acted.sample.simulated.reading.range[echo], simulated.reading.range[echo])


def test_a_difference_that_cannot_act_on_readings_is_compared_by_laws():
    less = Stack({**LAW.values, "dropped_reading": {"probability": 0.3}})
    compares = comparing(survey(1, lost=0.1), survey(2, lost=0.3), [LOST])
    compares.search.common = less
    assert compares.acted(["dropped_reading"], less.at({LOST: 0.1})) is None
    assert not compares.least_rejected(["dropped_reading"], less.at({LOST: 0.1}))[0].is_below(0.01)


@given(st.integers(0, 2**32 - 1), st.integers(1, 3), st.integers(3, 40))
def test_no_other_steps_have_a_lesser_greatest_statistic(seed, k, n):
    rng = np.random.default_rng(seed)
    value, slope, most = rng.normal(size=n), rng.normal(size=(n, k)), 2.5
    best = least_greatest(value, slope, most)
    assert np.all(np.abs(best) <= most + 1e-9)
    others = rng.uniform(-most, most, (50, k))
    least = np.abs(value + slope @ best).max()
    assert least <= np.abs(value + others @ slope.T).max(axis=1).min() + 1e-7
