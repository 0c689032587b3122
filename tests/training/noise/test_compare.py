"""Comparison of noise models on data whose law is known."""

from dataclasses import replace

import numpy as np
import pytest

from acquisition import EchoStatus, Ping, Reading, Recording, SettingError
from noise import GaussianModel, simulate
from noise.beam import BeamModel
from training.noise.baselines import NearestConditionModel
from training.noise.compare import BEAM, GAUSSIAN, alternate_pings, baselines, compare, comparison_text, repeatability

STEP = 0.01
TRUTH = BeamModel(0.8, 0.05, 0.1, 0.05, sigma=0.03, resolution=STEP)


def recorded(seed, conditions=60, pings=40, model=TRUTH):
    rng = np.random.default_rng(seed)
    ping = Ping.of(distance=np.repeat(rng.uniform(0.5, 4.0, conditions).round(2), pings))
    return Recording.of(ping, simulate(model, ping, rng))


@pytest.fixture(scope="module")
def fitted():
    return baselines(recorded(0))


def test_true_law_beats_gaussian_and_flexible_models_come_near(fitted):
    scores = compare(recorded(1), {**fitted, "truth": TRUTH}).scores
    best = scores["truth"].log_likelihood.mean
    assert best > scores[GAUSSIAN].log_likelihood.mean + 0.3
    assert scores[BEAM].log_likelihood.mean == pytest.approx(best, abs=0.02)
    # the empirical law of 40 pings in the nearest of 60 conditions is coarse
    assert best - 1.5 < scores["each condition as recorded"].log_likelihood.mean < best
    assert scores["physics, fitted"].log_likelihood.mean > scores[GAUSSIAN].log_likelihood.mean
    assert scores["truth"].credence_gap < 0.03


def test_empirical_law_is_the_distribution_of_readings_in_the_nearest_condition():
    ping = Ping.of([1.0, 1.0, 1.0, 1.0, 2.0, 2.0])
    model = NearestConditionModel.of(
        Recording.of(ping, Reading.of([1.01, 1.01, 1.03, 0.0, 2.0, 2.0])), replace(TRUTH, silent=0.1)
    )
    law = model.law(Ping.of([1.0, 1.0, 1.0, 1.0, 1.12]))
    got = np.exp(law.log_prob(Reading.of([1.01, 1.03, 0.0, 1.02, 1.13])))
    smooth = np.exp(TRUTH.law(Ping.of([1.0, 1.0, 1.0, 1.0, 1.12])).log_prob(Reading.of([1.01, 1.03, 0.0, 1.02, 1.13])))
    np.testing.assert_allclose(got, 0.8 * np.array([0.5, 0.25, 0.25, 0.0, 0.5]) + 0.2 * smooth, atol=1e-9)


def test_repeatability_of_a_constant_sensor_is_nearly_certain():
    certain = GaussianModel(sigma=1e-9, sigma_per_metre=0.0, resolution=STEP)
    test = recorded(2, model=certain, pings=20)
    fresh = alternate_pings(test.condition)
    value = repeatability(test, fresh, TRUTH)
    assert np.all(value >= np.log(19 / 20)), "19 equal other pings, and a prior weight of one"
    assert np.all(value < 0)


def test_pings_without_an_answer_are_no_other_readings():
    test = recorded(2, model=GaussianModel(sigma=1e-9, sigma_per_metre=0.0, resolution=STEP), pings=20)
    reading = test.reading
    reading.range[::4], reading.status[::4] = 0.0, EchoStatus.NO_ANSWER
    test = Recording.of(test.ping, reading)
    value = repeatability(test, alternate_pings(test.condition) & reading.answered, TRUTH)
    assert np.all(value >= np.log(14 / 15)), "14 equal other pings"


def test_gap_closed_is_zero_for_the_gaussian_and_full_for_the_repeatability(fitted):
    comparison = compare(recorded(4), fitted)
    assert comparison.gap_closed(GAUSSIAN) == 0.0
    table = [line.split(" | ") for line in comparison_text(comparison).splitlines()[2:]]
    assert table[-1][0] == "| repeatability"
    assert table[-1][2] == "100 %"
    assert [row[0] for row in table[2:5]] == [f"| {name}" for name in ("ideal", GAUSSIAN, BEAM)]


def test_different_register_steps_are_an_error():
    with pytest.raises(SettingError, match="counts in steps of 1 mm"):
        compare(recorded(1, conditions=5), {"fine": GaussianModel(resolution=0.001)})
