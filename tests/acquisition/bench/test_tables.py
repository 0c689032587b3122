"""Tables of independently computed numbers."""

from dataclasses import replace

import numpy as np
import pytest

from acquisition import Ping
from acquisition.bench import MIRROR, RUBBER, Disc, Plate, Post, Rig, Room, Setup, Unit, Wall
from acquisition.bench.acoustics.arrivals import FACE, FLOOR, POST
from acquisition.bench.acoustics.geometry import PathGeometry, Poses
from acquisition.bench.acoustics.receiver import Pulses, crossings, gain_over_time, waveforms
from acquisition.bench.acoustics.room import arrivals
from acquisition.bench.acoustics.transducer import PERIOD, pulse_at, pulse_phases
from acquisition.bench.laboratory.air import Air, sound_speed

SPEED = float(sound_speed(19.0, 50.0))
WAVELENGTH = SPEED / 40e3
# omnidirectional, without leak
BARE = replace(
    Unit.nominal(), radius=1e-6, baseline=0.0, noise=0.0, hysteresis=0.0, rail=1e9, leak_db=-300.0, sensitivity_db=0.0
)
STATIC = Setup.static()


def geometry(distance, incidence_deg=0.0, shape=MIRROR, setup=STATIC, unit=BARE, reflectance=1.0):
    pose = Poses(*(np.array([float(x)]) for x in (distance, 0.0, np.deg2rad(incidence_deg), 0.0, 0.0)))
    air = Air(np.array([19.0]), np.array([SPEED]), np.array([0.0]))
    return PathGeometry(unit, replace(setup, reflector=shape), pose, np.array([reflectance]), air)


def face(*args, **kwargs):
    return arrivals(geometry(*args, **kwargs)).only(FACE)


def steady_db(paths, distance):
    """Level of a continuous wave against a wall at the same distance, dB."""
    total = (paths.amplitude * np.exp(-4j * np.pi * paths.length / WAVELENGTH)).sum()
    return 20.0 * np.log10(abs(total) * 2.0 * distance)


def burst_db(paths, distance):
    """Level of the burst's peak against that from a wall at the same distance, dB."""
    pulses = Pulses(np.zeros(len(paths), dtype=int), 2.0 * paths.length / SPEED, paths.amplitude)
    wave = waveforms(BARE, np.array([20.0]), pulses, 1600)
    return 20.0 * np.log10(np.abs(wave).max() * 2.0 * distance)


@pytest.mark.parametrize(("width_hz", "q"), [(1.2e3, 57.7), (2.6e3, 26.6)])
def test_time_walk_of_narrow_and_wide_transducers(width_hz, q):
    """Width at -6 dB is sqrt(3) f / Q; first crossings in mm, of which each is one of a comb of 4.29 mm."""
    assert np.sqrt(3.0) * 40e3 / q == pytest.approx(width_hz, rel=0.005)
    over_db = [40, 30, 20, 16, 12, 9, 6, 4, 3, 2, 1, 0.2]
    table = {
        1.2e3: [4.9, 9.2, 18, 22, 26.5, 31, 39, 44, 52, 57, 65, 83],
        2.6e3: [4.6, 9, 13, 14, 18, 22, 27, 31, 35, 39, 44, 52],
    }
    unit = replace(BARE, q_tx=q, q_rx=q)
    pulse = pulse_phases(unit, 20.0)[0]
    z = pulse / np.abs(pulse).max() * 10.0 ** (np.array(over_db)[:, None] / 20.0)
    ping, time = crossings(z.astype(np.complex64), unit)
    first = time[np.searchsorted(ping, np.arange(len(over_db)))] * SPEED / 2.0 * 1e3
    assert np.abs(first - table[width_hz]).max() < 4.5  # one slip, where a level is between two periods
    assert np.mean(np.abs(first - table[width_hz]) < 1.0) >= 0.75


@pytest.mark.parametrize(("q", "millimetres"), [(57.7, (403, 622, 828)), (25.0, (189, 283, 369))])
def test_ringing_of_other_transducers(q, millimetres):
    pulse = np.abs(pulse_at(replace(BARE, q_tx=q, q_rx=q), 20.0, 1e-6))
    for db, expected in zip((-20, -40, -60), millimetres, strict=True):
        last = np.flatnonzero(pulse > pulse.max() * 10.0 ** (db / 20.0))[-1] * 1e-6
        assert last * SPEED / 2.0 * 1e3 == pytest.approx(expected, rel=0.03), db


@pytest.mark.parametrize(
    ("distance", "level"), [(1.05, -3.7), (1.10, -9.0), (1.15, -23.0), (1.20, -14.0), (1.25, -7.0)]
)
def test_continuous_wave_of_a_disc_near_its_null(distance, level):
    assert steady_db(face(distance), distance) == pytest.approx(level, abs=0.7)


@pytest.mark.parametrize(("distance", "level"), [(2.33, 6.0), (0.77, 6.0), (0.46, 6.0)])
def test_maxima_of_a_disc(distance, level):
    assert steady_db(face(distance), distance) == pytest.approx(level, abs=0.2)


def test_centring_error_removes_the_null_of_a_disc():
    """20 mm aside at 1.163 m: the rim's echoes no longer meet in one moment."""
    setup = replace(STATIC, above_m=0.02)
    pose = Poses(*(np.array([x]) for x in (np.hypot(1.163, 0.02), 0.0, 0.0, 0.0, 0.02)))
    aside = arrivals(replace(geometry(1.163, setup=setup), poses=pose)).only(FACE)
    assert burst_db(aside, 1.163) > burst_db(face(1.163), 1.163) + 10.0


def test_plate_has_no_deep_null():
    levels = [steady_db(face(d, 0.0, RUBBER), d) for d in np.arange(0.3, 4.0, 0.05)]
    assert np.abs(levels).max() < 6.5


@pytest.mark.parametrize(("shape", "degrees"), [(MIRROR, 1.50), (RUBBER, 2.05)], ids=["disc", "plate"])
def test_first_null_in_the_far_field(shape, degrees):
    """sin t = 0.61 wavelength / radius of a disc, wavelength / (2 width) of a plate; 60 m away, in lossless air."""
    levels = {t: steady_db(face(60.0, t, shape), 60.0) for t in (0.0, degrees - 0.4, degrees, degrees + 0.4)}
    assert levels[degrees] < levels[0.0] - 22.0
    assert levels[degrees] < min(levels[degrees - 0.4], levels[degrees + 0.4]) - 5.0


def test_half_power_angle_of_a_disc_in_the_far_field():
    assert steady_db(face(60.0, 0.87), 60.0) - steady_db(face(60.0), 60.0) == pytest.approx(-6.0, abs=0.4)


@pytest.mark.parametrize(("shape", "strength_db"), [(MIRROR, 11.3), (RUBBER, 5.2)], ids=["disc", "plate"])
def test_target_strength_far_away(shape, strength_db):
    """20 log (area / wavelength), per d^2."""
    paths = face(100.0, 0.0, shape)
    total = abs((paths.amplitude * np.exp(-4j * np.pi * paths.length / WAVELENGTH)).sum())
    assert 20.0 * np.log10(total * 100.0**2) == pytest.approx(strength_db, abs=0.15)


@pytest.mark.parametrize(("distance", "late_mm"), [(0.1, 0.78), (0.5, 0.16)])
def test_baseline_of_25_mm_lengthens_near_ranges(distance, late_mm):
    setup = replace(STATIC, output="us", reflector=Wall(), gain=0)
    near, apart = (
        Rig(replace(BARE, sensitivity_db=10.0, blanking=0.0, baseline=spacing), setup)
        .ping(Ping.of(distance), np.random.default_rng(0))
        .code[0, 0]
        for spacing in (0.0, 0.025)
    )
    assert (float(apart) - float(near)) * 1e-6 * SPEED / 2.0 * 1e3 == pytest.approx(late_mm, abs=0.18)


@pytest.mark.parametrize(
    ("celsius", "percent"), [(10, 2.09), (15, 1.16), (17, 0.79), (19, 0.43), (20, 0.24), (22, -0.12), (25, -0.66)]
)
def test_scale_of_58_us_a_centimetre_over_temperature(celsius, percent):
    """Slope between a wall at 2 m and one at 4 m, as loud over the threshold, at a relative humidity of 50 %."""
    air = Air.of(float(celsius), 50.0)
    gap = 20.0 * np.log10(2.0) + float(air.absorption_db[0]) * 4.0
    setup = replace(STATIC, reflector=Wall(), gain=31, output="us", temperature_c=float(celsius), range_register=255)
    code = [
        float(
            Rig(replace(BARE, sensitivity_db=20.0 + extra), setup)
            .ping(Ping.of(distance), np.random.default_rng(0))
            .code[0, 0]
        )
        for distance, extra in ((2.0, 0.0), (4.0, gap))
    ]
    assert ((code[1] - code[0]) / 5800.0 / 2.0 - 1.0) * 100.0 == pytest.approx(percent, abs=0.015)


@pytest.mark.parametrize(("register", "milliseconds"), [(140, 36.096), (24, 6.4), (255, 65.536)])
def test_range_gate_is_a_hard_edge(register, milliseconds):
    """A crossing just before (register + 1) 256 us counts, one just after does not, at any level."""
    last = milliseconds * 1e-3 * SPEED / 2.0
    unit = replace(BARE, sensitivity_db=80.0, t_offset=0.0)
    setup = replace(STATIC, reflector=Wall(), gain=31, output="us", range_register=register)
    distance = last - np.array([0.040, 0.012, -0.004])
    ping = Ping.of(distance, time=2.4 * np.arange(3))
    detected = Rig(unit, setup).ping(ping, np.random.default_rng(0)).code[:, 0]
    assert (detected > 0).tolist() == [True, True, False]
    assert detected.max() <= milliseconds * 1e3


@pytest.mark.parametrize(
    ("distance", "post", "foot", "by_floor"),
    [(1, 1.30, 1.98, 2.08), (2, 2.30, 2.75, 2.80), (3, 3.30, 3.63, 3.62), (4, 4.30, 4.55, 4.50), (6, 6.30, 6.48, 6.35)],
)
def test_positions_of_room_echoes_at_a_height_of_1_5_m(distance, post, foot, by_floor):
    setup = replace(STATIC, post=Post(radius=1e-3, behind=0.3), room=Room(1.5, None, None))
    found = arrivals(geometry(distance, setup=setup, shape=Plate(0.02, 0.02), unit=replace(BARE, sensitivity_db=60.0)))
    stand = np.sort(found.only(POST).length)
    assert stand == pytest.approx([post, foot], abs=0.006)
    assert found.only(FLOOR).length.min() == pytest.approx(by_floor, abs=0.011)


def test_gain_reaches_its_cap_at_the_documented_time():
    for code, millimetres in ((11, 132), (14, 168), (31, 372)):
        gain = gain_over_time(code, 200)
        full = np.flatnonzero(gain == gain[-1])[0] * PERIOD
        assert full * SPEED / 2.0 * 1e3 == pytest.approx(millimetres, abs=4.5)


@pytest.mark.parametrize(("degrees", "above_db"), [(5.0, 0.8), (22.5, 3.5), (45.0, 7.7)])
def test_straight_edge_agrees_with_kirchhoff_diffraction(degrees, above_db):
    """Near edge of a great plate turned by t, against a wall as far away.

    The geometrical theory has sqrt(wavelength/d) (1 + 1/sin t) / (2 sqrt 2 pi), Kirchhoff's integral cot t in place of
    the bracket: an edge here is as loud where the plate nearly faces the sensor, and 7.7 dB fainter at 45 degrees.
    """
    distance, turn = 4.0, np.deg2rad(degrees)
    edge = 2.0  # half width of the plate; its far edge is out of the window
    # the near edge straight ahead: centre of the plate beyond it along the plate
    near = np.array([distance, 0.0])
    centre = near + edge * np.array([np.sin(turn), np.cos(turn)])
    pose = Poses(
        np.array([np.hypot(*centre)]),
        np.array([np.arctan2(centre[1], centre[0])]),
        np.array([np.arctan2(centre[1], centre[0]) + turn]),
        np.zeros(1),
        np.zeros(1),
    )
    base = geometry(distance, shape=Plate(2.0 * edge, 4.0))
    paths = arrivals(replace(base, poses=pose)).only(FACE)
    pulses = Pulses(np.zeros(len(paths), dtype=int), 2.0 * paths.length / SPEED, paths.amplitude)
    wave = np.abs(waveforms(BARE, np.array([20.0]), pulses, 2000)[0])
    at = round((2.0 * distance / SPEED + 394e-6) / PERIOD)
    level = 20.0 * np.log10(wave[at - 2 : at + 3].max() * 2.0 * distance)
    theory = np.sqrt(WAVELENGTH / distance) * (1.0 + 1.0 / np.sin(turn)) / (2.0 * np.sqrt(2.0) * np.pi)
    assert 20.0 * np.log10(theory) - level == pytest.approx(above_db, abs=0.6)


# dB against a wall, continuous wave, at 22.5, 30 and 45 degrees, and at 0.3 and 4 m at all angles
TILTS = (0, 1, 2, 3, 5, 10, 15, 20, 22.5)
NEAR_AND_FAR = {
    "disc": {0.3: (2, 0, 1, -1, 0, -1, 1, -7, -11), 4.0: (4, -4, -10, -18, -28, -39, -43, -43, -44)},
    "plate": {0.3: (2, 0, -2, 0, 1, -4, -12, -16, -18), 4.0: (-1, -5, -18, -14, -19, -32, -31, -31, -35)},
}


@pytest.mark.parametrize("name", NEAR_AND_FAR)
def test_tilted_reflectors_near_and_far_against_the_surface_integral(name):
    shape = {"disc": Disc(0.1), "plate": RUBBER}[name]
    for distance, row in NEAR_AND_FAR[name].items():
        levels = [steady_db(face(distance, tilt, shape), distance) for tilt in TILTS]
        assert levels == pytest.approx(row, abs=1.6), distance
