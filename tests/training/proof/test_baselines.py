"""The baselines notice a planted difference, keep quiet without one, and correct a mean."""

import numpy as np
import pytest

from acquisition import Ping, Reading, Recording
from noise.discrepancy.baseline.forest import AnalogueForest
from noise.fitting.batch import Batch
from training.proof.baselines import _features, classifier_p, corrections, mmd_p, process_shift

OFFSET_M = 0.03


def recording(seed, offset=0.0, n=40, each=10):
    """Return visits of a sonar with placement errors of 1 mm and noise of 2 mm."""
    rng = np.random.default_rng(seed)
    distance = np.repeat(rng.uniform(0.5, 4.0, n), each)
    placed = distance + np.repeat(rng.normal(0.0, 0.001, n), each)
    time = np.arange(n * each) * 0.1
    reading = Reading.of(np.round(placed + offset + rng.normal(0.0, 0.002, n * each), 3))
    return Recording.of(Ping.of(distance=distance, angle=np.zeros(n * each), time=time), reading)


def p_values(offset, seed):
    files = Batch.of(recording(2 * seed)), Batch.of(recording(2 * seed + 1, offset))
    x, label, group = _features(*files)
    rng = np.random.default_rng(seed)
    return mmd_p(x, label, group, rng), classifier_p(x, label, group, rng)


def test_two_sample_tests_notice_an_offset():
    assert max(p_values(OFFSET_M, 0)) < 0.05


def test_two_sample_tests_are_valid_without_a_difference():
    p = np.array([p_values(0.0, seed) for seed in range(1, 6)])
    assert np.all(np.median(p, axis=0) > 0.05)


def test_a_gaussian_process_finds_an_offset_and_closes_the_gap():
    simulated, recorded, fresh = (Batch.of(recording(k, offset)) for k, offset in enumerate((0.0, OFFSET_M, OFFSET_M)))
    shift = process_shift(AnalogueForest.of(simulated, np.random.default_rng(0)), recorded, fresh)
    assert np.median(shift) == pytest.approx(OFFSET_M, abs=0.003)
    scores = corrections(simulated, recorded, fresh, np.random.default_rng(0))
    assert scores["process"] < 0.3 * OFFSET_M
    assert scores["beam"] < OFFSET_M + 0.01
