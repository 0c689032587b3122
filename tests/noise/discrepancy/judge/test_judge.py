"""What kind of verdict follows from what was located, named and left over."""

import numpy as np
import pytest

from acquisition import Ping, Recording
from noise.discrepancy.checks.transient import SURE_P
from noise.discrepancy.common.rules import SURE, SURE_OF_AIR
from noise.discrepancy.judge import judge as judge_module
from noise.discrepancy.judge.judge import SEEN, SURE_SCAN, at_the_edge, judge, may_be_the_laws, of_the_day
from noise.discrepancy.judge.rest import in_words
from noise.discrepancy.judge.verdict import Named, Rest
from noise.discrepancy.locate.locate import Finding
from noise.discrepancy.locate.matched import Matched
from noise.discrepancy.name.explanation import Explained, Final
from noise.discrepancy.name.search import Crossed, Search
from noise.effects import CATALOGUE
from noise.fitting.batch import Batch
from noise.fitting.fit import maximise
from noise.fitting.stack import NUISANCES, Stack
from noise.fitting.starts import nuisance_start
from noise.model import simulate
from noise.physical import PhysicalModel

SOMETHING = Rest(True, 0.0025, "small misfits")


def test_what_is_located_beyond_doubt_is_not_nothing():
    assert judge([], SOMETHING, 0.0, 0.5 * SURE_SCAN) == "unknown"
    assert judge([], SOMETHING, 0.0, 4.0 * SURE_SCAN) == "none"


@pytest.mark.parametrize(
    ("aspect", "size"), [("spread", 1.4), ("spread", 0.3), ("skew", 0.1), ("time_correlation", 0.9)]
)
def test_what_the_air_of_another_day_changes_is_no_mismatch(aspect, size):
    found = Finding(aspect, {}, size, "1", 0.0025, 10.0)
    assert found.carried
    assert judge([], Rest(True, 0.001, "so", (found,)), 0.0, 0.009) == "none"


def test_a_scatter_that_no_day_brings_is_a_mismatch():
    found = Finding("spread", {}, 1.8, "1", 0.0025, 10.0)
    assert not found.carried
    assert judge([], Rest(True, 0.001, "so", (found,)), 0.0, 0.009) == "unknown"


def named(effect, gain=20.0, error=5.0):
    return Named(effect, (), 0.9, {}, gain, error, "so")


@pytest.mark.parametrize(
    ("aspect", "verdict"),
    [("time_correlation", "named"), ("skew", "named"), ("spread", "named"), ("extra_mode", "unknown")],
)
def test_what_another_day_changes_hides_no_fault(aspect, verdict):
    """How the air hangs together differs from day to day whether a register is stuck now and then or not."""
    left = Rest(True, 0.001, "so", (Finding(aspect, {}, 0.3, "1", 0.001, 20.0),))
    assert judge([named("stuck")], left, 250.0, 1e-6) == verdict


@pytest.mark.parametrize("aspect", ["transient", "still", "window"])
def test_memory_that_is_sure_makes_a_fault_unknown(aspect):
    left = Rest(True, 0.001, "so", (Finding(aspect, {}, 0.3, "m", 0.5 * SURE_P, 2.0),))
    assert judge([named("stuck")], left, 250.0, 1e-6) == "unknown"


@pytest.mark.parametrize(
    ("effects", "gain", "p_scan", "day"),
    [
        (["scintillation"], 0.8 * SURE_OF_AIR, 0.2, True),
        (["scintillation", "travel_time_jitter"], 0.8 * SURE_OF_AIR, 0.2, True),
        (["scintillation"], 1.2 * SURE_OF_AIR, 0.2, False),
        (["scintillation"], 0.8 * SURE_OF_AIR, 0.001, False),
        (["travel_time_jitter"], 0.8 * SURE, 0.2, True),
        (["travel_time_jitter"], 1.2 * SURE, 0.2, False),
        (["scintillation", "zero_offset"], 0.8 * SURE_OF_AIR, 0.2, False),
    ],
)
def test_livelier_air_that_nothing_is_located_by_is_another_day(effects, gain, p_scan, day):
    assert of_the_day([named(effect) for effect in effects], gain, p_scan) == day


@pytest.mark.parametrize(
    ("gain", "p_scan", "matched", "law"),
    [
        (SURE - 1, 2 * SEEN, None, True),
        (SURE + 1, 2 * SEEN, None, False),
        (SURE - 1, SEEN / 2, None, False),
        (SURE - 1, SEEN / 2, Matched(30, 0.5, 0.0), True),
        (SURE - 1, 2 * SEEN, Matched(30, 1e-4, 0.02), False),
    ],
)
def test_what_is_faint_and_borne_out_by_nothing_may_be_the_laws_own_error(gain, p_scan, matched, law):
    assert may_be_the_laws([named("zero_offset", gain, 0.5 * gain)], gain, p_scan, matched) == law


@pytest.mark.parametrize(
    ("effect", "gain", "error", "matched", "counted", "law"),
    [
        ("boresight", 16.0, 5.0, None, SURE, False),
        ("boresight", 16.0, 6.0, None, SURE, True),
        ("boresight", 12.0, 3.0, None, SURE, True),
        ("boresight", 16.0, 5.0, Matched(30, 0.5, 0.0), SURE, True),
        ("scintillation", 25.0, 5.0, None, SURE, True),
        ("spike", 16.0, 9.0, None, 12.0, False),
        ("spike", 10.0, 6.0, None, 12.0, True),
        ("boresight", 16.0, 9.0, None, 12.0, True),
    ],
)
def test_many_standard_errors_or_counted_stays_bear_a_faint_cause_out(effect, gain, error, matched, counted, law):
    assert may_be_the_laws([named(effect, gain, error)], gain, 0.5, matched, counted) == law


def weighed(law, effect, size, ping):
    """Return the size that a fit to readings of a law comes to, what of it is told to lie at the edge, and its gain."""
    batch = Batch.of(Recording.of(ping, simulate(law, ping, np.random.default_rng(1))))
    stack = nuisance_start(Stack.of(PhysicalModel(())), batch)
    own = [(effect, parameter.name) for parameter in CATALOGUE[effect].parameters]
    fit = maximise(stack.put(own[:1], [size]), (*own, *NUISANCES), batch)
    joint = maximise(stack.put(own[:1], [0.5 * size]), NUISANCES, batch)  # as if it had missed it
    without = maximise(stack, NUISANCES, batch)
    crossed = [Crossed(each, each, np.full(4, each.nats / 4)) for each in (without, fit)]
    search = Search(stack, batch, batch, batch)
    finals = [Final(fits) for fits in ((fit,), (joint, fit), (fit, fit))]  # the last: with every reading counted
    found = [at_the_edge(search, Explained([effect], *crossed, final)) for final in finals]
    return fit.stack.get(own[0]), found, fit.nats - without.nats


@pytest.mark.parametrize(("axial", "edge"), [(-0.35, True), (-0.2, False)])
def test_no_cause_lies_at_the_edge_of_the_plausible(axial, edge):
    """A pivot that would have to be 35 cm off the sensor stands in for something else."""
    rng = np.random.default_rng(1)
    ping = Ping.of(distance=rng.uniform(0.5, 3.0, 200), angle=rng.uniform(-0.6, 0.6, 200))
    law = PhysicalModel([CATALOGUE["pivot_offset"](axial_m=axial), CATALOGUE["travel_time_jitter"](sigma_m=0.003)])
    for found in weighed(law, "pivot_offset", axial, ping)[1]:
        assert len(found) == int(edge)
        assert not edge or "pivot_offset.axial_m of -0.35 m" in in_words(found[0])


@pytest.mark.parametrize(("share", "edge"), [(0.04, False), (0.06, True)])
def test_what_lies_at_the_edge_is_plausible_where_less_would_do(share, edge, monkeypatch):
    """How steep a beam is beyond the edge of hearing no reading tells, and a climb may end anywhere."""
    rng = np.random.default_rng(1)
    ping = Ping.of(distance=rng.uniform(0.5, 3.0, 200), angle=rng.uniform(-0.6, 0.6, 200))
    law = PhysicalModel([CATALOGUE["pivot_offset"](axial_m=-0.35), CATALOGUE["travel_time_jitter"](sigma_m=0.003)])
    size, found, gain = weighed(law, "pivot_offset", -0.35, ping)
    assert size == pytest.approx(-0.35, abs=1e-3)
    assert all(found)
    monkeypatch.setattr(judge_module, "_missed", lambda *_: share * gain)
    assert all(bool(each) == edge for each in weighed(law, "pivot_offset", -0.35, ping)[1])
