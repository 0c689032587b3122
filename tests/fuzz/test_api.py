"""The Python interface: a bad value raises an error of the project that names the setting, and never gives a NaN."""

import contextlib
import inspect
import math
import warnings
from dataclasses import fields

import gymnasium
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import sonar_gym
from acquisition import Ping, SettingError, SonarError
from acquisition.limits import hints_of
from acquisition.survey.plan import SurveyPlan
from noise import Faulty, GaussianModel, IdealModel
from noise.beam import BeamModel
from noise.discrepancy import diagnose
from noise.effects import CATALOGUE
from noise.faults import FAULTS
from noise.learned.mixture import Head
from noise.learned.persistence import Persistence
from sonar_gym import SonarObservation
from sonar_gym.parking.environment import SonarParkingEnv
from sonar_gym.parking.fleet import RewardWeights
from sonar_gym.parking.vector import SonarParkingVectorEnv
from sonar_gym.sensing.mounts import Mount
from sonar_gym.sensing.odometry import OdometrySettings
from sonar_gym.sensing.scene import Box, WallSegment
from sonar_gym.street.street import StreetSettings
from sonar_gym.street.vehicle import CarSettings
from sonar_gym.wrappers.settings import SonarSettings
from tests.fuzz.conftest import recording
from tests.fuzz.rule import FUZZ, limited

BAD = (
    math.nan,
    math.inf,
    -math.inf,
    1e300,
    -1e300,
    "x",
    None,
    b"",
    [],
    {},
    object(),
    1j,
    True,
    [math.nan],
    range(10**15),
    range(10**30),
    (1, 2, 3, 4, 5),
    np.nan,
)
bad = st.sampled_from(BAD)
any_number = st.one_of(
    bad, st.floats(), st.integers(-(2**70), 2**70), st.tuples(st.floats(), st.floats()), st.text(max_size=8)
)
DATACLASSES = {
    cls.__name__: cls
    for cls in (
        IdealModel, GaussianModel, BeamModel, Persistence, Head, RewardWeights, StreetSettings, CarSettings, Mount,
        OdometrySettings, Box, WallSegment, *FAULTS.values(),
    )
}  # fmt: skip
REQUIRED = {
    Mount: {"name": "m", "x": 0.0, "y": 0.0, "heading_deg": 0.0},
    Box: {"x": 0.0, "y": 0.0, "length": 1.0, "width": 1.0},
    WallSegment: {"x1": 0.0, "y1": 0.0, "x2": 1.0, "y2": 1.0},
    Head: {"near": 1, "fixed": 1, "resolution": 0.01, "max_range": 3.0},
    Persistence: {"detection": 0.5, "range": 0.5},
}
PINGS = Ping.of(distance=np.linspace(0.0, 8.0, 50), angle=0.2)


@pytest.fixture(scope="module", autouse=True)
def _compiled():
    """Compile the kernels once, as the time to compile is not that of an input."""
    env = SonarParkingVectorEnv(2)
    env.reset(seed=0)
    env.step(np.zeros((2, 2)))
    SonarParkingEnv().reset(seed=0)


@pytest.mark.parametrize("name", DATACLASSES)
@FUZZ
@given(data=st.data())
def test_settings_are_used_or_rejected_by_name(name, data):
    cls = DATACLASSES[name]
    field = data.draw(st.sampled_from([field.name for field in fields(cls)]))
    value = data.draw(any_number)
    try:
        made = cls(**{**REQUIRED.get(cls, {}), field: value})
    except SettingError as error:
        check_named(name, error)
        return
    if name in ("IdealModel", "GaussianModel", "BeamModel"):
        check_law(made)
    elif name in FAULTS:
        check_law(Faulty(IdealModel(), [made]))


def check_named(name, error):
    assert name in str(error), error


def check_law(model):
    """Check that the probabilities of a law are probabilities, and its readings finite."""
    law = model.law(PINGS)
    for share in (law.echo, law.no_echo, law.no_answer, law.credence()):
        assert np.all((share >= -1e-9) & (share <= 1.0 + 1e-9)), (model, share)
    assert np.all(np.isfinite(law.sample(np.random.default_rng(0)).range))


@pytest.mark.parametrize("name", CATALOGUE)
@FUZZ
@given(data=st.data())
def test_effects_are_used_or_rejected_by_name(name, data):
    parameter = data.draw(st.sampled_from([*[p.name for p in CATALOGUE[name].parameters], "nosuch"]))
    try:
        CATALOGUE[name](**{parameter: data.draw(any_number)})
    except SettingError as error:
        check_named(parameter, error)


def arguments(cls):
    return [name for name in inspect.signature(cls).parameters if name not in ("self", "sonar", "threads", "infos")]


ENVIRONMENT = arguments(SonarParkingVectorEnv)
NESTED = {"street": StreetSettings, "car": CarSettings, "reward": RewardWeights, "odometry": OdometrySettings}
VALID = {"max_episode_steps", "render_mode", "pictured", "num_envs"}


@st.composite
def environment_settings(draw):
    name = draw(st.sampled_from([*ENVIRONMENT, "sonar_layout"]))
    value = draw(any_number)
    if name in NESTED and draw(st.integers(0, 4)):
        value = {draw(st.sampled_from([*[f.name for f in fields(NESTED[name])], "nosuch"])): value}
    if name == "sonar_layout" and draw(st.integers(0, 4)):
        mount = {**REQUIRED[Mount], draw(st.sampled_from([*[f.name for f in fields(Mount)], "z"])): value}
        value = [mount] * draw(st.integers(0, 2))
    if name == "num_envs" and isinstance(value, int) and value > 64:
        value = -value
    return {name: value}


@FUZZ
@given(settings=environment_settings(), action=st.one_of(bad, st.lists(any_number, max_size=3)), seed=any_number)
def test_an_environment_is_used_or_rejected(settings, action, seed):
    single = {name: value for name, value in settings.items() if name in arguments(SonarParkingEnv)}
    with limited(settings):
        for cls, given_settings in ((SonarParkingEnv, single), (SonarParkingVectorEnv, settings)):
            try:
                env = cls(**given_settings)
            except SonarError:
                continue
            check_steps(env, action, seed)


def check_steps(env, action, seed):
    try:
        env.reset(seed=seed if seed is not None else 0)
    except SonarError:
        env.reset(seed=0)
    with contextlib.suppress(SonarError):
        env.step(action)
    actions = np.zeros(env.action_space.shape, np.float32)
    for _ in range(3):
        observation, reward, *_ = env.step(actions)
    assert np.all(np.isfinite(reward))
    assert env.observation_space.contains(observation)


OPTIONS = ("difficulty", "street", "boxes", "obstacles", "start", "nosuch")
PARTS = ("begin", "length", "recess", "reflectance", "texture_deg", "x", "y", "width", "heading", "kind", "nosuch")


@FUZZ
@given(
    name=st.sampled_from(OPTIONS),
    value=st.one_of(any_number, st.lists(st.dictionaries(st.sampled_from(PARTS), any_number, max_size=4), max_size=3)),
)
def test_reset_options_are_used_or_rejected(name, value):
    env = SonarParkingEnv()
    with limited((name, value)):
        try:
            env.reset(seed=0, options={name: value})
        except SonarError:
            return
        assert np.isfinite(env.step(np.zeros(2))[1])


@FUZZ
@given(
    name=st.sampled_from([*(field.name for field in fields(SonarSettings)), "sonar"]), value=any_number,
    make=st.sampled_from(("SonarParking-v0", "Pendulum-v1")),
)  # fmt: skip
def test_a_wrapper_is_used_or_rejected(name, value, make):
    assert sonar_gym.__name__
    with limited((name, value)), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            env = SonarObservation(gymnasium.make(make), **{name: value})
            observation, _ = env.reset(seed=0)
        except SonarError:
            return
        for _ in range(2):
            observation = env.step(env.action_space.sample())[0]
        assert all(np.all(np.isfinite(part)) for part in observation.values())


@FUZZ
@given(value=any_number, place=st.sampled_from(("model", "recording", "simulated", "seed", "without", "progress")))
def test_a_diagnosis_rejects(value, place):
    given_values = {"model": "ideal", "recording": recording(24), place: value}
    if place in ("seed", "simulated", "without", "progress") and value in (None, [], {}):
        return
    with limited((place, value)), contextlib.suppress(SonarError):
        diagnose(given_values.pop("model"), given_values.pop("recording"), **given_values)


@FUZZ
@given(data=st.data())
def test_plans_are_used_or_rejected(data):
    field = data.draw(st.sampled_from([name for name, _ in hints_of(SurveyPlan)]))
    try:
        plan = SurveyPlan(**{"angles_deg": (0.0,), "distances_mm": (500.0,), field: data.draw(any_number)})
    except SonarError:
        return
    assert plan.ping(0)
