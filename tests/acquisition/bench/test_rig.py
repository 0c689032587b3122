"""The rig as a whole."""

import time
from dataclasses import replace

import numpy as np
import pytest

from acquisition import EchoStatus, Ping, Recording, SettingError
from acquisition.bench import Ambient, Bus, Neighbour, Post, Rig, Room, Setup, Unit, Wall
from acquisition.bench.laboratory.air import sound_speed
from acquisition.bench.wire import Link

STATIC = Setup.static(room=Room())
HALL = replace(STATIC, reflector=Wall(), gain=31, output="us", room=Room(None, None, None), range_register=255)


REGISTERS = {"gain": 14.0, "range_mm": 43.0 * 71}


def pings(distance, n, **conditions):
    return Ping.of(distance=np.repeat(distance, n), time=np.arange(n * np.size(distance)) * 2.4, **conditions)


def fire(unit, setup, ping, seed=0):
    return Rig(unit, setup).ping(ping, np.random.default_rng(seed))


def test_same_seed_same_registers_and_another_seed_others():
    rig, ping = Rig(Unit.draw(3), Setup(output="us")), pings([0.7, 1.9], 30, reflectance=0.9)
    first, again = (rig.ping(ping, np.random.default_rng(5)).code for _ in range(2))
    np.testing.assert_array_equal(first, again)
    assert np.any(first != rig.ping(ping, np.random.default_rng(6)).code)


def test_serial_numbers_identify_units():
    assert Unit.draw(7) == Unit.draw(7)
    assert Unit.draw(7) != Unit.draw(8)
    drawn = [Unit.draw(k) for k in range(50)]
    assert all(20.0 <= u.q_tx <= 58.0 and -120e-6 <= u.t_offset <= 0.0 and 6e-3 <= u.radius <= 7e-3 for u in drawn)


def test_scale_error_of_58_us_a_centimetre_at_19_degrees():
    """+0.43 %: slope of readings on distance at constant level over threshold, so without the time walk."""
    unit = replace(Unit.nominal(), noise=0.0, leak_db=-300.0)
    near, far = 2.0, 4.0
    gap = 20.0 * np.log10(far / near) + 1.2858 * 2.0 * (far - near)
    code = [
        float(fire(replace(unit, sensitivity_db=20.0 + extra), HALL, pings(d, 1)).code[0, 0])
        for d, extra in ((near, 0.0), (far, gap))
    ]
    assert (code[1] - code[0]) / 5800.0 / (far - near) - 1.0 == pytest.approx(0.0043, abs=1e-4)


def test_readings_follow_the_temperature():
    unit = replace(Unit.nominal(), noise=0.0, f_slope=0.0, sensitivity_db=10.0)
    code = {t: int(fire(unit, replace(HALL, temperature_c=t), pings(3.0, 1)).code[0, 0]) for t in (19.0, 29.0)}
    expected = float(sound_speed(19.0) / sound_speed(29.0))
    assert code[29.0] / code[19.0] == pytest.approx(expected, abs=2e-3)
    given = Ping.of(distance=3.0, temperature_c=29.0)
    assert fire(unit, HALL, given).code[0, 0] == code[29.0]


def test_slips_of_half_a_wavelength_make_a_comb():
    """Readings of a wall near the threshold lie on a comb of 25 us = 4.29 mm."""
    unit = replace(Unit.nominal(), sensitivity_db=9.0)
    code = fire(unit, replace(HALL, scintillation_db=1.0), pings(5.0, 400)).code[:, 0].astype(float)
    code = code[(code > 29_000) & (code < 30_500)]
    assert len(code) > 350
    phase = np.exp(2j * np.pi * code / 25.0)
    assert np.abs(phase.mean()) > 0.8
    assert len(np.unique(np.rint((code - np.median(code)) / 25.0))) >= 3


def test_gain_sets_the_detection_range():
    """Detection range of a unit that just detects a wall at 6 m at full gain, within a grid step."""
    unit = replace(Unit.nominal(), sensitivity_db=0.0)
    limits = {}
    for gain in (11, 14, 27):
        setup = replace(HALL, gain=gain, scintillation_db=0.5)
        distance = np.arange(1.5, 5.51, 0.1)
        echo = fire(unit, setup, pings(distance, 10)).code[:, 0].reshape(-1, 10) > 0
        limits[gain] = distance[echo.mean(axis=1) > 0.5].max()
    assert limits[11] == pytest.approx(2.35, abs=0.11)
    assert limits[14] == pytest.approx(2.55, abs=0.11)
    assert limits[27] == pytest.approx(4.3, abs=0.11)


def test_null_of_a_disc_disappears_at_a_degree_of_tilt():
    unit = replace(Unit.nominal(), sensitivity_db=-6.0, noise=0.02)
    setup = replace(STATIC, gain=9)
    level = [fire(unit, setup, pings(d, 5, reflectance=0.9)).code[:, 0] for d in (0.9, 1.163)]
    assert (level[0] > 0).all()
    assert (level[1] == 0).all()
    tilted = pings(1.163, 5, reflectance=0.9, incidence=np.deg2rad(1.0))
    assert (fire(unit, setup, tilted).code[:, 0] > 0).all()


def test_post_is_detected_when_the_mirror_echo_is_lost():
    setup = replace(STATIC, gain=31, post=Post(), room=Room(None, None, None))
    straight = fire(Unit.nominal(), setup, pings(0.5, 5, reflectance=0.9, angle=0.0)).code[:, 0]
    aside = fire(Unit.nominal(), setup, pings(0.5, 5, reflectance=0.9, angle=np.deg2rad(42.0))).code[:, 0]
    assert np.median(straight) == pytest.approx(50, abs=2)
    assert np.median(aside) > 70


def test_no_echo_is_an_answer():
    record = Rig(Unit.nominal(), STATIC).record(pings(5.9, 20, reflectance=0.1), np.random.default_rng(0))
    assert (record.reading.status == EchoStatus.NO_ECHO).all()


ECHOING = replace(Unit.nominal(), sensitivity_db=40.0, noise=0.01, leak_db=-300.0)
BACK_WALL = replace(HALL, range_register=100, reflector=None, room=Room(None, None, 9.0))


@pytest.mark.parametrize("distance", [0.0, 1e-6, 1e-3])
def test_a_reflector_at_the_sensor_or_behind_it_is_answered(distance):
    ping = Ping.of([distance] * 3, [0.0, 0.5, 3.0], incidence=[0.0, 3.0, 0.0], reflectance=0.9, time=[0.0, 1.0, 2.0])
    assert Rig().ping(ping, np.random.default_rng(0)).reading(Setup()).answered.all()


def test_echo_of_the_previous_ping_is_one_interval_earlier():
    """A wall at 9 m: its echo is 52.4 ms after the ping, so 52.4 ms less the interval after the next one."""
    interval = np.array([2.4, 0.048, 0.049, 0.0473, 2.4, 0.048])
    ping = Ping.of(distance=3.0, reflectance=0.0, time=np.cumsum(interval))
    code = fire(ECHOING, BACK_WALL, ping).code[:, 0].astype(float)
    assert code[[0, 4]].tolist() == [0, 0]
    after = code[[1, 2, 3, 5]]
    walk = after + interval[[1, 2, 3, 5]] * 1e6 - 18.0 / 343.36 * 1e6
    assert walk == pytest.approx(walk[0], abs=3.0)
    assert 0.0 < walk[0] + 60.0 < 100.0


def test_echo_of_the_previous_ping_is_from_its_own_reflector():
    """The sonar moves between two pings: the late echo is from the first reflector, at its own range."""
    setup, unit = replace(HALL, range_register=60), replace(ECHOING, sensitivity_db=14.0, rearm=1e-3)
    ping = Ping.of(distance=[7.6, 0.35], time=[0.0, 0.035])
    late = fire(unit, setup, ping).code[1] - (15.2 / 343.36 * 1e6 - 35e3)
    assert np.any((late > 0.0) & (late < 200.0))
    alone = fire(unit, setup, ping[1:]).code[0]
    assert alone[0] > 0
    assert alone.max() < 9000


def test_wire_faults_differ_from_no_echo():
    bus = Bus(nack=0.1, dropped=0.1, lost_write=0.1)
    ping = pings(1.0, 3000, reflectance=0.9)
    setup = replace(Setup(output="us"), bus=bus)
    registers = fire(Unit.nominal(), setup, ping)
    reading = registers.reading(setup)
    share = [np.mean(reading.status == status) for status in (EchoStatus.NO_ANSWER, EchoStatus.NO_ECHO)]
    assert share[0] == pytest.approx(0.1, abs=0.02)
    assert 0.07 < share[1] < 0.12  # dropped, less those hidden by other faults
    assert fire(Unit.nominal(), Setup(output="us"), ping).answered.all()
    table = Rig(Unit.nominal(), setup).record(ping, np.random.default_rng(0)).table
    silent = table["reading_mm"].isna()
    assert table.loc[silent, [c for c in table if c.startswith("echo_")]].isna().all().all()


def test_lost_writes_repeat_all_registers():
    setup = replace(Setup(output="us"), bus=Bus(lost_write=0.3))
    code = fire(Unit.nominal(), setup, pings(1.0, 500, reflectance=0.9)).code
    fault = fire(Unit.nominal(), setup, pings(1.0, 500, reflectance=0.9)).fault
    stale = np.flatnonzero(fault == Link.LOST_WRITE)
    assert len(stale) > 100
    np.testing.assert_array_equal(code[stale], code[stale - 1])


def test_a_lost_write_repeats_the_registers_and_not_what_the_wire_made_of_them():
    setup, ping = replace(STATIC, output="us", bus=Bus(lost_write=0.3, dropped=0.2, bit_flip=0.2)), pings(1.0, 500)
    clean = fire(Unit.nominal(), replace(setup, bus=Bus()), ping).code
    registers = fire(Unit.nominal(), setup, ping)
    stale = registers.fault == Link.LOST_WRITE
    source = np.maximum.accumulate(np.where(stale, 0, np.arange(500)))
    assert np.isin([Link.DROPPED, Link.BIT_FLIP], registers.fault[source[stale]]).all()
    np.testing.assert_array_equal(registers.code[stale], clean[source[stale]])


def test_faults_with_dwell_time_are_correlated():
    ping = Ping.of(distance=1.0, reflectance=0.9, time=np.arange(4000) * 0.1)
    answered = fire(Unit.nominal(), replace(STATIC, bus=Bus(nack=0.2, dwell_s=1.0)), ping).answered
    lost = ~answered
    assert lost.mean() == pytest.approx(0.2, abs=0.08)
    assert np.corrcoef(lost[1:], lost[:-1])[0, 1] == pytest.approx(np.exp(-0.1), abs=0.08)


def test_recording_has_the_columns_and_the_grid_of_its_format(tmp_path):
    rig = Rig(Unit.draw(1), Setup(gain=20))
    record = rig.record(pings([0.5, 1.0], 40, reflectance=0.9), np.random.default_rng(0))
    loaded = Recording.load(record.save(tmp_path / "rig.csv"))
    assert {"temperature_c", "humidity_pct", "gain", "range_mm"} <= set(loaded.covariates)
    assert loaded.resolution == pytest.approx(0.01)
    assert loaded.table["range_mm"].iloc[0] == 6063.0
    assert loaded.table["temperature_c"].mean() == pytest.approx(19.0, abs=1.5)
    assert np.abs(loaded.reading.range - loaded.ping.distance).max() < 0.1


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ({"gain": 49}, "gain must be a whole number from 0 to 31, got 49: the SRF08 holds no other"),
        ({"range_register": 256}, "range_register must be a whole number from 0 to 255, got 256: the SRF08 holds no"),
    ],
)
def test_invalid_register_values_are_an_error(setting, message):
    with pytest.raises(SettingError, match=message):
        Setup(**setting)


def test_progress_is_reported():
    steps = []
    Rig().ping(pings([1.0, 2.0], 200), np.random.default_rng(0), progress=lambda *so_far: steps.append(so_far))
    assert steps == [(200, 400), (400, 400)]


def test_flipped_bits_jump_by_powers_of_two():
    setup = replace(STATIC, output="us", bus=Bus(bit_flip=0.3))
    ping = pings(1.0, 400, reflectance=0.9)
    clean = fire(Unit.nominal(), replace(setup, bus=Bus()), ping).code[:, 0].astype(int)
    registers = fire(Unit.nominal(), setup, ping)
    flipped = registers.fault == Link.BIT_FLIP
    assert flipped.mean() == pytest.approx(0.3, abs=0.07)
    change = registers.code[:, 0].astype(int) ^ clean
    assert not change[~flipped].any()
    assert set(change[flipped].tolist()) <= {1 << k for k in range(16)}


def test_swaying_stand_modulates_the_range_only():
    ping = Ping.of(distance=1.0, reflectance=0.9, time=np.arange(200) * 0.065)
    unit = replace(Unit.nominal(), noise=0.0)
    static = fire(unit, replace(STATIC, gain=25, output="us"), ping).code[:, 0].astype(float)
    setup = replace(STATIC, gain=25, output="us", sway_m=0.004, sway_period_s=1.3)
    swung = fire(unit, setup, ping).code[:, 0] - static
    expected = 0.004 * np.sin(2.0 * np.pi * ping.time / 1.3) * 2.0 / 343.36 * 1e6
    assert swung == pytest.approx(expected, abs=4.0)


@pytest.mark.parametrize("sway_m", [0.02, 0.05])
def test_a_stand_that_sways_far_still_modulates_the_range_only(sway_m):
    ping = Ping.of(distance=1.0, reflectance=0.9, time=np.arange(60) * 0.065)
    unit = replace(Unit.nominal(), noise=0.0)
    static = fire(unit, replace(STATIC, gain=25, output="us"), ping).code[:, 0].astype(float)
    setup = replace(STATIC, gain=25, output="us", sway_m=sway_m, sway_period_s=1.3)
    swung = fire(unit, setup, ping).code[:, 0] - static
    expected = sway_m * np.sin(2.0 * np.pi * ping.time / 1.3) * 2.0 / 343.36 * 1e6
    assert swung == pytest.approx(expected, abs=4.0)


@pytest.mark.parametrize("rate", [-5.0, 2.0, 5.0])
def test_what_a_moving_target_reads_does_not_depend_on_other_pings(rate):
    unit, setup = replace(Unit.nominal(), noise=0.0), replace(HALL, ambient=None)
    one, two = (
        Ping.of(distance=np.full(n, 3.0), time=np.arange(n) * 2.0, range_rate_mps=np.full(n, rate)) for n in (1, 2)
    )
    assert fire(unit, setup, two).code[:, 0].tolist() == 2 * fire(unit, setup, one).code[:, 0].tolist()


@pytest.mark.parametrize(("name", "usual"), [("temperature_c", 19.0), ("humidity_pct", 50.0)])
def test_a_ping_without_a_logged_temperature_has_that_of_the_laboratory(name, usual):
    unit, setup = replace(Unit.nominal(), noise=0.0), replace(HALL, **{name: usual})
    known, missing = (
        Ping.of(distance=np.ones(3), time=np.arange(3) * 2.0, **{name: np.array([20.0, middle, 20.0])})
        for middle in (usual, np.nan)
    )
    np.testing.assert_array_equal(fire(unit, setup, missing).code, fire(unit, setup, known).code)


@pytest.mark.parametrize(("name", "usual"), [("humidity_pct", 50.0), ("tilt_back", 0.0), ("range_rate_mps", 0.0)])
def test_pings_without_a_covariate_belong_to_the_visit_of_those_with_its_usual_value(name, usual):
    setup = replace(HALL, humidity_pct=50.0, placement_m=0.02)
    known, missing = (
        Ping.of(distance=np.ones(6), reflectance=0.9, time=np.arange(6) * 2.0, **{name: np.resize([other, usual], 6)})
        for other in (usual, np.nan)
    )
    np.testing.assert_array_equal(fire(Unit.nominal(), setup, missing).code, fire(Unit.nominal(), setup, known).code)
    assert (fire(Unit.nominal(), setup, missing).code[:, 0] > 0).all()


def test_each_ping_has_its_own_tilt():
    unit, tilt = replace(Unit.nominal(), noise=0.0), np.array([0.0, 0.3, 0.3])
    every = Ping.of(distance=np.ones(3), reflectance=0.9, time=np.arange(3) * 2.0, tilt_back=tilt)
    setup = replace(STATIC, gain=31, output="us")
    alone = [fire(unit, setup, every[k : k + 1]).code[0, 0] for k in range(3)]
    assert fire(unit, setup, every).code[:, 0].tolist() == alone
    assert alone[1] != alone[0]


def test_asynchronous_neighbour_drifts_through_the_readings():
    """Another sonar 0.2 ms slower a ping moves away by 34 mm from ping to ping, until its burst leaves the window."""
    setup = replace(STATIC, output="us", gain=31, room=Room(None, None, None))
    other = Neighbour(period_s=0.1002, first_s=0.0, path_m=2.0, bearing_deg=10.0)
    ping = Ping.of(distance=5.0, reflectance=0.0, time=np.arange(60) * 0.1)
    code = fire(replace(Unit.nominal(), noise=0.01), replace(setup, neighbour=other), ping).code[:, 0].astype(float)
    assert np.diff(code) == pytest.approx(200.0, abs=30.0)
    assert code[0] == pytest.approx(2.0 / 343.36 * 1e6, abs=100)
    alone = fire(replace(Unit.nominal(), noise=0.01), setup, ping)
    assert not alone.code.any()


def test_ambient_noise_raises_false_alarms_while_present():
    setup = replace(STATIC, gain=31, ambient=Ambient(share=0.3, dwell_s=1.0, factor=2.0))
    ping = Ping.of(distance=5.0, reflectance=0.0, time=np.arange(1500) * 0.1)
    false = fire(Unit.nominal(), replace(setup, room=Room(None, None, None)), ping).code[:, 0] > 0
    assert false.mean() == pytest.approx(0.3, abs=0.17)  # three standard errors of 75 independent spells
    assert np.corrcoef(false[1:], false[:-1])[0, 1] > 0.5


def test_reflector_facing_the_sensor_is_detected_off_axis():
    setup = replace(STATIC, gain=31)
    parallel = pings(3.9, 5, reflectance=0.9, angle=np.deg2rad(30.0))
    facing = pings(3.9, 5, reflectance=0.9, angle=np.deg2rad(30.0), incidence=0.0)
    unit = replace(Unit.nominal(), sensitivity_db=6.0)
    assert not fire(unit, setup, parallel).code[:, 0].any()
    assert fire(unit, setup, facing).code[:, 0] == pytest.approx(395, abs=3)


def test_published_readings_of_one_condition_follow_from_its_published_credence():
    """Esmi (2016), table 4.1: mirror at 30 degrees, 3900 mm, credence 0.88, readings of 3950 to 3970 mm.

    The unit's sensitivity is unknown; the share of echoes fixes it, and so the time walk, and so the readings.
    """
    setup = replace(STATIC, gain=31, scintillation_db=1.0)
    ping = pings(3.9, 1000, reflectance=0.9, angle=np.deg2rad(30.0), incidence=0.0)
    for sensitivity in np.arange(0.0, 6.0, 0.25):
        code = fire(replace(Unit.nominal(), sensitivity_db=sensitivity), setup, ping).code[:, 0]
        if np.mean(code > 0) > 0.88:
            break
    assert np.median(code[code > 0]) * 10.0 == pytest.approx(3960.0, abs=15.0)
    inner = np.percentile(code[code > 0] * 10.0, [10, 90])
    assert 3935.0 <= inner[0] <= inner[1] <= 3985.0


def test_pivot_behind_the_face_increases_the_distance_of_a_turned_face():
    """Turned by t about an axis e behind it, the face's centre is sqrt(d^2 + 2 e (d + e)(1 - cos t)) away."""
    rig = Rig(Unit.nominal(), replace(STATIC, pivot_m=0.3))
    turn = np.deg2rad(45.0)
    square, turned = (
        rig.place(Ping.of(distance=2.0, angle=angle, incidence=incidence), np.random.default_rng(0))
        for angle, incidence in ((0.3, 0.0), (0.0, turn))
    )
    assert square.distance[0] == pytest.approx(2.0)
    assert square.angle[0] == pytest.approx(0.3)
    expected = np.sqrt(2.0**2 + 2.0 * 0.3 * 2.3 * (1.0 - np.cos(turn)))
    assert turned.distance[0] == pytest.approx(expected)
    assert turned.distance[0] - 2.0 == pytest.approx(0.088, abs=0.015)
    normal = turned.angle[0] - turned.incidence[0]
    assert normal == pytest.approx(-turn)


def test_cold_sensor_reads_long_and_warms_up():
    ping = Ping.of(distance=1.0, reflectance=0.9, time=np.array([0.0, 600.0, 1e5]))
    setup, unit = replace(STATIC, output="us", gain=25), replace(Unit.nominal(), noise=0.0)
    extra = fire(replace(unit, cold_s=100e-6), setup, ping).code[:, 0] - fire(unit, setup, ping).code[:, 0]
    assert extra.tolist() == pytest.approx([100, 37, 0], abs=1)


def test_laboratories_are_drawn_by_number_except_fixed_settings():
    assert Setup.draw(3) == Setup.draw(3)
    assert Setup.draw(3) != Setup.draw(4)
    assert Setup.draw(3, gain=20, temperature_c=30.0).temperature_c == 30.0
    assert all(17.0 <= Setup.draw(k).temperature_c <= 24.0 for k in range(20))


def test_gain_and_range_of_a_ping_are_those_of_the_registers():
    ping = pings([0.8, 2.9, 5.0], 20, reflectance=0.9)
    given = replace(ping, covariates={name: np.full(60, value) for name, value in REGISTERS.items()})
    unit, loud = Unit.draw(2), replace(STATIC, gain=31)
    expected = fire(unit, replace(STATIC, gain=14, range_register=70), ping)
    np.testing.assert_array_equal(fire(unit, loud, given).code, expected.code)
    assert np.any(fire(unit, loud, ping).code != expected.code)
    unknown = replace(given, covariates={name: np.full(60, np.nan) for name in REGISTERS})
    np.testing.assert_array_equal(fire(unit, loud, unknown).code, fire(unit, loud, ping).code)


def test_a_recording_states_the_registers_of_each_ping():
    gain = np.repeat([0.0, 31.0], 20)
    recording = Rig(Unit.nominal(), STATIC).record(pings(4.0, 40, gain=gain), np.random.default_rng(0))
    assert recording.table["gain"].tolist() == gain.tolist()
    assert recording.reading.echo.tolist() == (gain > 0.0).tolist()


@pytest.mark.parametrize(("name", "value"), [("gain", 32), ("gain", 1.5), ("gain", -1), ("range_mm", 43 * 257)])
def test_registers_that_cannot_be_are_errors(name, value):
    with pytest.raises(SettingError, match=f"Ping.{name} must be a whole number from 0 to"):
        fire(Unit.nominal(), STATIC, pings(1.0, 2, **{name: value}))


@pytest.mark.slow
def test_speed_of_a_survey():
    """Half the target of 2,200 pings a second, in processor time of one core."""
    rng = np.random.default_rng(0)
    distance, angle = rng.uniform(0.1, 6.0, 100), np.deg2rad(rng.uniform(0.0, 45.0, 100))
    ping = Ping.of(distance=np.repeat(distance, 50), angle=np.repeat(angle, 50), time=np.arange(5000) * 2.4)
    fire(Unit.nominal(), Setup(), ping[:50])
    start = time.process_time()
    fire(Unit.nominal(), Setup(), ping)
    assert 5000 / (time.process_time() - start) > 1100
