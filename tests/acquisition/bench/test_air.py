"""Air against the tables of the standards."""

import numpy as np
import pytest

from acquisition.bench.laboratory.air import Drift, absorption_db, flutter, sound_speed

# Cramer 1993 at 0.04 % CO2, m/s, for 0, 50 and 80 % of humidity
SPEEDS = {
    10: (337.5, 337.8, 338.0),
    17: (341.6, 342.1, 342.4),
    19: (342.8, 343.4, 343.7),
    22: (344.5, 345.2, 345.7),
    25: (346.3, 347.1, 347.6),
}
# ISO 9613-1 at 40 kHz, dB/m, for 10, 20 ... 90 % of humidity
ABSORPTION = {
    10: (0.31, 0.43, 0.57, 0.72, 0.85, 0.96, 1.04, 1.09, 1.13),
    19: (0.44, 0.74, 1.01, 1.20, 1.29, 1.31, 1.28, 1.24, 1.19),
    30: (0.81, 1.37, 1.53, 1.46, 1.34, 1.22, 1.11, 1.02, 0.95),
}


@pytest.mark.parametrize("temperature", SPEEDS)
def test_sound_speed(temperature):
    assert sound_speed(temperature, np.array([0.0, 50.0, 80.0])) == pytest.approx(SPEEDS[temperature], abs=0.06)


@pytest.mark.parametrize("temperature", ABSORPTION)
def test_absorption(temperature):
    humidity = np.arange(10.0, 91.0, 10.0)
    assert absorption_db(temperature, humidity) == pytest.approx(ABSORPTION[temperature], abs=0.011)


def test_sound_speeds_up_by_a_sixth_of_a_percent_a_kelvin():
    assert float(sound_speed(20.0) / sound_speed(19.0)) - 1.0 == pytest.approx(0.00175, abs=1e-4)


def test_drift_has_its_standard_deviation_and_correlation_time():
    time = np.array([0.0, 600.0, 3600.0])
    rng = np.random.default_rng(1)
    drawn = np.stack([Drift.draw(0.5, 3600.0, rng)(time) for _ in range(4000)])
    assert drawn.std(axis=0) == pytest.approx(0.5, rel=0.05)
    expected = np.exp(-np.array([600.0, 3600.0]) / 3600.0)
    assert [np.corrcoef(drawn[:, 0], drawn[:, k])[0, 1] for k in (1, 2)] == pytest.approx(expected, abs=0.05)


def test_drift_is_a_function_of_time_alone():
    drift = Drift.draw(0.5, 100.0, np.random.default_rng(3))
    time = np.linspace(0.0, 500.0, 11)
    np.testing.assert_allclose(drift(time[4:6]), drift(time)[4:6])


def test_flutter_has_its_correlation_time():
    time = np.arange(20_000) * 2.4
    rows = flutter(time, time == 0.0, 2.0, 2, np.random.default_rng(0))
    assert rows.std() == pytest.approx(1.0, abs=0.03)
    assert np.corrcoef(rows[1:, 0], rows[:-1, 0])[0, 1] == pytest.approx(np.exp(-1.2), abs=0.03)
    assert abs(np.corrcoef(rows[:, 0], rows[:, 1])[0, 1]) < 0.03
