"""SonarParkingGoal-v0: the interface of goal environments, and the goal in the frame of the odometry."""

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from hypothesis import given, settings
from hypothesis import strategies as st
from stable_baselines3 import SAC, HerReplayBuffer
from stable_baselines3.common.env_checker import check_env as check_for_sb3

from acquisition import SettingError
from sonar_gym import SonarParkingEnv, SonarParkingGoalEnv
from sonar_gym.parking.street import Goal


def test_checkers_of_gymnasium_and_stable_baselines_accept_it():
    env = gymnasium.make("SonarParkingGoal-v0", sonar="gaussian", credence_driver=None)
    check_env(env.unwrapped, skip_render_check=True)
    check_for_sb3(env.unwrapped)


def test_a_car_at_the_end_of_the_reference_path_has_reached_its_goal():
    env = SonarParkingGoalEnv()
    for seed in range(5):
        first = env.reset(seed=seed)[0]
        start, goal = env.street.start, Goal.of(env.street, env.car.settings)
        drive = np.array([goal.x - start[0], goal.y - start[1]])
        c, s = np.cos(start[2]), np.sin(start[2])
        reached = np.array([drive @ (c, s), drive @ (-s, c), c, -s, 0.0])
        assert first["desired_goal"] == pytest.approx(reached, abs=1e-6)
        assert env.compute_reward(reached, first["desired_goal"], {}) == pytest.approx(0.0, abs=1e-6)


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 10**6))
def test_rewards_computed_again_from_the_observations_agree_with_those_of_the_steps(seed):
    env, rng = SonarParkingGoalEnv(), np.random.default_rng(seed)
    env.reset(seed=seed)
    rewards, shown, infos, over = [], [], [], False
    while not over and len(rewards) < 200:
        observation, reward, over, _, info = env.step(rng.uniform((-1.0, 0.0), (0.0, 1.0)))
        rewards.append(reward)
        shown.append(observation)
        infos.append(info)
    poses = [np.array([one[name] for one in shown]) for name in ("achieved_goal", "desired_goal")]
    assert env.compute_reward(*poses, {}) == pytest.approx(np.array(rewards))
    assert infos[-1]["collision"]
    assert rewards[-1] < -20.0 < rewards[-2]


def test_the_observation_is_that_of_the_parking_environment():
    plain, goal = (
        SonarParkingEnv(sonar="gaussian", credence_driver=None),
        SonarParkingGoalEnv(sonar="gaussian", credence_driver=None),
    )
    first, second = plain.reset(seed=3)[0], goal.reset(seed=3)[0]
    assert np.array_equal(np.concatenate([first[name] for name in sorted(first)]), second["observation"])


def test_hindsight_replay_trains_on_it():
    env = gymnasium.make("SonarParkingGoal-v0")
    model = SAC(
        "MultiInputPolicy", env, replay_buffer_class=HerReplayBuffer, learning_starts=450, batch_size=16, device="cpu"
    )
    model.learn(460)
    assert model.num_timesteps >= 460


def test_a_reward_raises_an_error():
    with pytest.raises(SettingError, match=r"SonarParkingGoal-v0 takes no reward: its reward is the distance"):
        SonarParkingGoalEnv(reward={"parked": 1.0})


@pytest.mark.parametrize("seed", range(20))
def test_a_crash_costs_more_than_waiting(seed):
    env = SonarParkingGoalEnv()
    first, _ = env.reset(seed=seed)
    begin, goal, info = first["achieved_goal"], first["desired_goal"], {}
    crashed = begin + np.array([0.0, 0.0, 0.0, 0.0, 1.0], dtype=np.float32)
    discount = 0.95  # of the zoo's settings
    assert env.compute_reward(crashed, goal, info) < env.compute_reward(begin, goal, info) / (1.0 - discount)
