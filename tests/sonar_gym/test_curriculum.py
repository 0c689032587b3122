"""The curriculum: streets between two distributions, which become harder by success alone."""

import gymnasium
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import DummyVecEnv, VecMonitor

from acquisition import SettingError
from sonar_gym import Curriculum, SonarVecEnv
from sonar_gym.curriculum import between
from sonar_gym.street.street import LEVELS, StreetSettings, draw_street

EASY, HARD = LEVELS["easy"], LEVELS["hard"]


@given(st.floats(0.0, 1.0), st.integers(0, 10**6))
def test_streets_between_two_distributions_lie_between_them(share, seed):
    settings = between(EASY, HARD, share)
    assert HARD.gap[0] - 1e-9 <= settings.gap[0] <= EASY.gap[0] + 1e-9
    assert HARD.gap[1] - 1e-9 <= settings.gap[1] <= EASY.gap[1] + 1e-9
    assert EASY.decoys[1] <= settings.decoys[1] <= HARD.decoys[1]
    draw_street(settings, np.random.default_rng(seed))  # settings are valid


def test_the_ends_are_the_two_distributions():
    assert between(EASY, HARD, 0.0) == EASY
    assert between(EASY, HARD, 1.0) == HARD


@pytest.mark.parametrize(("first", "last"), [((), ("pole",)), (("pole", "car"), ("hedge",))])
def test_the_ends_have_their_own_obstacles(first, last):
    begin, end = StreetSettings(obstacles=first), StreetSettings(obstacles=last)
    assert [between(begin, end, share).obstacles for share in (0.0, 0.5, 1.0)] == [first, last, last]


def test_lengths_in_whole_numbers_are_not_rounded():
    begin, end = StreetSettings(gap=(2, 2), tail=1), StreetSettings(gap=(1, 1), tail=2)
    assert between(begin, end, 0.25).gap == (1.75, 1.75)
    assert between(begin, end, 0.5).tail == 1.5
    assert between(StreetSettings(decoys=(0, 1)), StreetSettings(decoys=(2, 4)), 0.6).decoys == (1, 3)


def test_an_environment_whose_streets_cannot_be_changed_raises_an_error():
    envs = DummyVecEnv([lambda: gymnasium.make("SonarParking-v0")])
    with pytest.raises(SettingError, match=r"Curriculum: .* no street_settings that can be changed: train on Sonar"):
        PPO("MultiInputPolicy", envs, n_steps=2, batch_size=2, device="cpu").learn(2, callback=Curriculum())


def trained(success, still):
    """Train for some steps in streets whose gap is everywhere, or by standing still."""
    envs = VecMonitor(SonarVecEnv(4, max_episode_steps=5))
    fleet = envs.unwrapped.envs.fleet
    step = fleet.step

    def park(rows, actions):
        for i in () if still else rows:
            street, car = fleet.world(i).street, fleet.car_settings
            place = 0.5 * sum(street.gap) - car.centre, 0.5 * (street.line + street.kerb)
            fleet.worlds.car[i] = (*place, 0.0, 0.0, 0.0)
        step(rows, 0.0 * actions)

    fleet.step = park
    curriculum = Curriculum("easy", "hard", success=success, step=0.25, episodes=8)
    PPO("MultiInputPolicy", envs, n_steps=16, batch_size=64, n_epochs=1, device="cpu").learn(64, callback=curriculum)
    return curriculum, envs.get_attr("street_settings")[0]


def test_success_makes_the_streets_harder_until_the_last():
    curriculum, settings = trained(0.8, still=False)
    assert curriculum.share == 1.0
    assert settings == HARD


def test_without_success_the_streets_stay():
    curriculum, settings = trained(0.8, still=True)
    assert curriculum.share == 0.0
    assert settings == EASY


def test_a_gap_that_is_too_short_for_the_car_raises_an_error():
    envs = SonarVecEnv(1)
    with pytest.raises(SettingError, match=r"the gap is 0.4 m long, but the car 0.45 m"):
        envs.set_attr("street_settings", StreetSettings(gap=(0.4, 0.6), decoy=(0.1, 0.2)))


@pytest.mark.parametrize(("name", "value"), [("success", 0.0), ("step", 2.0), ("episodes", 0)])
def test_invalid_settings_raise_an_error(name, value):
    with pytest.raises(SettingError, match=rf"Curriculum\.{name}: expected a .*number"):
        Curriculum(**{name: value})
