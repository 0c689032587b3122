"""Effects of the rig's settings: each setting has its characteristic effect and no other."""

from dataclasses import replace

import numpy as np
import pytest

from acquisition import EchoStatus, Ping, SettingError
from acquisition.bench import (
    MIRROR,
    Bus,
    Gradient,
    Hum,
    Mover,
    Neighbour,
    Post,
    Rig,
    Room,
    Scatterer,
    Setup,
    Unit,
    Wall,
)
from acquisition.bench.acoustics.arrivals import OTHER
from acquisition.bench.wire import Link

STATIC = Setup.static(gain=31, output="us")
QUIET = replace(Unit.nominal(), noise=0.0, leak_db=-300.0)
WALL = replace(STATIC, reflector=Wall())


def fire(unit, setup, ping, seed=0, **kwargs):
    return Rig(unit, setup).ping(ping, np.random.default_rng(seed), **kwargs)


def first(unit, setup, ping, seed=0):
    return fire(unit, setup, ping, seed).code[:, 0].astype(float)


def series(distance, n=200, interval=0.1, **conditions):
    return Ping.of(np.full(n, distance), time=interval * np.arange(n), **conditions)


def test_supply_scales_the_amplitude():
    """A tenth less voltage is 0.9 dB less level, and nothing else."""
    ping = Ping.of(np.linspace(0.5, 5.5, 60), time=2.4 * np.arange(60))
    weak = first(QUIET, replace(WALL, supply=0.9), ping)
    np.testing.assert_array_equal(weak, first(replace(QUIET, sensitivity_db=3.0 + 20.0 * np.log10(0.9)), WALL, ping))
    assert (weak != first(QUIET, WALL, ping)).any()


def test_reset_leaves_full_gain_and_range_until_registers_are_rewritten():
    bus = Bus(reset=0.02, rewrite_s=10.0)
    setup = replace(WALL, gain=5, range_register=60, bus=bus)
    ping = series(3.0, 2000)  # beyond both range gate and gain
    registers = fire(QUIET, setup, ping)
    down = registers.fault == Link.RESET
    assert down.mean() == pytest.approx(0.02, abs=0.01)
    assert not registers.code[down].any()
    detected = registers.code[:, 0] > 0
    for begin in range(0, 2000, 100):  # between two rewrites: no echo until the first reset, echoes afterwards
        fell = np.flatnonzero(down[begin : begin + 100])
        since = fell[0] if len(fell) else 100
        assert not detected[begin : begin + since].any()
        assert (detected | down)[begin + since : begin + 100].all()
    with pytest.raises(SettingError, match=r"Bus\.reset must lie from 0 to 1, got 2"):
        Bus(reset=2.0)


def test_hum_modulates_detection_of_weak_echoes():
    """A wall just below the threshold is detected only while the ripple lowers it, by the phase of its arrival."""
    unit = replace(QUIET, sensitivity_db=-0.6)
    loss = 20.0 * np.log10(4.0 / 6.0) + 2.0 * 1.2858 * (4.0 - 6.0)
    setup = replace(WALL, hum=Hum(100.0, 0.3))
    ping = series(4.0, 400, 0.1037)
    detected = first(replace(unit, sensitivity_db=loss - 0.6), setup, ping) > 0
    phase = 100.0 * (ping.time + 8.0 / 343.36 + 394e-6) % 1.0
    low = (phase > 0.6) & (phase < 0.9)
    assert detected[low].all()
    assert not detected[(phase > 0.05) & (phase < 0.45)].any()
    assert not first(replace(unit, sensitivity_db=loss - 0.6), WALL, ping).any()


def test_sagging_reference_shortens_near_ranges():
    """Near, a lower reference trips some periods earlier; far away, after 10 tau, it has recovered."""
    ping = Ping.of([*np.linspace(0.4, 1.2, 20), 5.0], time=2.4 * np.arange(21))
    setup, unit = replace(WALL, gain=11), replace(QUIET, sensitivity_db=2.0)
    plain, sagging = (first(replace(unit, sag=sag, sag_tau_s=3e-3), setup, ping) for sag in (0.0, 0.8))
    assert (sagging[:20] <= plain[:20] + 1.0).all()
    assert np.mean(sagging[:20] <= plain[:20] - 22.0) > 0.2
    assert sagging[20] == plain[20]


def test_spill_detects_objects_beside_the_beam():
    room = Room(None, None, None, clutter=(Scatterer((0.0, -1.0, 0.0), 0.0),))
    ping = Ping.of(3.0, reflectance=0.0)
    assert first(QUIET, replace(STATIC, room=room), ping) == 0
    spilled = first(replace(QUIET, spill=0.2), replace(STATIC, room=room), ping)
    assert spilled == pytest.approx([2e6 / 343.36], abs=300.0)


def needed(setup, ping, unit=QUIET):
    """Sensitivity at which the first ping has an echo, dB, by bisection."""
    low, high = -60.0, 60.0
    assert first(replace(unit, sensitivity_db=high), setup, ping).any()
    while high - low > 0.1:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if first(replace(unit, sensitivity_db=middle), setup, ping).any() else (middle, high)
    return high


def test_vertical_gradient_bends_sound_away_from_a_disc():
    """3 K/m upwards tilt a disc at 6 m by 0.9 degrees, where its lobe is 6 dB down; either sign, since it is round."""
    ping = Ping.of(6.0)
    disc = replace(STATIC, reflector=MIRROR, range_register=255)
    straight = needed(disc, ping)
    for up in (3.0, -3.0):
        assert needed(replace(disc, gradient=Gradient(up=up)), ping) - straight == pytest.approx(6.0, abs=1.5)


def test_gradient_ahead_shortens_ranges_by_the_square_of_distance():
    ping = Ping.of([1.0, 2.0, 4.0], time=2.4 * np.arange(3))
    unit = replace(QUIET, sensitivity_db=25.0)
    even, warmer = (first(unit, replace(WALL, gradient=Gradient(ahead=k)), ping) for k in (0.0, 4.0))
    expected = ping.distance**2 / 343.36 * 2.0 * 4.0 / 4.0 / 292.15 * 1e6
    assert even - warmer == pytest.approx(expected, rel=0.05, abs=2.0)


def test_person_walking_through_the_beam_is_detected():
    """Across the beam every 8 s at 1.5 m: detected instead of the wall twice per cycle, as the true echoes state."""
    walker = Mover(((0.0, 1.5, -2.0, 0.0), (4.0, 1.5, 2.0, 0.0), (8.0, 1.5, -2.0, 0.0)), loop=True)
    ping = series(3.0, 320)
    registers = fire(QUIET, replace(WALL, movers=(walker,)), ping, truth=True)
    near = registers.code[:, 0] < 11_000
    aside = np.abs(walker.positions(ping.time)[:, 1])
    assert near[aside < 0.3].all()
    assert not near[aside > 1.4].any()
    assert (registers.truth.cause[near] == OTHER).all()
    assert registers.code[near, 0].min() == pytest.approx(2.0 * 1.5 / 343.36 * 1e6, abs=150.0)


def test_moved_object_remains_at_its_new_position():
    chair = Mover(((10.0, 2.0, 0.1, 0.0), (10.05, 1.2, 0.1, 0.0)), radius=0.02)
    read = first(QUIET, replace(WALL, movers=(chair,)), series(3.0))
    assert np.ptp(read[:100]) <= 2.0
    assert np.ptp(read[101:]) <= 2.0
    assert read[0] - read[-1] == pytest.approx(2.0 * 0.8 / 343.36 * 1e6, abs=120.0)


def test_earlier_neighbour_causes_an_earlier_echo():
    """Two sonars 50 mm apart, the other 3 ms earlier with the same interval: its echo of the wall is 0.515 m nearer."""
    other = Neighbour(period_s=0.1, first_s=-0.003, path_m=0.05, bearing_deg=80.0, strength_db=-60.0, beside_m=0.05)
    ping = series(2.0, 20)
    alone, both = (first(QUIET, replace(WALL, neighbour=n), ping) for n in (None, other))
    assert both - alone == pytest.approx(-3000.0, abs=3.0)


def test_synchronous_sonars_receive_twice_the_pressure():
    """Fired together, both bursts arrive as one echo of twice the pressure: 6 dB."""
    other = Neighbour(period_s=0.1, path_m=0.05, bearing_deg=80.0, strength_db=-90.0, beside_m=0.0)
    ping = series(4.0, 1)
    gain = needed(WALL, ping) - needed(replace(WALL, neighbour=other), ping)
    assert gain == pytest.approx(6.0, abs=0.3)


def test_several_neighbours_arrive_at_their_own_times():
    others = tuple(Neighbour(0.1, late, 2.0, 5.0) for late in (0.004, 0.009))
    code = fire(QUIET, replace(STATIC, neighbour=others), series(3.0, 3, reflectance=0.0)).code.astype(float)
    assert code[:, :2] == pytest.approx(np.tile([9825.0, 14_825.0], (3, 1)), abs=100.0)


def test_echo_of_the_ping_before_the_previous_one():
    """The echo of a wall at 4.9 m takes 28.5 ms; with pings every 20 ms it arrives 8.5 ms after the next ping."""
    room = Room(None, None, 4.9)
    ping = Ping.of(np.full(6, 9.0), reflectance=0.0, time=0.01 * np.arange(6))
    setup = replace(STATIC, room=room, range_register=38)
    read = first(replace(QUIET, sensitivity_db=20.0), setup, ping)
    assert (read[:2] == 0).all()
    delay = 9.8 / 343.36 * 1e6 - 20_000.0
    assert read[2:] == pytest.approx(np.full(4, delay), abs=150.0)


def test_runs_of_one_recording_are_independent():
    """Interleaved rows of two runs give the same as consecutive runs."""
    time = np.repeat(0.05 * np.arange(30), 2)
    run = np.tile([0, 1], 30)
    both = Ping.of(np.where(run, 2.0, 3.0), time=time, run=run)
    setup = replace(WALL, room=Room(None, None, 9.0))
    mixed, sorted_ = fire(QUIET, setup, both), fire(QUIET, setup, both[np.argsort(run, kind="stable")])
    np.testing.assert_array_equal(mixed.code[np.argsort(run, kind="stable")], sorted_.code)


def test_higher_reflector_is_attenuated_by_the_beam():
    """At 20 degrees of elevation the two-way beam leaves -6.2 dB; the upright disc has no mirror echo."""
    small = Scatterer((2.0 * np.cos(np.deg2rad(20.0)), 0.0, 2.0 * np.sin(np.deg2rad(20.0))), 0.0)
    level = replace(small, position_m=(2.0, 0.0, 0.0))
    ping = Ping.of(5.0, reflectance=0.0)
    high, ahead = (needed(replace(STATIC, room=Room(None, None, None, clutter=(s,))), ping) for s in (small, level))
    assert high - ahead == pytest.approx(6.2, abs=0.3)
    disc = replace(STATIC, reflector=MIRROR)
    assert needed(replace(disc, above_m=0.3), Ping.of(2.0)) > needed(disc, Ping.of(2.0)) + 20.0


@pytest.mark.parametrize("pitch_deg", [-25.0, 0.0, 25.0])
def test_floor_echo_depends_on_pitch_and_height(pitch_deg):
    """At 0.5 m above a floor with a wall, levels of wall and corner follow the beam pattern."""
    room = Room(0.5, None, 1.5)
    unit = replace(QUIET, pitch=np.deg2rad(pitch_deg), sensitivity_db=20.0, rearm=0.3e-3)
    code = fire(unit, replace(STATIC, room=room), Ping.of(5.0, reflectance=0.0), truth=True)
    wall, corner = code.truth.level_db[0, [6, 4]]
    beam_db = {-25.0: (9.9, 0.9), 0.0: (0.0, 5.2), 25.0: (9.9, 39.0)}[pitch_deg]  # corner is 18.4 degrees below
    expected = -beam_db[0] - (-beam_db[1] + 20.0 * np.log10(0.9) - 20.0 * np.log10(np.hypot(1.5, 0.5) / 1.5) - 0.21)
    assert wall - corner == pytest.approx(expected, abs=1.0 if pitch_deg < 10.0 else 8.0)


def test_lost_writes_with_dwell_time_repeat_the_registers():
    bus = Bus(lost_write=0.3, dwell_s=2.0)
    registers = fire(Unit.nominal(), replace(WALL, bus=bus), series(2.0, 1000))
    stuck = registers.fault == Link.LOST_WRITE
    same = (registers.code[1:] == registers.code[:-1]).all(axis=1)
    assert same[stuck[1:]].all()
    assert np.mean(stuck[1:][stuck[:-1]]) > 0.9


def test_flat_post_is_strong_only_when_facing():
    """Facing, flat and square posts are stronger than a round one of equal width; turned by 9 degrees, weaker."""

    def level(profile, turn_deg):
        ping = Ping.of(1.0, 0.0, np.deg2rad(turn_deg), reflectance=0.0)
        return needed(replace(STATIC, post=Post(0.02, 0.3, profile)), ping)

    facing, turned = ([level(profile, turn) for profile in ("round", "square", "flat")] for turn in (0.0, 9.0))
    assert max(facing[1:]) < facing[0] - 5.0
    assert min(turned[1:]) > turned[0] + 3.0
    with pytest.raises(SettingError, match=r"Post\.profile must be round, square or flat, got 'oval'"):
        Post(profile="oval")


def test_extra_absorption_is_proportional_to_distance():
    """1 dB/m more: 4 dB from a wall at 2 m, 8 dB from one at 4 m; and its time is unchanged."""
    thick = replace(WALL, extra_absorption_db=1.0)
    for distance in (2.0, 4.0):
        ping = Ping.of(distance)
        assert needed(thick, ping) - needed(WALL, ping) == pytest.approx(2.0 * distance, abs=0.15)
    loud = replace(QUIET, sensitivity_db=QUIET.sensitivity_db + 4.0)
    assert first(loud, thick, Ping.of(2.0)) == pytest.approx(first(QUIET, WALL, Ping.of(2.0)), abs=1.0)


def test_rough_face_scatters_to_all_sides_without_mirror_echo():
    """At 1 m and a roughness of 3 mm: no mirror echo, and at 30 degrees as strong as ahead up to Lambert's cosines."""
    smooth, rough = (replace(STATIC, reflector=MIRROR, roughness_m=r) for r in (0.0, 3e-3))
    ahead, aside = Ping.of(1.0, 0.0, 0.0), Ping.of(1.0, 0.0, np.deg2rad(30.0))
    assert needed(smooth, aside) - needed(smooth, ahead) > 30.0
    assert needed(rough, aside) - needed(rough, ahead) < 8.0
    assert needed(rough, ahead) - needed(smooth, ahead) > 6.0
    barely = replace(smooth, roughness_m=0.1e-3)
    assert needed(barely, ahead) - needed(smooth, ahead) == pytest.approx(0.1, abs=0.25)


def test_humidity_drifts():
    setup = replace(WALL, humidity_drift_pct=10.0, drift_tau_s=100.0)
    registers = fire(QUIET, setup, series(2.0, 2000, 1.0))
    assert registers.humidity_pct.std() == pytest.approx(10.0, rel=0.4)
    assert fire(QUIET, WALL, series(2.0, 3)).humidity_pct.tolist() == [50.0, 50.0, 50.0]


def test_every_unknown_parameter_is_drawn():
    """All free parameters of the device are drawn, within their ranges."""
    drawn = [Unit.draw(k) for k in range(200)]
    ticks = {unit.tick for unit in drawn}
    assert ticks == {k * 1e-6 for k in (1, 2, 4, 8, 16, 32, 64)}
    names = "q_tx q_rx f_tx f_rx f_slope radius sensitivity_db noise hysteresis recovery t_offset blanking rearm"
    for name in (*names.split(), "yaw", "pitch", "clock_error", "leak_db", "leak_delay"):
        assert len({getattr(unit, name) for unit in drawn}) == 200, name
    rooms = [Setup.draw(k) for k in range(50)]
    assert all(0.005 <= s.post.radius <= 0.030 and 0.0 <= s.pivot_m <= 0.32 for s in rooms)
    assert len({s.room.wall for s in rooms}) == len({s.humidity_pct for s in rooms}) == 50


def test_no_echo_is_reported_with_movers_hum_and_neighbours():
    movers = (Mover(((0.0, 30.0, 0.0, 0.0),)),)
    setup = replace(STATIC, movers=movers, hum=Hum(), neighbour=Neighbour(strength_db=-200.0))
    reading = fire(QUIET, setup, series(20.0, 5)).reading(setup)
    assert (reading.status == EchoStatus.NO_ECHO).all()
