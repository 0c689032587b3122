"""Kernels of a step: firing, cost to go and causes against independent calculations."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sonar_gym.parking import step_kernel
from sonar_gym.parking.street import Goal, StreetSettings, arc_table, draw_street, reference_path
from sonar_gym.parking.vehicle import CarSettings
from sonar_gym.sensing import records

STREET = draw_street(StreetSettings(), np.random.default_rng(3))
CAR = CarSettings()
GOAL = Goal.of(STREET, CAR)
TASK = np.array([*STREET.gap, STREET.line, GOAL.x, GOAL.y, GOAL.turn, GOAL.ready_x, 0.0])


def minimum_cost(pose, per_metre, per_radian):
    """Return the cost to go by comparison of all poses of the path."""
    path = reference_path(STREET, CAR)
    turn = np.abs((pose[2] - path[:, 2] + np.pi) % (2 * np.pi) - np.pi)
    off = np.hypot(path[:, 0] - pose[0], path[:, 1] - pose[1])
    return np.min(path[:, 3] + per_metre * off + per_radian * turn)


@settings(max_examples=200, deadline=None)
@given(st.floats(-1.0, 3.5), st.floats(-0.5, 0.5), st.floats(-1.0, 1.0))
def test_cost_to_go_is_the_minimum_over_the_whole_path(x, y, heading):
    cost = step_kernel.cost_to_go(np.array([x, y, heading]), TASK, arc_table(CAR), 3.0, 0.5)
    reference = minimum_cost((x, y, heading), 3.0, 0.5)
    assert cost <= reference + 0.02 * (3.0 + 1.0 + 0.5 / 0.45)  # the poses compared are 1 cm apart
    assert cost >= reference - 0.02 * (3.0 + 1.0 + 0.5 / 0.45)


def test_cost_to_go_decreases_by_the_distance_driven_along_the_lane():
    cost = [step_kernel.cost_to_go(np.array([x, 0.0, 0.0]), TASK, arc_table(CAR), 3.0, 0.5) for x in (0.0, 0.25)]
    assert cost[0] - cost[1] == pytest.approx(0.25, abs=1e-12)
    arcs = 2 * 1.1 * CAR.turning_radius * GOAL.turn
    assert cost[0] == pytest.approx(GOAL.ready_x + arcs, abs=1e-12)


def test_cost_off_the_lane_is_that_of_the_refracted_path():
    # with costs w and 1, the minimum of x' - x + w * length has the angle arcsin(1/w) to the normal
    cost = step_kernel.cost_to_go(np.array([0.0, 0.1, 0.0]), TASK, arc_table(CAR), 3.0, 0.5)
    on_lane = step_kernel.cost_to_go(np.array([0.0, 0.0, 0.0]), TASK, arc_table(CAR), 3.0, 0.5)
    assert cost - on_lane == pytest.approx(0.1 * math.sqrt(3.0**2 - 1.0), abs=1e-12)


@settings(deadline=None)  # the first call compiles
@given(st.floats(0.1, 1.0), st.floats(0.0, 0.5))
def test_every_ping_of_a_period_is_fired_once_at_its_time(period, phase):
    fired = []
    for step in range(40):
        since = records.firing_delay(step * 0.1, 0.1, period, phase)
        assert since == -1.0 or 0.0 < since <= 0.1 + 1e-12
        if since > 0.0:
            fired.append(step * 0.1 + since)
    expected = phase + period * np.arange(100)
    expected = expected[(expected > 1e-9) & (expected <= 4.0 + 1e-9)]
    assert fired == pytest.approx(expected, abs=1e-8)


@pytest.mark.parametrize(
    ("status", "reading", "true", "fault", "cause"),
    [
        (0, 0.0, None, 0, records.EMPTY),
        (1, 1.05, 1.0, 0, records.TARGET),
        (1, 0.85, 1.0, 0, records.EARLY),
        (1, 1.15, 1.0, 0, records.LATE),
        (1, 2.0, None, 0, records.GHOST),
        (0, 0.0, 1.0, 0, records.MISSED),
        (2, 0.0, 1.0, 0, records.NO_ANSWER),
        (1, 1.0, 1.0, 2, records.FIRST_FAULT + 1),
    ],
)
def test_cause_of_each_kind_of_reading(status, reading, true, fault, cause):
    obstacle, distance = (-1.0, 3.01) if true is None else (0.0, true)
    assert records.cause_of(fault, status, obstacle, reading, distance) == cause


@settings(deadline=None)  # the first call compiles
@given(st.floats(0.0, 4.0))
def test_bin_agrees_with_a_search(reading):
    edges = np.linspace(0.0, 3.3, 101)
    assert records.bin_of(reading, edges) == min(int(np.searchsorted(edges, reading, side="right")) - 1, 99)
