"""What kind of verdict follows from what was located, named and left over."""

import pytest

from noise.discrepancy.judge import SURE_SCAN, judge, of_the_day
from noise.discrepancy.locate import Finding
from noise.discrepancy.rules import SURE, SURE_OF_AIR
from noise.discrepancy.verdict import Named, Rest

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
