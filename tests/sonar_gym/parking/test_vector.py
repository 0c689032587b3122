"""The vector environment gives the results of single environments in Gymnasium's own vector environment."""

import inspect
import subprocess
import sys
import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.utils.passive_env_checker import check_action_space, check_obs, check_observation_space
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.wrappers.vector import RecordEpisodeStatistics
from stable_baselines3.common.env_checker import check_env as check_for_sb3

import sonar_gym
from acquisition import Ping, SettingError
from noise import GaussianModel
from noise.faults import Constant, Faulty, Short
from noise.learned.inputs import Inputs
from noise.learned.mixture import Head
from noise.learned.networks import MlpModel
from noise.learned.recurrent import LstmModel
from noise.learned.recurrent_state import N_ANCHORS, N_HISTORY_FEATURES, LstmCell
from sonar_gym.parking.environment import SonarParkingEnv
from sonar_gym.parking.rendering import Renderer
from sonar_gym.parking.vector import SonarParkingVectorEnv
from sonar_gym.sb3 import env_info

MODES = list(AutoresetMode)


class Repeating(GaussianModel):
    """A model that repeats its previous reading with probability 0.5."""

    remembers = True

    def law(self, ping, past=None):
        law = super().law(ping)
        sample = law.sample

        def repeating(rng):
            fresh, repeats = sample(rng), rng.random(len(ping)) < 0.5
            if past is None:
                return fresh
            repeat = repeats & past.echo
            return type(fresh)(np.where(repeat, past.range, fresh.range), np.where(repeat, past.status, fresh.status))

        law.sample = repeating
        return law


def lstm(state=6):
    """Return a stateful model with random weights."""
    rng, ping = np.random.default_rng(0), Ping.of([0.1, 3.0], [0.0, 0.5], [0.0, 0.6], [0.1, 0.9])
    inputs = Inputs.of(ping, ("distance", "angle", "incidence", "reflectance"))
    head = Head(near=2, fixed=1, resolution=0.01, max_range=6.0, anchored=N_ANCHORS, fails=True)
    n_inputs = inputs.width + N_HISTORY_FEATURES
    shapes = ((4 * state, n_inputs), (4 * state, state), (4 * state,))
    layers = [(rng.normal(size=(head.width, n_inputs + state)), rng.normal(size=head.width))]
    return LstmModel(inputs, head, LstmCell(*(rng.normal(size=shape) for shape in shapes)), layers)


def native(n, mode=AutoresetMode.NEXT_STEP, **settings):
    return gymnasium.make_vec(sonar_gym.ENV_ID, num_envs=n, autoreset_mode=mode, **settings)


def singles(n, mode=AutoresetMode.NEXT_STEP, **settings):
    return SyncVectorEnv([lambda: gymnasium.make(sonar_gym.ENV_ID, **settings)] * n, autoreset_mode=mode)


def random_actions(n, steps, seed=1):
    """Return actions that change every 10 steps, so that cars move far and collide."""
    rng = np.random.default_rng(seed)
    commands = rng.uniform(-1.2, 1.2, (-(-steps // 10), n, 2)) * [0.6, 1.0] + [0.0, 0.15]
    return np.repeat(commands, 10, axis=0)[:steps].astype(np.float32)


def same(a, b, mask=None):
    """Compare observations or infos, only those of `mask`."""
    if isinstance(a, dict):
        assert set(a) == set(b)
        for key in a:
            same(a[key], b[key], a.get(f"_{key}", mask) if isinstance(key, str) else mask)
    elif isinstance(a, np.ndarray) and a.dtype.kind == "O":
        for i in np.flatnonzero(mask):
            same(a[i], b[i])
    else:
        pick = slice(None) if mask is None else mask
        assert a.dtype == b.dtype
        assert np.array_equal(a[pick], b[pick]) or np.allclose(a[pick], b[pick], rtol=0, atol=1e-12)


def compare(steps, n, mode, **settings):
    native_env, reference_env = native(n, mode, **settings), singles(n, mode, **settings)
    assert native_env.observation_space == reference_env.observation_space
    assert native_env.action_space == reference_env.action_space
    ended, ends = np.zeros(n, dtype=bool), 0
    for a, b in zip(native_env.reset(seed=7), reference_env.reset(seed=7), strict=True):
        same(a, b)
    for actions in random_actions(n, steps):
        if mode is AutoresetMode.DISABLED and ended.any():
            for a, b in zip(
                *(env.reset(options={"reset_mask": ended}) for env in (native_env, reference_env)), strict=True
            ):
                same(a, b)
        (a, *first, info), (b, *second, other) = native_env.step(actions), reference_env.step(actions)
        for x, y in zip((a, *first), (b, *second), strict=True):
            same(x, y)
        same(info, other)
        ended = first[1] | first[2]
        ends += ended.sum()
    native_env.close(), reference_env.close()
    return ends


@pytest.mark.parametrize("sonar", ["ideal", "srf08-mlp"])
def test_ten_thousand_steps_equal_those_of_single_environments(sonar):
    assert compare(1300, 8, AutoresetMode.NEXT_STEP, sonar=sonar) > 50


@pytest.mark.parametrize("mode", MODES)
def test_every_autoreset_mode_agrees_with_gymnasium(mode):
    assert compare(250, 5, mode, sonar="gaussian") > 5


@pytest.mark.parametrize(
    "settings",
    [
        {"sonar": Repeating(sigma=0.05)},
        pytest.param({"sonar": lstm()}, marks=pytest.mark.slow),
        {"sonar": lstm(), "sonar_layout": "eight in turn", "credence_driver": None},
        {"sonar": Faulty(GaussianModel(), [Constant(rate=0.2, value=0.5), Short(rate=0.1, span=3.0)])},
        {"sonar": "gaussian", "sonar_layout": "eight in turn"},
        {"sonar": "ideal", "odometry": "worn"},
        pytest.param(
            {
                "sonar": "srf08-mlp",
                "sonar_layout": [{"name": "a", "x": 0.3, "y": 0.0, "heading_deg": 0.0, "period_s": 0.3}],
            },
            marks=pytest.mark.slow,
        ),
        {"sonar": "gaussian", "difficulty": "hard", "street": {"decoys": [3, 4]}},
    ],
    ids=["past", "memory", "memory in turn", "faults", "in turn", "odometry", "slow", "hard"],
)
def test_results_equal_those_of_single_environments_with_all_settings(settings):
    assert compare(120, 4, AutoresetMode.NEXT_STEP, **settings) > 0


@pytest.mark.parametrize(
    "settings", [{"sonar": "gaussian"}, {"sonar": lstm(), "credence_driver": None}], ids=["gaussian", "memory"]
)
def test_results_do_not_depend_on_the_number_of_threads(settings):
    runs = []
    for threads in (1, 3):
        envs, out = native(200, threads=threads, **settings), []
        out.append(envs.reset(seed=3)[0])
        out += [envs.step(actions)[0] for actions in random_actions(200, 60)]
        envs.close()
        runs.append(out)
    for a, b in zip(*runs, strict=True):
        assert all(np.array_equal(a[key], b[key]) for key in a)


SCRIPT = """
import gymnasium, numpy, hashlib, sonar_gym
envs = gymnasium.make_vec("SonarParking-v0", num_envs=6, sonar="srf08-mlp")
digest = hashlib.sha256()
observation, _ = envs.reset(seed=11)
for k in range(60):
    for key in sorted(observation):
        digest.update(observation[key].tobytes())
    observation = envs.step(numpy.tile(numpy.float32([0.1 * (-1) ** (k // 20), 0.9]), (6, 1)))[0]
print(digest.hexdigest())
"""


def test_same_seed_gives_same_trajectory_in_other_processes():
    outputs = [
        subprocess.run([sys.executable, "-c", SCRIPT], capture_output=True, text=True, check=True).stdout
        for _ in range(2)
    ]
    assert outputs[0] == outputs[1]


def test_use_as_a_vector_environment_gives_no_warning():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        envs = native(3)
        assert isinstance(envs.unwrapped, SonarParkingVectorEnv)
        assert envs.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
        observation, _ = envs.reset(seed=0)
        assert observation in envs.observation_space
        observation, rewards, terminated, truncated, _ = envs.step(envs.action_space.sample())
        assert observation in envs.observation_space
        assert (rewards.dtype, terminated.dtype, truncated.dtype) == (np.float64, np.bool_, np.bool_)
        assert envs.spec.id == sonar_gym.ENV_ID
        envs.close()
        envs.close()


class FirstOfVector(gymnasium.Env):
    """A vector environment of one as a single environment."""

    metadata = SonarParkingVectorEnv.metadata

    def __init__(self, sonar):
        self.envs = native(1, AutoresetMode.DISABLED, sonar=sonar)
        self.observation_space, self.action_space = self.envs.single_observation_space, self.envs.single_action_space

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        observation, info = self.envs.reset(seed=seed, options=options)
        return {key: value[0] for key, value in observation.items()}, env_info(info, 0)

    def step(self, action):
        observation, reward, terminated, truncated, info = self.envs.step(action[None])
        first = {key: value[0] for key, value in observation.items()}
        return first, float(reward[0]), bool(terminated[0]), bool(truncated[0]), env_info(info, 0)

    def close(self):
        self.envs.close()


@pytest.mark.parametrize("sonar", ["ideal", "gaussian", "srf08-mlp"])
def test_checkers_give_no_warning_for_a_vector_of_one(sonar):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(FirstOfVector(sonar), skip_render_check=True)
        check_for_sb3(FirstOfVector(sonar))


@pytest.mark.parametrize("mode", MODES)
def test_gymnasium_checks_of_spaces_and_observations_pass(mode):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        envs = native(5, mode, sonar="gaussian", difficulty="hard")
        check_observation_space(envs.observation_space)
        check_action_space(envs.action_space)
        check_obs(envs.reset(seed=0)[0], envs.observation_space, "reset")
        for actions in random_actions(5, 60):
            observation, _, terminated, truncated, _ = envs.step(actions)
            check_obs(observation, envs.observation_space, "step")
            if mode is AutoresetMode.DISABLED and np.any(terminated | truncated):
                envs.reset(options={"reset_mask": terminated | truncated})


def test_seeds_count_up_or_are_given_as_a_list():
    envs = native(3, sonar="gaussian")
    envs.reset(seed=4)
    assert envs.unwrapped.np_random_seed == (4, 5, 6)
    listed, _ = envs.reset(seed=[9, 4, 5])
    counted, _ = envs.reset(seed=4)
    assert all(np.array_equal(listed[key][1:], counted[key][:2]) for key in listed)
    with pytest.raises(SettingError, match="seed has 2 items, expected 3"):
        envs.reset(seed=[1, 2])


def test_without_a_seed_all_environments_differ():
    envs = native(4)
    observation, _ = envs.reset()
    assert len({row.tobytes() for row in observation["ranges"]}) == 4
    assert len(set(envs.unwrapped.np_random_seed)) == 4


def test_episodes_are_truncated_at_the_limit():
    envs = native(2, max_episode_steps=5)
    envs.reset(seed=0)
    no_action = np.zeros((2, 2), dtype=np.float32)
    truncated = [envs.step(no_action)[3].copy() for _ in range(7)]
    assert [bool(row.all()) for row in truncated] == [False, False, False, False, True, False, False]


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
def test_episode_statistics_of_gymnasium_count_episodes(mode):
    envs = RecordEpisodeStatistics(native(4, mode, max_episode_steps=20))
    envs.reset(seed=0)
    lengths = []
    for _ in range(45):
        _, _, _, _, info = envs.step(np.zeros((4, 2), dtype=np.float32))
        if "episode" in info:
            lengths.extend(info["episode"]["l"][info["_episode"]])
    assert len(lengths) == 8
    assert set(lengths) == {20}


def test_environments_with_a_stateful_model_can_be_reset_one_by_one():
    envs = native(3, AutoresetMode.DISABLED, sonar=lstm())
    for i in range(3):
        envs.reset(seed=i, options={"reset_mask": np.arange(3) == i})
    outputs, _, _, _, _ = envs.step(np.zeros((3, 2)))
    assert outputs in envs.observation_space


def test_ended_environments_must_be_reset_without_autoreset():
    envs = native(2, AutoresetMode.DISABLED, max_episode_steps=1)
    envs.reset(seed=0)
    envs.step(np.zeros((2, 2)))
    with pytest.raises(gymnasium.error.ResetNeeded, match="environment 0 has ended"):
        envs.step(np.zeros((2, 2)))
    envs.reset(options={"reset_mask": np.array([True, False])})
    with pytest.raises(gymnasium.error.ResetNeeded, match="environment 1 has ended"):
        envs.step(np.zeros((2, 2)))
    with pytest.raises(SettingError, match="'reset_mask' must be 2 booleans"):
        envs.reset(options={"reset_mask": np.array([True])})


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_action_that_is_not_finite_raises_an_error_with_its_environment(bad):
    envs = native(3)
    envs.reset(seed=0)
    actions = np.zeros((3, 2))
    actions[1, 0] = bad
    with pytest.raises(SettingError, match="action of environment 1 must be finite"):
        envs.step(actions)
    with pytest.raises(SettingError, match=r"actions have shape \(2,\), expected \(3, 2\)"):
        envs.step(np.zeros(2))


def test_actions_beyond_the_limits_are_clipped():
    a, b = native(2), native(2)
    a.reset(seed=0), b.reset(seed=0)
    for _ in range(3):
        x, y = a.step(np.full((2, 2), 9.0))[0], b.step(np.ones((2, 2)))[0]
    assert all(np.array_equal(x[key], y[key]) for key in x)


def test_invalid_arguments_raise_an_error():
    with pytest.raises(SettingError, match=r"num_envs: expected a whole number from 1 .*, got 0"):
        SonarParkingVectorEnv(0)
    with pytest.raises(SettingError, match="pictured: expected at most 2 numbers of environments below 2"):
        SonarParkingVectorEnv(2, pictured=[2])
    with pytest.raises(ValueError, match="autoreset_mode: expected one of"):
        SonarParkingVectorEnv(2, autoreset_mode="never")
    with pytest.raises(gymnasium.error.ResetNeeded, match=r"step\(\) before the first reset"):
        SonarParkingVectorEnv(2).step(np.zeros((2, 2)))


def test_selected_environments_are_rendered():
    envs = native(3, render_mode="rgb_array", pictured=[2, 0])
    envs.reset(seed=0)
    images = envs.render()
    assert [image.shape for image in images] == [(660, 1000, 3)] * 2
    single = gymnasium.make(sonar_gym.ENV_ID, render_mode="rgb_array")
    single.reset(seed=2)
    assert np.array_equal(images[0], single.render())
    envs.close()


def test_learned_sonar_is_sampled_in_one_batch():
    envs = native(4, sonar="srf08-mlp")
    assert isinstance(envs.unwrapped.fleet.sonar.model, MlpModel)
    assert envs.unwrapped.fleet.sonar.batched


def test_a_window_shows_one_environment(monkeypatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    envs = native(2, render_mode="human", pictured=[1])
    with pytest.raises(gymnasium.error.ResetNeeded, match=r"render\(\) before the first reset"):
        envs.render()
    envs.reset(seed=0)
    rows, draw = [], Renderer.draw
    monkeypatch.setattr(Renderer, "draw", lambda self, world: rows.append(world.row) or draw(self, world))
    assert envs.render() is None
    assert rows == [1]
    envs.close()


def test_arguments_of_the_single_environment_exist_with_the_same_defaults():
    single, many = (inspect.signature(cls).parameters for cls in (SonarParkingEnv, SonarParkingVectorEnv))
    assert set(single) <= set(many)
    assert all(single[name].default == many[name].default for name in single)
