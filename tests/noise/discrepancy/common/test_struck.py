"""A few strays are told from none by counting the stays that they strike."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import kstest

from acquisition import Ping, Reading, Recording
from noise.discrepancy.baseline.emulate import Baseline
from noise.discrepancy.common.rules import Rules
from noise.discrepancy.common.splits import Split
from noise.discrepancy.common.struck import more_struck, struck
from noise.discrepancy.judge.verdict import BaselineCheck
from noise.fitting.batch import Batch
from noise.fitting.stack import Stack
from noise.physical import PhysicalModel


def stays(seed, strikes=0, cells=60, pings=10, misplaced=0, lost=0, rate=0.0):
    """Return stays of which `strikes` hold one stray each, `misplaced` lie off as a whole and `lost` are silent."""
    rng = np.random.default_rng(seed)
    distance = rng.uniform(0.5, 3.0, cells)[:, None] * np.ones(pings)
    read = distance + rng.normal(0.0, 0.003, (cells, pings))
    read[:misplaced] += 0.2
    order = rng.permutation(cells)
    read[order[:strikes], rng.integers(pings)] += 0.5
    read += np.where(rng.random((cells, pings)) < rate, 0.5, 0.0)
    read[order[cells - lost :]] = 0.0
    ping = Ping.of(distance=distance.ravel(), time=0.1 * np.arange(cells * pings))
    return Batch.of(Recording.of(ping, Reading.of(read.ravel())))


@settings(max_examples=25, deadline=None)
@given(strikes=st.integers(0, 40), misplaced=st.integers(0, 30), lost=st.integers(0, 20), seed=st.integers(0, 99))
def test_stays_are_counted_that_hold_a_stray_wherever_they_lie(strikes, misplaced, lost, seed):
    assert struck(stays(seed, strikes, misplaced=misplaced, lost=lost)) == (strikes, (60 - lost) * 10)


@pytest.mark.parametrize(("recorded", "simulated", "p"), [(4, 0, 1 / 16), (7, 0, 1 / 128), (5, 5, 0.623), (0, 9, 1.0)])
def test_as_many_stays_by_chance(recorded, simulated, p):
    assert more_struck(stays(1, recorded), stays(2, simulated)) == pytest.approx(p, abs=1e-3)


def test_nothing_heard_is_no_evidence():
    assert more_struck(stays(1, lost=60), stays(2)) == 1.0
    assert more_struck(stays(1), stays(2)) == 1.0


@pytest.mark.parametrize(("pings", "rate"), [((20, 10), 0.01), ((10, 30), 0.1)])
def test_longer_stays_of_the_same_sensor_are_not_struck_more(pings, rate):
    """Chances under the same rate are at least as large as uniform ones."""
    pairs = [[stays(k + 900 * n, cells=40, pings=pings[n], rate=rate) for n in (0, 1)] for k in range(150)]
    p = [more_struck(*pair) for pair in pairs]
    assert kstest(p, "uniform", alternative="greater").pvalue > 0.01


@pytest.mark.parametrize(("strikes", "enough"), [(0, Rules().sweeping_t), (12, 1.5)])
def test_fewer_standard_errors_are_enough_where_struck_stays_are_counted(strikes, enough):
    split = Split.of(stays(5), np.random.default_rng(0))
    base = Baseline(Stack.of(PhysicalModel(())), PhysicalModel(()), BaselineCheck(True, 1.0, ""), split)
    assert base.rules(stays(6, strikes)).sweeping_t == enough
    assert (base.rules(stays(6, strikes)).sweeping_nats < Rules().sweeping_nats) == (strikes > 0)
