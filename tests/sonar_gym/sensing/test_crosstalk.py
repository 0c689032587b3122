"""Bursts of other sonars: geometry by hand, and what firing together does to the readings."""

import math

import numpy as np
import pytest

from noise import GaussianModel, load_model
from sonar_gym.parking.environment import SonarParkingEnv
from sonar_gym.parking.fleet import MAX_RANGE
from sonar_gym.sensing import crosstalk, paths
from sonar_gym.sensing.detection import detection_table, has_beam
from sonar_gym.sensing.records import CROSSTALK
from sonar_gym.sensing.scene import Scene, WallSegment

TABLE = np.full((2, 2, 2, 2), 0.9)
HALF = math.radians(27.5)


def ping(poses, obstacles, sent=None, table=TABLE):
    """Return the paths of each sonar, with those of the others' bursts."""
    scene, n = Scene(obstacles), len(poses)
    out, counts, poses = np.zeros((n, paths.MAX_PATHS, paths.N_PATH)), np.zeros(n, np.int64), np.array(poses)
    faces = scene.segments, scene.surface, scene.owner
    for s, (x, y, heading) in enumerate(poses):
        counts[s] = paths.cast_paths(x, y, heading, HALF, *faces, MAX_RANGE, table, out[s])
    sent = np.zeros(n) if sent is None else np.array(sent)
    crosstalk.add_crosstalk(poses, np.ones(n, np.bool_), sent, *faces, MAX_RANGE, table, out, counts)
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
    env, causes = SonarParkingEnv(sonar="srf08-mlp", **settings), []
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
