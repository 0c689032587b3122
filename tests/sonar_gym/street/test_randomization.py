"""What episodes draw besides their streets: the distributions, the info, and what options fix."""

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from acquisition import SettingError
from sonar_gym.parking.environment import SonarParkingEnv
from sonar_gym.parking.vector import SonarParkingVectorEnv
from sonar_gym.sensing.mounts import LAYOUTS, Mount, mount_arrays
from sonar_gym.street.randomization import LEVEL_NAMES, Randomization

BOTH = {"street": {"easy": 1.0, "hard": 3.0}, "mounts": (0.02, 5.0)}
NOMINAL = mount_arrays(LAYOUTS["eight"])[0]


def drawn(count, **settings):
    envs = SonarParkingVectorEnv(count, **settings)
    return envs, envs.reset(seed=0)[1].get("randomized")


def test_levels_follow_their_weights_and_give_their_streets():
    envs, info = drawn(2000, randomize=BOTH)
    hard = info["level"] == LEVEL_NAMES.index("hard")
    assert set(info["level"]) == {LEVEL_NAMES.index("easy"), LEVEL_NAMES.index("hard")}
    assert abs(hard.mean() - 0.75) < 4.0 * np.sqrt(0.75 * 0.25 / 2000)
    gaps = np.array([np.diff(envs.fleet.world(i).street.gap)[0] for i in range(2000)])
    assert gaps[hard].max() <= 0.85 + 1e-9
    assert gaps[~hard].min() >= 1.10 - 1e-9


def test_displacements_are_uniform_within_their_limits():
    _, info = drawn(2000, randomize=BOTH)
    share = (info["mounts"] - NOMINAL) / [0.02, 0.02, np.radians(5.0)]
    assert np.abs(share).max() <= 1.0 + 1e-9
    assert np.histogram(share, 10, (-1.0, 1.0))[0] / share.size == pytest.approx(np.full(10, 0.1), abs=0.01)
    assert np.corrcoef(share.reshape(2000, -1).T) == pytest.approx(np.eye(24), abs=0.12)


def test_a_displaced_sonar_reads_as_one_mounted_there():
    env = SonarParkingEnv(randomize={"mounts": (0.05, 10.0)})
    _, info = env.reset(seed=4)
    poses = info["randomized"]["mounts"]
    mounts = [Mount(m.name, x, y, np.degrees(turn)) for m, (x, y, turn) in zip(LAYOUTS["eight"], poses, strict=True)]
    there = SonarParkingEnv(sonar_layout=mounts)
    there.reset(seed=4, options={"street": env.street})
    for action in ([0.3, 1.0], [0.0, 1.0], [-0.5, 0.5]):
        shown, expected = env.step(np.array(action))[4], there.step(np.array(action))[4]
        assert shown["distance"] == pytest.approx(expected["distance"], abs=1e-9)
    assert not np.allclose(poses, NOMINAL)


def test_environments_of_one_seed_draw_the_same_single_and_vector_and_each_episode_draws_anew():
    single, (_, many) = SonarParkingEnv(randomize=BOTH), drawn(3, randomize=BOTH)
    poses = [single.reset(seed=seed)[1]["randomized"]["mounts"] for seed in range(3)]
    assert np.array_equal(poses, many["mounts"])
    assert not np.array_equal(single.reset()[1]["randomized"]["mounts"], poses[2])
    check_env(gymnasium.make("SonarParking-v0", randomize=BOTH).unwrapped, skip_render_check=True)


def test_the_info_of_an_episode_is_not_changed_by_the_next():
    envs = SonarParkingVectorEnv(50, randomize=BOTH, max_episode_steps=1, autoreset_mode="SameStep")
    info, episodes = envs.reset(seed=0)[1], []
    for _ in range(3):
        episodes.append(info["randomized"])
        info = envs.step(np.zeros((50, 2)))[4]
        final = info["final_info"]["randomized"]
        for name in ("level", "mounts"):
            assert np.array_equal(final[name], episodes[-1][name])
    assert len({tuple(episode["level"]) for episode in episodes}) == 3


def test_nothing_is_drawn_unless_asked_for():
    assert drawn(2)[1] is None
    plain, moved = SonarParkingEnv(), SonarParkingEnv(randomize={"street": {}})
    plain.reset(seed=1)
    moved.reset(seed=1)
    assert np.array_equal(plain.street.strip, moved.street.strip)


def test_options_fix_the_difficulty():
    env = SonarParkingEnv(randomize=BOTH)
    for _ in range(5):
        info = env.reset(options={"difficulty": "normal"})[1]
        assert info["randomized"]["level"] == -1
        assert 0.85 <= np.diff(env.street.gap)[0] <= 1.15


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"street": {"lunar": 1.0}}, "randomize street 'lunar': unknown level; expected easy, normal, hard, manoeuvre"),
        ({"street": {"easy": -1.0}}, r"randomize street: weights must be >= 0 and one of them > 0, got \[-1.0\]"),
        ({"street": {"easy": 0.0}}, "weights must be >= 0 and one of them > 0"),
        ({"street": {"easy": "a"}}, "randomize street 'easy': expected a finite number, got 'a'"),
        ({"street": ["easy"]}, r"randomize street: expected a mapping of levels to weights, got \['easy'\]"),
        ({"mounts": (0.01,)}, r"randomize mounts: expected 2 values, got \(0.01,\)"),
        ({"mounts": 0.1}, "randomize mounts: expected a list, got 0.1"),
        ({"mounts": (-0.1, 5.0)}, "randomize mounts: expected a number from 0 to 1000 m, got -0.1 m"),
        ({"mounts": (0.01, np.nan)}, "randomize mounts: expected a number from 0 to 360 deg, got nan deg"),
        ({"weather": 1.0}, "randomize: unknown field 'weather'; expected street, mounts"),
    ],
)
def test_invalid_distributions_raise_an_error(given, message):
    with pytest.raises(SettingError, match=message):
        SonarParkingEnv(randomize=given)


def test_weights_need_not_sum_to_one():
    levels = [Randomization(street=weights).draw(np.random.default_rng(3), 8).level
              for weights in ({"easy": 1.0, "hard": 3.0}, {"easy": 10.0, "hard": 30.0})]  # fmt: skip
    assert levels[0] == levels[1]
