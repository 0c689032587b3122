"""An effect that acts everywhere alike has one size; one that stands for something local has not."""

from dataclasses import replace

import numpy as np
import pytest

from acquisition import Ping, Reading, Recording
from noise.discrepancy.locate.stability import slope, stability_test
from noise.discrepancy.moments.sample import Sample
from noise.fitting.batch import Batch
from noise.fitting.stack import Stack

LAW = Stack({"travel_time_jitter": {"sigma_m": 0.004}, "visits": {"placement_m": 0.0}})
LOST = LAW.put([("dropped_reading", "probability")], [0.1])
LONG = LAW.put([("zero_offset", "offset_m")], [0.012])
FAR_M = 1.8


def survey(seed, offset=0.0, lost=0.0):
    """Return readings at 60 places; offset, m, and lost, the probability of silence, are functions of the distance."""
    rng = np.random.default_rng(seed)
    distance = np.repeat(rng.permutation(np.linspace(0.4, 3.2, 60)), 12)
    given = [part(distance) if callable(part) else np.full(len(distance), part) for part in (offset, lost)]
    value = distance + given[0] + rng.normal(0.0, 0.004, len(distance))
    value = np.where(rng.random(len(distance)) < given[1], 0.0, np.round(value, 3))
    ping = replace(Ping.of(distance=distance), time=np.arange(len(distance)) * 0.1)
    return Batch.of(Recording.of(ping, Reading.of(value)))


def stability(law, recorded, name, simulated=None):
    return stability_test(law, LAW, LAW, Sample(recorded, simulated), name, np.random.default_rng(0))


@pytest.mark.parametrize("simulated", [None, survey(2)])
@pytest.mark.parametrize(
    ("law", "name", "fault"), [(LOST, "dropped_reading", {"lost": 0.1}), (LONG, "zero_offset", {"offset": 0.012})]
)
def test_an_effect_that_acts_everywhere_has_one_size(law, name, fault, simulated):
    found = stability(law, survey(1, **fault), name, simulated)
    assert found.p_value.value > 0.01
    assert found.variation < 0.2


@pytest.mark.parametrize("simulated", [None, survey(2)])
@pytest.mark.parametrize(
    ("law", "name", "fault"),
    [
        (LOST, "dropped_reading", {"lost": lambda d: np.where(d > FAR_M, 0.2, 0.0)}),
        (LONG, "zero_offset", {"offset": lambda d: np.where(d > FAR_M, 0.024, 0.0)}),
    ],
)
def test_a_fault_beyond_a_distance_has_not(law, name, fault, simulated):
    found = stability(law, survey(1, **fault), name, simulated)
    assert found.p_value.value < 0.01
    assert found.variation > 0.25  # its size is nothing before that distance and twice the mean beyond, less chance


def test_an_error_of_the_law_that_both_files_have_is_no_property_of_the_effect():
    bent = np.poly1d([0.006, -0.01])
    found = stability(LONG, survey(1, offset=lambda d: 0.012 + bent(d)), "zero_offset", survey(2, offset=bent))
    assert found.p_value.value > 0.01


def test_the_slope_is_the_derivative_of_the_log_probability_of_a_single_ping():
    batch, key, step = survey(1), ("zero_offset", "offset_m"), 1e-5
    models = [LONG.put([key], [0.012 + sign * step]).single_ping_model for sign in (-1, 1)]
    near = [model.law(batch.ping, batch.past).log_prob(batch.reading) for model in models]
    assert slope(LONG, batch, key) == pytest.approx((near[1] - near[0]) / (2.0 * step), rel=0.05, abs=1.0)


def test_an_effect_without_a_size_is_stable():
    assert stability(LAW, survey(1), "zero_offset").variation == 0.0
