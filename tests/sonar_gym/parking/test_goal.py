"""SonarParkingGoal-v0: the interface of goal environments, and the goal in the frame of the odometry."""

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from stable_baselines3 import SAC, HerReplayBuffer
from stable_baselines3.common.env_checker import check_env as check_for_sb3

from acquisition import SettingError
from sonar_gym import SonarParkingEnv, SonarParkingGoalEnv
from sonar_gym.parking.goal import DISCOUNT, LENGTH
from sonar_gym.street.street import Goal
from training.agents.zoo.settings import tuned

ENV = SonarParkingGoalEnv()


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
        reached = np.array([drive @ (c, s), drive @ (-s, c), c, -s, first["desired_goal"][LENGTH], 0.0])
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
    assert max(rewards) <= 0.0


def test_the_observation_is_that_of_the_parking_environment():
    plain, goal = (
        SonarParkingEnv(sonar="gaussian", credence_driver=None),
        SonarParkingGoalEnv(sonar="gaussian", credence_driver=None),
    )
    first, second = plain.reset(seed=3)[0], goal.reset(seed=3)[0]
    assert np.array_equal(np.concatenate([first[name] for name in sorted(first)]), second["observation"])


def test_an_action_is_held_for_four_steps_or_until_the_episode_ends():
    once, held = SonarParkingGoalEnv(hold=1), SonarParkingGoalEnv()
    once.reset(seed=3), held.reset(seed=3)
    over, action = False, np.array([-0.3, 1.0])
    while not over:
        for _ in range(4):
            single = once.step(action)
            if single[2]:
                break
        observation, reward, over, _, _ = held.step(action)
        assert all(np.array_equal(observation[name], single[0][name]) for name in observation)
        assert (reward, over) == single[1:3]


def test_hindsight_replay_trains_on_it():
    env = gymnasium.make("SonarParkingGoal-v0")
    model = SAC(
        "MultiInputPolicy", env, replay_buffer_class=HerReplayBuffer, learning_starts=150, batch_size=16, device="cpu"
    )
    model.learn(160)
    assert model.num_timesteps >= 160


def test_a_reward_raises_an_error():
    with pytest.raises(SettingError, match=r"SonarParkingGoal-v0 takes no reward: its reward is the cost"):
        SonarParkingGoalEnv(reward={"parked": 1.0})


@settings(max_examples=100, deadline=None)
@given(st.floats(-3.0, 3.0), st.floats(-1.0, 1.0), st.floats(-1.0, 1.0))
def test_a_crash_costs_two_more_than_to_wait_at_its_place_for_ever(x, y, turn):
    assert {tuned(name, "SonarParkingGoal-v0").keywords["gamma"] for name in ("sac", "tqc")} == {DISCOUNT}
    desired = np.array([0.0, 0.0, 1.0, 0.0, 0.9, 0.0])
    place = x, y, np.cos(turn), np.sin(turn), 0.9
    wait, crash = (ENV.compute_reward(np.array([*place, end]), desired, {}) for end in (0.0, 1.0))
    assume(wait < 0.0)
    assert crash == pytest.approx(wait / (1.0 - DISCOUNT) - 2.0)


@settings(max_examples=100, deadline=None)
@given(st.floats(-3.0, 3.0), st.floats(-1.0, 1.0), st.floats(-3.0, 3.0))
def test_the_reward_depends_on_the_pose_relative_to_the_goal_alone(x, y, turn):
    env = SonarParkingGoalEnv()
    achieved, desired = np.array([0.3, 0.2, 1.0, 0.0, 0.9, 0.0]), np.array([1.0, -0.3, 1.0, 0.0, 0.9, 0.0])
    c, s = np.cos(turn), np.sin(turn)
    moved = [np.array([x + c * g[0] - s * g[1], y + s * g[0] + c * g[1], c, s, 0.9, 0.0]) for g in (achieved, desired)]
    assert env.compute_reward(*moved, {}) == pytest.approx(env.compute_reward(achieved, desired, {}), abs=1e-6)


def test_rewards_of_many_goals_are_those_of_each_and_a_crash_reaches_none():
    env, rng = SonarParkingGoalEnv(), np.random.default_rng(0)
    goals = rng.uniform(-1.0, 1.0, (20, 6))
    goals[:, LENGTH] = np.tile([0.85, 1.0], 10)
    goals[:, -1] = goals[:, -1] > 0.0
    many = env.compute_reward(goals, goals, {})
    assert np.array_equal(many, [env.compute_reward(goal, goal, {}) for goal in goals])
    assert np.array_equal(many, np.where(goals[:, -1] > 0.0, -3.0, 0.0))
