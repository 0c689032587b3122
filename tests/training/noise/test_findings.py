"""What is told of models: on worlds whose truth is known, and of aims that are reached or not."""

import numpy as np
import pytest

from acquisition import Ping, Recording
from noise import GaussianModel, simulate
from noise.metrics import Score
from training.noise import findings
from training.noise.findings import NTH, Findings, Told, aims, by_nth
from training.noise.memory_gain import Gain

TRUTH = GaussianModel(sigma=0.06, sigma_per_metre=0.01, miss=0.1, resolution=0.01)


@pytest.fixture(scope="module")
def recording():
    rng = np.random.default_rng(0)
    ping = Ping.of(np.repeat(rng.permutation(np.linspace(0.3, 4.0, 300)), 40))
    return Recording.of(ping, simulate(TRUTH, ping, rng))


def test_the_truth_lies_in_nineteen_of_twenty_wilson_intervals(recording):
    told = Told.by(TRUTH, recording)
    assert told.inside == pytest.approx(0.95, abs=0.04)
    assert told.gap < 0.02
    # the share of 40 pings is off by sqrt(2 p (1 - p) / 40 pi) on average
    p = TRUTH.law(recording.ping).credence()
    assert told.off == pytest.approx(np.sqrt(2 * p * (1 - p) / (40 * np.pi)).mean(), rel=0.1)


def test_another_law_is_found_out(recording):
    told, own = (Told.by(model, recording) for model in (GaussianModel(0.02, miss=0.1, resolution=0.01), TRUTH))
    assert told.inside < 0.8
    assert told.gap > 4 * own.gap


def test_without_memory_it_matters_not_how_much_was_heard(recording):
    scores = by_nth(TRUTH, recording)
    assert [score.pings for score in scores.values()] == [300, 300, 4 * 300, 34 * 300]
    assert list(scores) == list(NTH)
    expected = TRUTH.law(recording.ping).log_prob(recording.reading).mean()
    for score in scores.values():
        assert abs(score.mean - expected) < 4 * score.error + 1e-3


@pytest.mark.parametrize(
    ("world", "mean", "met"),
    [("loose wire", 0.5, True), ("loose wire", 0.1, False), ("nothing to remember", 0.1, True),
     ("nothing to remember", 0.5, False), ("nothing to remember", -0.5, False)],
)  # fmt: skip
def test_memory_must_gain_where_pings_depend_on_each_other_and_there_alone(world, mean, met):
    gain = Gain(Score(-1.0, 0.1, 100, 10), Score(mean, 0.1, 100, 10))
    found = Findings({}, {}, {}, {world: gain}, {}, {}, {}, ("a",))
    with pytest.MonkeyPatch.context() as patch:  # nothing else is aimed at
        patch.setattr(findings, "WHERE", {})
        patch.setattr(findings, "LIMITS", {})
        (aim,) = aims(found)
    assert aim.met is met
    assert f"{mean:.3f} nats a ping, 95 %: {mean - 0.196:.3f} to {mean + 0.196:.3f}" in aim.row
