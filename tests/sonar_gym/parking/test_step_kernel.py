"""Kernels of a step: firing and causes against independent calculations."""

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from sonar_gym import SonarParkingVectorEnv
from sonar_gym.sensing import records


@settings(deadline=None)  # the first call compiles
@given(st.floats(0.1, 1.0), st.floats(0.0, 0.5))
@example(0.1, 2e-9)
def test_every_ping_of_a_period_is_fired_once_at_its_time(period, phase):
    fired = []
    for step in range(40):
        since = records.firing_delay(step * 0.1, 0.1, period, phase)
        assert since == -1.0 or 0.0 < since <= 0.1 + 1e-12
        if since > 0.0:
            fired.append(step * 0.1 + since)
    expected = phase + period * np.arange(100)
    from_ends = np.abs(np.r_[expected, expected - 4.0])
    assume((np.abs(from_ends - records.SAME_TIME_S) > 1e-12).all())  # at the tolerance itself, rounding decides
    expected = expected[(expected > 1e-9) & (expected <= 4.0 + 1e-9)]
    assert fired == pytest.approx(expected, abs=1e-8)


@pytest.mark.parametrize(
    ("status", "reading", "true", "fault", "cause"),
    [
        (0, 0.0, None, 0, records.EMPTY),
        (1, 1.05, 1.0, 0, records.TARGET),
        (1, 0.85, 1.0, 0, records.EARLY),
        (1, 1.15, 1.0, 0, records.LATE),
        (1, 2.0, None, 0, records.GHOST),
        (0, 0.0, 1.0, 0, records.MISSED),
        (2, 0.0, 1.0, 0, records.NO_ANSWER),
        (1, 1.0, 1.0, 2, records.FIRST_FAULT + 1),
    ],
)
def test_cause_of_each_kind_of_reading(status, reading, true, fault, cause):
    obstacle, distance = (-1.0, 3.01) if true is None else (0.0, true)
    assert records.cause_of(fault, status, obstacle, reading, distance) == cause


@settings(deadline=None)  # the first call compiles
@given(st.floats(0.0, 4.0))
def test_bin_agrees_with_a_search(reading):
    edges = np.linspace(0.0, 3.3, 101)
    assert records.bin_of(reading, edges) == min(int(np.searchsorted(edges, reading, side="right")) - 1, 99)


@pytest.mark.parametrize("which", [1, np.int64(1), np.array([1]), slice(1, 2)], ids=repr)
def test_the_readings_shown_of_one_car_are_the_same_however_it_is_numbered(which):
    envs = SonarParkingVectorEnv(3)
    envs.reset(seed=1)
    pings = envs.fleet.sensing.pings
    np.testing.assert_array_equal(
        pings.of_shown(which).reshape(pings.of_shown(1).shape), pings.of_shown(slice(None))[1]
    )
