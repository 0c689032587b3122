"""A learner without physics finds what is left, where something is, and learns nothing of nothing."""

from dataclasses import replace

import numpy as np
import pytest

from acquisition import Ping, Reading, Recording
from noise.discrepancy.checks.remainder import Remainder, remainder
from noise.discrepancy.judge.rest import beyond
from noise.effects import CATALOGUE
from noise.fitting.batch import Batch
from noise.fitting.fit import maximise
from noise.fitting.stack import NUISANCES, SPREAD, VISITS, Stack
from noise.physical import PhysicalModel

PINGS = 12


def recorded(seed=0, bias=None, smooth=1.0, placement_m=0.003, cells=60):
    """Return pings of cells in random order, of a sonar that scatters, is off by a bias, or averages with the past."""
    rng = np.random.default_rng(seed)
    distance = np.repeat(rng.uniform(0.3, 3.0, cells), PINGS)
    truly = distance + np.repeat(rng.normal(0.0, placement_m, cells), PINGS)
    read = truly + rng.normal(0.0, 0.003, len(distance)) + (0.0 if bias is None else bias(distance))
    for k in range(1, len(read)):
        read[k] = smooth * read[k] + (1.0 - smooth) * read[k - 1]
    ping = Ping.of(distance=distance, time=np.arange(len(distance)) * 0.1)
    return Recording.of(ping, Reading.of(np.round(read, 3)))


def left(recording, seed=0):
    """Return what is left of a recording that a scatter and nothing else explains."""
    batch = Batch.of(recording)
    stack = Stack.of(PhysicalModel([CATALOGUE["travel_time_jitter"](sigma_m=0.004)]))
    stack = stack.put([(VISITS, "placement_m")], [0.004])
    return remainder(maximise(stack, (*SPREAD, *NUISANCES), batch).stack, batch, np.random.default_rng(seed))


@pytest.mark.parametrize("seed", range(4))
def test_nothing_is_learned_of_nothing(seed):
    found = left(recorded(seed), seed)
    assert not (found.sure and found.nats > 15.0)


def test_readings_that_drag_behind_follow_from_what_was_read_before():
    found = left(recorded(smooth=0.4))
    assert found.of == "memory"
    assert found.sure
    assert found.nats > 50.0


def test_a_wave_along_the_rail_follows_from_the_conditions():
    found = left(recorded(bias=lambda d: 0.03 * np.sin(2.0 * np.pi * d / 0.9), cells=150))
    assert found.of == "conditions"
    assert found.sure
    assert found.nats > 15.0


def test_too_few_cells_teach_nothing():
    few = Batch.of(recorded()).select(np.arange(60 * PINGS) < 5 * PINGS)
    stack = Stack.of(PhysicalModel([CATALOGUE["travel_time_jitter"](sigma_m=0.004)]))
    stack = stack.put([(VISITS, "placement_m")], [0.004])
    assert remainder(stack, few, np.random.default_rng(0)).nats == 0.0


def test_what_the_simulation_itself_leaves_is_not_counted():
    found, usual = Remainder(60.0, 10.0, "memory", 50), Remainder(80.0, 10.0, "memory", 100)
    assert beyond(found, usual).nats == pytest.approx(20.0)
    assert not beyond(found, replace(usual, nats=120.0)).sure
    assert beyond(found, None) == found
