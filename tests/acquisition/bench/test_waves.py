"""Geometry, transducers and comparator against independently computed numbers."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from acquisition.bench import (
    MIRROR,
    RUBBER,
    Disc,
    Setup,
    Unit,
    Wall,
)
from acquisition.bench.acoustics.arrivals import FACE, Arrivals
from acquisition.bench.acoustics.geometry import PathGeometry, Poses, amplitude_scale
from acquisition.bench.acoustics.receiver import (
    GAINS,
    Pulses,
    SharedWaveforms,
    amplification,
    crossings,
    gain_over_time,
    noise,
    voltages,
    waveforms,
)
from acquisition.bench.acoustics.room import arrivals
from acquisition.bench.acoustics.transducer import PERIOD, Piston, pulse_at, pulse_phases
from acquisition.bench.firmware import first_echoes, smoothed, to_codes
from acquisition.bench.laboratory.air import Air, sound_speed

SPEED = float(sound_speed(19.0, 50.0))
WAVELENGTH = SPEED / 40e3
# no beam pattern, baseline, noise, hysteresis or clipping
BARE = replace(
    Unit.nominal(), radius=1e-6, baseline=0.0, noise=0.0, hysteresis=0.0, rail=1e9, leak_db=-300.0, sensitivity_db=0.0
)
EMPTY = Setup.static()
AIR = Air(np.array([19.0]), np.array([SPEED]), np.array([0.0]))


def one(value):
    return np.array([float(value)])


def geometry(distance, incidence_deg=0.0, shape=MIRROR, bearing_deg=0.0, setup=EMPTY, unit=BARE, reflectance=1.0):
    pose = Poses(one(distance), one(np.deg2rad(bearing_deg)), one(np.deg2rad(incidence_deg)), one(0.0), one(0.0))
    return PathGeometry(unit, replace(setup, reflector=shape), pose, one(reflectance), AIR)


def face(*args, **kwargs):
    return arrivals(geometry(*args, **kwargs)).only(FACE)


def signal(unit, paths, samples=1600, air=AIR):
    """Waveform at the receiver relative to the threshold at full gain."""
    weight = amplitude_scale(unit) * air.loss(paths.row, paths.length) * paths.amplitude
    return waveforms(unit, air.temperature_c, Pulses(paths.row, air.delay(paths.row, paths.length), weight), samples)[0]


def paths_of(*pairs):
    length, amplitude = np.array(pairs, dtype=complex).T
    return Arrivals.of([0], FACE, length.real[None], amplitude[None])


def steady_db(paths, distance):
    """Level of a continuous wave against a wall at the same distance, dB."""
    phase = np.exp(-4j * np.pi * paths.length / WAVELENGTH)
    return 20.0 * np.log10(abs((paths.amplitude * phase).sum()) * 2.0 * distance)


def burst_db(paths, distance):
    """Level of the burst's peak against a wall at the same distance, dB."""
    echo, wall = (np.abs(signal(BARE, w)).max() for w in (paths, paths_of((distance, 0.5 / distance))))
    return 20.0 * np.log10(echo / wall)


def test_peak_of_the_pulse():
    pulse = np.abs(pulse_at(Unit.nominal(), 20.0, 1e-6))
    assert np.argmax(pulse) * 1e-6 == pytest.approx(394e-6, abs=6e-6)
    assert 20.0 * np.log10(pulse.max()) == pytest.approx(-11.7, abs=0.1)


@pytest.mark.parametrize(("apart", "loss"), [(1e3, -1.0), (2e3, -3.0)])
def test_detuned_transducers_lose_level(apart, loss):
    tuned, apart_by = (
        np.abs(pulse_at(replace(Unit.nominal(), f_rx=40e3 + f / 2, f_tx=40e3 - f / 2), 20.0, 1e-6)).max()
        for f in (0.0, apart)
    )
    assert 20.0 * np.log10(apart_by / tuned) == pytest.approx(loss, abs=0.3)


@pytest.mark.parametrize(("db", "millimetres"), [(-20, 253), (-40, 382), (-60, 506)])
def test_ringing_decays_by_half_a_metre(db, millimetres):
    pulse = np.abs(pulse_at(Unit.nominal(), 20.0, 1e-6))
    last = np.flatnonzero(pulse > pulse.max() * 10.0 ** (db / 20.0))[-1] * 1e-6
    assert last * SPEED / 2.0 * 1e3 == pytest.approx(millimetres, rel=0.015)


def test_beam_is_55_degrees_wide_and_falls_as_a_piston_does():
    ka = 4.80
    angles = np.deg2rad([5.0, 10.0, 15.0, 20.0, 22.5, 25.0, 30.0, 35.0, 40.0, 45.0])
    expected = [-0.4, -1.5, -3.5, -6.2, -7.9, -9.9, -14.5, -20.4, -28.0, -39.0]
    assert 40.0 * np.log10(np.abs(Piston(ka)(angles))) == pytest.approx(expected, abs=0.25)
    assert 20.0 * np.log10(Piston(ka)(np.deg2rad(np.array([27.5])))[0]) == pytest.approx(-6.0, abs=0.1)


@pytest.mark.parametrize(
    ("over_db", "microseconds"),
    [(40, 28), (30, 52), (20, 79), (16, 104), (12, 129), (9, 154), (6, 180), (4, 205), (3, 230), (2, 255), (0.2, 356)],
)
def test_time_walk_of_the_first_crossing(over_db, microseconds):
    pulse = pulse_phases(Unit.nominal(), 20.0)[0] * 10.0 ** (over_db / 20.0)
    _, time = crossings(pulse[None].astype(np.complex64), BARE)
    assert time[0] * 1e6 == pytest.approx(microseconds, abs=1.6)


@pytest.mark.parametrize("over_db", [12, 20, 30, 40, 45])
def test_first_crossing_is_independent_of_the_sampling_phase(over_db):
    """Echoes at any delay, by the grid of arrivals and one sample a period: within 1.5 us of the exact crossing."""
    pulse = pulse_at(Unit.nominal(), 20.0, 1e-7) / np.abs(pulse_at(Unit.nominal(), 20.0, 1e-7)).max()
    t = np.arange(len(pulse)) * 1e-7
    voltage = (pulse * np.exp(2j * np.pi * 40e3 * t)).imag
    exact = t[np.argmax(voltage >= 10.0 ** (-over_db / 20.0))]
    delay = np.random.default_rng(0).uniform(5e-3, 6e-3, 100)
    weight = np.full(100, 10.0 ** (over_db / 20.0), dtype=complex)
    wave = waveforms(BARE, np.full(100, 20.0), Pulses(np.arange(100), delay, weight), 600)
    ping, time = crossings(wave.astype(np.complex64), BARE)
    late = time[np.searchsorted(ping, np.arange(100))] - delay - exact
    assert np.abs(late).max() < 1.5e-6


def test_time_walk_in_millimetres_and_its_comb():
    """13.5 mm at +20 dB, 44 mm at +2 dB, and everything between in steps of 4.29 mm."""
    levels = np.linspace(1.0, 25.0, 97)
    pulse = pulse_phases(Unit.nominal(), 20.0)[0]
    z = (pulse * 10.0 ** (levels[:, None] / 20.0)).astype(np.complex64)
    ping, time = crossings(z, BARE)
    walk = time[np.searchsorted(ping, np.arange(len(levels)))] * SPEED / 2.0 * 1e3
    assert np.interp([2.0, 20.0], levels, walk) == pytest.approx([44.0, 13.5], abs=0.5)
    steps = -np.diff(walk)
    slips = steps[steps > 1.0]
    assert len(slips) >= 8
    assert slips == pytest.approx(4.29, abs=0.75)
    assert (walk.max() - walk.min()) / len(slips) == pytest.approx(4.29, abs=0.15)


def test_disc_on_axis_equals_the_exact_solution():
    """1/(2d) [delta(2d) - (d/R)^2 delta(2R)], summed over the outline."""
    paths = face(0.7)
    distance, rim = 0.7, np.hypot(0.7, 0.1)
    assert paths.amplitude[0] == pytest.approx(1.0 / (2.0 * distance))
    assert paths.length[1:] == pytest.approx(rim, abs=2e-6)
    assert paths.amplitude[1:].sum().real == pytest.approx(-distance / (2.0 * rim**2), rel=1e-4)


@pytest.mark.parametrize(
    ("distance", "level"), [(1.163, -18.0), (0.578, -12.0), (0.382, -9.0), (1.10, -9.0), (1.25, -7.0), (2.33, 6.0)]
)
def test_burst_from_the_disc_has_its_nulls_and_maxima(distance, level):
    assert burst_db(face(distance), distance) == pytest.approx(level, abs=0.5)


def test_a_degree_of_tilt_removes_the_null():
    assert burst_db(face(1.163, 1.0), 1.163) > -1.0


# dB against a wall, continuous wave, at 0, 1, 2, 3, 5, 10, 15, 20, 30 degrees of tilt
TILTS = (0, 1, 2, 3, 5, 10, 15, 20)
DISC = {
    0.5: (4, -1, -1, 2, 0, -3, -13, -20),
    1.0: (0, 0, 1, 2, -5, -20, -27, -30),
    2.0: (6, 1, -1, -7, -18, -31, -36, -37),
    6.0: (1, -7, -14, -23, -32, -43, -47, -47),
}
PLATE = {
    0.5: (-4, -2, 0, -1, -3, -15, -21, -22),
    1.0: (4, 2, 0, -2, -7, -21, -23, -23),
    2.0: (4, 0, -8, -7, -13, -26, -26, -26),
    6.0: (-4, -8, -25, -17, -22, -36, -35, -35),
}


@pytest.mark.parametrize(("shape", "table"), [(MIRROR, DISC), (RUBBER, PLATE)], ids=["disc", "plate"])
def test_tilted_reflectors_against_the_surface_integral(shape, table):
    for distance, row in table.items():
        levels = [steady_db(face(distance, tilt, shape), distance) for tilt in TILTS]
        assert levels == pytest.approx(row, abs=1.2), distance


def test_mirror_echo_is_lost_where_the_perpendicular_misses_the_face():
    """At 1 m the disc mirrors up to atan(0.1/1) = 5.7 degrees; beyond, only its outline is left."""
    assert face(1.0, 5.5).amplitude[0].real > 0.0
    assert face(1.0, 5.9).length.min() > 1.0 * np.cos(np.deg2rad(5.9))
    assert burst_db(face(1.0, 8.0), 1.0) < -12.0


def test_range_is_the_perpendicular_or_the_distance_of_the_edge():
    paths = face(0.5, 10.0)
    assert paths.length[0] == pytest.approx(0.5 * np.cos(np.deg2rad(10.0)))
    tilted = face(2.0, 22.5)
    near = np.sqrt(2.0**2 + 0.1**2 - 2.0 * 2.0 * 0.1 * np.sin(np.deg2rad(22.5)))
    assert tilted.length.min() == pytest.approx(near, abs=1e-4)


def test_large_disc_is_a_wall_until_its_rim_arrives():
    disc, wall = face(1.0, 0.0, Disc(3.0)), face(1.0, 0.0, Wall())
    assert disc.amplitude[0] == wall.amplitude[0] == pytest.approx(0.5)
    assert disc.length[1:].min() > 3.0


def test_gain_steps_every_70_us_up_to_its_cap():
    gain = gain_over_time(31, 1500)
    assert gain[0] * 1025 == 94
    assert np.flatnonzero(gain == 1.0)[0] * PERIOD == pytest.approx(31 * 70e-6, abs=PERIOD)
    assert 20.0 * np.log10(gain[-1] / gain_over_time(11, 1500)[-1]) == pytest.approx(17.4, abs=0.05)
    assert 20.0 * np.log10(1025 / 94) == pytest.approx(20.75, abs=0.01)
    closed = 1.0 / (1.0 / 94.0 - 3.117e-4 * np.arange(32))
    assert list(GAINS) == pytest.approx(list(closed), rel=0.008)


def test_wall_at_six_metres_just_reaches_the_threshold_at_full_gain():
    wave = signal(BARE, paths_of((6.0, 1.0 / 12.0)), air=replace(AIR, absorption_db=one(1.29)))
    assert np.abs(wave).max() == pytest.approx(1.0, abs=0.01)


def test_waveform_is_the_sum_of_delayed_pulses():
    """Against the pulse sampled at the exact delay."""
    given = paths_of((1.2345, 0.3), (1.30, -0.1), (2.0, 0.2j))
    wave = signal(BARE, given, 900)
    fine = pulse_at(BARE, 19.0, PERIOD / 32)
    expected = np.zeros(900, dtype=complex)
    for length, amplitude in zip(given.length, given.amplitude, strict=True):
        delay = 2.0 * length / SPEED
        at = np.arange(900) * PERIOD - delay
        grid = np.arange(len(fine)) * PERIOD / 32
        copy = np.interp(at, grid, fine.real, 0, 0) + 1j * np.interp(at, grid, fine.imag, 0, 0)
        expected += amplitude * np.exp(-2j * np.pi * 40e3 * delay) * copy
    scale = np.abs(wave).max() / np.abs(expected).max()
    np.testing.assert_allclose(wave, expected * scale, atol=2e-3 * np.abs(wave).max())


def test_noise_has_unit_variance_and_the_amplifiers_correlation():
    z = noise((200, 1000), np.random.default_rng(0))
    assert z.real.std() == pytest.approx(1.0, abs=0.01)
    assert (z[:, 1:] * z[:, :-1].conj()).mean().real / 2.0 == pytest.approx(np.exp(-np.pi / 4.0), abs=0.02)


def test_false_alarm_rate_at_full_gain():
    """Noise at a quarter to a sixth of the threshold: from one in 10,000 pings to some in a hundred."""
    rng = np.random.default_rng(0)
    rates = []
    for level in (1.0 / 4.0, 1.0 / 6.0):
        unit = replace(Unit.nominal(), noise=level)
        ping, _ = crossings(noise((2000, 1440), rng) * np.float32(level), unit)
        rates.append(len(np.unique(ping)) / 2000)
    assert 0.02 < rates[0] < 0.3
    assert rates[1] < 3e-3


def test_dead_time_blanking_and_gate_bound_the_echoes():
    unit = replace(Unit.nominal(), blanking=1e-3, rearm=2e-3)
    time = np.array([0.5e-3, 1.5e-3, 2.0e-3, 3.4e-3, 3.6e-3, 9e-3, 0.9e-3, 12e-3])
    ping = np.array([0, 0, 0, 0, 0, 0, 2, 2])
    detected = first_echoes(ping, time, 3, unit, listening=10e-3)
    np.testing.assert_allclose(detected[0, :4], [1.5e-3, 3.6e-3, 9e-3, np.nan])
    assert np.isnan(detected[1:]).all()


def test_at_most_seventeen_echoes():
    time = np.arange(1, 40) * 1e-3
    detected = first_echoes(np.zeros(39, dtype=int), time, 1, replace(Unit.nominal(), rearm=0.5e-3), 1.0)
    assert detected.shape == (1, 17)
    np.testing.assert_allclose(detected[0], time[:17])


@pytest.mark.parametrize(("output", "code"), [("cm", 100), ("inch", 39), ("us", 5800)])
def test_codes_of_a_metre(output, code):
    unit = replace(Unit.nominal(), t_offset=0.0)
    assert to_codes(np.array([5.8e-3, np.nan]), unit, output).tolist() == [code, 0]


def test_fast_clock_reads_long_and_truncation_reads_short():
    time = np.array([17.445e-3])
    unit = replace(Unit.nominal(), t_offset=0.0)
    assert to_codes(time, replace(unit, clock_error=0.005), "us")[0] == 17_532
    assert to_codes(time, replace(unit, rounding="down"), "cm")[0] == 300
    assert to_codes(time, replace(unit, rounding="nearest"), "cm")[0] == 301


def test_no_detection_during_recovery_from_clipping():
    unit = replace(BARE, rail=5.0, recovery=75e-6)
    z = np.zeros((1, 60), dtype=np.complex64)
    z[0, 10:20], z[0, 20:40] = 6.0, 2.0
    _, time = crossings(z, unit)
    sample = np.unique((time / PERIOD).astype(int))
    assert 20 not in sample
    assert 22 not in sample
    assert 23 in sample


def test_omitting_inactive_samples_does_not_change_the_echoes():
    """Detection rate, mean and spread of the echoes agree with a computation of all samples."""
    unit, none = Unit.nominal(), np.zeros((400, 1))
    waves = [SharedWaveforms(signal(unit, paths_of((2.0, 0.11)), 1440)[None], none + 1.0, none)]
    gain = amplification(unit, Setup(gain=20), 1440)

    def times(seed, waves):
        z, start = voltages(waves, np.full(400, unit.noise), gain, None, np.random.default_rng(seed))
        ping, time = crossings(z, unit)
        return first_echoes(ping, time + start * PERIOD, 400, unit, 1.0)[:, 0], z.shape[1]

    short, width = times(0, waves)
    unbounded = SimpleNamespace(bound=lambda: 1e9, total=lambda active: 0.0)  # makes all samples active
    whole, full = times(1, [*waves, unbounded])
    assert width < 0.2 * full == 0.2 * 1440
    assert np.mean(np.isnan(short)) == pytest.approx(np.mean(np.isnan(whole)), abs=0.05)
    assert np.nanmean(short) == pytest.approx(np.nanmean(whole), abs=2e-6)
    assert np.nanstd(short) == pytest.approx(np.nanstd(whole), rel=0.25)


def test_firmware_averages_first_echoes_within_a_run():
    code = np.zeros((6, 17), dtype=np.uint16)
    code[:, 0] = [100, 200, 0, 300, 400, 500]
    run = np.array([0, 0, 0, 0, 1, 1])
    mean = replace(Unit.nominal(), averaging=3)
    assert smoothed(code, run, mean, "cm")[:, 0].tolist() == [100, 150, 0, 200, 400, 450]
    assert smoothed(code, run, replace(mean, averaging=1), "cm")[:, 0].tolist() == code[:, 0].tolist()
    code[3, 0] = 900
    assert smoothed(code, run, replace(mean, average="median"), "cm")[3, 0] == 200


def test_firmware_dead_band_repeats_the_previous_output():
    code = np.zeros((7, 17), dtype=np.uint16)
    code[:, 0] = [5800, 5850, 0, 5890, 5910, 5830, 5790]
    unit = replace(Unit.nominal(), deadband=100e-6)
    assert smoothed(code, np.zeros(7, dtype=int), unit, "us")[:, 0].tolist() == [5800, 5800, 0, 5800, 5910, 5910, 5790]


def test_capacitor_ramp_shortens_long_times():
    """t is measured as tau (1 - exp(-t / tau)): short by t^2 / (2 tau), so by the square of distance."""
    unit = replace(Unit.nominal(), t_offset=0.0, ramp_tau_s=1.0)
    time = np.array([6e-3, 12e-3, 24e-3])
    short = time * 1e6 - to_codes(time, unit, "us")
    assert short == pytest.approx([18.0, 72.0, 288.0], abs=2.5)
