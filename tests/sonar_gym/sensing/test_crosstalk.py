"""Bursts of other sonars: geometry by hand, and what firing together does to the readings."""

import math
from dataclasses import replace

import numpy as np
import pytest

from acquisition import EchoStatus, Ping
from acquisition.bench import Neighbour, Rig, Setup, Unit
from noise import GaussianModel, load_model
from noise.rig import SIMULATED
from sonar_gym.parking.environment import SonarParkingEnv
from sonar_gym.parking.fleet import MAX_RANGE
from sonar_gym.sensing import crosstalk, paths
from sonar_gym.sensing.detection import LISTENING_M, detection, detection_table, has_beam, listening_table
from sonar_gym.sensing.records import BY_CROSSTALK, CROSSTALK, RANGE, STATUS, FiredPings, first_echoes
from sonar_gym.sensing.scene import Scene, WallSegment

TABLE = np.full((2, 2, 2, 2), 0.9)
HALF = math.radians(27.5)


def ping(poses, obstacles, sent=None, before=None):
    """Return the paths of each sonar, with those of other bursts; `before` are poses and times of earlier ones."""
    scene, n = Scene(obstacles), len(poses)
    out, counts, poses = np.zeros((n, paths.MAX_PATHS, paths.N_PATH)), np.zeros(n, np.int64), np.array(poses)
    faces = scene.segments, scene.surface, scene.owner
    for s, (x, y, heading) in enumerate(poses):
        counts[s] = paths.cast_paths(x, y, heading, HALF, *faces, MAX_RANGE, TABLE, out[s])
    sent = np.zeros(n) if sent is None else np.array(sent)
    before = np.full((n, 4), crosstalk.NOT_SENT) if before is None else np.array(before)
    around = crosstalk.Surroundings(*faces, MAX_RANGE, TABLE, TABLE)
    crosstalk.add_crosstalk(poses, np.ones(n, np.bool_), sent, before, around, out, counts)
    assert np.array_equal(before, np.column_stack([poses, sent]))
    return [out[s, : counts[s]] for s in range(n)]


WALL = WallSegment(1.0, -5.0, 1.0, 5.0)


def test_the_path_by_a_wall_has_the_length_from_the_mirror_image():
    # sonars 0.6 m apart and 1 m from a wall: the image of one is 2 m behind, sqrt(4 + 0.36) m from the other
    found = ping([(0.0, -0.3, 0.0), (0.0, 0.3, 0.0)], [WALL])
    for own, (other, point_y) in enumerate(((1, 0.0), (0, 0.0))):
        crossed = found[own][found[own][:, paths.SOURCE] > 0.0]
        assert crossed[:, paths.SOURCE].tolist() == [other + 1.0]
        assert crossed[0, paths.DISTANCE] == pytest.approx(0.5 * math.sqrt(4.36))
        assert crossed[0, paths.BEARING] == pytest.approx(math.atan(0.3))  # the same at both
        assert crossed[0, paths.X : paths.Y + 1] == pytest.approx([1.0, point_y])
        assert found[own][-1, paths.SOURCE] == 0.0  # the own path stays last


def test_a_burst_sent_later_is_read_as_farther_and_one_too_late_not_at_all():
    poses = [(0.0, -0.3, 0.0), (0.0, 0.3, 0.0)]
    crossed = ping(poses, [WALL], [0.004, 0.0])[1]
    assert crossed[0, paths.SHIFT] == pytest.approx(0.5 * 343.0 * 0.004)
    assert all(len(found) == 1 for found in ping(poses, [WALL], [0.02, 0.0]))


def test_an_earlier_burst_is_heard_from_far_behind_the_range():
    # 20 ms are 6.86 m of sound: a wall 4.5 m away, beyond the range of 3.01 m, appears at 4.5 m - 3.43 m
    wall, pair = WallSegment(4.5, -9.0, 4.5, 9.0), [(0.0, -0.3, 0.0), (0.0, 0.3, 0.0)]
    earlier = [(0.0, -0.3, 0.0, -0.02), (0.0, 0.3, 0.0, -0.1)]  # the other one has faded
    first, second = ping(pair, [wall], before=earlier)
    for found, apart in ((first, 0.0), (second, 0.6)):
        crossed = found[found[:, paths.SOURCE] > 0.0]
        assert crossed[:, paths.SOURCE].tolist() == [1.0]
        assert crossed[0, paths.DISTANCE] == pytest.approx(math.hypot(4.5, 0.5 * apart))
        assert crossed[0, paths.SHIFT] == pytest.approx(-0.5 * 343.0 * 0.02)
    assert not any(np.any(found[:, paths.SOURCE] > 0.0) for found in ping(pair, [wall]))  # without earlier ones


@pytest.mark.parametrize(("reading", "heard"), [(3.40, 0.0), (3.43, 0.0), (3.45, 0.02), (4.5, 1.07)])
def test_an_echo_of_an_earlier_burst_that_is_back_before_the_ping_is_not_heard(reading, heard):
    # the burst of 20 ms ago, which adds -3.43 m in whole steps of the register, and an empty cone
    two = np.zeros((2, paths.N_PATH))
    two[0, [paths.DISTANCE, paths.SHIFT, paths.SOURCE]] = reading, -3.434, 2.0
    two[1, paths.OBSTACLE] = -1.0
    one, none = np.zeros(1, np.int64), np.zeros(0)
    fired = FiredPings(one, one, np.array([0, 2]), np.zeros(1), one + 2, two, np.zeros((4, 2)), np.zeros(2), one)
    status = np.array([EchoStatus.ECHO, EchoStatus.NO_ECHO], dtype=np.uint8)
    record = first_echoes(fired, np.array([reading, 0.0]), status, none, one[:0], 0.01, MAX_RANGE)[0]
    assert record[RANGE] == pytest.approx(heard)
    assert record[STATUS] == (EchoStatus.ECHO if heard else EchoStatus.NO_ECHO)
    assert record[BY_CROSSTALK] == (2.0 if heard else 0.0)


def test_an_earlier_burst_is_as_loud_as_in_the_rig():
    """A wall 4.5 m ahead is beyond the range, but returns the burst that a neighbour sent 20 ms before the ping."""
    law = listening_table(load_model("srf08-mlp"))
    expected, reading = [], []
    for distance in (4.0, 5.0, 6.0):
        expected.append(detection(law, LISTENING_M, distance, 0.0, 0.0, 0.9))
        found = [rig_reading(distance, unit) for unit in range(301, 365)]
        reading.append(np.mean([abs(r - (distance - 3.43)) <= 0.01 * distance + 0.07 for r in found]))
    assert expected == pytest.approx(reading, abs=0.2)


def rig_reading(distance, unit):
    """Return what a unit of the rig reads whose neighbour has pinged 20 ms before, m; 0 for nothing.

    The wall stands as exactly as the reflectors of the law's survey.
    """
    neighbour = Neighbour(period_s=0.2, first_s=0.18, beside_m=0.05, path_m=0.05, strength_db=0.0)
    setup = Setup(gain=31, range_register=69, neighbour=neighbour)
    ping = Ping.of([distance], reflectance=0.9, time=[0.2], run=[0])
    return Rig(Unit.draw(unit), setup).ping(ping, np.random.default_rng(unit)).reading(setup).range[0]


@pytest.mark.parametrize("distance", [0.5, 1.0, 2.0])
def test_firing_in_turn_helps_as_much_as_in_the_rig(distance):
    """A sonar that looks aside by 35 deg hears its neighbour by a wall; not if the neighbour fires 20 ms earlier."""
    wall, pair = WallSegment(distance, -9.0, distance, 9.0), [(0.0, -0.05, 0.0), (0.0, 0.05, math.radians(35.0))]
    together, in_turn = ping(pair, [wall])[1], ping(pair, [wall], [0.0, 0.02])[1]
    crossed = together[together[:, paths.SOURCE] > 0.0][0]
    expected = paths.detected(detection_table(load_model("srf08-mlp"), MAX_RANGE), MAX_RANGE, crossed)
    assert expected == pytest.approx(heard_in_rig(crossed[paths.DISTANCE], first_s=0.2), abs=0.15)
    assert not np.any(in_turn[:, paths.SOURCE] > 0.0)
    assert heard_in_rig(crossed[paths.DISTANCE], first_s=0.18) == pytest.approx(0.0, abs=0.1)


def heard_in_rig(half_path, first_s, units=range(701, 725)):
    """Return how often units that ping at 0.2 s read the burst of a mirror image, 38 deg off their axis."""
    image = Neighbour(period_s=0.2, first_s=first_s, path_m=2.0 * half_path, bearing_deg=38.0)
    setup, near = replace(SIMULATED, post=None, range_register=69, neighbour=image), []
    for unit in units:
        registers = Rig(Unit.draw(unit), setup).ping(Ping.of([20.0], time=[0.2]), np.random.default_rng(unit))
        near.append(abs(registers.reading(setup).range[0] - half_path) <= 0.01 * half_path + 0.07)
    return np.mean(near)


def test_what_either_cannot_see_is_not_heard():
    behind = WallSegment(0.5, -0.4, 0.5, -0.1)  # hides the mirror point from the first sonar
    assert len(ping([(0.0, -0.3, 0.0), (0.0, 0.3, 0.0)], [WALL, behind])[1]) == 1
    away = ping([(0.0, -0.3, math.pi), (0.0, 0.3, 0.0)], [WALL])
    assert [len(found) for found in away] == [1, 1]
    short = ping([(0.0, -0.3, 0.0), (0.0, 0.3, 0.0)], [WallSegment(1.0, 0.1, 1.0, 5.0)])
    assert not any(np.any(found[:, paths.SOURCE] > 0.0) for found in short)


def test_a_sonar_without_a_beam_hears_only_itself():
    assert not has_beam(detection_table(GaussianModel(), MAX_RANGE))
    assert has_beam(detection_table(load_model("srf08-mlp"), MAX_RANGE))


def share_of_crosstalk(**settings):
    env, causes = SonarParkingEnv(sonar="srf08-mlp", credence_driver=None, **settings), []
    for seed in range(4):
        env.reset(seed=seed)
        for _ in range(40):
            causes.append(env.step(np.array([0.1, 0.5]))[4]["cause"])
    return np.mean(np.array(causes) == CROSSTALK)


def test_firing_in_turn_reduces_crosstalk():
    together, in_turn = share_of_crosstalk(), share_of_crosstalk(sonar_layout="eight in turn")
    assert together > 0.05
    assert in_turn < 0.5 * together
    assert share_of_crosstalk(crosstalk=False) == 0.0
