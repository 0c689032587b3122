"""What kind of verdict follows from what was located, named and left over."""

import numpy as np
import pytest

from acquisition import Ping, Recording
from noise.batch import Batch
from noise.discrepancy.explanation import Explained, Final
from noise.discrepancy.judge import SEEN, SURE_SCAN, at_the_edge, judge, may_be_the_laws, of_the_day
from noise.discrepancy.locate import Finding
from noise.discrepancy.matched import Matched
from noise.discrepancy.rest import in_words
from noise.discrepancy.rules import SURE, SURE_OF_AIR
from noise.discrepancy.search import Crossed, Search
from noise.discrepancy.transient import SURE_P
from noise.discrepancy.verdict import Named, Rest
from noise.effects import CATALOGUE
from noise.fit import Fit
from noise.model import simulate
from noise.physical import PhysicalModel
from noise.stack import Stack
from noise.starts import nuisance_start

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


def named(effect):
    return Named(effect, (), 0.9, {}, 20.0, 5.0, "so")


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
    assert may_be_the_laws(gain, p_scan, matched) == law


@pytest.mark.parametrize(("axial", "edge"), [(-0.35, True), (-0.2, False)])
def test_no_cause_lies_at_the_edge_of_the_plausible(axial, edge):
    """A pivot that would have to be 35 cm off the sensor stands in for something else."""
    rng = np.random.default_rng(1)
    distance, angle = rng.uniform(0.5, 3.0, 200), rng.uniform(-0.6, 0.6, 200)
    ping = Ping.of(distance=distance, angle=angle)
    law = PhysicalModel([CATALOGUE["pivot_offset"](axial_m=axial), CATALOGUE["travel_time_jitter"](sigma_m=0.003)])
    batch = Batch.of(Recording.of(ping, simulate(law, ping, rng)))
    base = nuisance_start(Stack.of(PhysicalModel(())), batch)
    stack = base.put([("pivot_offset", "axial_m"), ("pivot_offset", "lateral_m")], [axial, 0.01])
    fit = Fit(stack, (), 0.0)
    crossed = Crossed(fit, fit, np.zeros(4))
    inside = Fit(stack.put([("pivot_offset", "axial_m")], [-0.2]), (), 0.0)
    for fits in ((fit,), (inside, fit), (fit, fit)):  # jointly with what cells share, or with every reading counted
        why = Explained(["pivot_offset"], crossed, crossed, Final(fits))
        found = at_the_edge(Search(base, batch, batch, batch), why)
        assert len(found) == int(edge)
    assert not edge or "pivot_offset.axial_m of -0.35 m" in in_words(found[0])
