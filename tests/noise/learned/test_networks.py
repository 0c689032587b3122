"""Properties of learned laws for any weights, and the shipped perceptron."""

import json
import subprocess
import sys
import warnings
from dataclasses import asdict, replace
from itertools import pairwise

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from acquisition import ModelError, Ping, Reading, SettingError
from acquisition.ping import RANGE_RATE
from noise import ExtrapolationWarning, load_model, model_names, save_model
from noise.effects.interping import INTERVAL
from noise.effects.medium import sound_speed
from noise.learned.inputs import Inputs
from noise.learned.mixture import Head
from noise.learned.networks import MlpModel
from noise.learned.tensors import WEIGHTS_FILE
from noise.replay import SIMULATED
from noise.store import WEIGHTS

REACH, STEP = 4.0, 0.01


def learned_on():
    return Ping.of(
        distance=[0.1, 2.0, 3.5], angle=[0.0, 0.2, 0.6], incidence=[0.1, 0.0, 0.6], reflectance=[0.1, 0.9, 0.5]
    )


def random_model(seed, no_answer=0.03, size=1.0, names=("distance", "angle", "incidence", "reflectance")):
    rng = np.random.default_rng(seed)
    inputs = Inputs.of(learned_on(), names)
    head = Head(near=3, fixed=2, resolution=STEP, max_range=REACH, no_answer=no_answer)
    widths = [inputs.width, 8, head.width]
    layers = [(size * rng.normal(size=(b, a)), size * rng.normal(size=b)) for a, b in pairwise(widths)]
    return MlpModel(inputs, head, layers)


conditions = st.tuples(st.floats(0.0, 6.0), st.floats(-1.0, 1.0), st.floats(-1.0, 1.0), st.floats(0.0, 1.0))


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 1000), conditions)
def test_probabilities_are_differences_of_the_cdf_and_sum_to_one(seed, condition):
    distance, angle, incidence, reflectance = condition
    steps = np.arange(1, round(REACH / STEP) + 1)
    ping = Ping.of(np.full(len(steps), distance), angle, incidence, reflectance)
    law = random_model(seed).law(ping)
    probability = np.exp(law.log_prob(Reading.of(steps * STEP)))
    np.testing.assert_allclose(probability, np.diff(law.cdf_step(steps), prepend=0.0), atol=1e-12)
    assert probability.sum() + law.no_echo[0] + law.no_answer[0] == pytest.approx(1.0, abs=1e-10)
    assert np.all(probability > 0), "no outcome has probability zero"


@pytest.mark.parametrize("seed", range(4))
def test_samples_agree_with_log_prob(seed):
    n, steps = 20_000, np.arange(1, round(REACH / STEP) + 1)
    model, condition = random_model(seed, size=0.5), {"angle": 0.3, "incidence": 0.2, "reflectance": 0.7}
    law = model.law(Ping.of(distance=np.full(len(steps), 1.5), **condition))
    drawn = model.law(Ping.of(distance=np.full(n, 1.5), **condition)).sample(np.random.default_rng(seed))
    kind = np.where(drawn.echo, np.rint(drawn.range / STEP).astype(int) + 1, np.where(drawn.status == 2, 0, 1))
    tail = [law.no_answer[0], law.no_echo[0]]
    expected = n * np.concatenate([tail, np.exp(law.log_prob(Reading.of(steps * STEP)))])
    observed = np.bincount(kind, minlength=len(expected))
    few = expected < 8
    counts = [np.append(x[~few], x[few].sum()) for x in (observed, expected)]
    assert stats.chisquare(counts[0], counts[1] * n / counts[1].sum()).pvalue > 1e-5


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 1000), conditions, st.integers(0, 2**31))
def test_readings_are_values_of_the_register(seed, condition, draw):
    ping = Ping.of(*[np.full(50, x) for x in condition])
    drawn = random_model(seed).law(ping).sample(np.random.default_rng(draw))
    step = drawn.range[drawn.echo] / STEP
    np.testing.assert_allclose(step, np.rint(step), atol=1e-6)
    assert np.all((step > 0.5) & (step < REACH / STEP + 0.5))


def test_no_widening_inside_the_learned_range():
    law = random_model(0).law(learned_on())
    np.testing.assert_array_equal(law.excess, 0.0)
    assert not law.extrapolates.any()


def test_outside_the_learned_range_the_law_widens_continuously():
    model = random_model(3, no_answer=0.0)
    distance = np.array([3.5, 3.5001, 4.0, 6.0, 12.0])
    law = model.law(Ping.of(distance=distance, angle=0.1, incidence=0.3, reflectance=0.5))
    np.testing.assert_allclose(law.excess, (distance - 3.5) / 3.4)
    beyond_a_thousandth = [False, False, True, True, True]
    np.testing.assert_array_equal(law.extrapolates, beyond_a_thousandth)
    assert np.all(np.diff(law.scale, axis=1) > 0)
    uniform = law.share[-2:].sum(axis=0)
    assert np.all(np.diff(uniform) > 0)
    assert uniform[-1] > 0.9
    assert law.echo[1] == pytest.approx(law.echo[0], abs=1e-3)
    np.testing.assert_allclose(law.share.sum(axis=0), 1.0)


def test_bearings_of_one_sign_are_folded_and_of_both_are_not():
    left = learned_on()
    assert Inputs.of(left, ("distance", "angle", "incidence")).folded
    both = Ping.of(distance=1.0, angle=[-0.3, 0.3], incidence=[0.1, 0.2])
    assert not Inputs.of(both, ("distance", "angle")).folded
    model = random_model(1)
    there, mirrored = (model.law(Ping.of(1.0, angle=a, incidence=a / 2)).credence()[0] for a in (0.4, -0.4))
    assert there == mirrored


def test_incidence_equal_to_bearing_is_no_input_but_extends_the_excess():
    inputs = Inputs.of(Ping.of(distance=[1.0, 2.0], angle=[0.0, 0.5]), ("distance", "angle", "incidence"))
    assert inputs.tied
    assert inputs.names == ("distance", "angle")
    excess = inputs.features(Ping.of(distance=1.5, angle=0.2, incidence=[0.2, 0.45])).excess
    np.testing.assert_allclose(excess, [0.0, 0.5])


AIR = {"temperature_c": [15.0, 20.0, 25.0], "gain": 31.0}


def air_model(seed=0, uncompensated=True):
    """Return a random network that has learned 15 to 25 degC at gain 31."""
    ping = replace(learned_on(), covariates={n: np.broadcast_to(v, 3).astype(float) for n, v in AIR.items()})
    inputs = Inputs.of(ping, ("distance", "angle", "incidence", "reflectance", "temperature_c"), None, uncompensated)
    rng, head = np.random.default_rng(seed), Head(near=3, fixed=2, resolution=STEP, max_range=REACH)
    layers = [(rng.normal(size=(b, a)), rng.normal(size=b)) for a, b in pairwise([inputs.width, 8, head.width])]
    return MlpModel(inputs, head, layers)


@settings(max_examples=40, deadline=None)
@given(st.floats(-10.0, 45.0), st.floats(0.2, 3.0), st.integers(0, 50))
def test_beyond_the_learned_temperatures_equal_times_of_flight_have_equal_laws(temperature, distance, seed):
    model, end = air_model(seed), np.clip(temperature, 15.0, 25.0)
    speed = sound_speed(torch.tensor([end, temperature], dtype=torch.float64)).numpy()
    z, pose = np.array([[0.5], [1.0], [2.5]]), {"angle": 0.1, "incidence": 0.1, "reflectance": 0.5}
    here = model.law(Ping.of(distance, temperature_c=temperature, **pose))
    there = model.law(Ping.of(distance * speed[0] / speed[1], temperature_c=end, **pose))
    np.testing.assert_allclose(here.arrival(z), there.arrival(z), atol=1e-9)
    assert here.distance[0] == distance
    low, high = np.ceil(0.9 * distance / STEP - 1e-9), np.floor(1.1 * distance / STEP + 1e-9)
    right = here.cdf_step(np.array([high])) - here.cdf_step(np.array([low - 1]))
    assert here.credence()[0] == pytest.approx(right.item(), abs=1e-9)
    assert not here.extrapolates.any()


def test_a_sensor_that_may_compensate_or_an_unknown_temperature_is_not_rescaled():
    cold = Ping.of([1.0, 1.0], temperature_c=[0.0, np.nan])
    assert air_model(uncompensated=False).inputs.equivalent(cold) is cold
    rescaled = air_model().inputs.equivalent(cold)
    assert rescaled.distance[0] > 1.02
    assert rescaled.distance[1] == 1.0
    assert np.isnan(rescaled.covariates["temperature_c"][1])
    warm = Ping.of(1.0, temperature_c=20.0)
    assert air_model().inputs.equivalent(warm) is warm


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"gain": 14.0}, "gain 31"),
        ({"temperature_c": 60.0}, "temperature_c from 15 to 25"),
        ({"temperature_c": -30.0, "gain": 1.0}, "temperature_c from 15 to 25; gain 31"),
    ],
)
def test_a_law_says_once_that_it_was_not_trained_with_a_covariate(given, said):
    model, values = air_model(), {"temperature_c": 20.0, "gain": 31.0} | given
    known = Ping.of(
        [1.0, 1.0], 0.1, 0.1, 0.5, **{name: [AIR[name] if name == "gain" else 20.0, v] for name, v in values.items()}
    )
    with pytest.warns(ExtrapolationWarning, match=f"it was trained with {said}"):
        law = model.law(known)
    np.testing.assert_array_equal(law.extrapolates, [False, True])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert model.law(known).extrapolates[1]
        assert not air_model().law(known[:1]).extrapolates.any()


def test_a_law_says_once_which_covariates_it_does_not_know():
    model = air_model()
    with pytest.warns(ExtrapolationWarning, match="does not know gian, and ignores it; did you mean gain?"):
        law = model.law(Ping.of(1.0, 0.1, 0.1, 0.5, gian=14.0, temperature_c=20.0))
    assert not law.extrapolates.any()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        model.law(Ping.of(1.0, gian=14.0, temperature_c=20.0))
        air_model().law(Ping.of(1.0, interval_s=0.1, range_rate_mps=0.5))


def test_a_law_knows_the_covariates_over_which_it_was_averaged():
    ping = Ping.of([1.0, 2.0], wind_mps=[0.0, 3.0], gain=31.0)
    inputs = Inputs.of(ping, ("distance", "angle", "incidence"))
    assert (inputs.averaged, inputs.fixed) == (("wind_mps",), {"gain": 31.0})
    assert {"wind_mps", "gain", INTERVAL, RANGE_RATE, *SIMULATED} <= inputs.known
    assert Inputs.from_dict(json.loads(json.dumps(asdict(inputs)))) == inputs


def test_what_a_law_was_trained_with_is_saved(tmp_path):
    model = air_model()
    again = load_model(save_model(model, tmp_path / "m"))
    assert again.inputs == model.inputs
    assert again.inputs.fixed == {"gain": 31.0}
    for name in ("srf08-mlp", "srf08-lstm", "srf08-hybrid"):
        inputs = load_model(name).inputs
        assert (inputs.uncompensated, inputs.fixed["range_mm"]) == (True, 6063.0)
        with pytest.warns(ExtrapolationWarning, match="range_mm 6063"):
            load_model(name).law(Ping.of(1.0, range_mm=3010.0, temperature_c=20.0))


def test_a_missing_covariate_is_marked():
    ping = Ping.of(distance=[1.0, 2.0], angle=[0.0, 0.1], temperature_c=[18.0, 20.0])
    inputs = Inputs.of(ping, ("distance", "angle", "temperature_c"))
    given = inputs.features(Ping.of(distance=[1.0, 1.0, 1.0], temperature_c=[19.0, np.nan, 30.0]))
    np.testing.assert_array_equal(given.missing, [False, True, False])
    np.testing.assert_allclose(
        given.feature[:, 2], [0.0, 0.0, 1.0], atol=1e-5
    )  # the middle of what was learned; its end
    np.testing.assert_allclose(given.feature[:, -1], [1.0, -1.0, 1.0])
    np.testing.assert_allclose(given.excess, [0.0, 0.0, 5.0], atol=1e-5)
    absent = inputs.features(Ping.of(distance=1.0))
    assert absent.missing.all()
    assert np.isfinite(absent.feature).all()
    np.testing.assert_array_equal(absent.feature[0], given.feature[1])


def test_beyond_the_horizon_every_distance_is_one_condition():
    ping = Ping.of(distance=[0.1, 3.0, 20.0])
    inputs = Inputs.of(ping, ("distance",), horizon=6.5)
    assert inputs.high == (6.5,)
    far = inputs.features(Ping.of(distance=[6.5, 11.0, 50.0]))
    assert np.ptp(far.feature, axis=0).max() == 0.0
    np.testing.assert_array_equal(far.excess, 0.0)
    closed = Inputs.of(ping[:2], ("distance",), horizon=6.5)
    assert not closed.open_end, "no ping lies beyond"
    assert closed.features(Ping.of(distance=6.5)).excess[0] > 0


@pytest.fixture
def saved(tmp_path):
    model = random_model(5)
    model.card = "# made for a test\n"
    return save_model(model, tmp_path / "net")


def test_a_saved_network_has_the_same_law(saved):
    model, again = random_model(5), load_model(saved)
    ping = Ping.of(distance=np.linspace(0.1, 5.0, 20), angle=0.2, incidence=0.1, reflectance=0.4)
    # weights are stored in single precision
    np.testing.assert_allclose(again.law(ping).credence(), model.law(ping).credence(), atol=1e-5)
    twice = load_model(save_model(again, saved.parent / "twice"))
    np.testing.assert_array_equal(twice.law(ping).credence(), again.law(ping).credence())
    assert (saved / "README.md").read_text() == "# made for a test\n"
    assert (saved.parent / "twice" / "README.md").exists()


def test_it_runs_without_torch(saved):
    script = (
        "import sys, numpy as np; from acquisition import Ping; from noise import load_model;"
        f"law = load_model({str(saved)!r}).law(Ping.of(distance=[1.0]));"
        "law.sample(np.random.default_rng(0)); law.credence(); assert 'torch' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", script], check=True, timeout=60)


def damage(path, data):
    path.write_bytes(data)


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda p: p.unlink(), "is missing"),
        (lambda p: damage(p, p.read_bytes()[:-100]), "it is damaged or of another model"),
        (lambda p: damage(p, p.read_bytes() + bytes(200_000)), "it is damaged or of another model"),
        (lambda p: damage(p, b"\x80\x04" + p.read_bytes()[2:]), "cannot be read as safetensors"),
        (lambda p: damage(p, p.read_bytes().replace(b"0.bias", b"0.soap")), "the tensors differ"),
        (lambda p: damage(p, p.read_bytes()[:-4] + np.float32(np.nan).tobytes()), "not finite"),
    ],
    ids=["missing", "truncated", "oversized", "pickle", "foreign", "nan"],
)
def test_damaged_weights_raise_with_their_path(saved, spoil, message):
    spoil(saved / WEIGHTS_FILE)
    with pytest.raises(ModelError, match=message) as error:
        load_model(saved)
    assert str(saved / WEIGHTS_FILE) in str(error.value)


@pytest.mark.parametrize("key", ["inputs", "head", "sizes"])
def test_an_invalid_description_raises_with_its_path(saved, key):
    path = saved / "model.json"
    data = json.loads(path.read_text())
    for broken in ({k: v for k, v in data.items() if k != key}, {**data, key: []}):
        path.write_text(json.dumps(broken))
        with pytest.raises(ModelError, match=r"model\.json"):
            load_model(saved)


def test_an_invalid_head_raises():
    with pytest.raises(SettingError, match=r"Head\.near: expected a whole number from 1 to 1024, got 0"):
        Head(0, 1, 0.01, 6.0)
    with pytest.raises(SettingError, match=r"no_answer: expected a number of at least 0 and below 1, got 1"):
        Head(1, 1, 0.01, 6.0, 1.0)


def test_the_shipped_network_is_small_documented_and_physical():
    model = load_model("srf08-mlp")
    folder = WEIGHTS / "srf08-mlp"
    assert sum(path.stat().st_size for path in folder.iterdir()) < 300_000
    assert "srf08-mlp" in model_names()
    for word in ("sonar-gym make-noise", "160 serial numbers", "Simulated by the waveform rig", "Limits"):
        assert word in model.card
    facing = model.law(Ping.of(distance=[0.5, 1.0, 2.0], angle=0.0, incidence=0.0, reflectance=0.9))
    assert np.all(facing.credence() > 0.95)
    assert np.all(facing.missing), "the temperature is missing"
    # a 200 mm disc is lost when its perpendicular misses the sensor, beyond 1.0 deg at 6 m and 5.7 deg at 1 m
    turned = model.law(Ping.of(distance=[3.0, 4.0, 5.0], angle=0.0, incidence=np.radians(30), reflectance=0.9))
    # its stand gives some echoes: 5 % of such pings in the survey, from 2.5 to 5.5 m
    assert turned.echo.mean() == pytest.approx(0.05, abs=0.05)
    assert np.all(model.law(Ping.of([1.0, 1.0], [0.0, 1.0], 0.0, 0.9)).extrapolates == [False, True])


def test_the_shipped_network_detects_almost_nothing_in_an_empty_cone():
    # 160 sensors had echoes in 1.4 % of pings at an empty cone
    law = load_model("srf08-mlp").law(Ping.of([20.0], 0.0, 0.0, 0.0))
    assert law.arrival(np.array([5.0]))[0] < 0.02
    assert not law.extrapolates[0]


def test_the_shipped_network_reads_longer_ranges_in_cold_air():
    # sound takes 0.18 % longer per degree below: 22 mm at 2 m between 24 and 18 degC
    law = load_model("srf08-mlp").law(Ping.of(2.0, 0.0, 0.0, 0.9, temperature_c=[18.0, 24.0]))
    middle = np.arange(1.8, 2.2, 1e-3)[:, None]
    mean = [
        np.average(middle[:-1, 0], weights=np.diff(law.arrival(middle + np.zeros(2)), axis=0)[:, k]) for k in (0, 1)
    ]
    assert 0.010 < mean[0] - mean[1] < 0.034


def test_the_ends_of_a_range_are_no_extrapolation():
    """Reflectances drawn from 0 to 1 hold neither."""
    law = load_model("srf08-mlp").law(Ping.of(1.0, reflectance=[0.0, 1.0]))
    assert not law.extrapolates.any()


@pytest.mark.parametrize("name", ["hcsr04-mlp", "maxbotix-mlp"])
def test_a_law_that_a_gaussian_beats_on_real_readings_says_so(name):
    """Each row of the card names the fitted laws that were better, than the shipped law and than the adapted one."""
    model = load_model(name)
    assert sum(path.stat().st_size for path in (WEIGHTS / name).iterdir()) < 60_000
    assert model.about["real"]
    for recording, crps in model.about["real"].items():
        row = next(line for line in model.card.splitlines() if line.startswith(f"| {recording} |"))
        for law, cell in zip((name, f"{name}, adapted"), row.split("|")[-3:-1], strict=True):
            for fitted in ("Gaussian", "beam model", "physics"):
                assert (fitted in cell) == (crps[fitted] < crps[law]), (recording, law, fitted)
