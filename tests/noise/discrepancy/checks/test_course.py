"""A sonar before a still target is a thermometer, and says how good a one."""

import numpy as np
import pytest

from acquisition import Ping, Reading, Recording, SettingError
from noise.discrepancy.checks.course import temperature_course
from noise.effects.medium import ASSUMED_TEMPERATURE_C, CELSIUS

HOUR = 3600.0


def day(distance=2.0, swing_k=6.0, scatter_m=0.001, hours=72, seed=0, stray=0.0):
    """Return a recording of days that warm and cool, and how much warmer than at rest it was at each ping."""
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, hours * HOUR, 600.0)
    warmer = swing_k * np.sin(2.0 * np.pi * time / (24.0 * HOUR))
    kelvin = CELSIUS + ASSUMED_TEMPERATURE_C
    read = distance * np.sqrt(kelvin / (kelvin + warmer)) + rng.normal(0.0, scatter_m, len(time))
    read = np.where(rng.random(len(time)) < stray, rng.uniform(0.1, 6.0, len(time)), read)
    ping = Ping.of(distance=np.full(len(time), distance), time=time)
    return Recording.of(ping, Reading.of(read)), warmer


@pytest.mark.parametrize("distance", [0.5, 2.0, 6.0])
def test_the_course_of_warm_days_is_recovered(distance):
    recording, warmer = day(distance, scatter_m=0.0005)
    course = temperature_course(recording, window_s=2 * HOUR)
    assert np.corrcoef(course.warming, warmer)[0, 1] > 0.98
    assert np.polyfit(warmer, course.warming, 1)[0] == pytest.approx(1.0, abs=0.05)


def test_stray_readings_and_silence_leave_it_alone():
    recording, warmer = day(stray=0.2)
    course = temperature_course(recording, window_s=2 * HOUR)
    assert np.corrcoef(course.warming, warmer[course.row])[0, 1] > 0.97
    assert len(course.row) < len(recording)


def test_a_wrong_distance_shifts_it_and_no_more():
    right, warmer = day()
    wrong = Recording.of(Ping.of(right.ping.distance * 1.01, time=right.ping.time), right.reading)
    first, second = (temperature_course(each).warming for each in (right, wrong))
    assert np.std(first - second) < 0.02 * np.std(warmer)


def test_its_error_is_that_of_its_scatter():
    recording, _ = day(swing_k=0.0, scatter_m=0.004, hours=600)
    course = temperature_course(recording, window_s=HOUR)
    ratio = course.warming / course.error
    assert 0.7 < np.std(ratio) < 1.5


def test_what_cannot_tell_says_so():
    far = Recording.of(Ping.of(np.full(50, 1.0), time=np.arange(50.0)), Reading.of(np.full(50, 3.0)))
    with pytest.raises(SettingError, match="no run has 8 echoes"):
        temperature_course(far)
    with pytest.raises(SettingError, match="window_s must be above 0 s"):
        temperature_course(day()[0], window_s=0.0)
