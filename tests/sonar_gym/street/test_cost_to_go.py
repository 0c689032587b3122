"""The cost to go: known lengths of ways, lower bounds, and cars that follow it into the space."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sonar_gym.sensing.kernels import NO_HIT, roll, touches
from sonar_gym.street.cost_to_go import (
    CHANGE_M,
    PARKED_ANGLE,
    PARKED_OVERHANG,
    CostTables,
    Space,
    cost_to_go,
    grid_of,
    stands_in,
    tabulated,
)
from sonar_gym.street.street import ARC_MARGIN, LEVELS, StreetSettings
from sonar_gym.street.vehicle import CarSettings

CAR = CarSettings()
RADIUS = ARC_MARGIN * CAR.turning_radius
TOLERANCE = 0.12  # m; a path ends anywhere in the cell of its pose, and has whole arcs of two cells


def space_of(level):
    return Space.of(LEVELS[level], CAR)


def costs_of(space):
    """Return the cost to go as a function of x from the begin of the space, y and heading."""
    tables = CostTables()
    number = tables.number(space)
    return lambda x, y, turn: cost_to_go(x, y, turn, tables.grids[number], tables.values)


@pytest.fixture(scope="module", params=["normal", "hard"])
def level(request):
    return request.param


@pytest.mark.parametrize("distance", [0.25, 2.0])
def test_along_the_lane_before_the_space_the_cost_is_the_distance_driven(distance, level):
    cost = costs_of(space_of(level))
    assert cost(-1.0 - distance, 0.0, 0.0) - cost(-1.0, 0.0, 0.0) == pytest.approx(distance, abs=1e-9)


def test_a_parked_car_has_no_way_to_go():
    cost = costs_of(space_of("normal"))
    assert cost(CAR.rear_overhang + 0.1, -0.475, 0.0) == 0.0


def test_two_equal_arcs_backwards_are_the_way_in_from_a_pose_ahead():
    """Across by d, two arcs of radius r turn by arccos(1 - d / 2r) each."""
    # the least distance of a parked car from the lane's centre
    across = LEVELS["easy"].line - PARKED_OVERHANG + 0.5 * CAR.width
    turn = math.acos(1.0 - across / (2.0 * RADIUS))
    ahead = CAR.rear_overhang + 0.1 + 2.0 * RADIUS * math.sin(turn)
    cost = costs_of(space_of("easy"))(ahead, 0.0, 0.0)
    # a parked car may still be turned by 10 degrees
    assert 2.0 * RADIUS * turn - RADIUS * PARKED_ANGLE - TOLERANCE < cost < 2.0 * RADIUS * turn + TOLERANCE


@settings(max_examples=200, deadline=None)
@given(st.floats(-2.0, 1.3), st.floats(-0.2, 0.15), st.floats(-1.0, 1.0))
def test_no_way_is_shorter_than_the_straight_distance_and_the_turn(x, y, turn):
    space = space_of("normal")
    away = max(abs(y + space.line + 0.5 * CAR.width) - PARKED_OVERHANG - TOLERANCE, 0.0)
    turned = max(abs(turn) - PARKED_ANGLE, 0.0) * RADIUS
    assert costs_of(space)(x, y, turn) >= max(away, turned) - TOLERANCE


def test_the_less_room_the_longer_the_way():
    costs = [costs_of(space_of(level))(-1.0, 0.0, 0.0) for level in ("easy", "normal", "hard", "manoeuvre")]
    assert costs == sorted(costs)
    assert costs[3] > costs[2] + 3 * CHANGE_M  # several moves


@given(st.floats(0.45, 1.5), st.floats(0.45, 1.5))
def test_a_gap_has_the_table_of_one_that_is_hardly_shorter(gap, shortest):
    length = tabulated(gap, shortest, CAR)
    assert gap - 0.05 <= length <= gap + 1e-5
    assert length >= min(shortest, gap - 0.01)


def test_the_gaps_of_a_level_have_few_tables():
    low, high = LEVELS["normal"].gap
    assert len({tabulated(gap, low, CAR) for gap in np.linspace(low, high, 1000)}) == 7


def test_a_space_that_no_car_fits_in_has_no_cost():
    streets = StreetSettings(depth=0.05, line=0.3)
    assert costs_of(Space.of(streets, CAR))(-1.0, 0.0, 0.0) == pytest.approx(0.7)  # the distance to the table


@pytest.mark.parametrize("width", [1.0, 2.0, 50.0])
def test_a_car_that_is_wider_than_the_table_is_at_the_distance_to_it(width):
    cost = costs_of(Space.of(StreetSettings(), CarSettings(width=width)))(-1.0, 0.0, 0.0)
    assert 0.7 - 1e-6 <= cost <= 0.7 + width


def test_the_table_of_a_large_space_is_not_larger():
    space = Space.of(StreetSettings(gap=(90.0, 90.0), depth=100.0), CarSettings(length=80.0))
    assert np.prod(grid_of(space).cells) < 3e6


def least_ahead(cost, space, pose, arcs):
    """Return the least cost at any pose on ways of some arcs from a pose, infinite if each touches something."""
    least = math.inf
    for travel in (0.06, -0.06) if arcs else ():
        for bend in (-1.0, 0.0, 1.0):
            after = np.array(roll(pose, travel, bend / CAR.turning_radius))
            if touches(after, CAR.body, space.outline) == NO_HIT:
                least = min(least, cost(*after), least_ahead(cost, space, after, arcs - 1))
    return least


def test_no_pose_is_a_trap(level):
    """From beside the space, too, a short way leads to a lower cost: straight distances would make cars wait there."""
    space, rng, trapped, tried = space_of(level), np.random.default_rng(0), 0, 0
    cost = costs_of(space)
    while tried < 200:
        pose = rng.uniform((-0.6, -0.45, -1.0), (1.2, 0.1, 1.0))
        inside = stands_in(pose, CAR.body, np.array(space[:4]))
        if inside or touches(pose, CAR.body, space.outline) != NO_HIT:
            continue
        tried += 1
        trapped += least_ahead(cost, space, pose, 4) > cost(*pose) - 0.05
    assert trapped <= 0.02 * tried
