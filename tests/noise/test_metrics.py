"""Metrics against closed forms, another library, and laws that are true by construction."""

from dataclasses import replace

import numpy as np
import pytest
import scoringrules
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from acquisition import Ping, Reading, SettingError
from noise import GaussianModel, IdealModel, load_model
from noise.effects import CATALOGUE
from noise.learned.networks import MlpModel
from noise.metrics import ClusterMean, credence_reliability, crps, crps_with_silence, evaluate, pit
from noise.physical import PhysicalModel


@pytest.fixture
def rng():
    return np.random.default_rng(7)


def test_crps_of_a_normal_law():
    sigma = np.array([0.02, 0.05, 0.1])
    laws = [GaussianModel(sigma=s, sigma_per_metre=0.0, resolution=1e-4).law(Ping.of(distance=2.0)) for s in sigma]
    read = np.array([2.01, 1.9, 2.3])
    score = [crps(law, Reading.of(y))[0] for law, y in zip(laws, read, strict=True)]
    np.testing.assert_allclose(score, scoringrules.crps_normal(read, 2.0, sigma), rtol=0.01)


def test_crps_is_the_integral_over_the_register():
    stack = [
        CATALOGUE["fixed_clutter"](presence=0.3, range_m=0.8),
        CATALOGUE["travel_time_jitter"](sigma_m=0.02),
        CATALOGUE["spike"](probability=0.1, span_m=3.0),
    ]
    model = PhysicalModel(stack, 0.005, 3.0)
    law = model.law(Ping.of(distance=[2.0] * 600))
    steps = np.arange(1, 601) * 0.005
    cdf = law.cdf(steps) / law.echo
    for y in (0.8, 1.995, 2.5):
        integral = 0.005 * np.sum((cdf - (steps >= y)) ** 2)
        assert crps(model.law(Ping.of(distance=2.0)), Reading.of(y))[0] == pytest.approx(integral, rel=0.01, abs=1e-4)


def test_crps_of_a_deterministic_law_is_the_absolute_error():
    law = IdealModel().law(Ping.of(distance=[1.0, 1.0, 1.0]))
    np.testing.assert_allclose(crps(law, Reading.of([1.0, 1.25, 0.0])), [0.0, 0.25, np.nan])


def test_pit_of_the_true_law_is_uniform_and_of_another_is_not(rng):
    stack = [
        CATALOGUE["travel_time_jitter"](sigma_m=0.003),
        CATALOGUE["sensitivity"](loss_db=48.0),
        CATALOGUE["spike"](probability=0.05),
        CATALOGUE["quantisation"](step_m=0.01),
    ]
    model, ping = PhysicalModel(stack), Ping.of(distance=rng.uniform(0.2, 5.5, 4000))
    drawn = model.law(ping).sample(rng)
    assert stats.kstest(pit(model.law(ping), drawn, rng), "uniform").pvalue > 1e-3
    other = PhysicalModel([*stack[:-1], CATALOGUE["zero_offset"](offset_m=0.01)])
    assert stats.kstest(pit(other.law(ping), drawn, rng), "uniform").pvalue < 1e-9


def test_credence_of_the_true_law_is_calibrated(rng):
    model, ping = (
        GaussianModel(sigma=0.05, sigma_per_metre=0.08, miss=0.1),
        Ping.of(distance=rng.uniform(0.2, 5, 20_000)),
    )
    law = model.law(ping)
    curve = credence_reliability(law, law.sample(rng), np.arange(20_000) % 500)
    filled = curve.pings > 200
    assert filled.sum() >= 2
    assert np.all(np.abs(curve.predicted - curve.observed)[filled] < 4.5 * curve.error[filled])
    assert curve.gap < 0.02
    overconfident = credence_reliability(IdealModel().law(ping), law.sample(rng), np.arange(20_000) % 500)
    assert overconfident.gap > 0.2


def test_standard_errors_are_over_clusters(rng):
    visit = np.repeat(np.arange(50), 40)
    value = rng.normal(size=50)[visit]
    score = ClusterMean.of(value, visit)
    assert score.error == pytest.approx(np.std(value[::40], ddof=1) / np.sqrt(50))
    assert score.error > 5 * np.std(value) / np.sqrt(len(value))
    alone = ClusterMean.of(value, np.arange(2000))
    assert alone.error == pytest.approx(np.std(value, ddof=1) / np.sqrt(2000))


def test_one_cluster_gives_no_standard_error():
    assert np.isnan(ClusterMean.of([1.0, 2.0], [0, 0]).error)
    with pytest.raises(SettingError, match="got 0 and 0"):
        ClusterMean.of([], [])


@pytest.mark.parametrize("cluster", [[None, 1], [0, "a", 2], [[0], [1, 2]], [{}, {}]])
def test_a_cluster_that_is_neither_number_nor_name_is_named(cluster):
    with pytest.raises(SettingError, match="cluster: expected a number or name for each of 2 pings"):
        ClusterMean.of([1.0, 2.0], cluster)


def test_the_true_model_scores_best(rng):
    ping = Ping.of(distance=np.repeat(rng.uniform(0.3, 4, 60), 20))
    visit = np.repeat(np.arange(60), 20)
    true = GaussianModel(sigma=0.02, sigma_per_metre=0.01)
    drawn = true.law(ping).sample(rng)
    scores = [evaluate(m, ping, drawn, visit) for m in (true, GaussianModel(0.05, 0.01), GaussianModel(0.02, 0.04))]
    assert scores[0].log_likelihood.mean > max(s.log_likelihood.mean for s in scores[1:])
    assert scores[0].crps_mm.mean < min(s.crps_mm.mean for s in scores[1:])
    # entropy of a normal in 1 mm steps: -0.5 log(2 pi e sigma^2) + log step, averaged over the distances
    sigma = 0.02 + 0.01 * ping.distance
    entropy = np.mean(0.5 * np.log(2 * np.pi * np.e * sigma**2) - np.log(0.001))
    assert scores[0].log_likelihood.mean == pytest.approx(-entropy, abs=5 * scores[0].log_likelihood.error)
    assert evaluate(IdealModel(), ping, drawn, visit).log_likelihood.mean == -np.inf


@given(st.floats(0.05, 3.0), st.floats(0.0, 1.0), st.booleans())
def test_the_threshold_weighted_crps_is_the_integral_within_the_tolerance(read, presence, silent):
    stack = [
        CATALOGUE["fixed_clutter"](presence=presence, range_m=1.7),
        CATALOGUE["travel_time_jitter"](sigma_m=0.08),
        CATALOGUE["dropped_reading"](probability=0.2),
    ]
    law = PhysicalModel(stack, 0.005, 3.0).law(Ping.of(distance=[2.0]))
    value = np.inf if silent else round(read / 0.005) * 0.005
    steps = np.arange(360, 440)  # of 5 mm: 1.8 m to 2.2 m; the law is constant between them
    below = np.array([law.cdf_step(np.array([step]))[0] for step in steps])
    expected = 0.005 * np.sum((below - (value <= 0.005 * steps + 1e-9)) ** 2)
    score = crps_with_silence(law, Reading.of([0.0 if silent else value]), levels=4000, tolerance=0.1)
    assert score[0] == pytest.approx(expected, abs=2e-3)


@pytest.mark.parametrize(("silence", "read", "expected"), [(4.0, 0.0, 1.0), (4.0, 8.0, 1.0), (11.008, 0.0, 0.752)])
def test_silence_stands_in_its_place_among_the_ranges(silence, read, expected):
    """Known answer: for two values, each with probability 1/2, the score of either is a quarter of their distance."""
    law = GaussianModel(0.0, 0.0, 0.5).law(Ping.of(distance=[8.0]))
    score = crps_with_silence(law, Reading.of([read]), silence, levels=4000)
    assert score[0] == pytest.approx(expected, abs=2e-3)


def test_scores_of_answered_pings_are_those_of_the_law_given_an_answer():
    sure = load_model("srf08-mlp")
    fails = MlpModel(sure.inputs, replace(sure.head, no_answer=0.3), sure.layers)
    ping = Ping.of(distance=np.repeat(np.linspace(0.3, 4.0, 40), 10))
    reading = fails.law(ping).sample(np.random.default_rng(0))
    one, other = (evaluate(model, ping, reading, ping.distance, answered=True) for model in (sure, fails))
    assert one.log_likelihood.mean == pytest.approx(other.log_likelihood.mean)
    assert one.credence_gap == pytest.approx(other.credence_gap)
    assert one.log_likelihood.pings == reading.answered.sum() < len(ping)


SCORES = {
    "crps": crps,
    "crps_with_silence": crps_with_silence,
    "pit": lambda law, reading: pit(law, reading, np.random.default_rng(0)),
    "credence": lambda law, reading: credence_reliability(law, reading, [0]),
    "log_prob": lambda law, reading: law.log_prob(reading),
}


@pytest.mark.parametrize("model", [GaussianModel(), PhysicalModel()], ids=["gaussian", "physical"])
@pytest.mark.parametrize("score", SCORES.values(), ids=SCORES)
def test_there_is_one_reading_for_each_ping(score, model):
    with pytest.raises(SettingError, match=r"\.reading: expected one reading for each ping, got 1 for 2"):
        score(model.law(Ping.of(distance=[1.0, 2.0])), Reading.of([1.0]))
