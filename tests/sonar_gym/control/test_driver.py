"""The scripted controller: measurements in known streets, and rates of success."""

import gymnasium
import numpy as np
import pytest

from acquisition import SettingError
from noise import GaussianModel
from sonar_gym.control.driver import ParkingDriver, ReversePath, run_episode
from sonar_gym.control.perception import RawPerception, box_distance, find_runs, find_spaces, lane_heading
from sonar_gym.parking.environment import MAX_RANGE
from sonar_gym.parking.fleet import RewardWeights
from sonar_gym.sensing.mounts import LAYOUTS
from sonar_gym.sensing.scene import Box, Scene
from sonar_gym.street.vehicle import CarSettings

HALF = np.radians(27.5)


def passing(boxes, step=0.01):
    """Return positions and readings of a sonar that moves along the x axis and points to the right."""
    along = np.arange(-0.3, 3.0, step)
    poses = np.column_stack([along, 0 * along, np.full(len(along), -np.pi / 2)])
    kerb = Box(1.0, -0.6, 9.0, 0.1)
    return along, Scene([*boxes, kerb]).cast(poses, np.full(len(along), HALF), MAX_RANGE).distance


def test_spaces_are_measured_between_corners():
    boxes = [Box(0.5, -0.38, 0.6, 0.36), Box(1.9, -0.38, 0.4, 0.36), Box(2.7, -0.38, 0.4, 0.36)]
    found = find_spaces(*passing(boxes), HALF)
    assert [found[0].begin, found[0].end] == pytest.approx([0.8, 1.7], abs=0.01)
    assert found[1].length == pytest.approx(0.4, abs=0.02)


def test_space_whose_end_was_not_passed_is_infinite():
    along, reading = passing([Box(0.5, -0.38, 0.6, 0.36), Box(1.9, -0.38, 0.4, 0.36)])
    upto = along < 1.3
    assert find_spaces(along[upto], reading[upto], HALF)[-1].end == np.inf


def test_isolated_outliers_make_no_space():
    along, reading = passing([Box(1.0, -0.38, 2.0, 0.36)])
    wrong = reading.copy()
    wrong[[60, 61, 100, 140]] = [2.0, 1.5, MAX_RANGE, 0.9]
    assert [s.length for s in find_spaces(along, wrong, HALF)] == [s.length for s in find_spaces(along, reading, HALF)]


def test_no_boxes_means_no_space():
    assert find_spaces(np.linspace(0, 1, 20), np.full(20, MAX_RANGE), HALF) == []
    assert box_distance(np.full(20, MAX_RANGE)) == 0.2


def test_runs_too_short_join_the_one_before():
    far = np.array([0, 0, 0, 0, 1, 0, 0, 1, 1, 1, 1, 0, 1, 1], dtype=bool)
    assert find_runs(far) == [(0, 7, False), (7, 14, True)]


@pytest.mark.parametrize("degrees", [-3.0, 0.0, 2.0])
def test_lane_heading_is_estimated_from_the_wall(degrees):
    # a car set down at -degrees to the lane sees the wall at +degrees in its own frame
    slope = np.tan(np.radians(degrees))
    x = np.linspace(0.0, 2.0, 60)
    noise = np.random.default_rng(0).normal(0.0, 0.01, 60)
    wall = 0.65 + slope * x + noise
    wall[::15] = 2.5  # outliers
    assert np.degrees(lane_heading(x, 0 * x, wall)) == pytest.approx(degrees, abs=0.4)


def test_lane_heading_without_readings_is_that_of_the_prior():
    assert lane_heading(np.zeros(0), np.zeros(0), np.zeros(0)) == 0.0
    assert lane_heading(np.arange(5.0), np.zeros(5), np.array([0.1, 1.0, 2.0, 3.0, 9.0])) == 0.0


def test_path_ends_at_its_goal_with_the_heading_of_the_lane():
    path = ReversePath.to(np.array([1.0, -0.48, 0.0]), 0.01, 0.5)
    ends = path.pose(np.array([0.0, path.length]))
    assert ends[0] == pytest.approx([path.start[0], 0.01, 0.0])
    assert ends[1] == pytest.approx([1.0, -0.48, 0.0], abs=1e-9)


def test_path_has_its_radius_and_length():
    path = ReversePath.to(np.array([1.0, -0.48, 0.0]), 0.0, 0.5)
    poses = path.pose(np.linspace(0.0, path.length, 5001))
    moved = np.hypot(*np.diff(poses[:, :2], axis=0).T)
    assert moved.sum() == pytest.approx(path.length, rel=1e-6)
    assert np.abs(np.diff(poses[:, 2])).max() <= moved.max() / 0.5 * (1 + 1e-6)
    assert path.project(poses[2000]) == pytest.approx(2000 / 5000 * path.length, abs=path.length / 199)


def rate(sonar, seeds):
    env, driver = gymnasium.make("SonarParking-v0", sonar=sonar), ParkingDriver()
    return np.mean([run_episode(env, driver, seed).success for seed in seeds])


@pytest.mark.parametrize("sonar", ["ideal", "gaussian"])
def test_driver_parks(sonar):
    assert rate(sonar, range(1000, 1025)) >= 0.9


@pytest.mark.slow
@pytest.mark.parametrize("sonar", ["ideal", "gaussian", "srf08-mlp"])
def test_driver_parks_in_nine_of_ten_streets(sonar):
    assert rate(sonar, range(100)) >= 0.9


def test_driver_fails_without_echoes():
    assert rate(GaussianModel(miss=1.0), range(2)) == 0.0


def test_actions_depend_on_observations_only():
    """Copies of the same observations give the same actions."""
    env, first, second = gymnasium.make("SonarParking-v0"), ParkingDriver(), ParkingDriver()
    observation, _ = env.reset(seed=0)
    for _ in range(150):
        action = first.act(observation)
        assert np.array_equal(action, second.act({key: value.copy() for key, value in observation.items()}))
        assert env.action_space.contains(action)
        observation, _, terminated, _, _ = env.step(action)
        if terminated:
            break


def test_episode_records_readings_and_true_distances_of_every_step():
    env = gymnasium.make("SonarParking-v0", render_mode="rgb_array", max_episode_steps=3)
    episode = run_episode(env, ParkingDriver(), seed=0)
    assert (episode.steps, len(episode.frames)) == (3, 4)
    assert episode.readings.shape == episode.truths.shape == episode.credence.shape == (4, 8)
    echo = episode.echoes == 1
    assert np.abs(episode.readings - episode.truths)[echo].max() < 0.001
    assert episode.frames[0].dtype == np.uint8
    assert not episode.success
    assert run_episode(env, ParkingDriver(), seed=0, every=0).frames == []
    assert len(run_episode(env, ParkingDriver(), seed=0, every=2).frames) == 3  # at the start, at two, at the end


def test_reward_of_parking_exceeds_that_of_idle_and_random_actions():
    class Idle(ParkingDriver):
        def act(self, observation):
            return np.zeros(2, dtype=np.float32)

    class Random(ParkingDriver):
        rng = np.random.default_rng(0)

        def act(self, observation):
            return self.rng.uniform(-1.0, 1.0, 2).astype(np.float32)

    env = gymnasium.make("SonarParking-v0")
    scores = [[run_episode(env, driver(), seed).score for seed in range(5)] for driver in (ParkingDriver, Idle, Random)]
    parked, idle, random = np.array(scores)
    assert parked.min() > 10.0  # ten for parking; progress outweighs the cost of time
    assert np.allclose(idle, 400 * RewardWeights().time)
    assert parked.min() > max(idle.max(), random.max()) + 5.0


def test_layout_without_a_needed_sonar_raises():
    with pytest.raises(SettingError, match="ParkingDriver needs a sonar named 'left'"):
        ParkingDriver(LAYOUTS["four"])


def test_driver_parks_a_car_with_a_larger_turning_radius():
    wide = CarSettings(max_steering=np.radians(25.0))
    assert wide.turning_radius > CarSettings().turning_radius
    env = gymnasium.make("SonarParking-v0", car={"max_steering": wide.max_steering}, street={"gap": [1.2, 1.3]})
    parked = [run_episode(env, ParkingDriver(car=wide), seed).success for seed in range(5)]
    assert np.mean(parked) >= 0.8


def test_perception_by_name_and_as_an_object():
    with pytest.raises(SettingError, match="perception 'radar': no such kind; expected survey, fusion"):
        ParkingDriver(perception="radar")
    own = RawPerception(LAYOUTS["eight"], MAX_RANGE)
    assert ParkingDriver(perception=own).perception is own
