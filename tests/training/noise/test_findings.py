"""Results of the noise report on data whose law is known, and targets that are met or not."""

import numpy as np
import pytest

from acquisition import Ping, Recording
from noise import GaussianModel, simulate
from noise.metrics import ClusterMean
from training.noise.experiments import MemoryGain
from training.noise.findings import POSITIONS, ConditionCredence, NoiseFindings, by_position_in_condition, targets

TRUTH = GaussianModel(sigma=0.06, sigma_per_metre=0.01, miss=0.1, resolution=0.01)


@pytest.fixture(scope="module")
def recording():
    rng = np.random.default_rng(0)
    ping = Ping.of(np.repeat(rng.permutation(np.linspace(0.3, 4.0, 300)), 40))
    return Recording.of(ping, simulate(TRUTH, ping, rng))


def test_true_law_lies_in_95_percent_of_the_wilson_intervals(recording):
    found = ConditionCredence.of(TRUTH, recording)
    assert found.coverage == pytest.approx(0.95, abs=0.04)
    assert found.gap < 0.02
    # mean absolute error of the observed frequency in 40 pings: sqrt(2 p (1 - p) / 40 pi)
    p = TRUTH.law(recording.ping).credence()
    assert found.error == pytest.approx(np.sqrt(2 * p * (1 - p) / (40 * np.pi)).mean(), rel=0.1)


def test_wrong_law_is_detected(recording):
    wrong = ConditionCredence.of(GaussianModel(0.02, miss=0.1, resolution=0.01), recording)
    assert wrong.coverage < 0.8
    assert wrong.gap > 4 * ConditionCredence.of(TRUTH, recording).gap


def test_likelihood_of_independent_pings_does_not_depend_on_position(recording):
    scores = by_position_in_condition(TRUTH, recording)
    assert [score.pings for score in scores.values()] == [300, 300, 4 * 300, 34 * 300]
    assert list(scores) == list(POSITIONS)
    expected = TRUTH.law(recording.ping).log_prob(recording.reading).mean()
    for score in scores.values():
        assert abs(score.mean - expected) < 4 * score.error + 1e-3


@pytest.mark.parametrize(
    ("scenario", "mean", "met"),
    [("loose wire", 0.5, True), ("loose wire", 0.1, False), ("independent pings", 0.1, True),
     ("independent pings", 0.5, False), ("independent pings", -0.5, False)],
)  # fmt: skip
def test_memory_must_gain_on_correlated_pings_only(scenario, mean, met):
    gain = MemoryGain(ClusterMean(-1.0, 0.1, 100, 10), ClusterMean(mean, 0.1, 100, 10))
    (target,) = targets(NoiseFindings({}, {}, {}, {scenario: gain}, {}, ("a",)))
    assert target.met is met
    assert target.result == f"{mean:.3f} nats per ping, 95 %: {mean - 0.196:.3f} to {mean + 0.196:.3f}"
