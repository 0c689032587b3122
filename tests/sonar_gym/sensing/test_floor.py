"""The echo of the floor, by geometry and against the waveform rig."""

import math
from dataclasses import replace

import numpy as np
import pytest

from acquisition import Ping
from acquisition.bench import Rig, Unit
from acquisition.bench.laboratory.setup import Room
from noise import load_model
from noise.rig import SIMULATED
from sonar_gym.parking.fleet import MAX_RANGE
from sonar_gym.sensing import paths
from sonar_gym.sensing.detection import detection_table
from sonar_gym.sensing.scene import Scene, WallSegment
from sonar_gym.street.street import StreetSettings

HALF = math.radians(27.5)
ROUGH_DB = -20.0  # of the rig's floor
FLOOR = StreetSettings().floor_reflectance, math.radians(StreetSettings().floor_texture_deg)


def cast(height, obstacles, table):
    """Return the paths of a sonar at a height in m."""
    scene, out = Scene(obstacles), np.zeros((paths.MAX_PATHS, paths.N_PATH))
    faces = scene.segments, scene.surface, scene.owner
    count = paths.cast_paths(0.0, 0.0, 0.0, HALF, *faces, MAX_RANGE, table, out, (height, *FLOOR))
    return out[:count]


def test_the_floor_adds_an_echo_to_what_else_is_in_the_cone_and_is_never_the_main_path():
    table = np.full((2, 2, 2, 2), 0.9)
    for obstacles, main in (([], -1), ([WallSegment(2.0, -5.0, 2.0, 5.0)], 0)):
        found = cast(0.2, obstacles, table)
        assert found[:, paths.OBSTACLE].tolist() == [len(obstacles), main]
        assert found[0, paths.DISTANCE] == pytest.approx(0.2 / math.sin(HALF))


def test_a_wall_that_is_always_heard_hides_the_floor_behind_it_but_not_before_it():
    table = np.ones((2, 2, 2, 2))
    assert len(cast(0.2, [WallSegment(0.3, -5.0, 0.3, 5.0)], table)) == 1
    assert len(cast(0.2, [WallSegment(0.6, -5.0, 0.6, 5.0)], table)) == 2


@pytest.mark.parametrize("height", [0.15, 0.2, 0.4, 0.6])
def test_the_floor_is_heard_as_often_as_in_the_rig(height):
    """Without the echo from straight below, which some units hear by a side lobe."""
    table = detection_table(load_model("srf08-mlp"), MAX_RANGE)
    found = cast(height, [], table)
    expected = paths.detected(table, MAX_RANGE, found[0]) if len(found) > 1 else 0.0
    reading = np.array([rig_reading(height, unit) for unit in range(701, 717)])
    nearest = height / math.sin(HALF)
    heard = (reading > 0.5 * (height + nearest)) & (reading < nearest + 0.3)
    assert expected == pytest.approx(np.mean(heard), abs=0.25)


def rig_reading(height, unit):
    """Return what a unit of the rig reads above a rough floor, m; 0 for nothing."""
    room = Room(height=height, ceiling=None, wall=None, floor_scatter_db=ROUGH_DB)
    setup = replace(SIMULATED, post=None, range_register=69, room=room)
    return Rig(Unit.draw(unit), setup).ping(Ping.of([20.0]), np.random.default_rng(unit)).reading(setup).range[0]
