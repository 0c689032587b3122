"""Obstacles that move, those drawn with a street, and the floor."""

import math

import numpy as np
import pytest

from acquisition import SettingError
from sonar_gym.parking.environment import SonarParkingEnv
from sonar_gym.parking.fleet import MAX_RANGE
from sonar_gym.parking.vector import SonarParkingVectorEnv
from sonar_gym.sensing.kernels import SOUND_SPEED, touches
from sonar_gym.street.obstacles import OBSTACLES
from sonar_gym.street.street import StreetSettings, draw_street
from sonar_gym.street.vehicle import CarSettings
from tests.sonar_gym.parking.reference import reference_path

BOXES = [{"begin": 4.0, "length": 0.3}, {"begin": 6.0, "length": 0.3}]
FRONT_X = 0.36


def nose(**fields):
    """Return a layout of one sonar in front, with a cone of 10 deg, whose readings arrive at once."""
    mount = {"name": "nose", "x": FRONT_X, "y": 0.0, "heading_deg": 0.0, "cone_deg": 10.0, "latency_s": 0.0}
    return [{**mount, **fields}]


def approaching(speed, x=2.5, **fields):
    """Return a car's rear, 0.1 m deep and in the lane ahead, that moves towards the own car at a speed in m/s."""
    return {"kind": "car", "x": x, "y": 0.0, "length": 0.1, "vx": -speed, **fields}


# ---- movement --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("speed", [0.0, 0.3, -0.4])
def test_the_sound_meets_a_moving_face_where_it_is_then(speed):
    env = SonarParkingEnv(sonar_layout=nose())
    env.reset(seed=0, options={"boxes": BOXES, "start": [0.0, 0.0, 0.0], "obstacles": [approaching(speed)]})
    for k in range(1, 6):
        info = env.step(np.zeros(2))[4]
        # t seconds after the ping the face is at d - v t, and the sound at c t
        met = (2.5 - 0.05 - FRONT_X - speed * 0.1 * k) / (1.0 + speed / SOUND_SPEED)
        assert info["distance"][0] == pytest.approx(met, abs=1e-9)


def test_a_ping_within_a_step_meets_the_faces_of_its_own_time():
    env = SonarParkingEnv(sonar_layout=nose(latency_s=0.03))
    env.reset(seed=0, options={"boxes": BOXES, "start": [0.0, 0.0, 0.0], "obstacles": [approaching(0.5)]})
    info = env.step(np.zeros(2))[4]
    assert info["sent"][0] == pytest.approx(0.07)
    assert info["distance"][0] == pytest.approx((2.45 - FRONT_X - 0.5 * 0.07) / (1.0 + 0.5 / SOUND_SPEED), abs=1e-9)


def test_a_car_that_stands_is_hit_by_one_that_moves():
    env = SonarParkingEnv()
    options = {"boxes": BOXES, "start": [0.0, 0.0, 0.0], "obstacles": [approaching(1.0, x=0.8)]}
    env.reset(seed=0, options=options)
    hit = [env.step(np.zeros(2))[4]["collision"] for _ in range(8)]
    free = 0.8 - 0.05 - env.fleet.car_settings.body[2]  # m
    assert hit.index(True) == math.ceil(free / 0.1 - 1e-9) - 1
    assert env.world.obstacles[0].x < 0.8


def test_moving_streets_are_the_same_in_both_forms_and_repeat():
    settings = {"obstacles": ["car", "pedestrian", "hedge"]}
    envs = SonarParkingVectorEnv(3, "srf08-mlp", street=settings, credence_driver=None, max_episode_steps=None)
    single = SonarParkingEnv("srf08-mlp", street=settings, credence_driver=None)
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, (12, 3, 2))
    many, one = envs.reset(seed=5)[0], single.reset(seed=6)[0]
    for action in actions:
        for key, value in one.items():
            assert np.array_equal(value, many[key][1]), key
        many, one = envs.step(action)[0], single.step(action[1])[0]
    assert single.world.obstacles[0].x != single.street.obstacles[0].x


# ---- drawn with the street -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", OBSTACLES)
def test_drawn_obstacles_leave_the_path_of_the_car_free_at_all_times(kind):
    settings, car = StreetSettings(obstacles=(kind, kind)), CarSettings()
    for seed in range(10):
        street = draw_street(settings, np.random.default_rng(seed))
        plain = draw_street(StreetSettings(), np.random.default_rng(seed))
        assert np.array_equal(street.strip, plain.strip)
        assert street.gap == plain.gap
        scene, poses = street.scene, reference_path(street, car)[::5, :3].copy()
        assert len(street.obstacles) == 2
        assert len(scene.segments) <= settings.max_faces
        for time in np.linspace(0.0, 40.0, 30):
            moved = (scene.segments + np.tile(scene.velocity * time, 2))[-8:]
            assert all(touches(pose, car.body, moved) == -1 for pose in poses)


def test_an_unknown_kind_is_named():
    with pytest.raises(SettingError, match=r"street.obstacles: expected one of pole, hedge"):
        SonarParkingEnv(street={"obstacles": ["cloud"]})


# ---- floor -----------------------------------------------------------------------------------------------------------


def floor_distance(height, **obstacle):
    """Return distance and obstacle that a nose with a cone of 40 deg faces at a height in m."""
    env = SonarParkingEnv(sonar_layout=nose(cone_deg=40.0, height_m=height))
    obstacles = [obstacle] if obstacle else []
    options = {"boxes": BOXES, "start": [0.0, 0.0, 0.0], "obstacles": obstacles}
    info = env.reset(seed=0, options=options)[1]
    return info["distance"][0], info["obstacle"][0], len(env.street.boxes) + 3 + len(obstacles)


def test_the_floor_is_heard_at_the_lower_edge_of_the_cone():
    for height in (0.05, 0.15, 0.2):
        distance, obstacle, floor = floor_distance(height)
        assert distance == pytest.approx(height / math.sin(math.radians(20.0)))
        assert obstacle == floor


def test_a_near_obstacle_hides_the_floor_behind_it():
    wall = {"kind": "wall", "x": FRONT_X + 0.2, "y": 0.0, "length": 0.02, "width": 0.3}
    distance, obstacle, floor = floor_distance(0.15, **wall)
    assert distance == pytest.approx(0.19)
    assert obstacle == floor - 1


def test_a_high_sonar_hears_no_floor():
    height = MAX_RANGE * math.sin(math.radians(20.0)) + 0.01
    assert floor_distance(height)[:2] == floor_distance(None)[:2]
