"""SonarParking-v0: the Gymnasium interface, observations, rewards and the end of episodes."""

import subprocess
import sys
import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from hypothesis import given, settings
from hypothesis import strategies as st
from stable_baselines3 import PPO
from stable_baselines3.common.env_checker import check_env as check_for_sb3

import sonar_gym
from acquisition import Reading, SettingError, UnknownModelError
from noise import GaussianModel, IdealModel
from sonar_gym.parking.environment import MAX_RANGE, SonarParkingEnv
from sonar_gym.parking.step_kernel import COST

SONARS = ["ideal", "gaussian"]
CHECKED = [*SONARS, "srf08-mlp"]


class NoAnswer(IdealModel):
    """A sensor that never answers: every reading has status NO_ANSWER."""

    def law(self, ping, past=None):
        law = super().law(ping, past)
        law.sample = lambda rng: Reading.of(np.zeros(len(ping)), np.full(len(ping), 2))
        return law


def drive(env, seed, steps=60):
    """Return observations and true distances of one episode under fixed pseudo-random actions."""
    actions = np.random.default_rng(1).uniform([-0.3, 0.2], [0.3, 0.6], (steps, 2)).astype(np.float32)
    observation, info = env.reset(seed=seed)
    out = [(observation, info)]
    for action in actions:
        observation, _, terminated, truncated, info = env.step(action)
        out.append((observation, info))
        if terminated or truncated:
            break
    return out


@pytest.mark.parametrize("sonar", CHECKED)
def test_checker_of_gymnasium_gives_no_warning(sonar):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(gymnasium.make("SonarParking-v0", sonar=sonar).unwrapped, skip_render_check=True)


def test_checker_of_gymnasium_gives_no_warning_with_rendering():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(gymnasium.make("SonarParking-v0", render_mode="rgb_array").unwrapped)


@pytest.mark.parametrize("sonar", CHECKED)
def test_checker_of_stable_baselines_gives_no_warning(sonar):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_for_sb3(gymnasium.make("SonarParking-v0", sonar=sonar))


def test_both_forms_of_the_id_work():
    assert isinstance(gymnasium.make("sonar_gym:SonarParking-v0").unwrapped, SonarParkingEnv)
    assert gymnasium.make("SonarParking-v0").spec.max_episode_steps == 400
    assert sonar_gym.ENV_ID in gymnasium.registry


def test_spec_can_be_restored_from_json():
    env = gymnasium.make("SonarParking-v0", sonar="gaussian", street={"gap": [0.9, 1.0]}, sonar_layout="four")
    again = gymnasium.make(gymnasium.envs.registration.EnvSpec.from_json(env.spec.to_json()))
    assert again.unwrapped.fleet.sonar_name == "gaussian"
    assert again.unwrapped.fleet.street_settings.gap == (0.9, 1.0)
    assert again.observation_space["ranges"].shape == (4,)


def test_observation_is_in_its_space_for_2000_random_steps():
    env = gymnasium.make("SonarParking-v0", sonar="gaussian")
    env.action_space.seed(3)
    observation, _ = env.reset(seed=3)
    for _ in range(2000):
        observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
        assert observation in env.observation_space
        assert type(reward) is float
        assert np.isfinite(reward)
        assert reward == pytest.approx(sum(info["reward_terms"].values()))
        assert type(terminated) is bool
        assert type(truncated) is bool
        if terminated or truncated:
            env.reset()


def test_same_seed_gives_same_episode():
    a, b = (drive(gymnasium.make("SonarParking-v0", sonar="gaussian"), 5) for _ in range(2))
    assert len(a) == len(b)
    for (first, _), (second, _) in zip(a, b, strict=True):
        assert all(np.array_equal(first[key], second[key]) for key in first)


def test_a_generator_that_the_user_has_set_gives_the_episode():
    readings = []
    for seed in (5, 5, 6):
        env = SonarParkingEnv(sonar="gaussian")
        env.np_random = np.random.default_rng(seed)
        readings.append(env.reset()[0]["ranges"].tolist())
    assert readings[0] == readings[1] != readings[2]


SCRIPT = """
import gymnasium, numpy, hashlib, sonar_gym
env = gymnasium.make("SonarParking-v0", sonar="gaussian")
observation, _ = env.reset(seed=11)
digest = hashlib.sha256()
for k in range(40):
    observation = env.step(numpy.array([0.1, 0.4], dtype=numpy.float32))[0]
    for key in sorted(observation):
        digest.update(observation[key].tobytes())
print(digest.hexdigest())
"""


def run(script):
    return subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True).stdout


def test_same_seed_gives_same_episode_in_other_processes():
    assert run(SCRIPT) == run(SCRIPT)


def test_the_world_does_not_depend_on_the_sonar():
    a, b = (drive(gymnasium.make("SonarParking-v0", sonar=sonar), 5) for sonar in SONARS)
    assert len(a) == len(b)
    for (first, truth), (second, same) in zip(a, b, strict=True):
        assert np.array_equal(truth["distance"], same["distance"])
        assert np.array_equal(first["ego"], second["ego"])
    assert any(
        not np.array_equal(first["ranges"], second["ranges"]) for (first, _), (second, _) in zip(a, b, strict=True)
    )


def test_streets_of_later_episodes_do_not_depend_on_the_sonar():
    worlds = []
    for sonar in SONARS:
        env = gymnasium.make("SonarParking-v0", sonar=sonar)
        drive(env, 5, steps=7)
        env.reset()
        worlds.append(env.unwrapped.street.scene.segments)
    assert np.array_equal(*worlds)


def test_ideal_sonar_reads_the_truth_up_to_its_resolution():
    for observation, info in drive(gymnasium.make("SonarParking-v0"), 2):
        assert np.array_equal(observation["echo"] == 1, info["in_cone"])
        assert np.all(observation["ranges"][~info["in_cone"]] == 1.0)
        readings = observation["ranges"].astype(np.float64) * MAX_RANGE
        assert np.all(np.abs(readings - info["distance"])[info["in_cone"]] <= 0.0005 + 1e-6)
        assert np.all(observation["credence"][info["in_cone"]] == 1.0)


def test_noise_has_the_standard_deviation_of_the_model():
    env = gymnasium.make("SonarParking-v0", sonar=GaussianModel(sigma=0.02, sigma_per_metre=0.0), credence_driver=None)
    error = []
    for seed in range(5):
        for observation, info in drive(env, seed):
            error.extend((observation["ranges"] * MAX_RANGE - info["distance"])[observation["echo"] == 1])
    assert np.std(error) == pytest.approx(0.02, rel=0.05)
    assert abs(np.mean(error)) < 0.002


def test_no_answer_differs_from_no_echo():
    observation, _ = gymnasium.make("SonarParking-v0", sonar=NoAnswer()).reset(seed=0)
    assert np.all(observation["echo"] == -1.0)
    assert np.all(observation["ranges"] == 1.0)
    assert np.all(observation["credence"] == 0.0)


def test_odometry_starts_at_zero_and_follows_the_car():
    env = gymnasium.make("SonarParking-v0")
    observation, _ = env.reset(seed=1)
    assert np.array_equal(observation["ego"], np.array([0, 0, 1, 0, 0, 0, 0], dtype=np.float32))
    for _ in range(10):
        observation = env.step(np.array([0.0, 1.0], dtype=np.float32))[0]
    speed, _, cosine, _, along, across, time = observation["ego"]
    assert speed == pytest.approx(1.0, abs=1e-3)
    assert (cosine, across) == (pytest.approx(1.0), pytest.approx(0.0, abs=1e-6))
    assert 0.4 < along * 10.0 < 0.5
    assert time == pytest.approx(10 / 400)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("place", [0, 1])
def test_actions_that_are_not_finite_raise_an_error(bad, place):
    env = SonarParkingEnv()
    env.reset(seed=0)
    action = np.zeros(2, dtype=np.float32)
    action[place] = bad
    with pytest.raises(SettingError, match="action must be finite, got steering"):
        env.step(action)


def test_action_of_another_shape_raises_an_error():
    env = SonarParkingEnv()
    env.reset(seed=0)
    with pytest.raises(SettingError, match=r"action has shape \(3,\), expected \(2,\)"):
        env.step(np.zeros(3))


def test_actions_beyond_the_limits_are_clipped():
    poses = []
    for action in ([5.0, 9.0], [1.0, 1.0]):
        env = SonarParkingEnv()
        env.reset(seed=0)
        for _ in range(5):
            env.step(np.array(action, dtype=np.float32))
        poses.append(env.car.pose)
    assert np.array_equal(*poses)


def test_a_collision_ends_the_episode():
    env = SonarParkingEnv()
    env.reset(seed=0)
    for _ in range(100):
        _, _, terminated, _, info = env.step(np.array([-1.0, 1.0]))
        if terminated:
            break
    assert info["collision"]
    assert not info["is_success"]
    assert info["reward_terms"]["crashed"] < -3.0


def test_leaving_by_the_open_end_ends_the_episode():
    env = SonarParkingEnv(street={"start_heading_deg": 0.0}, reward={"crashed": -2.0, "crash_distance": 0.0})
    env.reset(seed=0)
    for _ in range(100):
        _, _, terminated, _, info = env.step(np.array([0.0, -1.0]))
        if terminated:
            break
    assert info["left_street"]
    assert info["reward_terms"]["crashed"] == -2.0


@pytest.mark.parametrize(("turn", "parked"), [(0.0, True), (9.0, True), (12.0, False)])
def test_standing_in_the_gap_is_success(turn, parked):
    env = SonarParkingEnv()
    env.reset(seed=0)
    street, car = env.street, env.world.car_settings
    middle = 0.5 * sum(street.gap) - car.centre
    env.car = env.car.at(car, middle, 0.5 * (street.line + street.kerb), np.radians(turn))
    _, _, terminated, _, info = env.step(np.zeros(2))
    assert (info["is_success"], terminated) == (parked, parked)
    assert (info["reward_terms"]["parked"] == 10.0) == parked
    assert not info["collision"]


def test_standing_in_the_lane_beside_the_gap_is_no_success():
    env = SonarParkingEnv()
    env.reset(seed=0)
    env.car = env.car.at(env.world.car_settings, 0.5 * sum(env.street.gap) - env.world.car_settings.centre, 0.0, 0.0)
    assert not env.step(np.zeros(2))[4]["is_success"]


def test_shaping_is_the_distance_driven_along_the_lane_times_the_potential():
    street = {"start_offset": 0.0, "start_heading_deg": 0.0, "start": (0.0, 0.0)}
    env = SonarParkingEnv(street=street, reward={"potential": 2.0})
    env.reset(seed=0)
    forwards = sum(env.step(np.array([0.0, 1.0]))[4]["reward_terms"]["shaping"] for _ in range(10))
    assert forwards == pytest.approx(2.0 * env.car.pose[0], abs=0.04)
    backwards = sum(env.step(np.array([0.0, -1.0]))[4]["reward_terms"]["shaping"] for _ in range(10))
    assert backwards < 0


def discounted_shaping(env, seed, choose, discount):
    """Return the discounted sum of the shaping over an episode, the potential at its start, and whether it ended."""
    env.reset(seed=seed)
    before = env.fleet.worlds.task[0, COST]
    total, factor, terminated = 0.0, 1.0, False
    for _ in range(300):
        _, _, terminated, _, info = env.step(choose(env))
        total, factor = total + factor * info["reward_terms"]["shaping"], factor * discount
        if terminated:
            break
    after = 0.0 if terminated else env.fleet.worlds.task[0, COST]
    return total, before - factor * after, terminated


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10**6), st.floats(0.9, 1.0), st.floats(-1.0, 1.0), st.floats(-1.0, 1.0))
def test_shaping_adds_to_any_episode_an_amount_that_its_start_and_end_determine(seed, discount, steering, speed):
    # so no policy gains by it (Ng, Harada and Russell 1999, theorem 1)
    env = SonarParkingEnv(reward={"discount": discount, "potential": 1.0})
    rng = np.random.default_rng(seed)
    total, expected, _ = discounted_shaping(
        env, seed, lambda _: np.clip(rng.normal((steering, speed), 0.3), -1, 1), discount
    )
    assert total == pytest.approx(expected, abs=1e-9)


def test_shaping_of_a_parked_episode_is_the_potential_at_its_start():
    env = SonarParkingEnv(reward={"potential": 1.0})

    def park(env):
        street, car = env.street, env.world.car_settings
        env.car = env.car.at(car, 0.5 * sum(street.gap) - car.centre, 0.5 * (street.line + street.kerb), 0.0)
        return np.zeros(2)

    total, expected, parked = discounted_shaping(env, 0, park, 1.0)
    assert parked
    assert total == pytest.approx(expected, abs=1e-12)


def test_unknown_sonar_and_render_mode_raise_an_error():
    with pytest.raises(UnknownModelError, match="model 'sonic': no such name or folder"):
        SonarParkingEnv(sonar="sonic")
    with pytest.raises(SettingError, match="sonar is a int, expected a name"):
        SonarParkingEnv(sonar=3)
    with pytest.raises(SettingError, match="render_mode 'ansi'"):
        SonarParkingEnv(render_mode="ansi")


def test_step_and_render_need_a_reset():
    env = SonarParkingEnv(render_mode="rgb_array")
    with pytest.raises(gymnasium.error.ResetNeeded, match=r"step\(\) before the first reset"):
        env.step(np.zeros(2))
    with pytest.raises(gymnasium.error.ResetNeeded, match=r"render\(\) before the first reset"):
        env.render()


def test_gymnasium_vector_gives_the_results_of_single_environments():
    envs = gymnasium.make_vec("SonarParking-v0", num_envs=3, vectorization_mode="sync", sonar="gaussian")
    observations, _ = envs.reset(seed=4)
    alone, _ = gymnasium.make("SonarParking-v0", sonar="gaussian").reset(seed=5)
    assert all(np.array_equal(observations[key][1], alone[key]) for key in alone)
    observations, rewards, _, _, _ = envs.step(np.zeros((3, 2), dtype=np.float32))
    assert observations in envs.observation_space
    assert rewards.shape == (3,)
    envs.close()


def test_ppo_can_learn_without_wrappers():
    env = gymnasium.make("SonarParking-v0", sonar="gaussian")
    model = PPO("MultiInputPolicy", env, n_steps=64, batch_size=32, n_epochs=1, seed=0, device="cpu")
    model.learn(64)
    action, _ = model.predict(env.reset(seed=0)[0], deterministic=True)
    assert env.action_space.contains(action)


IMPORT = """
import time
begin = time.process_time()  # processor time of this process, independent of other load
import sonar_gym
took = time.process_time() - begin
import sys, gymnasium
assert "torch" not in sys.modules and "pygame" not in sys.modules and "numba" not in sys.modules
gymnasium.make("SonarParking-v0").reset(seed=0)
assert "torch" not in sys.modules and "pygame" not in sys.modules and "matplotlib" not in sys.modules
print(took)
"""


def test_import_is_fast_and_the_ideal_sonar_needs_no_torch():
    assert min(float(run(IMPORT)) for _ in range(2)) <= 1.0
