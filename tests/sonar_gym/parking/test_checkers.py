"""Gymnasium's and Stable-Baselines3's checkers on many seeds, for every registered form and for wrapped roads."""

import warnings

import gymnasium
import highway_env
import pytest
from gymnasium.utils.env_checker import check_env
from stable_baselines3.common.env_checker import check_env as check_for_sb3

import sonar_gym
from tests.sonar_gym.rounded import Rounded

FORMS = [*sonar_gym.ENVIRONMENTS, sonar_gym.GOAL_ENV_ID]
ROADS = ["parking-v0", "highway-v0", "roundabout-v0"]
SHORT = 2  # seeds that are tried in every run of the tests


def made(env_id):
    """Return an environment with a learned sonar; roads are wrapped."""
    if env_id in FORMS:
        return gymnasium.make(env_id, sonar="srf08-mlp", credence_driver=None)
    gymnasium.register_envs(highway_env)
    return sonar_gym.SonarObservation(gymnasium.make(env_id), "srf08-mlp")


def check(env_id, seeds):
    """Run both checkers, then step from each seed; every observation is in the space and repeats with its seed."""
    env = made(env_id)
    env.reset(seed=0)
    env.action_space.seed(0)  # the checkers draw without a seed, and compare rewards of goals to the last digit
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the wrapper differs from the unwrapped environment, on purpose
        check_env(env.unwrapped if env_id in FORMS else env, skip_render_check=True)
        whole = Rounded(env) if env_id == "parking-v0" else env
        check_for_sb3(env.unwrapped if env_id in FORMS else whole, warn=False)  # `make` hides `compute_reward`
    for seed in seeds:
        env.action_space.seed(seed)
        first = env.reset(seed=seed)[0]
        for _ in range(3):
            observation, _, ended, truncated, _ = env.step(env.action_space.sample())
            assert observation in env.observation_space, (seed, observation)
            if ended or truncated:
                break
        again = env.reset(seed=seed)[0]
        for key in first:
            assert (first[key] == again[key]).all(), (seed, key)
    env.close()


@pytest.mark.filterwarnings("ignore:.*out of date:DeprecationWarning")
@pytest.mark.parametrize("env_id", [*FORMS, *ROADS])
def test_checkers_pass(env_id):
    check(env_id, range(SHORT))


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.filterwarnings("ignore:.*out of date:DeprecationWarning")
@pytest.mark.parametrize("env_id", [*FORMS, *ROADS])
def test_checkers_pass_on_200_seeds(env_id):
    check(env_id, range(200))
