"""SonarObservation: the new observation, the retained parts, random streams, memory and messages."""

import subprocess
import sys

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from stable_baselines3.common.env_checker import check_env as check_for_sb3

from acquisition import SettingError
from noise import CATALOGUE, GaussianModel, IdealModel, PhysicalModel, save_model
from sonar_gym import SonarObservation
from sonar_gym.parking.environment import MAX_RANGE
from tests.sonar_gym.rounded import Rounded

pytest.importorskip("highway_env")

PARKING = {
    "key": "ranges",
    "metres_per_unit": MAX_RANGE,
    "max_range": MAX_RANGE,
    "incidence": "incidence",
    "bearing": "bearing",
    "reflectance": "reflectance",
}


class Rays(gymnasium.Env):
    """Three ranges in cm, and two other numbers, the last of which is random."""

    def __init__(self, dictionary=False, values=(100.0, 250.0, 900.0)):
        self.dictionary, self.values = dictionary, np.array(values, dtype=np.float32)
        low, high = np.float32([0, 0, 0, -1, 0]), np.float32([1000, 1000, 1000, 1, 1])
        box = gymnasium.spaces.Box(low, high)
        beside = gymnasium.spaces.Box(-1.0, 1.0, (2,), np.float32)
        self.observation_space = gymnasium.spaces.Dict({"rays": box, "beside": beside}) if dictionary else box
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (1,), np.float32)

    def _see(self):
        row = np.array([*self.values, -0.5, self.np_random.random()], dtype=np.float32)
        return {"rays": row, "beside": np.float32([0.25, -0.25])} if self.dictionary else row

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        return self._see(), {"tilt": np.array([0.1, 0.2, 0.3])}

    def step(self, action):
        return self._see(), 0.0, False, False, {"tilt": np.array([0.1, 0.2, 0.3])}


class Recorder(IdealModel):
    """An ideal sonar that records its arguments."""

    remembers = True

    def law(self, ping, past=None):
        if len(ping) <= 8:
            self.asked.append((ping, past))
        return super().law(ping, past)


def recorder():
    model = Recorder()
    object.__setattr__(model, "asked", [])
    object.__setattr__(model, "remembers", True)
    return model


def rays(sonar="ideal", dictionary=False, **settings):
    settings = {"indices": [0, 1, 2], "metres_per_unit": 0.01, "max_range": 6.0, **settings}
    return SonarObservation(Rays(dictionary), sonar, key="rays" if dictionary else None, **settings)


def step(env):
    return env.step(np.zeros(1, dtype=np.float32))[0]


@pytest.mark.parametrize("dictionary", [False, True])
def test_ideal_readings_equal_the_ranges_and_other_numbers_are_unchanged(dictionary):
    env = rays(dictionary=dictionary)
    observation, info = env.reset(seed=0)
    plain, _ = Rays(dictionary).reset(seed=0)
    row = plain["rays"] if dictionary else plain
    assert observation["ranges"] == pytest.approx([1.0 / 6.0, 2.5 / 6.0, 1.0], abs=1e-6)
    assert list(observation["echo"]) == [1.0, 1.0, 0.0]
    assert list(observation["credence"]) == [1.0, 1.0, 0.0]
    assert np.array_equal(observation["rays" if dictionary else "rest"], row[3:])
    assert ("beside" in observation) == dictionary
    assert info["sonar"]["distance"] == pytest.approx([1.0, 2.5, 9.0])
    assert info["sonar"]["credence_given_condition"] == pytest.approx([1.0, 1.0, 0.0])
    assert observation in env.observation_space


def test_a_whole_box_of_ranges():
    env = SonarObservation(
        gymnasium.make("SonarParking-v0"), key="ranges", metres_per_unit=MAX_RANGE, max_range=MAX_RANGE
    )
    observation, _ = env.reset(seed=0)
    assert set(observation) == {"ranges", "credence", "echo", "age", "ego"}
    assert observation in env.observation_space


@pytest.mark.parametrize(
    "inner",
    [
        lambda: gymnasium.make("SonarParkingGoal-v0"),
        lambda: gymnasium.wrappers.FlattenObservation(gymnasium.make("SonarParking-v0")),
    ],
    ids=["goal", "flattened"],
)
def test_replaced_sonars_leave_the_form_of_the_observation(inner):
    env, plain = SonarObservation(inner(), "gaussian"), inner()
    assert env.observation_space == plain.observation_space
    assert env.reset(seed=0)[0] in env.observation_space
    assert env.step(np.float32([0.0, 0.5]))[0] in env.observation_space


TIMED = {"period_s": 0.2, "phase_s": 0.05, "latency_s": 0.03}


FORMS = {
    "street": lambda **how: SonarObservation(gymnasium.make("SonarParking-v0"), **how),
    "street as ranges": lambda **how: SonarObservation(gymnasium.make("SonarParking-v0"), **PARKING, **how),
    "car park": lambda **how: SonarObservation(Rounded(gymnasium.make("parking-v0")), **how),
    "road": lambda **how: SonarObservation(gymnasium.make("highway-v0", config={"vehicles_count": 5}), **how),
    "vector of numbers": lambda **how: rays(**how),
    "dictionary": lambda **how: rays(dictionary=True, **how),
}


@pytest.mark.parametrize("times", [{}, TIMED], ids=["at once", "timed"])
@pytest.mark.parametrize("sonar", ["ideal", "gaussian", "srf08-mlp"])
@pytest.mark.parametrize("form", FORMS.values(), ids=FORMS)
def test_checker_of_stable_baselines_passes(form, sonar, times):
    if form is FORMS["car park"] or form is FORMS["road"]:
        times = {name: 5.0 * value for name, value in times.items()}  # a step of the policy takes longer there
    check_for_sb3(form(sonar=sonar, **times))


@pytest.mark.filterwarnings("ignore:.*is different from the unwrapped version")  # raised for every wrapper
@pytest.mark.parametrize("times", [{}, TIMED], ids=["at once", "timed"])
@pytest.mark.parametrize("form", ["street", "street as ranges", "vector of numbers", "dictionary"])
def test_checker_of_gymnasium_passes(form, times):
    check_env(FORMS[form](sonar="gaussian", **times), skip_render_check=True)


def test_true_conditions_of_the_street_do_not_depend_on_the_inner_sonar():
    """An inner sonar without echoes does not affect the sonar of the wrapper."""
    deaf = gymnasium.make("SonarParking-v0", sonar=GaussianModel(miss=1.0))
    outer, alone = SonarObservation(deaf, "ideal"), gymnasium.make("SonarParking-v0")
    first, second = outer.reset(seed=1)[0], alone.reset(seed=1)[0]
    for _ in range(10):
        for name, value in second.items():
            assert first[name] == pytest.approx(value, abs=1e-12), name
        first, second = (env.step(np.float32([0.1, 0.7]))[0] for env in (outer, alone))


def test_credence_in_the_street_uses_the_prior_of_the_task():
    inner, outer = (gymnasium.make("SonarParking-v0", sonar="srf08-mlp") for _ in range(2))
    outer = SonarObservation(outer, "srf08-mlp")
    assert np.array_equal(outer.sonar.tables, inner.unwrapped.fleet.sonar.tables)


def test_time_step_is_that_of_the_environment_unless_set():
    class Timed(Rays):
        dt = 0.04

    assert SonarObservation(Timed(), indices=[0]).source.step_s == 0.04
    assert SonarObservation(Timed(), indices=[0], step_s=0.02).source.step_s == 0.02
    assert rays().source.step_s == 0.1


def test_every_setting_survives_json():
    how = {**PARKING, **TIMED, "period_s": np.full(8, 0.2), "incidence": (0.0, 0.3), "step_s": 0.1, "indices": range(8)}
    env = SonarObservation(gymnasium.make("SonarParking-v0"), "gaussian", **how)
    again = gymnasium.make(gymnasium.envs.registration.EnvSpec.from_json(env.spec.to_json()))
    for one in (env, again):
        one.reset(seed=6)
    for _ in range(6):
        first, second = (one.step(np.float32([0.0, 0.5]))[0] for one in (env, again))
        assert all(np.array_equal(first[name], second[name]) for name in first)
    assert first["age"].max() > 0.0


def course():
    """Return the sum of the observation at each step of a wrapped street."""
    env = SonarObservation(gymnasium.make("SonarParking-v0"), "srf08-mlp", **TIMED)
    env.reset(seed=11)
    steps = [env.step(np.float32([0.1 * (k % 3 - 1), 0.6]))[0] for k in range(12)]
    return [float(np.concatenate(list(observation.values())).astype(np.float64).sum()) for observation in steps]


def test_same_seed_gives_same_readings_in_another_process():
    code = f"import runpy; print(runpy.run_path({__file__!r})['course']())"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == str(course())


def test_extreme_actions_give_no_nan():
    env = SonarObservation(gymnasium.make("SonarParking-v0"), "srf08-mlp", **TIMED)
    rng, refused = np.random.default_rng(0), 0
    env.reset(seed=0)
    for _ in range(400):
        action = rng.uniform(-4.0, 4.0, 2).astype(np.float32)
        if rng.random() < 0.05:
            action[rng.integers(2)] = rng.choice([np.nan, np.inf, -np.inf])
        if not np.all(np.isfinite(action)):
            with pytest.raises(SettingError, match="action must be finite"):
                env.step(action)
            refused += 1
            continue
        observation, _, terminated, truncated, _ = env.step(action)
        assert observation in env.observation_space
        if terminated or truncated:
            env.reset()
    assert refused > 5


def test_unknown_setting_is_a_type_error():
    with pytest.raises(TypeError, match="wavelength"):
        rays(wavelength=0.0086)


def test_environment_is_the_same_with_and_without_the_wrapper():
    bare, wrapped = (
        gymnasium.make("SonarParking-v0"),
        SonarObservation(gymnasium.make("SonarParking-v0"), "gaussian", **PARKING),
    )
    for seed in (
        3,
        None,
    ):  # the second street is drawn from the stream of the environment, which the wrapper must not use
        bare.reset(seed=seed)
        wrapped.reset(seed=seed)
        assert np.array_equal(bare.unwrapped.street.scene.segments, wrapped.unwrapped.street.scene.segments)
        for _ in range(20):
            a = bare.step(np.array([0.1, 0.5], dtype=np.float32))
            b = wrapped.step(np.array([0.1, 0.5], dtype=np.float32))
            assert np.array_equal(a[4]["distance"], b[4]["distance"])
            assert a[1] == b[1]


def test_same_seed_gives_same_readings_and_another_seed_does_not():
    def episode(seed):
        env = rays("gaussian")
        return np.array([env.reset(seed=seed)[0]["ranges"], *(step(env)["ranges"] for _ in range(5))])

    assert np.array_equal(episode(4), episode(4))
    assert not np.array_equal(episode(4), episode(5))
    assert not np.array_equal(episode(4)[0], episode(4)[1])


def test_wrapper_and_environment_draw_from_different_streams():
    """The same model inside and outside: with one stream the errors would be equal."""
    model = GaussianModel(sigma=0.02, sigma_per_metre=0.0)
    env = SonarObservation(gymnasium.make("SonarParking-v0", sonar=model), model, **PARKING)
    inner, outer = [], []
    env.reset(seed=0)
    for _ in range(60):
        observation, _, _, _, info = env.step(np.array([0.0, 0.3], dtype=np.float32))
        echo = (observation["echo"] == 1) & (info["sonar"]["distance"] < MAX_RANGE)
        inner.extend((info["sonar"]["distance"] - info["distance"])[echo])
        outer.extend((observation["ranges"] * MAX_RANGE - info["sonar"]["distance"])[echo])
    assert abs(np.corrcoef(inner, outer)[0, 1]) < 0.2


def test_path_of_a_model_survives_spec_and_json(tmp_path):
    folder = save_model(PhysicalModel([CATALOGUE["zero_offset"](offset_m=0.05)]), tmp_path / "late")
    env = SonarObservation(gymnasium.make("SonarParking-v0"), folder, **PARKING)
    again = gymnasium.make(gymnasium.envs.registration.EnvSpec.from_json(env.spec.to_json()))
    assert isinstance(again, SonarObservation)
    first, second = env.reset(seed=2)[0], again.reset(seed=2)[0]
    assert all(np.array_equal(first[name], second[name]) for name in first)
    info = env.step(np.zeros(2, dtype=np.float32))[4]
    assert info["sonar"]["distance"].shape == (8,)


def test_conditions_come_from_info_constants_and_priors():
    model = recorder()
    env = rays(model, incidence="tilt", bearing=0.05, reflectance=(0.2, 0.4), latency_s=0.0)
    model.asked.clear()  # what the environment asked when it was made
    env.reset(seed=0)
    step(env)
    (first, _), (second, _) = model.asked
    assert np.array_equal(first.incidence, [0.1, 0.2, 0.3])
    assert np.array_equal(first.angle, [0.05] * 3)
    assert np.all((first.reflectance >= 0.2) & (first.reflectance <= 0.4))
    assert np.array_equal(first.reflectance, second.reflectance)  # reflectance is constant in an episode
    assert (first.time[0], second.time[0]) == (0.0, 0.1)
    env.reset()
    assert not np.array_equal(model.asked[-1][0].reflectance, first.reflectance)
    drawn = recorder()
    env = rays(drawn, incidence=(0.0, 0.4))
    drawn.asked.clear()
    env.reset(seed=0)
    step(env)
    assert not np.array_equal(drawn.asked[0][0].incidence, drawn.asked[1][0].incidence)


def test_past_readings_are_passed_to_the_model_and_cleared_at_reset():
    model = recorder()
    env = rays(model)
    model.asked.clear()
    env.reset(seed=0)
    step(env)
    env.reset()
    pasts = [past for _, past in model.asked]
    assert pasts[0] is None
    assert pasts[1].range == pytest.approx([1.0, 2.5, 0.0])
    assert pasts[2] is None


PAIRS = [(1.0, 2.0), (2.5, 3.0), (6.0, 4.0)]  # before and after; 6 m stands for no echo


def test_stale_readings_repeat_the_previous_reading():
    model = PhysicalModel([CATALOGUE["stale_repeat"](probability=0.9)])
    env = rays(model)
    env.reset(seed=0)
    env.unwrapped.values = np.float32([200.0, 300.0, 400.0])
    readings = 6.0 * step(env)["ranges"]
    assert all(
        any(value == pytest.approx(v, abs=1e-3) for v in pair) for value, pair in zip(readings, PAIRS, strict=True)
    )
    assert readings[0] == pytest.approx(1.0, abs=1e-3)  # the stale one: under seed 0, with probability 0.9


def test_infinity_is_an_empty_cone_and_nan_raises():
    env = rays()
    env.unwrapped.values = np.float32([100.0, np.inf, 600.0])
    observation, _ = env.reset(seed=0)
    assert list(observation["echo"]) == [1.0, 0.0, 0.0]
    assert np.all(observation["ranges"][1:] == 1.0)
    env.unwrapped.values = np.float32([100.0, np.nan, 600.0])
    with pytest.raises(SettingError, match="a range is negative or NaN"):
        step(env)


def test_empty_value_is_an_empty_cone():
    """As -1 of MuJoCo's rangefinders."""
    env = rays(empty=-1.0)
    env.unwrapped.values = np.float32([100.0, -1.0, 250.0])
    observation, info = env.reset(seed=0)
    assert list(observation["echo"]) == [1.0, 0.0, 1.0]
    assert list(info["sonar"]["in_cone"]) == [True, False, True]
    env.unwrapped.values = np.float32([100.0, -2.0, 250.0])
    with pytest.raises(SettingError, match="a range is negative or NaN"):
        step(env)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"indices": [7]}, r"indices must lie in \[0, 4\], got 7"),
        ({"indices": []}, "indices holds 0 indices"),
        ({"metres_per_unit": 0.0}, "metres_per_unit: expected a number above 0 .*, got 0 m"),
        ({"max_range": -1.0}, "max_range: expected a number from .*, got -1 m"),
        ({"incidence": (0.4, 0.0)}, "incidence must be a number, two limits low <= high, or a key"),
    ],
)
def test_invalid_settings_raise(settings, message):
    with pytest.raises(SettingError, match=message):
        rays(**settings)


def test_wrong_keys_raise_and_are_named():
    with pytest.raises(SettingError, match="key 'radar': not in the observation, which has beside, rays"):
        SonarObservation(Rays(dictionary=True), key="radar")
    with pytest.raises(SettingError, match="the observation is not a Dict; omit the key"):
        SonarObservation(Rays(), key="rays")
    with pytest.raises(SettingError, match="needs ranges in a Box"):
        SonarObservation(gymnasium.make("FrozenLake-v1"))
    with pytest.raises(SettingError, match="incidence 'slope': neither the observation nor info has that key"):
        rays(incidence="slope").reset(seed=0)
    env = rays(incidence="beside", dictionary=True)
    with pytest.raises(SettingError, match=r"incidence 'beside' has shape \(2,\), expected \(3,\)"):
        env.reset(seed=0)


class Named(Rays):
    """The ranges and the two other numbers under one name, and a number under another."""

    def __init__(self, key, other):
        super().__init__()
        self.names = key, other
        number = gymnasium.spaces.Box(0.0, 100.0, (1,), np.float32)
        self.observation_space = gymnasium.spaces.Dict({key: self.observation_space, other: number})

    def _see(self):
        return dict(zip(self.names, (super()._see(), np.float32([50.0])), strict=True))


@pytest.mark.parametrize(("key", "other"), [("ranges", "speed"), ("rays", "age"), ("rays", "echo"), ("rays", "ranges")])
def test_retained_parts_with_a_name_of_the_sonars_raise(key, other):
    hidden = key if key == "ranges" else other
    with pytest.raises(SettingError, match=f"the retained part '{hidden}' of the observation has the name .*: rename"):
        SonarObservation(Named(key, other), key=key, indices=[0, 1, 2], metres_per_unit=0.01)
