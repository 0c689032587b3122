"""Starting points of fits agree with the readings."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from acquisition import Ping, Reading, Recording
from noise.effects import CATALOGUE, EchoSample
from noise.fitting.batch import Batch
from noise.fitting.fit import maximise
from noise.fitting.likelihood import log_likelihood
from noise.fitting.stack import NUISANCES, Stack
from noise.fitting.starts import fitting_value, nuisance_start, starting_points, target_echo
from noise.physical import PhysicalModel

torch.set_num_threads(1)


def batch_of(outliers=0.0, seed=0, visits=40, **effects):
    """Return visits of 5 readings with a scatter of 2 mm and a share of outliers."""
    rng = np.random.default_rng(seed)
    ping = Ping.of(distance=np.repeat(rng.uniform(0.3, 4.0, visits), 5), time=np.arange(5 * visits) * 10.0)
    stack = {"travel_time_jitter": {"sigma_m": 0.002}, "spike": {"probability": outliers}, **effects}
    model = PhysicalModel([CATALOGUE[name](**values) for name, values in stack.items()])
    return Batch.of(Recording.of(ping, model.law(ping).sample(rng)))


def fitted(key, batch):
    ideal = Stack.of(PhysicalModel())
    return fitting_value(ideal, key, batch, target_echo(ideal, batch))


@settings(max_examples=20, deadline=None)
@given(error=st.floats(-0.04, 0.04), outliers=st.sampled_from([0.0, 0.2]))
def test_a_clock_starts_at_its_error_in_spite_of_outliers(error, outliers):
    batch = batch_of(outliers, clock_scale={"error": error})
    found = fitted(("clock_scale", "error"), batch)
    assert found == pytest.approx(error, abs=0.002)


@pytest.mark.parametrize(
    ("name", "parameter", "value"), [("zero_offset", "offset_m", 0.05), ("warm_up", "offset_m", 0.0)]
)
def test_an_offset_starts_at_the_median_error(name, parameter, value):
    batch = batch_of(zero_offset={"offset_m": value})
    assert fitted((name, parameter), batch) == pytest.approx(value, abs=0.003)


def test_a_parameter_that_shifts_no_echo_has_no_estimate():
    assert fitted(("spike", "probability"), batch_of()) is None


@pytest.mark.parametrize("period_s", [200.0, 900.0])
def test_a_thermal_oscillation_starts_at_its_period(period_s):
    batch = batch_of(thermal_drift={"sine_k": 4.0, "cosine_k": -3.0, "period_s": period_s})
    seen = EchoSample(batch.ping.distance, batch.ping.time, batch.reading.range)
    first = CATALOGUE["thermal_drift"].guesses(seen)[0]
    assert first["period_s"] == pytest.approx(period_s, rel=0.1)
    assert np.hypot(first["sine_k"], first["cosine_k"]) == pytest.approx(5.0, abs=1.5)


def test_intermittent_noise_starts_at_the_onset_of_early_readings():
    batch = batch_of(false_alarm={"per_metre": 5.0, "share": 0.3, "from_m": 0.25})
    seen = EchoSample(batch.ping.distance, batch.ping.time, batch.reading.range)
    guess, steady = CATALOGUE["false_alarm"].guesses(seen)
    assert guess["from_m"] == pytest.approx(0.25, abs=0.05)
    assert guess["share"] == pytest.approx(0.3, abs=0.12)
    assert 2.0 < guess["per_metre"] < 12.0
    assert steady["share"] == 1.0
    assert steady["per_metre"] < guess["per_metre"]


def test_steady_noise_is_fitted_from_its_starting_points():
    """Noise in all pings from the start is common, although one of its parameters is at its null value."""
    truth = {"per_metre": 0.03, "share": 1.0, "from_m": 0.0}
    batch = batch_of(visits=300, false_alarm=truth)
    *_, steady = CATALOGUE["false_alarm"].guesses(EchoSample(batch.ping.distance, batch.ping.time, batch.reading.range))
    assert steady["per_metre"] == pytest.approx(0.03, rel=0.35)
    stack = nuisance_start(Stack.of(PhysicalModel((), batch.resolution)), batch)
    starts = starting_points(stack, "false_alarm", batch, np.random.default_rng(0))
    best = max(starts, key=lambda start: log_likelihood(start, batch).sum())
    keys = [("false_alarm", name) for name in truth]
    fitted = maximise(best, (*keys, *NUISANCES), batch)
    known = maximise(best.put(keys, list(truth.values())), (*keys, *NUISANCES), batch)
    assert fitted.nats > known.nats - 3.0
    rate, share, onset = (fitted.stack.get(key) for key in keys)
    assert share * -np.expm1(-rate * (2.0 - onset)) == pytest.approx(-np.expm1(-0.03 * 2.0), rel=0.4)


def test_the_value_of_a_stuck_register_is_guessed_exactly():
    rng = np.random.default_rng(0)
    distance = rng.uniform(0.8, 3.0, 300)
    value = np.where(
        rng.random(300) < 0.1, 0.3327, np.where(rng.random(300) < 0.1, rng.uniform(0.1, 0.6, 300), distance)
    )
    (guess, *_) = CATALOGUE["stuck"].guesses(EchoSample(distance, np.zeros(300), value))
    assert guess["value_m"] == 0.3327
    assert guess["probability"] == pytest.approx(0.1, abs=0.04)
    assert CATALOGUE["stuck"].guesses(EchoSample(distance, np.zeros(300), distance)) == []


@pytest.mark.parametrize(
    ("name", "parameter", "value"), [("dropped_reading", "probability", 0.02), ("sensitivity", "loss_db", 30.0)]
)
def test_a_parameter_that_the_law_has_also_starts_a_little_beside_it(name, parameter, value):
    batch = batch_of()
    law = nuisance_start(Stack.of(PhysicalModel([CATALOGUE[name](**{parameter: value})])), batch)
    starts = {start.get((name, parameter)) for start in starting_points(law, name, batch, np.random.default_rng(0))}
    assert any(value < start <= 4.0 * value for start in starts)
    assert any(value > start >= value / 4.0 for start in starts)


@pytest.mark.parametrize("step", [0.001, 0.01, 0.0254])
def test_wrong_bits_are_those_of_the_register(step):
    rng = np.random.default_rng(0)
    plain = batch_of(visits=60)
    count = np.maximum(np.rint(plain.reading.range / step).astype(np.int64), 1)
    wrong = np.where(rng.random(len(plain)) < 0.3, count ^ (1 << rng.integers(0, 16, len(plain))), count)
    batch = Batch.of(Recording.of(plain.ping, Reading.of(wrong * step)))
    starts = starting_points(nuisance_start(Stack.of(PhysicalModel()), batch), "corrupted_byte", batch, rng, 2)
    best = max(starts, key=lambda stack: log_likelihood(stack, batch).sum())
    found = maximise(best, (("corrupted_byte", "probability"), *NUISANCES), batch).stack
    assert found.get(("corrupted_byte", "unit_m")) == pytest.approx(step)
    assert found.get(("corrupted_byte", "probability")) == pytest.approx(0.3, abs=0.1)
