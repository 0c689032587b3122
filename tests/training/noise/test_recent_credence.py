"""Learned credence against worlds whose answer is known."""

import numpy as np
import pytest

from acquisition import Ping, Reading, Recording
from training.noise.recent_credence import CredenceScore, Plan, learn_credence, right


def world(seed, runs=500, pings=8):
    """Reflectors that stay; a third of the readings is uniform over 4 m, the others are right."""
    rng = np.random.default_rng(seed)
    run = np.repeat(np.arange(runs), pings)
    ping = Ping.of(rng.uniform(0.5, 3.5, runs)[run], run=run, time=np.tile(0.1 * np.arange(pings), runs))
    stray = rng.random(len(run)) < 1 / 3
    value = np.where(stray, rng.uniform(0.01, 4.0, len(run)), ping.distance)
    return Recording.of(ping, Reading.of(np.maximum(np.rint(value / 0.01), 1) * 0.01))


@pytest.fixture(scope="module")
def scored():
    train, choose, test = world(0), world(1), world(2)
    ping, reading = test.ping, test.reading
    true = right(ping, reading)
    said = {k: learn_credence(train, choose, Plan(k, 24, 20, 256)).follow(ping, reading) for k in (1, 6)}
    return {k: CredenceScore.of(value, true, test.run) for k, value in said.items()}, said, reading, true


def test_alone_a_reading_is_worth_what_bayes_says(scored):
    _, said, reading, _ = scored
    inside = (reading.range > 0.8) & (reading.range < 3.0)
    # a right reading r has density 2/3 / 3 m; a stray one is right by chance where |r - d| < d/10
    reach = reading.range[inside] / 0.9 - reading.range[inside] / 1.1
    by_bayes = (2 / 9 + reach / 36) / (2 / 9 + 1 / 12)
    assert np.abs(said[1][inside] - by_bayes).mean() < 0.03


def test_memory_makes_it_sharper_and_leaves_it_calibrated(scored):
    scores = scored[0]
    for score in scores.values():
        assert score.reliability.gap < 0.05
    assert scores[6].log_score.mean > scores[1].log_score.mean + 0.15
    assert scores[6].brier.mean < 0.7 * scores[1].brier.mean


def test_saying_the_truth_scores_best():
    true = np.array([True, False, True, True])
    perfect = CredenceScore.of(true.astype(float), true, np.arange(4))
    assert perfect.log_score.mean == pytest.approx(0.0, abs=1e-5)
    assert perfect.brier.mean == 0.0
    assert perfect.reliability.gap == 0.0
