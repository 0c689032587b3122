"""Learned credence against processes whose credence is known."""

import numpy as np
import pytest

from acquisition import Ping, Reading, Recording
from noise.metrics import is_correct
from training.noise.experiments import CredenceScore, RecentCredencePlan, learn_credence


def recording(seed, runs=500, pings=8):
    """One reflector per run; a third of the readings is uniform over 4 m, the others are exact."""
    rng = np.random.default_rng(seed)
    run = np.repeat(np.arange(runs), pings)
    ping = Ping.of(rng.uniform(0.5, 3.5, runs)[run], run=run, time=np.tile(0.1 * np.arange(pings), runs))
    outlier = rng.random(len(run)) < 1 / 3
    value = np.where(outlier, rng.uniform(0.01, 4.0, len(run)), ping.distance)
    return Recording.of(ping, Reading.of(np.maximum(np.rint(value / 0.01), 1) * 0.01))


@pytest.fixture(scope="module")
def scored():
    train, choose, test = recording(0), recording(1), recording(2)
    ping, reading = test.ping, test.reading
    correct = is_correct(ping, reading)
    credence = {
        k: learn_credence(train, choose, RecentCredencePlan(k, 24, 20, 256)).follow(ping, reading) for k in (1, 6)
    }
    return {k: CredenceScore.of(value, correct, test.run) for k, value in credence.items()}, credence, reading, correct


def test_credence_of_one_reading_follows_bayes_rule(scored):
    _, credence, reading, _ = scored
    inside = (reading.range > 0.8) & (reading.range < 3.0)
    # a correct reading r has density 2/3 / 3 m; an outlier is correct by chance where |r - d| < d/10
    reach = reading.range[inside] / 0.9 - reading.range[inside] / 1.1
    by_bayes = (2 / 9 + reach / 36) / (2 / 9 + 1 / 12)
    assert np.abs(credence[1][inside] - by_bayes).mean() < 0.03


def test_previous_readings_improve_scores_and_calibration_holds(scored):
    scores = scored[0]
    for score in scores.values():
        assert score.reliability.gap < 0.05
    assert scores[6].log_score.mean > scores[1].log_score.mean + 0.15
    assert scores[6].brier.mean < 0.7 * scores[1].brier.mean


def test_certain_and_correct_credence_has_perfect_scores():
    correct = np.array([True, False, True, True])
    perfect = CredenceScore.of(correct.astype(float), correct, np.arange(4))
    assert perfect.log_score.mean == pytest.approx(0.0, abs=1e-5)
    assert perfect.brier.mean == 0.0
    assert perfect.reliability.gap == 0.0
