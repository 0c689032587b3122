"""What kind of verdict follows from what was located, named and left over."""

import pytest

from noise.discrepancy.diagnosis import SURE_SCAN, judge
from noise.discrepancy.locate import Finding
from noise.discrepancy.verdict import Rest

SOMETHING = Rest(True, 0.0025, "small misfits")


def test_what_is_located_beyond_doubt_is_not_nothing():
    assert judge([], SOMETHING, 0.0, 0.5 * SURE_SCAN) == "unknown"
    assert judge([], SOMETHING, 0.0, 4.0 * SURE_SCAN) == "none"


@pytest.mark.parametrize(("aspect", "size"), [("spread", 1.2), ("skew", 0.1), ("time_correlation", 0.9)])
def test_what_the_air_of_another_day_changes_is_no_mismatch(aspect, size):
    found = Finding(aspect, {}, size, "1", 0.0025, 10.0)
    assert found.carried
    assert judge([], Rest(True, 0.001, "so", (found,)), 0.0, 0.009) == "none"


def test_a_scatter_that_no_day_brings_is_a_mismatch():
    found = Finding("spread", {}, 1.8, "1", 0.0025, 10.0)
    assert not found.carried
    assert judge([], Rest(True, 0.001, "so", (found,)), 0.0, 0.009) == "unknown"
