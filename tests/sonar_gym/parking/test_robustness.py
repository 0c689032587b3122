"""Robustness: random and invalid actions, and sonars without probabilities."""

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

import sonar_gym
from acquisition import SettingError
from noise import GaussianModel
from noise.law import SampleOnlyLaw
from sonar_gym.control.driver import ParkingDriver, run_episode

NOT_FINITE = (np.nan, np.inf, -np.inf)


def random_actions(rng, count):
    """Return actions of which one in twenty is not finite and most others exceed the limits."""
    actions = rng.uniform(-3.0, 3.0, (count, 2)).astype(np.float32)
    invalid = rng.random((count, 2)) < 0.025
    actions[invalid] = rng.choice(NOT_FINITE, invalid.sum())
    return actions


def step_or_error(env, action, used=...):
    """Return the result of a step or its error message; an error must leave the cars unchanged."""
    before = env.unwrapped.fleet.worlds.car.copy()
    try:
        result = env.step(action)
    except SettingError as error:
        assert np.array_equal(env.unwrapped.fleet.worlds.car, before)
        return str(error)
    assert np.all(np.isfinite(action[used]))
    return result


def count_errors(env, steps, seed=0):
    """Take random actions; return the number of errors."""
    errors = 0
    env.reset(seed=seed)
    for action in random_actions(np.random.default_rng(seed), steps):
        result = step_or_error(env, action)
        if isinstance(result, str):
            assert result.startswith("action must be finite, got steering")
            errors += 1
            continue
        observation, reward, terminated, truncated, _ = result
        assert observation in env.observation_space
        assert np.isfinite(reward)
        if terminated or truncated:
            env.reset()
    return errors


def count_errors_of_many(envs, steps, seed=0):
    """Take random actions in many environments; return the number of steps with errors."""
    errors, rng, resets = 0, np.random.default_rng(seed), np.zeros(envs.num_envs, dtype=bool)
    envs.reset(seed=seed)
    for _ in range(steps):
        actions = random_actions(rng, envs.num_envs)
        actions[rng.random(envs.num_envs) < 0.99] = 0.5  # otherwise every step raises an error
        result = step_or_error(envs, actions, ~resets)  # actions of environments that are reset are ignored
        if isinstance(result, str):
            assert result.startswith("action of environment ")
            errors += 1
            continue
        assert result[0] in envs.observation_space
        assert np.all(np.isfinite(result[1]))
        if envs.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP:
            resets = result[2] | result[3]
    return errors


@pytest.mark.parametrize("settings", [{"sonar": "ideal"}, {"sonar": "srf08-mlp", "odometry": "worn"}], ids=str)
def test_2000_random_steps_are_clipped_or_raise_an_error(settings):
    assert 50 < count_errors(gymnasium.make(sonar_gym.ENV_ID, **settings), 2000) < 200


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
def test_random_steps_of_many_are_clipped_or_raise_an_error(mode):
    envs = gymnasium.make_vec(sonar_gym.ENV_ID, num_envs=20, sonar="gaussian", autoreset_mode=mode)
    assert count_errors_of_many(envs, 300) > 0


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("sonar", ["ideal", "gaussian", "srf08-mlp"])
@pytest.mark.parametrize("layout", ["eight", "eight in turn"])
def test_100000_random_steps_are_clipped_or_raise_an_error(sonar, layout):
    env = gymnasium.make(sonar_gym.ENV_ID, sonar=sonar, sonar_layout=layout, difficulty="hard", odometry="worn")
    assert count_errors(env, 100_000) > 4000


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("sonar", ["ideal", "srf08-mlp"])
def test_100000_random_steps_of_many_are_clipped_or_raise_an_error(sonar):
    assert count_errors_of_many(gymnasium.make_vec(sonar_gym.ENV_ID, num_envs=64, sonar=sonar), 1600) > 50


class Sampled(SampleOnlyLaw):
    """The samples of a law alone."""

    def __init__(self, law):
        super().__init__(law.distance, law.resolution, law.max_range)
        self.sample = law.sample


class SampleOnlyModel(GaussianModel):
    """The Gaussian sonar without its probabilities."""

    def law(self, ping, past=None):
        return Sampled(super().law(ping, past))


def test_a_sonar_without_probabilities_gives_the_same_readings_and_credence():
    env = gymnasium.make(sonar_gym.ENV_ID, sonar=SampleOnlyModel())
    known = gymnasium.make(sonar_gym.ENV_ID, sonar=GaussianModel())
    result = [run_episode(each, ParkingDriver(), 1) for each in (env, known)]
    assert np.array_equal(result[0].readings, result[1].readings)
    assert np.mean(np.abs(result[0].credence - result[1].credence)) < 0.03
    assert "credence_given_condition" not in env.reset(seed=0)[1]
    assert "credence_given_condition" in known.reset(seed=0)[1]


def test_many_with_a_sonar_without_probabilities_equal_single_environments():
    envs = gymnasium.make_vec(sonar_gym.ENV_ID, num_envs=3, sonar=SampleOnlyModel())
    alone = gymnasium.make(sonar_gym.ENV_ID, sonar=SampleOnlyModel())
    observations, infos = envs.reset(seed=4)
    observation, _ = alone.reset(seed=5)
    for _ in range(20):
        assert all(np.array_equal(observations[key][1], observation[key]) for key in observation)
        observations, _, _, _, infos = envs.step(np.full((3, 2), 0.3))
        observation = alone.step(np.full(2, 0.3))[0]
    assert "credence_given_condition" not in infos


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_a_car_can_be_driven_with_the_rig():
    env = gymnasium.make(sonar_gym.ENV_ID, sonar="rig")
    count_errors(env, 300)
    episode = run_episode(env, ParkingDriver(), 0)
    echo = episode.echoes == 1
    right = np.abs(episode.readings - episode.truths) <= 0.1 * episode.truths
    assert np.isfinite(episode.readings).all()
    assert np.mean(right[echo]) == pytest.approx(np.mean(episode.credence[echo]), abs=0.15)
