"""`Ping`, `Reading` and `previous`."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from acquisition import EchoStatus, Ping, Reading, SettingError, previous


def test_incidence_defaults_to_the_angle():
    ping = Ping.of(distance=[1.0, 2.0], angle=[0.1, 0.2])
    np.testing.assert_array_equal(ping.incidence, ping.angle)


def test_selection_applies_to_every_field():
    ping = Ping.of(distance=[1.0, 2.0, 3.0], run=[0, 1, 1], temperature_c=[19.0, 20.0, 21.0])
    picked = ping[np.array([False, True, True])]
    assert len(picked) == 2
    np.testing.assert_array_equal(picked.run, [1, 1])
    np.testing.assert_array_equal(picked.covariates["temperature_c"], [20.0, 21.0])


@pytest.mark.parametrize("field", ["distance", "angle", "reflectance", "time"])
def test_a_condition_that_is_not_finite_is_an_error(field):
    with pytest.raises(SettingError, match=f"Ping.{field} holds a value that is not finite"):
        Ping.of(**{"distance": 1.0, field: [1.0, np.nan]})


def test_a_negative_distance_is_an_error():
    with pytest.raises(SettingError, match=r"must be >= 0 m, got -1 m"):
        Ping.of(distance=-1.0)


def test_a_range_exists_only_with_an_echo():
    with pytest.raises(SettingError):
        Reading.of([0.0], [EchoStatus.ECHO])
    with pytest.raises(SettingError):
        Reading.of([1.0], [EchoStatus.NO_ECHO])


@given(st.lists(st.tuples(st.integers(0, 3), st.floats(0.1, 6.0)), min_size=1, max_size=40))
def test_previous_is_the_previous_reading_of_the_same_run(rows):
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
