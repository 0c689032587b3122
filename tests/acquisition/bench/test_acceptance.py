"""Independently computed numbers at the registers: detection ranges, range errors, levels."""

from dataclasses import replace

import numpy as np
import pytest

from acquisition import Ping
from acquisition.bench import MIRROR, RUBBER, Post, Rig, Room, Setup, Unit, Wall
from acquisition.bench.acoustics.arrivals import FACE, GROUPS, LEAK, POST
from acquisition.bench.wire import Link

STATIC = Setup.static(output="us", range_register=255)
# a wall at 6 m just reaches the threshold at full gain; no hysteresis, no firmware offset
BARE = replace(Unit.nominal(), sensitivity_db=0.0, hysteresis=0.0, t_offset=0.0, leak_db=-300.0, noise=0.0)


def codes(unit, setup, distance, n=1, **conditions):
    ping = Ping.of(np.repeat(distance, n), time=2.4 * np.arange(n * np.size(distance)), **conditions)
    return Rig(unit, setup).ping(ping, np.random.default_rng(0)).code[:, 0].reshape(-1, n).astype(float)


def farthest(setup, reflectance=0.9):
    """Largest distance with an echo, m."""
    distance = np.arange(0.05, 8.6, 0.05)
    return distance[codes(BARE, setup, distance, reflectance=reflectance)[:, 0] > 0].max()


LIMITS = {
    "wall": ({11: 2.35, 14: 2.55, 27: 4.3, 31: 6.0}, {"reflector": Wall()}),
    "disc": ({11: 3.25, 14: 3.45, 27: 4.9, 31: 6.2}, {"reflector": MIRROR}),
    "plate": ({11: 2.65, 14: 2.8, 27: 4.0, 31: 5.15}, {"reflector": RUBBER}),
    "disc in dry air": ({11: 3.9, 14: 4.15, 31: 8.0}, {"reflector": MIRROR, "humidity_pct": 20.0}),
}


@pytest.mark.parametrize("name", LIMITS)
def test_detection_range_at_each_gain(name):
    limits, settings = LIMITS[name]
    for gain, metres in limits.items():
        assert farthest(replace(STATIC, gain=gain, **settings)) == pytest.approx(metres, abs=0.16), gain


@pytest.mark.parametrize(
    ("profile", "half", "gain", "metres"),
    [
        ("round", 0.015, 11, 0.60),
        ("round", 0.015, 14, 0.65),
        ("round", 0.015, 27, 1.2),
        ("round", 0.015, 31, 1.8),
        ("flat", 0.020, 11, 1.5),
    ],
)
def test_detection_range_of_a_post(profile, half, gain, metres):
    depth = half if profile == "round" else 0.0
    setup = replace(STATIC, gain=gain, post=Post(half, 0.3 + depth, profile))
    assert farthest(setup, reflectance=0.0) + 0.3 == pytest.approx(metres, abs=0.16)


@pytest.mark.parametrize(
    ("gain", "offsets_mm"),
    [
        (11, {0.5: 15, 1.0: 27, 2.0: 35, 2.5: 46, 3.0: 57}),
        (31, {0.5: 7, 1.0: 13, 2.0: 18, 3.0: 26, 4.0: 39, 5.0: 52}),
    ],
)
def test_range_error_of_a_disc(gain, offsets_mm):
    """Scale error and time walk, within one cycle slip of 4.3 mm."""
    distance = np.array(list(offsets_mm))
    read = codes(BARE, replace(STATIC, gain=gain, reflector=MIRROR), distance)[:, 0] / 5800.0
    assert (read - distance) * 1e3 == pytest.approx(list(offsets_mm.values()), abs=4.4)


def test_gain_codes_31_and_11_are_17_4_db_apart():
    """Past the gain steps, a unit more sensitive by 17.4 dB reads the same at code 11; with 1 dB less it does not."""
    distance = np.linspace(0.6, 2.2, 60)
    full = codes(BARE, replace(STATIC, gain=31, reflector=Wall()), distance)
    low = replace(STATIC, gain=11, reflector=Wall())
    same, off = (codes(replace(BARE, sensitivity_db=db), low, distance) for db in (17.36, 16.36))
    assert np.abs(full - same).max() <= 25.0
    assert np.mean(full == same) > 0.9
    assert np.mean(full == off) < 0.5


def test_time_walk_of_20_and_of_2_db_at_the_register():
    """A wall at 3 m, 20 and 2 dB over the threshold, reads 13.5 and 44 mm long."""
    loss = 20.0 * np.log10(3.0 / 6.0) + 1.2858 * 2.0 * (3.0 - 6.0)
    setup = replace(STATIC, gain=31, reflector=Wall())
    unit = replace(BARE, baseline=0.0)
    for over_db, late_mm in ((20.0, 13.5), (2.0, 44.0)):
        read = codes(replace(unit, sensitivity_db=over_db + loss), setup, 3.0)[0, 0]
        assert (read * 1e-6 * 343.36 / 2.0 - 3.0) * 1e3 == pytest.approx(late_mm, abs=0.6)


def test_null_and_maximum_of_a_disc_at_the_register():
    """Level of a disc below that of a wall: 18 dB at 1.163 m, 1 dB at a degree of tilt, -6 dB at 2.33 m."""

    def needed(setup, distance, **conditions):
        """Sensitivity at which there is an echo, dB."""
        point, low, high = (
            replace(BARE, radius=1e-6),
            -60.0,
            60.0,
        )  # without a beam, which favours the centre over the rim
        while high - low > 0.1:
            middle = 0.5 * (low + high)
            detected = codes(replace(point, sensitivity_db=middle), setup, distance, **conditions)[0, 0] > 0
            low, high = (low, middle) if detected else (middle, high)
        return high

    disc, wall = (replace(STATIC, gain=31, reflector=shape) for shape in (MIRROR, Wall()))
    assert needed(wall, 1.163) - needed(disc, 1.163) == pytest.approx(-18.0, abs=0.6)
    assert needed(wall, 1.163) - needed(disc, 1.163, incidence=np.deg2rad(1.0)) > -1.3
    assert needed(wall, 2.33) - needed(disc, 2.33) == pytest.approx(6.0, abs=0.6)


def test_ringing_of_a_strong_leak_ends_by_half_a_metre():
    """Leak 60 dB over the threshold at full gain: detected up to 0.5 m, where the cascade has decayed by 60 dB."""
    over = replace(BARE, blanking=2.3e-3, leak_delay=0.0, rearm=20e-6, rail=1e9)  # the registers hold only 17 echoes
    unit = replace(over, leak_db=60.0 - 20.0 * np.log10(12.0 * 10.0 ** (1.29 * 12.0 / 20.0)))
    ping = Ping.of(1.0, reflectance=0.0)
    last = Rig(unit, replace(STATIC, gain=31)).ping(ping, np.random.default_rng(0)).code[0].max()
    full_gain = last * 1e-6 * 343.36 / 2.0
    assert full_gain == pytest.approx(0.5, abs=0.05)


def test_rough_floor_echoes_from_about_3_metres():
    """Sensor at 1.5 m, where the beam's edge meets the floor at 3.25 m: no clutter from 1.85 to 2.9 m."""
    room = Room(1.5, None, None, floor_scatter_db=-15.0)
    setup = replace(STATIC, gain=31, room=room)
    ping = Ping.of(1.0, reflectance=0.0)
    for sensitivity in np.arange(0.0, 40.0, 0.5):
        unit = replace(BARE, sensitivity_db=sensitivity, rearm=1e-4)
        read = Rig(unit, setup).ping(ping, np.random.default_rng(0)).code[0] / 5800.0
        if (read > 1.85).sum() >= 5:  # nearer, below the beam's null, its side lobe meets the floor
            break
    assert 2.9 < read[read > 1.85].min() < 4.6


def test_mirror_echo_is_lost_beyond_5_7_degrees_at_a_metre():
    """Turned about the vertical: 14 dB above the threshold it is detected at 5 degrees, and not at 9."""
    setup = replace(STATIC, gain=31, reflector=MIRROR)
    unit = replace(BARE, sensitivity_db=-14.0)
    turned = [codes(unit, setup, 1.0, incidence=np.deg2rad(a))[0, 0] for a in (2.0, 5.0, 9.0, 15.0)]
    assert turned[0] > 0
    assert turned[1] > 0
    assert turned[2:] == [0, 0]


def test_true_echoes_state_cause_time_and_period():
    """The face ahead; the post at 30 degrees of incidence; no cause with only the leak."""
    setup = replace(STATIC, gain=31, post=Post(), reflector=MIRROR)
    unit = replace(Unit.nominal(), noise=0.01)
    ping = Ping.of([1.0, 1.0, 4.0], incidence=np.deg2rad([0.0, 30.0, 0.0]), reflectance=[0.9, 0.9, 0.0])
    registers = Rig(unit, setup).ping(ping, np.random.default_rng(0), truth=True)
    truth = registers.truth
    assert [GROUPS[k] for k in truth.cause[:2]] == ["face", "post"]
    assert truth.cause[2] == -1
    assert truth.time[0, FACE] == pytest.approx(2.0 / 343.36, rel=1e-3)
    assert truth.level_db[1, POST] > truth.level_db[1, FACE] - 30.0
    assert truth.level_db[0, FACE] > truth.level_db[1, FACE] + 15.0
    assert np.isfinite(truth.time[:, LEAK]).all()
    first = (registers.code[0, 0] * 1e-6 + 60e-6 - truth.time[0, FACE]) / 25e-6
    assert truth.period[0] == int(first)
    assert (registers.fault == Link.OK).all()


def test_true_echoes_do_not_change_the_registers():
    """The registers are equal with and without."""
    rng = np.random.default_rng(1)
    ping = Ping.of(rng.uniform(0.3, 3.0, 40).repeat(20), time=2.4 * np.arange(800), reflectance=0.9)
    rig = Rig(Unit.draw(5), Setup(gain=25, output="us"))
    with_truth, without = (
        rig.ping(ping, np.random.default_rng(2), truth=with_true_echoes) for with_true_echoes in (True, False)
    )
    np.testing.assert_array_equal(with_truth.code, without.code)
    assert with_truth.truth.cause.shape == (800,)
    assert without.truth is None
