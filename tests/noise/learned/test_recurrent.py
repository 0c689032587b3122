"""Properties of learned laws with memory, for any weights."""

import json
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from acquisition import EchoStatus, ModelError, Ping, Reading, SettingError
from noise import Faulty, follow, listener, load_model, save_model, simulate
from noise.faults import Constant, Short
from noise.learned.inputs import Inputs
from noise.learned.mixture import Head
from noise.learned.networks import MlpModel
from noise.learned.recurrent import LstmModel
from noise.learned.recurrent_state import N_ANCHORS, N_HISTORY_FEATURES, LstmCell, PingHistory
from noise.learned.tensors import WEIGHTS_FILE
from noise.model import StatefulModel

REACH, STEP, STATE = 4.0, 0.01, 6
NAMES = ("distance", "angle", "incidence", "reflectance", "temperature_c")


def learned_on():
    return Ping.of(
        distance=[0.1, 2.0, 3.5], angle=[0.0, 0.2, 0.6], incidence=[0.1, 0.0, 0.6], reflectance=[0.1, 0.9, 0.5],
        temperature_c=[15.0, 20.0, 25.0],
    )  # fmt: skip


def random_layers(rng, *widths, size=1.0):
    return [(size * rng.normal(size=(b, a)), size * rng.normal(size=b)) for a, b in pairwise(widths)]


def random_model(seed=0, hybrid=True, size=0.7):
    rng = np.random.default_rng(seed)
    inputs = Inputs.of(learned_on(), NAMES)
    simple = Head(near=3, fixed=2, resolution=STEP, max_range=REACH)
    head = Head(3, 2, STEP, REACH, anchored=N_ANCHORS, fails=True)
    width = inputs.width + N_HISTORY_FEATURES
    cell = LstmCell(*(rng.normal(size=shape) for shape in ((4 * STATE, width), (4 * STATE, STATE), (4 * STATE,))))
    base = MlpModel(inputs, simple, random_layers(rng, inputs.width, 5, simple.width)) if hybrid else None
    return LstmModel(inputs, head, cell, random_layers(rng, width + STATE, 8, head.width, size=size), base)


def course(n=60, runs=4, seed=0):
    """Return interleaved pings of a few sensors, with echoes, no echoes and no answers."""
    rng = np.random.default_rng(seed)
    ping = Ping.of(
        rng.uniform(0.1, 3.5, n), rng.uniform(0, 0.5, n), rng.uniform(0, 0.5, n), rng.uniform(0.1, 0.9, n),
        time=np.sort(rng.uniform(0, 60, n)), run=rng.integers(0, runs, n), temperature_c=rng.uniform(15, 25, n),
    )  # fmt: skip
    status = rng.choice(3, n, p=[0.2, 0.7, 0.1])
    value = np.where(status == EchoStatus.ECHO, np.maximum(np.rint((ping.distance + 0.02) / STEP), 1) * STEP, 0.0)
    return ping, Reading.of(value, status)


@pytest.fixture(params=[True, False], ids=["hybrid", "lstm"])
def model(request):
    return random_model(3, request.param)


def test_following_a_recording_agrees_with_single_steps(model):
    ping, reading = course()
    whole = model.follow(ping, reading).log_prob(reading)
    for run in np.unique(ping.run):
        rows, own, past = np.flatnonzero(ping.run == run), listener(model), None
        for k in rows:
            law = own.law(ping[[k]], past)
            past = reading[[k]]
            assert law.log_prob(past)[0] == pytest.approx(whole[k], abs=1e-9)


def test_sensors_in_parallel_agree_with_single_sensors(model):
    ping, reading = course(n=40, runs=1)
    together, alone = model.fresh(), [model.fresh() for _ in range(4)]
    past = None
    for t in range(10):
        rows = np.arange(4) * 10 + t
        law = together.law(ping[rows], past)
        for i, (row, one) in enumerate(zip(rows, alone, strict=True)):
            single = one.law(ping[[row]], None if past is None else past[[i]])
            assert single.credence()[0] == pytest.approx(law.credence()[i], abs=1e-12)
        past = reading[rows]


def test_laws_do_not_depend_on_later_readings(model):
    ping, reading = course()
    other = Reading.of(reading.range.copy(), reading.status.copy())
    other.range[40:], other.status[40:] = 1.23, 1
    one, two = (model.follow(ping, r).log_prob(reading) for r in (reading, other))
    first = {run: np.flatnonzero((ping.run == run) & (np.arange(60) >= 40))[:1] for run in range(4)}
    upto = np.r_[np.arange(40), *first.values()]
    np.testing.assert_allclose(one[upto], two[upto], atol=1e-12)
    assert np.abs(one - two).max() > 1e-3, "but on earlier readings"


def test_reset_a_new_run_and_no_past_clear_the_state(model):
    ping, reading = course(n=3, runs=1)
    initial = model.fresh().law(ping).credence()
    own = model.fresh()
    own.law(ping)
    moved = own.law(ping, reading).credence()
    assert np.abs(moved - initial).max() > 1e-4, "the law depends on the reading"
    other_run = Ping.of(
        ping.distance, ping.angle, ping.incidence, ping.reflectance, ping.time, run=[0, 9, 0], **ping.covariates
    )
    own.reset()
    np.testing.assert_allclose(own.law(ping, reading).credence(), initial)
    partly = own.law(other_run, reading).credence()
    np.testing.assert_allclose(partly, [moved[0], initial[1], moved[2]])
    own.reset()
    own.law(ping)
    own.reset(np.array([True, False, False]))
    np.testing.assert_allclose(own.law(ping, None).credence(), initial)


def test_some_sensors_can_be_reset(model):
    ping, reading = course(n=3, runs=1)
    initial, own, other = model.fresh().law(ping).credence(), model.fresh(), model.fresh()
    for one in (own, other):
        one.law(ping)
        one.law(ping, reading)
    own.reset(np.array([False, True, False]))
    mixed, advanced = own.law(ping, reading).credence(), other.law(ping, reading).credence()
    np.testing.assert_allclose(mixed, [advanced[0], initial[1], advanced[2]], atol=1e-12)


def test_reset_accepts_sensors_without_a_ping(model):
    ping, reading = course(n=3, runs=1)
    own = model.fresh()
    initial = own.law(ping).credence()
    own.reset(np.arange(16))
    own.reset([])
    np.testing.assert_allclose(own.law(ping, reading).credence(), initial)


def test_sensors_that_fire_in_turn_have_separate_states(model):
    ping, reading = course(n=30, runs=1)
    turns, alone = model.fresh(), [model.fresh() for _ in range(3)]
    for t in range(10):
        sensors = np.array([0, 2]) if t % 2 else np.array([1])
        rows, before = 3 * t + sensors, 3 * max(t - 2, 0) + sensors
        law = turns.law(ping[rows], reading[before], sensors)
        for i, seat in enumerate(sensors):
            single = alone[seat].law(ping[rows[[i]]], reading[before[[i]]] if t >= 2 else None)
            assert single.credence()[0] == pytest.approx(law.credence()[i], abs=1e-12)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 1000))
def test_probabilities_sum_to_one_after_any_past(seed):
    ping, reading = course(n=12, runs=2, seed=seed)
    steps = np.arange(1, round(REACH / STEP) + 1)
    law = random_model(seed).follow(ping, reading)
    edges = np.diff(law.cdf_step(np.repeat(steps[:, None], 12, axis=1)), axis=0, prepend=0.0)
    np.testing.assert_allclose(edges.sum(axis=0) + law.no_echo + law.no_answer, 1.0, atol=1e-9)
    assert np.all(np.isfinite(law.log_prob(reading))), "no reading has probability zero"


def test_samples_agree_with_the_law_no_answer_included():
    model, n = random_model(1), 20_000
    one = Ping.of(1.5, 0.3, 0.2, 0.7, temperature_c=20.0)
    law = model.law(one)
    many = model.fresh().law(Ping.of(np.full(n, 1.5), 0.3, 0.2, 0.7, temperature_c=20.0))
    drawn = many.sample(np.random.default_rng(0))
    for share, expected in (((drawn.status == 2).mean(), law.no_answer), ((drawn.status == 0).mean(), law.no_echo)):
        assert share == pytest.approx(expected[0], abs=4.5 * np.sqrt(0.25 / n))
    near = drawn.echo & (np.abs(drawn.range - 1.5) <= 0.15 + 1e-9)
    assert near.mean() == pytest.approx(law.credence()[0], abs=4.5 * np.sqrt(0.25 / n))


def test_simulation_samples_step_by_step_and_separates_runs():
    model = random_model(2)
    ping, _ = course(n=50, runs=3)
    one, two = (simulate(model, ping, np.random.default_rng(5)) for _ in range(2))
    np.testing.assert_array_equal(one.range, two.range)
    # with a model that always repeats its last echo, each run repeats its own
    stuck = random_model(2, hybrid=False, size=0.0)
    bias = stuck.layers[-1][1]
    # logits of 3 near, 2 fixed, 2 anchored, the uniform, silence, no answer; 7 places; 7 widths
    bias[:] = [*np.zeros(6), 40.0, 0.0, 0.0, -40.0, *np.zeros(7), *np.full(7, -6.0)]
    drawn = simulate(stuck, ping, np.random.default_rng(0))
    for run in range(3):
        assert np.ptp(drawn.range[ping.run == run]) <= 0.011, "all readings are on the first one's step"
    assert len({drawn.range[ping.run == run][0] for run in range(3)}) == 3


def test_history_has_the_last_ping_and_the_last_echo():
    ping = Ping.of([1.0, 2.0, 3.0, 1.5], run=[0, 1, 0, 0])
    history = PingHistory.of_recording(ping, Reading.of([1.02, 0.0, 0.0, 1.4]))
    np.testing.assert_array_equal(history.known, [False, False, True, True])
    np.testing.assert_allclose(history.error, [0.0, 0.0, 0.02, 0.02])
    np.testing.assert_array_equal(history.has_echo, [False, False, True, True])
    np.testing.assert_allclose(history.anchors(ping.distance)[:, 2], [3.02, 1.02])
    np.testing.assert_allclose(history.anchors(ping.distance)[:, 3], [1.52, 1.5], err_msg="no echo is not repeated")
    assert np.all(history.features(ping)[:2] == 0.0)


def test_another_number_of_sensors_needs_a_reset(model):
    ping, reading = course(n=3)
    own = model.fresh()
    own.law(ping)
    with pytest.raises(SettingError, match="2 pings and 2 readings for a state of 3 sensors"):
        own.law(ping[:2], reading[:2])


def test_listeners_share_weights_but_no_state():
    model = random_model()
    assert isinstance(model, StatefulModel)
    one, two = listener(model), listener(model)
    ping, reading = course(n=3, runs=1)
    one.law(ping)
    one.law(ping, reading)
    np.testing.assert_array_equal(two.law(ping).credence(), model.law(ping).credence())


def test_faults_preserve_the_state(tmp_path):
    model = random_model()
    ping, reading = course()
    faulty = Faulty(model, [Short(0.1), Constant(0.05, 0.7)])
    assert faulty.remembers
    clean = follow(model, ping, reading)
    affected = follow(faulty, ping, reading)
    np.testing.assert_allclose(affected.no_answer, clean.no_answer)
    np.testing.assert_allclose(affected.parts[0].log_prob(reading), clean.log_prob(reading))
    again = load_model(save_model(faulty, tmp_path / "faulty"))
    assert again.causes == ("none", "SHORT", "CONSTANT")
    np.testing.assert_allclose(follow(again, ping, reading).log_prob(reading), affected.log_prob(reading), atol=1e-4)
    drawn = simulate(faulty, ping, np.random.default_rng(0))
    assert len(drawn) == len(ping)


@pytest.fixture
def saved(tmp_path, model):
    model.card = "# made for a test\n"
    return save_model(model, tmp_path / "net"), model


def test_a_saved_network_has_the_same_law(saved):
    folder, model = saved
    ping, reading = course()
    again = load_model(folder)
    np.testing.assert_allclose(
        follow(again, ping, reading).log_prob(reading), follow(model, ping, reading).log_prob(reading), atol=2e-4
    )
    assert again.card == "# made for a test\n"
    assert (again.base is None) == (model.base is None)


@pytest.mark.parametrize(
    ("key", "value"),
    [("hidden", 7), ("sizes", [3, 2]), ("inputs", {}), ("head", {"near": 3}), ("base", {"sizes": [1]})],
)
def test_an_invalid_description_raises_with_its_path(saved, key, value):
    path = saved[0] / "model.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), key: value}))
    with pytest.raises(ModelError, match=r"model\.json"):
        load_model(saved[0])


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda data: data[:-100], "damaged or of another model"),
        (lambda data: data + bytes(200_000), "damaged or of another model"),
        (lambda data: data.replace(b"lstm.bias", b"gate.bias"), "the tensors differ"),
    ],
    ids=["truncated", "oversized", "foreign"],
)
def test_damaged_weights_raise_with_their_path(saved, spoil, message):
    path = saved[0] / WEIGHTS_FILE
    path.write_bytes(spoil(path.read_bytes()))
    with pytest.raises(ModelError, match=message):
        load_model(saved[0])
