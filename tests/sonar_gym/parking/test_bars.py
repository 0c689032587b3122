"""Wild actions, none of which may do harm; and sonars of which nothing is known but what they say."""

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

import sonar_gym
from acquisition import SettingError
from acquisition.errors import SampleOnlyError
from noise import EchoLaw, GaussianModel
from sonar_gym.control.driver import ParkingDriver, run_episode

NOT_FINITE = (np.nan, np.inf, -np.inf)


def wild(rng, count):
    """Return actions of which one in twenty is not finite, and most of the others are too great."""
    actions = rng.uniform(-3.0, 3.0, (count, 2)).astype(np.float32)
    broken = rng.random((count, 2)) < 0.025
    actions[broken] = rng.choice(NOT_FINITE, broken.sum())
    return actions


def stepped(env, action, looked_at=...):
    """Return what a step says, or why it is refused; what is not finite must be refused, and leave the cars alone."""
    before = env.unwrapped.fleet.worlds.car.copy()
    try:
        said = env.step(action)
    except SettingError as error:
        assert np.array_equal(env.unwrapped.fleet.worlds.car, before)
        return str(error)
    assert np.all(np.isfinite(action[looked_at]))
    return said


def torment(env, steps, seed=0):
    """Take wild actions; return how many were refused."""
    refused = 0
    env.reset(seed=seed)
    for action in wild(np.random.default_rng(seed), steps):
        said = stepped(env, action)
        if isinstance(said, str):
            assert said.startswith("action must be finite, got steering")
            refused += 1
            continue
        observation, reward, terminated, truncated, _ = said
        assert observation in env.observation_space
        assert np.isfinite(reward)
        if terminated or truncated:
            env.reset()
    return refused


def torment_many(envs, steps, seed=0):
    """Take wild actions in many environments; return how many steps were refused."""
    refused, rng, begins = 0, np.random.default_rng(seed), np.zeros(envs.num_envs, dtype=bool)
    envs.reset(seed=seed)
    for _ in range(steps):
        actions = wild(rng, envs.num_envs)
        actions[rng.random(envs.num_envs) < 0.99] = 0.5  # else every step of many holds something that is refused
        said = stepped(envs, actions, ~begins)  # an environment that begins anew does not look at its action
        if isinstance(said, str):
            assert said.startswith("action of environment ")
            refused += 1
            continue
        assert said[0] in envs.observation_space
        assert np.all(np.isfinite(said[1]))
        if envs.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP:
            begins = said[2] | said[3]
    return refused


@pytest.mark.parametrize("settings", [{"sonar": "ideal"}, {"sonar": "srf08-mlp", "odometry": "worn"}], ids=str)
def test_2000_wild_steps_are_clipped_or_refused(settings):
    assert 50 < torment(gymnasium.make(sonar_gym.ENV_ID, **settings), 2000) < 200


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
def test_wild_steps_of_many_are_clipped_or_refused(mode):
    envs = gymnasium.make_vec(sonar_gym.ENV_ID, num_envs=20, sonar="gaussian", autoreset_mode=mode)
    assert torment_many(envs, 300) > 0


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("sonar", ["ideal", "gaussian", "srf08-mlp"])
@pytest.mark.parametrize("layout", ["eight", "eight in turn"])
def test_100000_wild_steps_are_clipped_or_refused(sonar, layout):
    env = gymnasium.make(sonar_gym.ENV_ID, sonar=sonar, sonar_layout=layout, difficulty="hard", odometry="worn")
    assert torment(env, 100_000) > 4000


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("sonar", ["ideal", "srf08-mlp"])
def test_100000_wild_steps_of_many_are_clipped_or_refused(sonar):
    assert torment_many(gymnasium.make_vec(sonar_gym.ENV_ID, num_envs=64, sonar=sonar), 1600) > 50


class Mute(EchoLaw):
    """A law that is drawn from as another is, and tells nothing."""

    has_probabilities = False

    def __init__(self, law):
        super().__init__(law.distance, law.resolution, law.max_range)
        self.sample = law.sample

    def arrival(self, z):
        raise SampleOnlyError("draw readings")

    @property
    def no_answer(self):
        raise SampleOnlyError("draw readings")


class MuteModel(GaussianModel):
    """The Gaussian sonar, as far as it can be known by listening."""

    def law(self, ping, past=None):
        return Mute(super().law(ping, past))


def test_a_sonar_that_can_only_be_drawn_from_gives_what_can_be_known():
    env = gymnasium.make(sonar_gym.ENV_ID, sonar=MuteModel())
    known = gymnasium.make(sonar_gym.ENV_ID, sonar=GaussianModel())
    said = [run_episode(each, ParkingDriver(), 1) for each in (env, known)]
    assert np.array_equal(said[0].readings, said[1].readings)
    assert np.mean(np.abs(said[0].credence - said[1].credence)) < 0.03
    assert "credence_given_condition" not in env.reset(seed=0)[1]
    assert "credence_given_condition" in known.reset(seed=0)[1]


def test_many_with_a_sonar_that_can_only_be_drawn_from_say_what_each_says_alone():
    envs = gymnasium.make_vec(sonar_gym.ENV_ID, num_envs=3, sonar=MuteModel())
    alone = gymnasium.make(sonar_gym.ENV_ID, sonar=MuteModel())
    observations, infos = envs.reset(seed=4)
    observation, _ = alone.reset(seed=5)
    for _ in range(20):
        assert all(np.array_equal(observations[key][1], observation[key]) for key in observation)
        observations, _, _, _, infos = envs.step(np.full((3, 2), 0.3))
        observation = alone.step(np.full(2, 0.3))[0]
    assert "credence_given_condition" not in infos


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_the_rig_is_driven_by():
    env = gymnasium.make(sonar_gym.ENV_ID, sonar="rig")
    torment(env, 300)
    episode = run_episode(env, ParkingDriver(), 0)
    echo = episode.echoes == 1
    right = np.abs(episode.readings - episode.truths) <= 0.1 * episode.truths
    assert np.isfinite(episode.readings).all()
    assert np.mean(right[echo]) == pytest.approx(np.mean(episode.credence[echo]), abs=0.15)
