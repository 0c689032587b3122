"""Estimates hold the truth, and are those of the difference."""

import numpy as np
import pytest
import torch

from noise.discrepancy.name.estimates import conclude, intervals, statement
from noise.discrepancy.name.folds import Folds
from noise.discrepancy.name.search import Search
from tests.noise.discrepancy.made import CHANGES, batch_of, found_of, law_of, search_of

torch.set_num_threads(1)


def test_the_interval_holds_the_truth():
    search = search_of(CHANGES["zero_offset"])
    _, found = search.run()
    known = intervals(search, conclude(search, found))[("zero_offset", "offset_m")]
    assert known.low < 0.012 < known.high
    assert known.high - known.low < 0.004


def test_the_interval_of_a_size_at_which_both_files_agree_holds_that_of_the_likelihood():
    """Away from its maximum the likelihood's curvature says nothing of the error."""
    search, found = found_of("zero_offset")
    key, final = ("zero_offset", "offset_m"), conclude(search, found)
    fitted, agreed = (intervals(search, each)[key] for each in (final, final.at({key: final.stack.get(key) + 0.004})))
    assert agreed.value == pytest.approx(fitted.value + 0.004)
    assert agreed.low < fitted.value < agreed.high
    assert agreed.high - agreed.low < fitted.high - fitted.low + 0.016


def test_what_jumps_does_not_blur_what_is_smooth():
    offset, step = {"zero_offset": {"offset_m": 0.012}}, {"quantisation": {"step_m": 0.0128}}
    widths = []
    for changed in (offset, offset | step):
        search = search_of(changed)
        none, keys = search.null(), [(name, p) for name, values in changed.items() for p in values]
        start = none.stacks[0].put(keys, [changed[name][p] for name, p in keys])
        found = search.crossed(start, none, tuple(changed), own_scatter=False)
        known = intervals(search, conclude(search, found))[("zero_offset", "offset_m")]
        assert known.low < 0.012 < known.high
        widths.append(known.high - known.low)
    assert widths[1] < 2.0 * widths[0]


def test_a_range_within_one_step_of_the_register_is_known_to_about_a_step():
    changed = {
        "fixed_clutter": {"presence": 0.9, "range_m": 0.731, "spread_m": 0.001},
        "quantisation": {"step_m": 0.043},
    }
    search = search_of(changed)
    none, keys = search.null(), [(name, p) for name, values in changed.items() for p in values]
    start = none.stacks[0].put(keys, [changed[name][p] for name, p in keys])
    found = search.crossed(start, none, tuple(changed), own_scatter=False)
    known = intervals(search, conclude(search, found))
    place, presence = known[("fixed_clutter", "range_m")], known[("fixed_clutter", "presence")]
    assert place.low <= 0.731 <= place.high
    assert place.high - place.low < 2 * 0.043
    assert presence.low <= 0.9 <= presence.high
    assert presence.high - presence.low < 0.2


@pytest.mark.parametrize("step_m", [0.0128, 0.0341])
def test_a_step_of_the_register_is_known_to_a_share_of_itself(step_m):
    search = search_of({"quantisation": {"step_m": step_m}})
    none = search.null()
    start = none.stacks[0].put([("quantisation", "step_m")], [step_m])
    found = search.crossed(start, none, ("quantisation",), own_scatter=False)
    known = intervals(search, conclude(search, found))[("quantisation", "step_m")]
    assert known.low < step_m < known.high
    assert known.high - known.low < 0.1 * step_m


def test_lost_readings_are_those_that_the_simulation_does_not_lose():
    few, more = ({"dropped_reading": {"probability": p}} for p in (0.05, 0.15))
    common = law_of().put([("dropped_reading", "probability")], [0.05])
    folds = Folds.of(batch_of(more, seed=1), np.random.default_rng(0))
    search = Search(common, folds, batch_of(few, seed=2), np.random.default_rng(0))
    none = search.null()
    start = none.stacks[0].put([("dropped_reading", "probability")], [0.1])
    found = search.crossed(start, none, ("dropped_reading",), own_scatter=False)
    known = intervals(search, conclude(search, found))[("dropped_reading", "probability")]
    assert known.low < 0.10 < known.high
    assert known.high < 0.15


@pytest.mark.parametrize("value_m", [1.7, 0.9])
def test_a_fault_is_that_beyond_the_same_fault_of_the_simulation(value_m):
    """The law of the simulation lacks its fault; a reading that sticks at another value is another fault."""

    def stuck(probability, value_m):
        return {"stuck": {"probability": probability, "value_m": value_m}}

    search = search_of(stuck(0.15, value_m), simulated=batch_of(stuck(0.05, 1.7), seed=77))
    keys = [("stuck", "probability"), ("stuck", "value_m")]
    start = search.null().stacks[0].put(keys, [0.1, value_m])
    found = search.crossed(start, search.null(), ("stuck",), own_scatter=False)
    known = intervals(search, conclude(search, found))[keys[0]]
    recorded, simulated = (np.mean(np.abs(b.reading.range - value_m) < 1e-3) for b in (search.joined, search.simulated))
    assert (simulated > 0.02) == (value_m == 1.7)
    assert known.value == pytest.approx(recorded - simulated, abs=0.01)
    assert known.low < recorded - simulated < known.high


@pytest.mark.parametrize("more_db", [8.0, -8.0])
def test_a_loss_is_that_beyond_the_loss_of_the_simulation(more_db):
    def less_sensitive(loss_db):
        return {"sensitivity": {"loss_db": loss_db}}

    key = ("sensitivity", "loss_db")
    common = law_of().put([key], [42.0])
    search = search_of(less_sensitive(42.0 + more_db), simulated=batch_of(less_sensitive(42.0), seed=77), law=common)
    start = search.null().stacks[0].put([key], [42.0 + more_db])
    found = search.crossed(start, search.null(), ("sensitivity",), own_scatter=False)
    known = intervals(search, conclude(search, found))[key]
    assert known.low < more_db < known.high
    assert known.value == pytest.approx(more_db, abs=2.0)
    assert f"dB {'less' if more_db > 0 else 'more'} sensitive" in statement(search, "sensitivity", [(key, known)])


def test_a_law_that_is_known_has_its_own_size_subtracted():
    key = ("zero_offset", "offset_m")
    search = search_of({"zero_offset": {"offset_m": 0.032}}, law=law_of().put([key], [0.02]))
    found = search.crossed(search.null().stacks[0].put([key], [0.03]), search.null(), ("zero_offset",), False)
    known = intervals(search, conclude(search, found))[key]
    assert known.low < 0.012 < known.high
    assert known.high - known.low < 0.01


def test_where_a_reflector_stands_is_no_difference_from_where_another_stood():
    def clutter(range_m):
        return {"fixed_clutter": {"presence": 0.3, "range_m": range_m, "spread_m": 0.01}}

    keys = [("fixed_clutter", p) for p in ("presence", "range_m", "spread_m")]
    common = law_of().put(keys, clutter(2.0)["fixed_clutter"].values())
    search = search_of(clutter(0.9), simulated=batch_of(clutter(2.0), seed=77), law=common)
    none = search.null()
    start = none.stacks[0].put(keys, clutter(0.9)["fixed_clutter"].values())
    found = search.crossed(start, none, ("fixed_clutter",), own_scatter=False)
    known = intervals(search, conclude(search, found))[("fixed_clutter", "range_m")]
    assert known.low < 0.9 < known.high
    assert known.value == pytest.approx(0.9, abs=0.01)
