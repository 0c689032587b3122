"""Logs of robots that drive: delays show against movement, and nothing is taken for the memory of a stay."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from acquisition import Ping, Recording
from noise.discrepancy import diagnose
from noise.discrepancy.checks.trailing import trailing
from noise.discrepancy.checks.transient import transient
from noise.effects import CATALOGUE
from noise.fitting.batch import Batch
from noise.fitting.stack import Stack
from noise.model import simulate
from noise.physical import PhysicalModel

torch.set_num_threads(1)
SONAR = PhysicalModel([CATALOGUE["travel_time_jitter"](sigma_m=0.004), CATALOGUE["sensitivity"](loss_db=36.0)])


def driven(robot, seed, late=0, n=600, sonar=SONAR):
    """Return a log in which each reading is of where the target was so many pings before."""
    rng = np.random.default_rng(seed)
    there = robot.way(rng, n + late)
    time = np.arange(n + late) * robot.pace_s
    reading = simulate(sonar, Ping.of(distance=there, time=time), rng)
    rows = slice(0, n)
    return Recording.of(Ping.of(distance=there[late:], time=time[rows]), reading[rows])


def seen(recording):
    return trailing(Stack.of(SONAR), Batch.of(recording))


@given(st.integers(1, 4), st.integers(0, 2**31))
@settings(max_examples=15, deadline=None)
def test_a_delay_is_told_in_seconds(robot, late, seed):
    found = seen(driven(robot, seed, late)).finding(None)
    assert found.p_value < 1e-6
    assert found.unit == "s"
    assert found.size == pytest.approx(late * robot.pace_s, abs=0.35 * late * robot.pace_s)


def test_readings_in_time_trail_by_nothing(robot):
    z = [(found := seen(driven(robot, seed))).pings / found.error for seed in range(60)]
    assert abs(np.mean(z)) < 0.4
    assert 0.7 < np.std(z) < 1.4


def test_a_delay_that_the_simulation_has_too_is_no_news(robot):
    usual = seen(driven(robot, 1, 2))
    assert seen(driven(robot, 2, 2)).finding(usual).p_value > 0.01
    assert seen(driven(robot, 3, 0)).finding(usual).p_value < 1e-6


def test_a_target_that_stands_tells_nothing_of_delays(robot):
    rng = np.random.default_rng(1)
    distance = np.repeat(rng.uniform(0.4, 2.5, 40), 10)
    ping = Ping.of(distance=distance, time=np.arange(400) * robot.pace_s)
    found = seen(Recording.of(ping, simulate(SONAR, ping, rng)))
    assert found.stretches == 0
    assert found.finding(None) is None


def test_moving_is_no_memory_of_the_place_before(robot):
    assert transient(Batch.of(driven(robot, 4))) is None


@pytest.mark.parametrize("late", [0, 3])
def test_a_robots_log_is_diagnosed(robot, late):
    short = CATALOGUE["zero_offset"](offset_m=-0.03)
    sonar = PhysicalModel([*SONAR.effects, short])
    found = diagnose(SONAR, driven(robot, 5, late, sonar=sonar), seed=1).verdict
    if late:
        assert found.verdict == "unknown"
        assert "trail behind a moving target by 0." in found.unknown.description
    else:
        assert found.verdict in ("named", "confounded")
        assert found.effects[0].effect == "zero_offset" or "zero_offset" in found.effects[0].indistinguishable_from
