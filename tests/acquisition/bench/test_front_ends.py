"""Front ends of HC-SR04 and MaxBotix, against known answers."""

from dataclasses import replace

import numpy as np
import pytest

from acquisition import Ping
from acquisition.bench import Rig, Setup, Wall
from acquisition.bench.acoustics.receiver import gain_over_time
from acquisition.bench.front_ends import FRONT_ENDS, HCSR04, MAXBOTIX, NEAREST_S
from acquisition.bench.laboratory.air import sound_speed

METRES_PER_S = 0.01 / 58e-6  # of range, by the 58 us/cm of the data sheets


def read(unit, distance, **settings):
    """Return the readings of a unit in front of a wall in still air."""
    setup = Setup.static(gain=31, range_register=172, output="us", reflector=Wall(), **settings)
    ping = Ping.of(distance=distance, time=np.arange(len(distance)) * 1.0)
    return Rig(unit, setup).ping(ping, np.random.default_rng(0)).reading(setup)


def ideal(sensor, **fields):
    """Return a unit without errors of its clock, start, mounting and filter."""
    exact = {"t_offset": 0.0, "clock_error": 0.0, "yaw": 0.0, "pitch": 0.0, "sensitivity_db": 6.0, "averaging": 1}
    return replace(FRONT_ENDS[sensor].unit(3), **{**exact, **fields})


@pytest.mark.parametrize("sensor", FRONT_ENDS)
def test_a_unit_is_the_same_for_its_number_and_within_limits(sensor):
    front = FRONT_ENDS[sensor]
    assert front.unit(7) == front.unit(7) != front.unit(8)
    units = [front.unit(serial) for serial in range(200)]
    for name, (low, high) in {"hcsr04": HCSR04, "maxbotix": MAXBOTIX}[sensor].items():
        drawn = np.array([getattr(unit, name) for unit in units])
        assert low <= drawn.min() < drawn.max() <= high
        assert np.ptp(drawn) > 0.9 * (high - low)


def test_an_hcsr04_has_no_gain_steps_and_a_threshold_above_its_burst():
    assert np.all(gain_over_time(31, 100, 0.0) == 1.0)
    unit = ideal("hcsr04", leak_db=-40.0)
    assert read(unit, [0.5]).range[0] == pytest.approx(0.5, abs=0.03)
    constant = replace(unit, sag=0.0)
    assert read(constant, [0.5]).range[0] < 0.1  # the burst itself


def test_an_hcsr04_reads_times_and_a_maxbotix_corrects_them():
    distance = np.array([1.0, 2.0])
    for t in (-10.0, 40.0):
        longer = 2.0 * METRES_PER_S / sound_speed(t)
        late = np.diff(read(ideal("hcsr04"), distance, temperature_c=t).range)[0]
        assert late == pytest.approx(longer, abs=0.009)  # two slips of a period at most
        right = np.diff(read(ideal("maxbotix"), distance, temperature_c=t).range)[0]
        assert right == pytest.approx(1.0, abs=0.009)


@pytest.mark.parametrize("nearest", NEAREST_S)
def test_a_maxbotix_reports_nothing_nearer_than_its_least_range(nearest):
    got = read(ideal("maxbotix", nearest_s=nearest), np.linspace(0.02, 0.6, 30))
    least = nearest * METRES_PER_S
    assert got.range[got.echo].min() == pytest.approx(least, abs=1e-3)
    assert np.all(got.range[got.echo] >= least - 1e-3)


def test_a_filter_of_five_readings_lags_by_two():
    unit = ideal("maxbotix", averaging=5, average="mean", hysteresis=0.0)
    distance = 1.0 + 0.05 * np.arange(20)
    lag = distance - read(unit, distance).range
    plain = distance - read(replace(unit, averaging=1), distance).range
    assert (lag - plain)[5:] == pytest.approx(0.1, abs=0.01)


def test_rooms_are_low_and_have_rough_or_smooth_floors():
    rooms = [FRONT_ENDS["hcsr04"].room(np.random.default_rng(k)) for k in range(100)]
    assert min(room.height for room in rooms) < 0.2 < 1.0 < max(room.height for room in rooms)
    assert {room.floor_scatter_db for room in rooms} == {None, -30.0, -20.0}
