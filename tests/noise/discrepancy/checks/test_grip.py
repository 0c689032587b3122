"""Hysteresis repeats what is near and nothing that is far; a link that repeats asks for no distance."""

import numpy as np
import pytest
import torch

from noise.discrepancy import diagnose
from noise.discrepancy.checks.grip import grip
from noise.discrepancy.checks.transient import SURE_P
from noise.discrepancy.judge.rest import in_words
from noise.effects import CATALOGUE
from noise.fitting.batch import Batch
from noise.fitting.stack import Stack
from noise.physical import PhysicalModel

torch.set_num_threads(1)
SONAR = PhysicalModel([CATALOGUE["travel_time_jitter"](sigma_m=0.003)])
BAND_M = 0.1


def holding(reading):
    """Return readings that a host lets go of only where they change by more than a band."""
    out = reading.copy()
    for k in range(1, len(out)):
        out[k] = reading[k] if abs(reading[k] - out[k - 1]) > BAND_M else out[k - 1]
    return out


def repeating(reading, rng, share=0.5):
    """Return readings of which a share repeats the one before."""
    out, again = reading.copy(), rng.random(len(reading)) < share
    for k in range(1, len(out)):
        out[k] = out[k - 1] if again[k] else reading[k]
    return out


def driven(robot, seed, change, n=600):
    rng = np.random.default_rng(seed)
    there = robot.way(rng, n)
    return robot.log_of(change(there + rng.normal(0.0, 0.003, n), rng), distance=there)


def look(recording):
    return grip(Stack.of(SONAR), Batch.of(recording))


def test_hysteresis_is_seen_with_its_width(robot):
    found = look(driven(robot, 1, lambda reading, rng: holding(reading)))
    assert found.p_value < 0.1 * SURE_P
    assert found.size == pytest.approx(BAND_M, rel=0.25)
    assert "until the target has moved by" in in_words(found)


def test_a_link_that_repeats_asks_for_no_distance(robot):
    p = np.array([look(driven(robot, seed, repeating)).p_value for seed in range(40)])
    assert np.mean(p < 0.05) <= 0.15
    assert p.min() > SURE_P


def test_readings_without_memory_are_not_asked(robot):
    assert look(driven(robot, 2, lambda reading, rng: reading)) is None


@pytest.mark.slow
def test_hysteresis_is_no_repeat(robot):
    found = diagnose(SONAR, driven(robot, 3, lambda reading, rng: holding(reading)), seed=1).verdict
    assert found.verdict == "unknown"
    assert "readings stay as they were" in found.unknown.description
