"""Readings carried from one law to another keep their rank and take on the other law."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from acquisition import EchoStatus, Ping, Reading
from noise import GaussianModel, load_model, save_model
from noise.discrepancy.baseline.forest import grown
from noise.discrepancy.baseline.transport import Transport, transforms
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


@pytest.mark.parametrize(("before_m", "after_m"), [(0.004, 0.008), (0.008, 0.004)])
def test_carried_readings_have_the_mean_and_spread_of_the_other_law(before_m, after_m):
    before = model_of({**LOUD, "travel_time_jitter": {"sigma_m": before_m}})
    after = model_of({**LOUD, "travel_time_jitter": {"sigma_m": after_m}, "zero_offset": {"offset_m": 0.03}})
    reading = drawn(before)
    found = carried(Transport(before, after), reading)
    expected = drawn(after, seed=2).range
    assert found.range.mean() == pytest.approx(expected.mean(), abs=4 * after_m * np.sqrt(2 / N))
    assert found.range.std() == pytest.approx(expected.std(), rel=0.08)
    if after_m < before_m:
        order = np.argsort(reading.range, kind="stable")[10:-10]  # beyond, ranks are guesses
        assert np.all(np.diff(found.range[order]) >= -0.0031)  # those of one step come in any order
    else:
        assert np.corrcoef(reading.range, found.range)[0, 1] == pytest.approx(before_m / after_m, abs=0.05)


def test_noise_that_is_new_with_every_reading_is_so_where_it_is_added():
    """A visit whose placement moves all its readings alike is no narrower for it under a noisier law."""
    before, after = (model_of({**LOUD, "travel_time_jitter": {"sigma_m": sigma}}) for sigma in (0.004, 0.016))
    visit = Reading.of(np.full(N, 2.004))
    found = carried(Transport(before, after), visit).range
    assert found.std() == pytest.approx(np.sqrt(0.016**2 - 0.004**2), rel=0.08)
    assert found.mean() == pytest.approx(2.004, abs=0.0015)


class Follower:
    """A sonar whose reading lies around the one before it, of which it keeps a share of the error."""

    resolution, remembers = 0.001, True

    def __init__(self, share):
        self.share = share

    def law(self, ping, past=None):
        error = 0.0 if past is None else np.where(past.echo, past.range - ping.distance, 0.0)
        moved = Ping.of(distance=ping.distance + self.share * error)
        return GaussianModel(0.004, 0.0, miss=0.0).law(moved)


def test_each_law_is_that_given_the_reading_before_in_its_own_file():
    """Both sonars keep a share of the error before; the other keeps less, and the innovations are the same."""
    rng, error = np.random.default_rng(0), np.zeros(N)
    innovation = rng.normal(0.0, 0.004, N)
    for k in range(1, N):
        error[k] = 0.9 * error[k - 1] + innovation[k]
    reading = Reading.of(np.round(2.0 + error, 3))
    before = Reading.of(np.r_[2.0, reading.range[:-1]])
    found = Transport(Follower(0.9), Follower(0.5)).law(
        with_simulated(PING, reading, before), Reading.of(np.full(N, 2.0))
    )
    np.testing.assert_allclose(found.sample(rng).range[1:], 2.0 + innovation[1:], atol=0.0035)


@given(st.integers(0, 2**32 - 1))
def test_transforms_enclose_probabilities_that_sum_to_one(seed):
    law = GaussianModel(0.01, 0.0, 0.1).law(PING)
    low, high = transforms(law, law.sample(np.random.default_rng(seed)))
    assert ((low >= 0.0) & (low <= high) & (high <= 1.0)).all()
    silent = transforms(law, Reading.of(np.zeros(len(PING))))
    np.testing.assert_allclose(silent[1] - silent[0], law.no_echo, atol=1e-12)


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
    forest = grown(simulated, np.random.default_rng(0))
    assert is_carried(simulation, forest, None, lambda _: transport, recorded, np.random.default_rng(0)) is expected


@pytest.mark.parametrize(("offset_m", "expected"), [(0.03, True), (-0.03, False)])
def test_without_common_conditions_a_forest_of_the_readings_tells_whether_to_carry_them(offset_m, expected):
    simulated, recorded = batch_of(LOUD, seed=1), batch_of({**LOUD, "zero_offset": {"offset_m": 0.03}}, seed=2)
    transport = Transport(model_of(LOUD), model_of({**LOUD, "zero_offset": {"offset_m": offset_m}}))
    simulation, rng = Simulation(model_of(LOUD), simulated), np.random.default_rng(0)
    forest = grown(simulated, rng)
    assert is_carried(simulation, forest, None, lambda _: transport, recorded, rng) is expected
    assert not is_carried(simulation, forest, model_of(LOUD), lambda _: transport, recorded, rng)
