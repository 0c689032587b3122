"""Readings carried from one law to another keep their rank and take on the other law."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from acquisition import EchoStatus, Ping, Reading
from noise import GaussianModel, load_model, save_model
from noise.discrepancy.baseline.transport import Transport
from noise.discrepancy.judge.difference import is_carried
from noise.discrepancy.judge.held_out import Simulation
from noise.replay import with_simulated
from tests.noise.discrepancy.made import batch_of, model_of

N = 4000
PING = Ping.of(distance=np.full(N, 2.0))
LOUD = {"sensitivity": {"loss_db": 0.0}}


def carried(transport, reading, ping=PING, seed=0):
    return transport.law(with_simulated(ping, reading)).sample(np.random.default_rng(seed))


def drawn(model, seed=1):
    return model.law(PING).sample(np.random.default_rng(seed))


@given(
    st.lists(st.integers(1, 11_000), min_size=1, max_size=20),
    st.sampled_from([0.0, 0.3, 1.0]),
    st.integers(0, 2**32 - 1),
)
def test_between_equal_laws_every_reading_remains(steps, miss, seed):
    """Those too that the law does not expect, silence, and what was no answer."""
    status = np.random.default_rng(seed).integers(0, 3, len(steps))
    reading = Reading.of(np.where(status == EchoStatus.ECHO, 0.001 * np.array(steps), 0.0), status)
    law = GaussianModel(0.01, 0.0, miss=miss)
    found = carried(Transport(law, law), reading, Ping.of(distance=np.full(len(steps), 2.0)), seed)
    np.testing.assert_array_equal(found.status, reading.status)
    np.testing.assert_allclose(found.range, reading.range, atol=0.001 + 1e-9)  # the end of a step may be the next one


def test_carried_readings_have_the_mean_and_spread_of_the_other_law_in_the_order_they_had():
    before = model_of({**LOUD, "travel_time_jitter": {"sigma_m": 0.004}})
    after = model_of({**LOUD, "travel_time_jitter": {"sigma_m": 0.008}, "zero_offset": {"offset_m": 0.03}})
    reading = drawn(before)
    found = carried(Transport(before, after), reading)
    expected = drawn(after, seed=2).range
    assert found.range.mean() == pytest.approx(expected.mean(), abs=4 * 0.008 * np.sqrt(2 / N))
    assert found.range.std() == pytest.approx(expected.std(), rel=0.08)
    order = np.argsort(reading.range, kind="stable")[10:-10]  # beyond, ranks are guesses
    assert np.all(np.diff(found.range[order]) >= -0.0031)  # those of one step come in any order


def test_silence_becomes_as_frequent_as_under_the_other_law():
    before, after = GaussianModel(0.005, 0.0, miss=0.1), GaussianModel(0.005, 0.0, miss=0.4)
    found = carried(Transport(before, after), drawn(before))
    assert found.echo.mean() == pytest.approx(0.6, abs=4 * np.sqrt(2 * 0.24 / N))
    assert found.range[found.echo].mean() == pytest.approx(2.0, abs=0.001)  # near and far echoes are lost alike


def test_where_the_simulator_is_silent_against_its_law_the_law_makes_no_echoes():
    """Of a silence that a law all but excludes the two laws leave a sixth; but it is rather the law that is wrong."""
    before, after = GaussianModel(0.005, 0.0, miss=0.003), GaussianModel(0.005, 0.0, miss=0.0005)
    assert carried(Transport(before, after), Reading.of(np.zeros(N))).echo.mean() < 0.2


def test_an_error_that_both_laws_share_cancels():
    """Both expect echoes 0.15 m short of where the simulator hears them, and one 30 mm behind the other."""
    wrong = {**LOUD, "zero_offset": {"offset_m": -0.07}}
    before, after = model_of(wrong), model_of({**LOUD, "zero_offset": {"offset_m": -0.04}})
    reading = drawn(model_of({**LOUD, "zero_offset": {"offset_m": 0.1}}))
    np.testing.assert_allclose(carried(Transport(before, after), reading).range - reading.range, 0.03, atol=0.0021)


def test_a_ping_without_a_reading_of_the_simulator_has_the_other_law():
    after = model_of({**LOUD, "zero_offset": {"offset_m": 0.03}})
    law = Transport(model_of(LOUD), after).law(PING[:1])
    assert law.quantile(0.5)[0] == after.law(PING[:1]).quantile(0.5)[0]


def test_a_saved_transport_acts_alike(tmp_path):
    model = Transport(model_of(LOUD), model_of({**LOUD, "zero_offset": {"offset_m": 0.03}}))
    loaded = load_model(save_model(model, tmp_path / "difference"))
    reading = drawn(model_of(LOUD))
    np.testing.assert_array_equal(carried(loaded, reading).range, carried(model, reading).range)


@pytest.mark.parametrize(("offset_m", "expected"), [(0.03, True), (-0.03, False), (0.0, False)])
def test_readings_are_carried_only_to_a_law_that_predicts_unseen_visits_better(offset_m, expected):
    simulated, recorded = batch_of(LOUD, seed=1), batch_of({**LOUD, "zero_offset": {"offset_m": 0.03}}, seed=1)
    other = model_of({**LOUD, "zero_offset": {"offset_m": offset_m}})
    transport = Transport(model_of(LOUD), other)
    simulation = Simulation(model_of(LOUD), simulated)
    assert is_carried(simulation, None, transport, recorded, np.random.default_rng(0)) is expected


def test_without_common_conditions_readings_are_carried_where_no_cause_acts():
    simulated, recorded = batch_of(LOUD, seed=1), batch_of({**LOUD, "zero_offset": {"offset_m": 0.03}}, seed=2)
    transport = Transport(model_of(LOUD), model_of({**LOUD, "zero_offset": {"offset_m": 0.03}}))
    simulation, rng = Simulation(model_of(LOUD), simulated), np.random.default_rng(0)
    assert is_carried(simulation, None, transport, recorded, rng)
    assert not is_carried(simulation, model_of(LOUD), transport, recorded, rng)
