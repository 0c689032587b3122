"""Formulas for what has no known cause: the right terms, and none where there is nothing."""

import numpy as np
import pytest

from acquisition import Ping, Reading, Recording
from noise.discrepancy.locate.describe import formula
from noise.fitting.batch import Batch
from noise.fitting.stack import Stack

STACK = Stack({"travel_time_jitter": {"sigma_m": 0.004}, "visits": {"placement_m": 0.003}})


def batch_of(seed, error_mm, cells=80, pings=6):
    rng = np.random.default_rng(seed)
    d = np.round(rng.uniform(0.3, 4.0, cells), 3)
    a = rng.choice([-20.0, -10.0, 0.0, 10.0, 20.0], cells)
    shared = rng.normal(0, 0.003, cells) + 1e-3 * error_mm(d, a)
    truth = np.repeat(d, pings)
    reading = np.round(truth + np.repeat(shared, pings) + rng.normal(0, 0.004, cells * pings), 3)
    ping = Ping.of(distance=truth, angle=np.deg2rad(np.repeat(a, pings)), time=0.1 * np.arange(len(truth)))
    return Batch.of(Recording.of(ping, Reading.of(reading)))


def test_a_bend_over_the_angle_is_told_as_one():
    found = formula(STACK, batch_of(1, lambda d, a: 25.0 * (a / 27.5) ** 2), np.random.default_rng(0))
    assert found.terms[0].name == "(angle / 27.5 deg)^2"
    assert found.terms[0].coefficient == pytest.approx(25.0, abs=4.0)
    assert found.explained > 0.6
    assert "angle" in str(found)


def test_distance_times_angle_is_told_as_their_product():
    found = formula(STACK, batch_of(2, lambda d, a: 12.0 * d * a / 27.5), np.random.default_rng(0))
    assert found.terms[0].name == "(distance / 1 m) * (angle / 27.5 deg)"
    assert found.terms[0].coefficient == pytest.approx(12.0, abs=3.0)


def test_nothing_is_told_of_nothing():
    none = [formula(STACK, batch_of(100 + k, lambda d, a: 0.0 * d), np.random.default_rng(k)) for k in range(20)]
    assert sum(found is not None for found in none) <= 3


def test_few_cells_allow_no_formula():
    assert formula(STACK, batch_of(1, lambda d, a: 25.0 * a, cells=10), np.random.default_rng(0)) is None
