"""Odometry: exact without errors, errors as set, and no influence on the world."""

import itertools

import gymnasium
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from acquisition import SettingError
from sonar_gym.parking.environment import ODOMETRY_SPAN, STEP_S, SonarParkingEnv
from sonar_gym.sensing import kernels
from sonar_gym.sensing.odometry import ODOMETRIES, Odometer, OdometrySettings, dead_reckoned, odometry, update_odometry

poses = st.tuples(st.floats(-5, 5), st.floats(-5, 5), st.floats(-3.1, 3.1)).map(np.array)


def step(odometer, before, after):
    """Update the odometry of the first car between two true poses."""
    odometer.slip()
    update_odometry(odometer.state[0], before, after)


def walk(kind, seed, steps=200, length=0.02):
    """Return the estimated pose after driving straight on with a heading of 0.3 rad."""
    odometer = Odometer(kind)
    odometer.seed(seed)
    odometer.begin()
    path = np.arange(steps + 1)[:, None] * length * np.array([[np.cos(0.3), np.sin(0.3), 0.0]]) + [1.0, 2.0, 0.3]
    for before, after in itertools.pairwise(path):
        step(odometer, before, after)
    return odometer.pose


@settings(deadline=None)  # the first call compiles
@given(st.lists(poses, min_size=2, max_size=6))
def test_exact_odometry_is_the_pose_in_the_frame_of_the_start(path):
    odometer = Odometer(OdometrySettings())
    odometer.begin()
    for before, after in itertools.pairwise(path):
        step(odometer, before, after)
    x, y = kernels.to_frame(path[-1][0], path[-1][1], path[0])
    assert odometer.pose[:2] == pytest.approx([x, y], abs=1e-9)
    turn = odometer.pose[2] - (path[-1][2] - path[0][2])
    assert np.exp(1j * turn) == pytest.approx(1.0, abs=1e-9)


def test_a_wheel_diameter_error_scales_distances_and_a_steering_offset_bends_the_path():
    pose = np.zeros(3)
    for k in range(100):
        pose = dead_reckoned(pose, np.array([0.01 * k, 0, 0]), np.array([0.01 * (k + 1), 0, 0]), 0.02, 0.05, 0.0)
    assert pose[2] == pytest.approx(0.05 * 1.02)  # rad; 1 m, measured 2 % too long
    radius = 1.0 / 0.05
    end = [radius * np.sin(0.051), radius * (1.0 - np.cos(0.051))]
    assert pose[:2] == pytest.approx(end, abs=3e-4)  # on the circle, up to the length of a step


def test_driving_back_undoes_driving_forth():
    there = dead_reckoned(np.zeros(3), np.zeros(3), np.array([0.1, 0.0, 0.0]), 0.03, 0.2, 0.0)
    back = dead_reckoned(there, np.array([0.1, 0.0, 0.0]), np.zeros(3), 0.03, 0.2, 0.0)
    assert back == pytest.approx(np.zeros(3), abs=3e-3)
    assert back[2] == pytest.approx(0.0, abs=1e-12)


def test_standard_deviation_after_four_metres_follows_the_settings():
    kind = ODOMETRIES["wheels"]
    ends = np.array([walk(kind, seed) for seed in range(600)])
    along = np.hypot(kind.scale * 4.0, kind.slip * np.sqrt(4.0))
    turned = np.hypot(kind.pull * 4.0, kind.wander * np.sqrt(4.0))
    assert ends[:, 2].std() == pytest.approx(turned, rel=0.1)
    assert np.hypot(ends[:, 0], ends[:, 1]).std() == pytest.approx(along, rel=0.1)
    assert np.abs(ends.mean(axis=0) - [4.0, 0.0, 0.0]).max() < 0.03


def test_same_seed_gives_same_errors_and_standing_gives_none():
    assert np.array_equal(walk(ODOMETRIES["worn"], 3), walk(ODOMETRIES["worn"], 3))
    assert not np.array_equal(walk(ODOMETRIES["worn"], 3), walk(ODOMETRIES["worn"], 4))
    assert np.array_equal(walk(ODOMETRIES["worn"], 3, length=0.0), np.zeros(3))


def test_world_and_readings_do_not_depend_on_the_odometry():
    exact, worn = (gymnasium.make("SonarParking-v0", sonar="gaussian", odometry=kind) for kind in ("exact", "worn"))
    for seed in (3, None):
        exact.reset(seed=seed)
        worn.reset(seed=seed)
        for _ in range(30):
            a, b = (env.step(np.float32([0.2, 0.6])) for env in (exact, worn))
        assert np.array_equal(a[4]["distance"], b[4]["distance"])
        assert np.array_equal(a[0]["ranges"], b[0]["ranges"])
        assert not np.array_equal(a[0]["ego"], b[0]["ego"])


def test_observed_speed_and_steering_have_the_errors_of_the_odometry():
    at_once = {"acceleration": 1e9, "speed_lag": 0.0}
    env = SonarParkingEnv(car=at_once, odometry={"scale": 0.1, "pull": 0.1}, street={"start_heading_deg": 0.0})
    car, ego_values = env.fleet.car_settings, [env.reset(seed=2)[0]["ego"].astype(np.float64)]
    ego_values += [env.step(np.array([0.0, 0.6]))[0]["ego"].astype(np.float64) for _ in range(30)]
    speed = np.array([ego[0] for ego in ego_values[1:]]) * car.max_speed
    curvature = np.tan([ego[1] * car.max_steering for ego in ego_values[1:]]) / car.wheelbase
    assert abs(speed[0] / (0.6 * car.max_speed) - 1.0) > 0.005  # otherwise the test shows nothing
    assert abs(curvature[0]) > 0.005
    heading = np.arctan2(ego_values[-1][3], ego_values[-1][2])
    assert np.sum(speed * curvature) * STEP_S == pytest.approx(heading, abs=1e-5)
    distance = np.hypot(ego_values[-1][4] * ODOMETRY_SPAN[0], ego_values[-1][5] * ODOMETRY_SPAN[1])
    assert np.sum(speed) * STEP_S == pytest.approx(distance, rel=2e-3)  # an arc and its chord


def test_settings_by_name_mapping_and_error():
    assert odometry({"scale": 0.1}) == OdometrySettings(scale=0.1)
    with pytest.raises(SettingError, match="odometry: expected one of exact, wheels, worn, got 'gps'"):
        odometry("gps")
    with pytest.raises(SettingError, match=r"OdometrySettings.pull: expected a number from 0 to 10, got -1"):
        OdometrySettings(pull=-1.0)
