"""Physics of the rig against known answers: speckle, near ranges, ringing in the cold, the pattern over the band."""

from dataclasses import replace

import numpy as np
import pytest

from acquisition import Ping
from acquisition.bench import Plate, Rig, Setup, Unit, Wall
from acquisition.bench.acoustics.arrivals import FACE
from acquisition.bench.acoustics.geometry import PathGeometry, Poses
from acquisition.bench.acoustics.room import arrivals
from acquisition.bench.acoustics.transducer import PULSE_STEP, REFERENCE_C, Piston, pulse_at
from acquisition.bench.firmware import PER_UNIT
from acquisition.bench.laboratory.air import CARRIER, Air, sound_speed
from acquisition.ping import RANGE_RATE

SPEED = float(sound_speed(19.0, 50.0))
WIDTH_M, DISTANCE_M, SLOPE = 0.4, 2.0, np.deg2rad(35.0)
ROUGH = Setup.static(roughness_m=3e-3, reflector=Plate(WIDTH_M, WIDTH_M))
ALL_SIDES = replace(Unit.nominal(), radius=1e-6, leak_db=-300.0, sensitivity_db=60.0)
# in turning by this angle, the ends of the plate move apart by half a wavelength of the way there and back
SPECKLE_RAD = SPEED / CARRIER / (2.0 * WIDTH_M)


def speckle(incidence):
    """Return the complex echo of a rough plate at one frequency, by its incidence, rad."""
    n, none = len(incidence), np.zeros(len(incidence))
    poses = Poses(np.full(n, DISTANCE_M), none, incidence, none, none)
    air = Air(np.full(n, 19.0), np.full(n, SPEED), none)
    paths = arrivals(PathGeometry(ALL_SIDES, ROUGH, poses, np.ones(n), air)).only(FACE)
    wave = paths.amplitude * np.exp(-4j * np.pi * CARRIER / SPEED * paths.length)
    return np.bincount(paths.row, wave.real, n) + 1j * np.bincount(paths.row, wave.imag, n)


def test_a_rough_face_is_fully_developed_speckle():
    """Its level is exponential in power (Goodman): mean and standard deviation agree, over independent aspects."""
    echo = speckle(SLOPE + 2.0 * SPECKLE_RAD * np.arange(-30, 31) / 2.0)
    power = np.abs(echo) ** 2
    assert power.std() / power.mean() == pytest.approx(1.0, abs=0.3)
    assert np.abs(echo.mean()) ** 2 < 0.15 * power.mean()


def test_speckle_is_correlated_over_the_angle_that_the_face_subtends():
    """The correlation of a square's speckle is the sinc function: 1, about 2/pi at half, 0 at the whole angle."""
    base = SLOPE + SPECKLE_RAD * np.arange(-40, 41)
    here = speckle(base)
    for share, expected in ((0.0, 1.0), (0.5, 2.0 / np.pi), (1.0, 0.0)):
        there = speckle(base + share * SPECKLE_RAD / np.cos(SLOPE))
        found = np.abs(np.vdot(here, there)) / np.sqrt(np.vdot(here, here) * np.vdot(there, there)).real
        assert found == pytest.approx(expected, abs=0.2)


def test_nothing_is_read_right_before_the_end_of_blanking():
    """An SRF08 fails below 3 cm: what arrives while it is deaf is read at the end of blanking, or by a later bounce."""
    unit = replace(Unit.nominal(), noise=0.0, leak_db=-300.0)
    near = np.linspace(0.005, 0.028, 24)
    setup = Setup.static(gain=31, output="us", reflector=Wall())
    reading = Rig(unit, setup).ping(Ping.of(near), np.random.default_rng(0)).reading(setup)
    least = (unit.blanking + unit.t_offset) / PER_UNIT["cm"] * 0.01
    assert least == pytest.approx(0.0328, abs=1e-4)
    assert np.all(reading.range[reading.echo] >= least - 1e-4)
    right = Rig(unit, setup).ping(Ping.of(np.linspace(0.045, 0.1, 12)), np.random.default_rng(0)).reading(setup)
    assert np.all(np.abs(right.range - np.linspace(0.045, 0.1, 12)) < 0.015)


def decay(unit, temperature_c):
    """Return the rate at which the amplitude of a unit's ringing falls, 1/s, long after the burst."""
    wave = np.abs(pulse_at(unit, temperature_c, PULSE_STEP))
    late = slice(int(2.5e-3 / PULSE_STEP), int(4.0e-3 / PULSE_STEP))
    return -np.polyfit(PULSE_STEP * np.arange(len(wave))[late], np.log(wave[late]), 1)[0]


def test_ringing_falls_at_the_rate_of_the_resonance_and_longer_in_the_cold():
    """The amplitude falls as exp(-pi f t / Q): of two resonators, the one of higher quality is heard last."""
    unit = replace(Unit.nominal(), q_tx=50.0, q_rx=15.0, q_slope=-0.004)
    for temperature_c in (-20.0, REFERENCE_C, 45.0):
        warmer = temperature_c - REFERENCE_C
        frequency, quality = unit.f_tx + unit.f_slope * warmer, unit.q_tx * (1.0 + unit.q_slope * warmer)
        assert decay(unit, temperature_c) == pytest.approx(np.pi * frequency / quality, rel=0.03)


def test_the_beam_over_the_bands_frequencies_is_that_of_the_carrier():
    """Within the cone of 55 degrees, the pattern of the burst's whole band differs by less than 0.1 dB."""
    pulse = pulse_at(Unit.nominal(), REFERENCE_C, PULSE_STEP)
    power = np.abs(np.fft.fft(pulse)) ** 2
    offset = np.fft.fftfreq(len(pulse), PULSE_STEP)
    ka = 2.0 * np.pi * CARRIER * Unit.nominal().radius / SPEED
    for degrees in (5.0, 15.0, 27.5):
        angle = np.array([np.deg2rad(degrees)])
        band = np.abs(offset) < 5e3
        each = np.array([Piston(ka * (1.0 + f / CARRIER))(angle)[0] ** 2 for f in offset[band]])
        level = np.sqrt(np.average(each**2, weights=power[band]))
        assert 20.0 * np.log10(level / Piston(ka)(angle)[0] ** 2) == pytest.approx(0.0, abs=0.1)


@pytest.mark.parametrize("rate", [-1.5, 1.0])
def test_a_moving_wall_is_met_where_it_is_when_the_sound_arrives(rate):
    """At distance d, when the burst is fired, sound that travels at c meets it after d/(c - v), and returns as long."""
    distance = np.array([0.5, 1.0, 2.0, 3.0])
    setup = Setup.static(gain=31, output="us", reflector=Wall())
    unit = replace(Unit.nominal(), noise=0.0, leak_db=-300.0)
    still = Ping.of(distance, time=np.arange(4.0))
    moving = replace(still, covariates={RANGE_RATE: np.full(4, rate)})
    before, after = (
        Rig(unit, setup).ping(ping, np.random.default_rng(0)).code[:, 0].astype(float) for ping in (still, moving)
    )
    speed = float(sound_speed(setup.temperature_c, setup.humidity_pct))
    later = 2e6 * distance * (1.0 / (speed - rate) - 1.0 / speed)
    assert after - before == pytest.approx(later, abs=1.5)  # us, to which times are rounded


def test_the_doppler_shift_at_walking_speed_is_less_than_a_decibel():
    """An echo from 1 m/s is 233 Hz higher: as if the receiver were tuned 233 Hz lower."""
    shift = 2.0 * 1.0 / SPEED * CARRIER
    assert shift == pytest.approx(233.0, abs=0.5)
    unit = Unit.nominal()
    level = [np.abs(pulse_at(u, REFERENCE_C, PULSE_STEP)).max() for u in (unit, replace(unit, f_rx=unit.f_rx - shift))]
    assert abs(20.0 * np.log10(level[1] / level[0])) < 1.0
