"""A register with coarser steps is a fact, whatever else is wrong."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from acquisition import Ping, Reading, Recording
from noise.discrepancy.baseline.sources import Baseline
from noise.discrepancy.diagnose import on_register_of
from noise.discrepancy.name.first import REGISTERS, coarsest, with_register
from noise.discrepancy.name.folds import Folds
from noise.discrepancy.name.search import Search
from noise.fitting.batch import Batch
from noise.model import simulate
from tests.noise.discrepancy.made import law_of, model_of, recording_of


def truncated(step_m, changed=None):
    """Return a recording whose readings are truncated to whole steps."""
    fine = recording_of(changed, seed=5)
    count = np.maximum(np.floor(fine.reading.range / step_m + 1e-9), 1.0)
    return Recording.of(fine.ping, Reading.of(np.where(fine.reading.echo, count * step_m, 0.0)))


def on_fine_register(recording):
    law = law_of()
    return on_register_of(Baseline(law, None, model_of(), model_of(), None), Batch.of(recording))


@pytest.mark.parametrize("step_m", [0.0225, 0.0254, 0.0333])
def test_fine_steps_divide_the_coarse_ones(step_m):
    """A reading half way between two steps would lie on one of them by rounding, and its law on the other."""
    batch = on_fine_register(truncated(step_m))
    count = batch.reading.range / batch.resolution
    assert np.abs(count - np.rint(count)).max() < 1e-6
    assert 0.0 < law_of().resolution - batch.resolution < 0.1 * law_of().resolution


@pytest.mark.parametrize("changed", [{}, {"zero_offset": {"offset_m": 0.04}}])
def test_a_coarse_register_is_found_before_other_effects(changed):
    batch = on_fine_register(truncated(0.0225, changed))
    search = Search(law_of(), Folds.of(batch, np.random.default_rng(0)), None, np.random.default_rng(0))
    assert with_register(search, search.null()).effects[0] in REGISTERS
    same = Batch.of(recording_of(changed, seed=5))
    search = Search(law_of(), Folds.of(same, np.random.default_rng(0)), None, np.random.default_rng(0))
    assert with_register(search, search.null()).effects == ()


def test_steps_are_told_from_marks_on_the_same_steps_by_how_readings_scatter():
    """The targets stand on the steps of the register: that no reading lies between them shows little."""
    rng = np.random.default_rng(0)
    distance = np.repeat(np.resize([0.65, 1.2, 2.25], 60), 12)
    ping = Ping.of(distance=distance, reflectance=0.9, time=np.arange(720.0))
    exact = simulate(model_of({"travel_time_jitter": {"sigma_m": 0.006}}), ping, rng)
    rounded = Reading.of(np.where(exact.echo, np.rint(exact.range / 0.05) * 0.05, 0.0))
    for reading, steps in ((rounded, [0.05]), (exact, [])):
        batch = on_fine_register(Recording.of(ping, reading))
        search = Search(law_of(), Folds.of(batch, np.random.default_rng(0)), None, np.random.default_rng(0))
        found = with_register(search, search.null())
        assert [found.stacks[0].get((name, "step_m")) for name in found.effects] == pytest.approx(steps)


def test_a_register_that_is_known_not_to_differ_is_left_out():
    batch = on_fine_register(truncated(0.0225))
    folds = Folds.of(batch, np.random.default_rng(0))
    search = Search(law_of(), folds, None, np.random.default_rng(0), ("truncation", "quantisation"))
    none = search.null()
    assert with_register(search, none) is none


def test_a_hypothesis_loses_nothing_when_it_is_fitted_anew_on_the_same_common_law():
    """The nuisances of readings on coarse steps, without the law of these steps, are far from those with it."""
    batch = on_fine_register(truncated(0.0225, {"dropped_reading": {"probability": 0.06}}))
    search = Search(law_of(), Folds.of(batch, np.random.default_rng(0)), None, np.random.default_rng(0))
    found = with_register(search, search.null())
    assert search.rebased(found).value > found.value - 1.0


@settings(max_examples=200, deadline=None)
@given(step=st.floats(0.004, 0.1), n=st.integers(2, 300), seed=st.integers(0, 2**31))
@example(step=0.0265, n=89, seed=0)
def test_the_coarsest_step_is_that_of_a_register_whose_readings_others_rounded(step, n, seed):
    index = np.random.default_rng(seed).integers(1, 60, n)
    assume(np.gcd.reduce(index) == 1 and len(np.unique(index)) > 1)
    readings = np.round(step * index, 3)
    batch = Batch.of(Recording.of(Ping.of(distance=np.full(n, 1.0)), Reading.of(readings)))
    assert coarsest(replace(batch, grid_m=0.001, origin=0.0)) >= 0.98 * step
