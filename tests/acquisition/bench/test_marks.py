"""Scatter, drift, offsets and electronics: size of each effect at the registers."""

from dataclasses import replace

import numpy as np
import pytest

from acquisition import EchoStatus, Ping
from acquisition.bench import MIRROR, Bus, Reverberation, Rig, Setup, Unit, Wall
from acquisition.bench.laboratory.air import sound_speed

STATIC = Setup.static(gain=31, output="us", range_register=255)
WALL = replace(STATIC, reflector=Wall())
QUIET = replace(Unit.nominal(), noise=0.0, leak_db=-300.0, sensitivity_db=20.0)
US_PER_M = 2e6 / float(sound_speed(19.0, 50.0))


def first(unit, setup, ping, seed=0):
    return Rig(unit, setup).ping(ping, np.random.default_rng(seed)).code[:, 0].astype(float)


def visits(distance, n, interval=2.4, **conditions):
    """Pings that are one visit each, as runs of one ping."""
    return Ping.of(np.full(n, distance), time=interval * np.arange(n), run=np.arange(n), **conditions)


def needed(unit, setup, ping):
    """Lowest sensitivity at which a ping has an echo, dB."""
    low, high = -60.0, 60.0
    while high - low > 0.02:
        middle = 0.5 * (low + high)
        detected = first(replace(unit, sensitivity_db=middle), setup, ping)[0] > 0
        low, high = (low, middle) if detected else (middle, high)
    return high


def test_drift_scales_all_readings_by_the_root_of_temperature():
    """0.5 K of slow drift: -0.175 % a kelvin, the same share near and far, and slow."""
    ping = Ping.of(np.tile([2.0, 4.0], 2000), time=20.0 * np.arange(4000))
    setup = replace(WALL, drift_c=0.5, drift_tau_s=3000.0)
    unit = replace(QUIET, f_slope=0.0, rail=1e9)
    near, far = first(unit, setup, ping).reshape(-1, 2).T
    share = near / first(unit, WALL, ping[:1])[0] - 1.0
    assert share.std() == pytest.approx(0.5 * 0.00175, rel=0.35)
    assert np.corrcoef(near, far)[0, 1] > 0.99
    assert (far.std() / near.std()) == pytest.approx(2.0, rel=0.03)
    assert np.corrcoef(near[1:], near[:-1])[0, 1] == pytest.approx(np.exp(-40.0 / 3000.0), abs=0.02)


def test_jitter_grows_with_the_root_of_distance():
    setup = replace(WALL, jitter_m=2e-3, flutter_tau_s=0.1)
    unit = replace(QUIET, sensitivity_db=6.0, rail=1e9)
    for distance in (1.5, 6.0):
        read = first(unit, setup, Ping.of(np.full(1500, distance), time=2.4 * np.arange(1500)))
        assert read.std() / US_PER_M == pytest.approx(2e-3 * np.sqrt(distance / 6.0), rel=0.08)


def test_scintillation_is_a_normal_level_error_per_ping():
    """1 dB at 6 m: the fraction of detected pings over sensitivity is a normal distribution function of that width."""
    setup = replace(WALL, scintillation_db=1.0, flutter_tau_s=0.1)
    ping = Ping.of(np.full(2000, 6.0), time=2.4 * np.arange(2000))
    middle = needed(QUIET, WALL, ping[:1])
    detected = [np.mean(first(replace(QUIET, sensitivity_db=middle + db), setup, ping) > 0) for db in (-1.0, 0.0, 1.0)]
    assert detected == pytest.approx([0.159, 0.5, 0.841], abs=0.035)


def test_placement_error_is_per_visit():
    setup = replace(WALL, placement_m=5e-3)
    unit = replace(QUIET, rail=1e9)
    assert first(unit, setup, visits(2.0, 800)).std() / US_PER_M == pytest.approx(5e-3, rel=0.09)
    assert np.ptp(first(unit, setup, Ping.of(np.full(50, 2.0), time=2.4 * np.arange(50)))) <= 1.0


def test_tilt_and_bearing_errors_scatter_the_level_of_a_disc():
    """At 6 m a lobe is half a degree wide: some visits with scatter have no echo. Bearing acts by the beam."""
    disc = replace(STATIC, reflector=MIRROR)
    ping = visits(6.0, 200)
    middle = needed(QUIET, disc, ping[:1])
    fainter = replace(QUIET, sensitivity_db=middle + 2.0)
    assert (first(fainter, disc, ping) > 0).all()
    share = np.mean(first(fainter, replace(disc, tilt_deg=0.6), ping) > 0)
    assert 0.2 < share < 0.9
    aside = visits(2.0, 200, angle=np.deg2rad(20.0), incidence=0.0)
    fainter = replace(QUIET, sensitivity_db=needed(QUIET, disc, aside[:1]) + 0.5)
    assert (first(fainter, disc, aside) > 0).all()
    share = np.mean(first(fainter, replace(disc, placement_deg=2.0), aside) > 0)  # 0.6 dB a degree there
    assert share == pytest.approx(0.66, abs=0.12)


def test_zero_and_firmware_offset_shift_all_readings_equally():
    ping = Ping.of([1.0, 2.0, 4.0], time=2.4 * np.arange(3))
    unit = replace(QUIET, rail=1e9)
    base = first(unit, WALL, ping)
    assert first(unit, replace(WALL, zero_m=0.02), ping) - base == pytest.approx(0.02 * US_PER_M, abs=3.0)
    assert first(replace(unit, t_offset=unit.t_offset - 40e-6), WALL, ping) - base == pytest.approx(-40.0, abs=1.0)


def test_boresight_moves_the_centre_of_the_beam():
    """Yawed by 3 degrees, a facing disc is as strong at 13 degrees as at -7, and as without yaw at 10."""
    disc = replace(STATIC, reflector=MIRROR)

    def level(yaw_deg, bearing_deg):
        ping = Ping.of(2.0, np.deg2rad(bearing_deg), 0.0)
        return needed(replace(QUIET, yaw=np.deg2rad(yaw_deg)), disc, ping)

    assert [level(3.0, 13.0), level(3.0, -7.0)] == pytest.approx([level(0.0, 10.0)] * 2, abs=0.1)
    assert level(0.0, 13.0) - level(0.0, 10.0) == pytest.approx(1.1, abs=0.2)  # 40 log D: -1.5 dB, -2.6 dB


def test_hysteresis_raises_the_threshold_by_half_of_it():
    ping = Ping.of(4.0)
    levels = [needed(replace(QUIET, hysteresis=h), WALL, ping) for h in (0.0, 0.10)]
    assert levels[1] - levels[0] == pytest.approx(20.0 * np.log10(1.05), abs=0.05)


def test_readings_are_multiples_of_the_tick():
    unit = replace(QUIET, tick=64e-6, t_offset=0.0)
    code = first(unit, WALL, Ping.of(np.linspace(1.0, 3.0, 60), time=2.4 * np.arange(60)))
    assert not (code % 64).any()
    assert len(np.unique(code)) > 50


def test_open_line_is_no_answer():
    setup = replace(WALL, bus=Bus(all_ones=0.2, dwell_s=5.0))
    ping = Ping.of(np.full(3000, 2.0), time=0.5 * np.arange(3000))
    status = Rig(QUIET, setup).ping(ping, np.random.default_rng(0)).reading(setup).status
    lost = status == EchoStatus.NO_ANSWER
    assert lost.mean() == pytest.approx(0.2, abs=0.07)
    assert (status[~lost] == EchoStatus.ECHO).all()


def test_detuning_by_temperature_costs_level():
    """Tuned at 20 degC, -60 Hz/K: 15 K detune both resonances by 0.9 kHz."""
    setup = replace(WALL, temperature_c=35.0, humidity_pct=50.0)
    ping = Ping.of(2.0)
    tuned, off = (needed(replace(QUIET, f_slope=slope), setup, ping) for slope in (0.0, -60.0))
    assert 0.5 < off - tuned < 4.0


def test_reverberation_raises_false_alarms_at_short_intervals():
    """Mixed after 10 ms: before that there is only reverberation of previous pings, decayed by 442 dB/s."""
    setup = replace(STATIC, reverberation=Reverberation(-34.0, 442.0), range_register=140)
    unit = replace(QUIET, rearm=0.2e-3)

    def early(interval):
        ping = Ping.of(np.full(200, 3.0), reflectance=0.0, time=interval * np.arange(200))
        code = Rig(unit, setup).ping(ping, np.random.default_rng(0)).code
        return np.mean(((code > 0) & (code < 9000)).any(axis=1))

    rates = [early(interval) for interval in (0.040, 0.070, 0.140)]
    assert rates[0] > 0.9
    assert 0.2 < rates[1] < 0.7
    assert rates[2] == 0.0


def test_reverberation_has_its_level_and_decay():
    """Level of the waveform, 442 dB/s: mean square over many pings, against the pressure at 1 m."""
    setup = replace(STATIC, reverberation=Reverberation(-30.0, 442.0))
    ping = Ping.of(np.full(120, 3.0), reflectance=0.0, time=2.4 * np.arange(120))
    for late_ms, db in ((15.0, -30.0 - 442.0 * 0.005), (35.0, -30.0 - 442.0 * 0.025)):
        near = replace(QUIET, blanking=late_ms * 1e-3, sensitivity_db=0.0)
        reach = 12.0 * 10.0 ** (1.29 * 12.0 / 20.0)  # of a pressure of 1 over the threshold at full gain
        share = []
        for over_db in (-3.0, 3.0):  # of the threshold over the rms
            unit = replace(near, sensitivity_db=-20.0 * np.log10(reach) - db - over_db)
            code = first(unit, setup, ping)
            share.append(np.mean((code > late_ms * 1e3 - 100) & (code < late_ms * 1e3 + 300)))
        assert share[0] > 0.75
        assert share[1] < 0.75
        assert share[0] > share[1] + 0.2
