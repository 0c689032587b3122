"""When an effect is believed: by how much it gains, how evenly, and what the law it is held against is known by."""

from dataclasses import replace

import numpy as np
import pytest

from noise.discrepancy.common.rules import Rules, spread_over_blocks

VISITS = 70
AGAINST_A_SIMULATION = replace(Rules(), least_nats=12.0, least_t=2.0 * np.sqrt(2.0))  # with as many positions


def struck(cells, nats=10.0, elsewhere=-0.05):
    """Return the gain of an effect that is plain in some cells and costs a little in all others."""
    return np.r_[np.full(cells, nats), np.full(VISITS - cells, elsewhere)]


@pytest.mark.parametrize(("cells", "believed"), [(1, False), (4, False), (5, False), (7, True), (20, True)])
def test_what_is_plain_in_a_few_cells_needs_more_than_a_handful(cells, believed):
    assert AGAINST_A_SIMULATION.believes("spike", struck(cells)) == believed
    assert AGAINST_A_SIMULATION.believes("spike", struck(cells), first=True) == believed


def test_what_has_to_show_everywhere_is_held_to_more_standard_errors():
    gain = struck(7)
    assert 2.5 < gain.sum() / spread_over_blocks(gain) < AGAINST_A_SIMULATION.least_t
    assert AGAINST_A_SIMULATION.believes("spike", gain)
    assert not AGAINST_A_SIMULATION.believes("sensitivity", gain)


def test_what_is_plain_needs_no_more_than_what_is_faint():
    gain = struck(5)
    assert 2.0 < gain.sum() / spread_over_blocks(gain) < Rules().sweeping_t
    assert Rules().believes("spike", gain)
    assert Rules().believes("sensitivity", gain)


def test_one_cell_makes_no_case_and_breaks_none():
    even = np.full(VISITS, 0.5)
    assert Rules().believes("clock_scale", even)
    assert not Rules().believes("clock_scale", np.r_[60.0, np.zeros(VISITS - 1)])
    heavy = np.r_[40.0, even]
    assert heavy.sum() < 2.0 * spread_over_blocks(heavy)
    assert Rules().believes("clock_scale", heavy, first=True)
