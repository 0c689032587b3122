"""Ping, Reading and what came before."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from acquisition import EchoStatus, Ping, Reading, SettingError, previous


def test_incidence_is_the_angle_where_it_is_not_given():
    ping = Ping.of(distance=[1.0, 2.0], angle=[0.1, 0.2])
    np.testing.assert_array_equal(ping.incidence, ping.angle)


def test_selection_keeps_every_field_in_step():
    ping = Ping.of(distance=[1.0, 2.0, 3.0], run=[0, 1, 1], temperature_c=[19.0, 20.0, 21.0])
    picked = ping[np.array([False, True, True])]
    assert len(picked) == 2
    np.testing.assert_array_equal(picked.run, [1, 1])
    np.testing.assert_array_equal(picked.covariates["temperature_c"], [20.0, 21.0])


@pytest.mark.parametrize("field", ["distance", "angle", "reflectance", "time"])
def test_a_condition_that_is_not_finite_is_refused_by_name(field):
    with pytest.raises(SettingError, match=f"Ping.{field} holds a value that is not finite"):
        Ping.of(**{"distance": 1.0, field: [1.0, np.nan]})


def test_negative_distance_is_refused_with_its_value():
    with pytest.raises(SettingError, match=r"must be >= 0 m, got -1 m"):
        Ping.of(distance=-1.0)


def test_silence_is_no_range_and_an_echo_has_one():
    with pytest.raises(SettingError):
        Reading.of([0.0], [EchoStatus.ECHO])
    with pytest.raises(SettingError):
        Reading.of([1.0], [EchoStatus.NO_ECHO])


@given(st.lists(st.tuples(st.integers(0, 3), st.floats(0.1, 6.0)), min_size=1, max_size=40))
def test_previous_is_the_reading_before_in_the_same_run(rows):
    run = np.array([r for r, _ in rows])
    reading = Reading.of([x for _, x in rows])
    before = previous(reading, run)
    last: dict[int, float] = {}
    for k, (r, x) in enumerate(rows):
        if r in last:
            assert before.range[k] == last[r]
            assert before.status[k] == EchoStatus.ECHO
        else:
            assert before.status[k] == EchoStatus.NO_ANSWER
        last[r] = x
