"""SonarVecEnv against the vector environment of Stable-Baselines3, and in training."""

import warnings

import gymnasium
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from stable_baselines3 import PPO
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.vec_env import DummyVecEnv, VecCheckNan, VecMonitor

import sonar_gym
from acquisition import SettingError
from sonar_gym.sb3 import SonarVecEnv


def singles(n, **settings):
    return DummyVecEnv([lambda: gymnasium.make(sonar_gym.ENV_ID, **settings)] * n)


def same(a, b):
    assert set(a) == set(b)
    assert all(np.array_equal(a[key], b[key]) for key in a)


def test_results_equal_those_of_dummy_vec_env():
    vec, dummy = SonarVecEnv(4, sonar="gaussian"), singles(4, sonar="gaussian")
    vec.seed(5), dummy.seed(5)
    same(vec.reset(), dummy.reset())
    rng, ends = np.random.default_rng(0), 0
    for k in range(150):
        actions = np.repeat(rng.uniform([-0.8, 0.2], 1.0, (1, 4, 2)), 1, axis=0)[0].astype(np.float32)
        (a, r, done, infos), (b, q, over, others) = vec.step(actions), dummy.step(actions)
        same(a, b)
        assert np.array_equal(r, q)
        assert np.array_equal(done, over)
        for i in np.flatnonzero(done):
            same(infos[i]["terminal_observation"], others[i]["terminal_observation"])
            for name in ("TimeLimit.truncated", "is_success", "collision", "left_street"):
                assert infos[i][name] == others[i][name]
            same(vec.reset_infos[i]["reward_terms"], dummy.reset_infos[i]["reward_terms"])
        ends += done.sum()
        assert k < 400
    assert ends > 4


def test_truncated_episodes_are_marked():
    envs = SonarVecEnv(2, max_episode_steps=3)
    envs.reset()
    for _ in range(3):
        _, _, done, infos = envs.step(np.zeros((2, 2), dtype=np.float32))
    assert done.all()
    assert all(info["TimeLimit.truncated"] for info in infos)


def test_monitor_records_episodes():
    envs = VecMonitor(SonarVecEnv(3, max_episode_steps=10), info_keywords=("is_success",))
    envs.reset()
    episodes = [info["episode"] for _ in range(25) for info in envs.step(np.zeros((3, 2)))[3] if "episode" in info]
    assert len(episodes) == 6
    assert {episode["l"] for episode in episodes} == {10}
    assert not any(episode["is_success"] for episode in episodes)


def test_check_nan_passes():
    envs = VecCheckNan(SonarVecEnv(16, sonar="srf08-mlp", odometry="worn", difficulty="hard"), raise_exception=True)
    envs.reset()
    rng = np.random.default_rng(0)
    for _ in range(100):
        envs.step(rng.uniform(-1.0, 1.0, (16, 2)).astype(np.float32))


def test_ppo_learns_on_it_without_a_warning():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        envs = VecMonitor(SonarVecEnv(8, sonar="srf08-mlp"))
        model = PPO("MultiInputPolicy", envs, n_steps=32, batch_size=64, n_epochs=2, seed=0, device="cpu")
        before = {name: value.clone() for name, value in model.policy.state_dict().items()}
        model.learn(512)
        assert any(not value.equal(before[name]) for name, value in model.policy.state_dict().items())
        mean, _ = evaluate_policy(model, SonarVecEnv(2, max_episode_steps=5), n_eval_episodes=2, warn=False)
    assert np.isfinite(mean)


def test_options_and_images():
    envs = SonarVecEnv(2, render_mode="rgb_array", pictured=[0, 1], infos=True)
    envs.set_options({"difficulty": "easy", "start": [0.5, 0.0, 0.0]})
    envs.reset()
    assert np.all(envs.envs.fleet.worlds.car[:, 0] == 0.5)
    assert envs.render().shape == (660, 2000, 3) or envs.render().shape == (1320, 1000, 3)
    assert set(envs.step(np.zeros((2, 2)))[3][0]["reward_terms"]) == {"shaping", "time", "parked", "crashed"}
    envs.close()


def test_attributes_are_set_for_all_environments():
    envs = SonarVecEnv(3)
    assert envs.get_attr("render_mode", [0, 1]) == [None, None]
    assert envs.env_is_wrapped(gymnasium.Wrapper) == [False] * 3
    envs.set_attr("max_episode_steps", 7)
    assert envs.envs.max_episode_steps == 7
    with pytest.raises(SettingError, match="'max_episode_steps' is shared by all"):
        envs.set_attr("max_episode_steps", 7, indices=[0])
    with pytest.raises(SettingError, match="SonarVecEnv takes no autoreset_mode"):
        SonarVecEnv(2, autoreset_mode="NextStep")


def test_features_of_an_observation_resolve_what_is_near():
    envs = SonarVecEnv(3)
    extractor = sonar_gym.SonarExtractor(envs.observation_space)
    observations = {name: torch.as_tensor(value) for name, value in envs.reset().items()}
    features = extractor(observations)
    assert features.shape == (3, extractor.features_dim)
    observations["ranges"][:, 3] = torch.tensor([0.10, 0.15, 3.01]) / 3.01
    moved = extractor(observations)[:, [3, 11]]
    assert moved == pytest.approx(torch.tensor([[-0.5, 2 / 3], [-1 / 3, 0.5], [2 * 3.01 / 3.31 - 1, 0.0]]), abs=1e-5)


@pytest.mark.parametrize("sonar_layout", ["eight", "four"])
def test_the_extractor_makes_a_policy_of_ppo(sonar_layout):
    features = {"features_extractor_class": sonar_gym.SonarExtractor}
    envs = SonarVecEnv(2, sonar_layout=sonar_layout)
    model = PPO("MultiInputPolicy", envs, n_steps=8, batch_size=16, policy_kwargs=features, device="cpu")
    assert model.learn(16).num_timesteps == 16


@pytest.mark.parametrize("extractor", [sonar_gym.SonarExtractor, sonar_gym.GoalExtractor])
@pytest.mark.parametrize("space", [range(3), gymnasium.spaces.Discrete(2), gymnasium.spaces.Dict({})])
def test_an_extractor_names_the_space_that_it_needs(extractor, space):
    with pytest.raises(SettingError, match=f"{extractor.__name__}.observation_space: expected a Dict space with"):
        extractor(space)


@settings(max_examples=20, deadline=None)
@given(st.floats(-3.0, 3.0), st.floats(-1.0, 1.0), st.floats(-3.0, 3.0))
def test_features_of_a_goal_depend_on_its_pose_relative_to_the_car_alone(x, y, turn):
    space = sonar_gym.SonarParkingGoalEnv().observation_space
    extractor, n = sonar_gym.GoalExtractor(space), 8
    c, s = np.cos(turn), np.sin(turn)
    poses = np.array([[0.3, 0.2, 1.0, 0.0], [1.0, -0.3, 0.8, 0.6]])  # of car and goal
    turned = [(c * p[0] - s * p[1], s * p[0] + c * p[1], c * p[2] - s * p[3], s * p[2] + c * p[3]) for p in poses]
    moved = np.array(turned) + np.array([x, y, 0.0, 0.0])
    own = torch.rand(1, 4 * n + 7)

    def features(car, goal):
        goals = [torch.tensor([[*pose, 0.9, 0.0]], dtype=torch.float32) for pose in (car, goal)]
        return extractor({"observation": own, "achieved_goal": goals[0], "desired_goal": goals[1]})

    assert features(*moved) == pytest.approx(features(*poses), abs=1e-4)
    parts = {"age": own[:, :n], "credence": own[:, n : 2 * n], "echo": own[:, 2 * n : 3 * n]}
    parts |= {"ego": own[:, 3 * n : 3 * n + 7], "ranges": own[:, 3 * n + 7 :]}
    alone = sonar_gym.SonarExtractor(sonar_gym.SonarParkingEnv().observation_space)
    assert torch.equal(features(*poses)[:, 7:], alone(parts))
    assert features(*poses).shape == (1, extractor.features_dim)
