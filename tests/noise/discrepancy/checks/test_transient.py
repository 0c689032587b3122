"""Memory of moves: filters lean towards the place before, honest sonars do not."""

import numpy as np
import pytest
import torch

from acquisition import Ping, Reading, Recording
from noise.discrepancy import diagnose
from noise.discrepancy.checks.transient import SURE_P, transient, windowed
from noise.effects import CATALOGUE
from noise.fitting.batch import Batch
from noise.model import simulate
from noise.physical import PhysicalModel

torch.set_num_threads(1)
SONAR = PhysicalModel([CATALOGUE["travel_time_jitter"](sigma_m=0.003), CATALOGUE["sensitivity"](loss_db=36.0)])


def heard(seed, change=lambda x: x):
    """Return 48 stays of 8 pings, placed to 3 mm; what is read goes through a host in the order of time."""
    rng = np.random.default_rng(seed)
    distance = np.repeat(rng.uniform(0.4, 2.5, 48), 8)
    placed = distance + np.repeat(rng.normal(0, 0.003, 48), 8)
    time = np.arange(len(distance)) * 0.1
    reading = simulate(SONAR, Ping.of(distance=placed, time=time), rng)
    return Recording.of(Ping.of(distance=distance, time=time), Reading.of(np.round(change(reading.range), 4)))


def stays(recording, count):
    """Return the first so many stays of what `heard` returns."""
    return Recording.of(recording.ping[: 8 * count], recording.reading[: 8 * count])


def smoothed(x):
    """Return a running mean in which each new reading weighs a half."""
    out = x.copy()
    for k in range(1, len(x)):
        out[k] = 0.5 * (out[k - 1] + x[k])
    return out


def slewing(x):
    """Return readings that move by 0.3 m at most."""
    out = x.copy()
    for k in range(1, len(x)):
        out[k] = out[k - 1] + np.clip(x[k] - out[k - 1], -0.3, 0.3)
    return out


def averaged(x):
    """Return the means of the last four readings."""
    return np.array([x[max(0, k - 3) : k + 1].mean() for k in range(len(x))])


def repeating(x):
    """Return readings of which every first one of a stay is the last one of the stay before."""
    out = x.copy()
    out[8::8] = out[7:-1:8]
    return out


@pytest.mark.parametrize("host", [smoothed, slewing, averaged])
def test_a_host_that_remembers_leans_towards_the_place_before(host):
    found = transient(Batch.of(heard(1, host)))
    assert found.p_value < SURE_P
    assert found.size_m > 0.05


def test_sonars_without_memory_lean_to_either_side_alike():
    p = [transient(Batch.of(heard(seed))).p_value for seed in range(20, 60)]
    assert 0.2 < np.mean(p) < 0.8
    assert min(p) > SURE_P / 10


def test_a_repeated_reading_is_no_lean():
    found = transient(Batch.of(heard(2, repeating)))
    assert found is None or found.p_value > SURE_P


@pytest.mark.parametrize("host", [smoothed, slewing, averaged])
def test_ten_moves_that_all_lean_towards_the_place_before_are_memory(host):
    found = transient(Batch.of(stays(heard(4, host), 11)))
    assert found.moves < 12
    assert 0.5**found.moves <= found.p_value < 4 * 0.5**found.moves  # of 2^n ways to give them signs


def test_few_moves_are_weighed_exactly():
    p = np.array([transient(Batch.of(stays(heard(seed), 11))).p_value for seed in range(100, 160)])
    assert 0.35 < np.mean(p) < 0.65
    assert np.mean(p <= 0.05) <= 0.15


def test_too_few_moves_say_nothing():
    assert transient(Batch.of(stays(heard(3), 7))) is None


def test_a_mean_of_readings_is_no_repeat():
    verdict = diagnose(SONAR, heard(6, averaged), seed=1).to_verdict()
    assert verdict["verdict"] == "unknown"


@pytest.mark.slow
def test_a_filter_is_no_scatter():
    verdict = diagnose(SONAR, heard(4, smoothed), seed=1).to_verdict()
    assert verdict["verdict"] == "unknown"
    assert "the place before" in verdict["unknown"]["description"]


def in_steps(change):
    """Return a host on a register of 1 cm steps."""
    return lambda x: np.round(change(x), 2)


def middling(x):
    """Return the medians of the last five readings."""
    return np.array([np.median(x[max(0, k - 4) : k + 1]) for k in range(len(x))])


def losing(share):
    """Return a host that now and then gives its last reading again."""

    def host(x):
        out, lost = x.copy(), np.random.default_rng(9).random(len(x)) < share
        for k in range(1, len(x)):
            out[k] = out[k - 1] if lost[k] else x[k]
        return out

    return host


def test_a_median_lets_go_of_the_place_before_after_so_many_readings():
    found = windowed(Batch.of(heard(1, in_steps(middling))), np.random.default_rng(0))
    assert found.p_value < SURE_P
    assert found.size == pytest.approx(2.0, abs=0.3)


@pytest.mark.parametrize("share", [0.3, 0.5, 0.7])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_commands_that_are_lost_let_go_at_random(seed, share):
    found = windowed(Batch.of(heard(seed, in_steps(losing(share)))), np.random.default_rng(0))
    assert found is None or found.p_value > 0.01


def test_a_sonar_without_memory_leaves_nothing_behind():
    assert windowed(Batch.of(heard(1)), np.random.default_rng(0)) is None


def test_a_median_on_a_coarse_register_is_no_repeated_reading():
    diagnosis = diagnose(SONAR, heard(1, in_steps(middling)))
    assert diagnosis.verdict.verdict == "unknown"
    assert "as a filter has it" in diagnosis.verdict.unknown.description
