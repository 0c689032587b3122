"""The law of a simulation: known, emulated, sampled or asked; the empirical term."""

import numpy as np
import pytest

from acquisition import ModelError, Ping, Reading, Recording
from noise import GaussianModel, IdealModel, load_model, save_model
from noise.discrepancy.baseline.emulator import base_physics, crossed_log_likelihood, with_smooth
from noise.discrepancy.baseline.sources import asked, baseline_of
from noise.effects import CATALOGUE
from noise.fitting.batch import Batch
from noise.fitting.stack import PLACEMENT
from noise.metrics import crps_with_silence
from noise.physical import PhysicalModel
from tests.noise.discrepancy.made import batch_of, recording_of

SONAR = PhysicalModel(
    [
        CATALOGUE["travel_time_jitter"](sigma_m=0.004),
        CATALOGUE["sensitivity"](loss_db=46.0),
        CATALOGUE["zero_offset"](offset_m=0.02),
    ]
)


def survey(seed, n_visits=60, n_pings=8):
    rng = np.random.default_rng(seed)
    visits = Ping.of(np.round(rng.uniform(0.3, 7.0, n_visits), 3), rng.choice([0.0, 0.2], n_visits))
    every = visits[np.repeat(np.arange(n_visits), n_pings)]
    return Ping.of(every.distance, every.angle, time=np.arange(len(every)) * 0.1)


def recording(model, seed):
    ping = survey(seed)
    return Recording.of(ping, model.law(ping).sample(np.random.default_rng(seed)))


@pytest.fixture(scope="module")
def baseline():
    return baseline_of(IdealModel(), recording(SONAR, 2), recording(SONAR, 1), np.random.default_rng(0))


@pytest.mark.parametrize("model", [IdealModel(0.01, 6.0), SONAR])
def test_a_model_with_a_known_law_is_used_as_it_is(model):
    found = baseline_of(model, recording(SONAR, 1), None, np.random.default_rng(0))
    assert found.before is model
    assert found.emulator is model
    assert found.readings is None
    assert found.held_out is None
    assert found.law.resolution == model.resolution
    assert found.law.max_range == model.max_range


def test_the_emulator_predicts_unseen_readings_nearly_as_well_as_the_true_law(baseline):
    test = Batch.of(recording(SONAR, 3))
    true, found = (crps_with_silence(m.law(test.ping), test.reading).mean() for m in (SONAR, baseline.emulator))
    assert found < 1.15 * true


def test_the_emulator_predicts_better_than_a_forest(baseline):
    test = Batch.of(recording(SONAR, 3))
    near, found = (
        crps_with_silence(m.law(test.ping), test.reading).mean() for m in (baseline.before, baseline.emulator)
    )
    assert found < near


def test_a_fifth_of_the_conditions_is_held_out(baseline):
    assert baseline.held_out.n_visits == 12
    assert baseline.readings.n_visits == 60


def test_the_emulator_can_be_saved(baseline, tmp_path):
    again = load_model(save_model(baseline.emulator, tmp_path / "emulator"))
    ping = survey(4)
    assert np.allclose(again.law(ping).echo, baseline.emulator.law(ping).echo, atol=1e-9)


def test_equal_seeds_give_equal_laws(baseline):
    again = baseline_of(IdealModel(), recording(SONAR, 2), recording(SONAR, 1), np.random.default_rng(0))
    assert again.law.values == baseline.law.values


def test_a_simulator_is_asked_under_the_pings_of_the_recording():
    def simulator(ping, rng):
        return ping.distance + rng.normal(0.0, 0.01, len(ping))

    real = recording(SONAR, 1)
    found = asked(simulator, real, np.random.default_rng(0))
    assert np.array_equal(np.sort(found.ping.distance), np.sort(real.ping.distance))


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        (lambda ping: ping.distance[:-1], "of shape"),
        (lambda ping: -ping.distance, "a range of -"),
        (lambda ping: np.full(len(ping), np.nan), "a range of nan m"),
        (lambda ping: np.full(len(ping), 1e300), r"a range of 1e\+300 m"),
        (lambda ping: {"range": ping.distance}, "returned a dict"),
        (lambda ping: Reading.of(ping.distance[:-1]), "return one each"),
    ],
)
def test_a_wrong_answer_of_a_simulator_is_a_clear_error(answer, message):
    with pytest.raises(ModelError, match=message):
        asked(lambda ping, _: answer(ping), recording(SONAR, 1), np.random.default_rng(0))


@pytest.mark.slow
def test_another_model_is_sampled_under_the_conditions_of_the_recording():
    model, real = GaussianModel(), recording(SONAR, 1)
    found = baseline_of(model, real, None, np.random.default_rng(0))
    assert found.before is model
    assert set(found.readings.ping.distance) <= set(real.ping.distance)


def test_rare_silence_of_strong_echoes_is_not_taken_for_a_threshold():
    loud = {"sensitivity": {"loss_db": 0.0}, "dropped_reading": {"probability": 0.02}}
    readings = recording_of(loud, seed=5, visits=12, pings=100)
    found = baseline_of(IdealModel(), readings, readings, np.random.default_rng(0)).emulator
    new = recording_of(loud, seed=6).ping
    assert np.abs(found.law(new).echo - 0.98).max() < 0.03


def test_a_smooth_correction_never_predicts_conditions_left_out_worse_than_no_correction():
    rng = np.random.default_rng(0)
    readings = batch_of({"multipath": {"presence": 0.5}}, seed=0, visits=40, pings=8)
    physics = base_physics(readings, rng)
    smooth = with_smooth(physics, readings, rng)
    assert crossed_log_likelihood(smooth, readings) >= crossed_log_likelihood(physics, readings)


def test_who_is_heard_is_learned_from_a_few_dozen_positions():
    deaf = {"sensitivity": {"loss_db": 40.0}, "specular_loss": {"strength": 1.4}, "reflectance_loss": {"strength": 0.1}}
    readings = recording_of(deaf, seed=7, visits=40, pings=10)
    found = baseline_of(IdealModel(), readings, readings, np.random.default_rng(0)).emulator
    new = recording_of(deaf, seed=8)
    right = np.where(new.reading.echo, found.law(new.ping).echo, 1.0 - found.law(new.ping).echo)
    assert right.mean() > 0.9


@pytest.mark.parametrize("seed", [21, pytest.param(41, marks=pytest.mark.slow)])
def test_the_threshold_is_found_from_starts_in_other_basins(seed):
    """A likelier start may lead to a sonar that loses readings by chance instead of beyond its range."""
    found = baseline_of(IdealModel(), recording(SONAR, seed + 1), recording(SONAR, seed), np.random.default_rng(0))
    new = Batch.of(recording(SONAR, seed + 2))
    true, emulated = (crps_with_silence(m.law(new.ping), new.reading).mean() for m in (SONAR, found.emulator))
    assert emulated < 1.1 * true


def test_an_error_that_follows_from_the_condition_is_no_scatter_of_placements():
    """A sonar that hears the nearer edge of a panel errs by which way both are turned, relative to each other."""
    rng = np.random.default_rng(3)
    grid = np.meshgrid(np.linspace(0.5, 2.0, 6), np.deg2rad([-30, -15, 15, 30]), np.deg2rad([-20, -10, 10, 20]))
    distance, angle, incidence = (np.repeat(each.ravel(), 6) for each in grid)
    error = 0.15 * np.sign(angle) * incidence * np.abs(angle) / np.deg2rad(30)
    ping = Ping.of(distance, angle, incidence, time=np.arange(len(distance)) * 0.1)
    reading = Reading.of(np.round(distance + error + rng.normal(0.0, 0.002, len(distance)), 3))
    batch = Batch.of(Recording.of(ping, reading))
    physics = base_physics(batch, rng)
    law = with_smooth(physics, batch, rng)
    assert physics.get(PLACEMENT) > 0.01
    assert law.get(PLACEMENT) < 0.005
