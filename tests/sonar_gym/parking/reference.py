"""The reference path of a street: what the step kernel follows, pose by pose."""

import numpy as np

from sonar_gym.street.street import BEHIND, Goal, arc_radius

PATH_STEP = 0.01  # m; distance between poses


def reference_path(street, car):
    """Return a feasible path: along the lane, then backwards in two equal arcs.

    Args:
        street: street to park on.
        car: measures of the car.

    Returns:
        X, y, heading of the rear axle and remaining length: m, m, rad, m, (k, 4).
    """
    goal, radius, arc = Goal.of(street, car), arc_radius(car), arc_table(car)
    angle, along, across, arc_length = np.vstack([arc[arc[:, 0] < goal.turn], _arc_end(radius, goal.turn)]).T
    arcs, lane_x = 2.0 * radius * goal.turn, np.arange(-BEHIND, goal.ready_x, PATH_STEP)
    lane = np.column_stack([lane_x, 0 * lane_x, 0 * lane_x, arcs + goal.ready_x - lane_x])
    first = np.column_stack([goal.ready_x - along, -across, angle, arcs - arc_length])
    second = np.column_stack([goal.x + along, goal.y + across, angle, arc_length])[::-1]
    return np.vstack([lane, first, second])


def arc_table(car):
    """Return poses along an arc: angle, distance along x, distance along y, arc length: rad, m, m, m, (k, 4)."""
    radius = arc_radius(car)
    angle = np.arange(0.0, np.pi, PATH_STEP / radius)
    return np.column_stack([angle, radius * np.sin(angle), radius * (1.0 - np.cos(angle)), radius * angle])


def _arc_end(radius, turn):
    return np.array([[turn, radius * np.sin(turn), radius * (1.0 - np.cos(turn)), radius * turn]])
