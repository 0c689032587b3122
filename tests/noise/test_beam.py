"""The beam model: properties of its law, and recovery of known parameters by the fit."""

import numpy as np
import pytest
from scipy import stats

from acquisition import ModelError, Ping, Reading, SettingError
from noise import load_model, save_model, simulate
from noise.beam import BeamModel, fit_beam

STEP, REACH = 0.01, 5.0
TRUE = BeamModel(0.7, 0.1, 0.15, 0.05, sigma=0.04, short_rate=1.5, resolution=STEP, max_range=REACH)


def test_probabilities_sum_to_one_and_no_echo_is_the_silent_component():
    steps = np.arange(1, round(REACH / STEP) + 1)
    for distance in (0.0, 0.3, 2.0, 6.0):
        law = TRUE.law(Ping.of(distance=np.full(len(steps), distance)))
        probability = np.exp(law.log_prob(Reading.of(steps * STEP)))
        np.testing.assert_allclose(probability, np.diff(law.cdf_step(steps), prepend=0.0), atol=1e-12)
        assert law.no_echo[0] == pytest.approx(0.15, abs=1e-9)
        assert probability.sum() == pytest.approx(0.85, abs=1e-9)


def test_samples_agree_with_log_prob():
    n, steps = 20_000, np.arange(1, round(REACH / STEP) + 1)
    law = TRUE.law(Ping.of(distance=np.full(len(steps), 1.5)))
    drawn = TRUE.law(Ping.of(distance=np.full(n, 1.5))).sample(np.random.default_rng(1))
    expected = n * np.r_[law.no_echo[0], np.exp(law.log_prob(Reading.of(steps * STEP)))]
    observed = np.bincount(np.rint(drawn.range / STEP).astype(int), minlength=len(expected))
    few = expected < 8
    counts = [np.append(x[~few], x[few].sum()) for x in (observed, expected)]
    assert stats.chisquare(counts[0], counts[1] * n / counts[1].sum()).pvalue > 1e-5


def test_expectation_maximisation_recovers_the_parameters():
    rng = np.random.default_rng(2)
    ping = Ping.of(distance=rng.uniform(2.5, 4.5, 20_000))
    fitted, course = fit_beam(ping, simulate(TRUE, ping, rng), STEP, REACH)
    assert fitted.silent == pytest.approx(0.15, abs=0.01)
    assert fitted.hit == pytest.approx(0.7, abs=0.01)
    assert fitted.sigma == pytest.approx(0.04, rel=0.05)
    assert fitted.short_rate == pytest.approx(1.5, rel=0.25)
    assert course[-1] > course[0]


def test_the_fit_is_as_likely_as_the_true_model():
    rng = np.random.default_rng(3)
    ping = Ping.of(distance=rng.uniform(0.5, 4.5, 10_000))
    reading = simulate(TRUE, ping, rng)
    fitted, _ = fit_beam(ping, reading, STEP, REACH)
    gain = fitted.law(ping).log_prob(reading) - TRUE.law(ping).log_prob(reading)
    assert gain.mean() > -3e-3, "the M-step ignores the truncation of the exponential, as in the book"


def test_a_saved_model_loads_unchanged(tmp_path):
    assert load_model(save_model(TRUE, tmp_path / "beam")) == TRUE
    with pytest.raises(ModelError, match="beam model: cannot be built from its parameters"):
        BeamModel.from_dict({"hit": 1.0})


def test_invalid_mixtures_and_unanswered_pings_raise():
    with pytest.raises(SettingError, match="must sum to 1"):
        BeamModel(hit=0.9)
    with pytest.raises(SettingError, match="remove pings without an answer"):
        fit_beam(Ping.of(distance=[1.0]), Reading.of([0.0], [2]), STEP, REACH)


@pytest.mark.parametrize("seed", range(6))
def test_a_sensor_that_always_detects_has_no_silent_component(seed):
    rng = np.random.default_rng(seed)
    ping = Ping.of(distance=rng.uniform(0.2, 4.0, 200))
    reading = Reading.of(np.rint(np.clip(ping.distance + rng.normal(0.0, 0.03, 200), STEP, REACH) / STEP) * STEP)
    assert 0.0 <= fit_beam(ping, reading, STEP, REACH)[0].silent < 1e-12


@pytest.mark.parametrize("setting", [{"sigma": 2.3e-308}, {"sigma": 5e-324}, {"short_rate": 5e-324}])
def test_the_least_positive_numbers_are_limits_of_the_law(setting):
    law = BeamModel(**setting).law(Ping.of(distance=np.linspace(0.3, 9.0, 20)))
    cdf = law.cdf(np.linspace(0.0, 10.0, 30)[:, None])
    assert np.all(np.isfinite(cdf))
    assert np.all(np.diff(cdf, axis=0) >= 0.0)
