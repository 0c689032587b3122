"""A teacher who sees everything: drives many cars along the reference path, knowing where car and space really are.

An agent that imitates it learns what to do from what it can observe itself, as in Chen et al. (2019, "Learning by
cheating"): the teacher's actions depend on the truth, the agent's on its memory of readings alone.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sonar_gym.parking.fleet import Fleet
from sonar_gym.parking.step_kernel import GOAL_X, GOAL_Y, READY_X, TURN
from sonar_gym.parking.street import arc_radius

Floats = NDArray[np.float64]
CRUISE, APPROACH, BACKING, CREEP = 0.40, 0.15, 0.16, 0.10  # m/s; forwards at most and at least, backwards too
STIFFNESS, DAMPING = 16.0, 8.0  # 1/m^2, 1/m; errors off the path die out within 0.25 m
SLOWING = 2.0  # 1/s; speed for each metre that is left
LOST, TURNED = 0.12, 0.35  # m, rad off the arcs beyond which the car drives out and tries anew
LANE = 0.10  # m off the lane's centre within which the lane is followed, not the arcs
READY, BEYOND = 0.02, 0.30  # m before and beyond the arcs' beginning: where the car may stop, and where it must
SQUARE = 0.05  # m off the lane, and half the rad off its heading, with which it may
LAST, STRAIGHT = 0.15, 0.15  # m; so near to the end the car must be straighter than this, rad
END = 0.01  # m of the arcs left where the car stops
AHEAD = 0.05  # m; the wheels are turned this much before the arcs change sides
POINTS = 120  # of the arcs, among which the nearest is looked for


class Nearest(NamedTuple):
    """Where cars are beside the two arcs into their spaces, each (n,).

    Attributes:
        ahead: the arcs' beginning, along the lane, m.
        gone, left: along the arcs to the point nearest, and from it, m.
        off, turned: how far left of it the car is, m, and how far turned to the left of its heading, rad.
        bend: of the path there, 1/m.
    """

    ahead: Floats
    gone: Floats
    left: Floats
    off: Floats
    turned: Floats
    bend: Floats


class Teacher:
    """Tells what n cars should do now, from where they are and which way they go; it has no plans of its own.

    A plan that the agent cannot see would make it two masters: in the same place it would be told to drive out and to
    back in. So what decides is the way that the car itself has taken last.

    Args:
        fleet: the cars and their streets.
    """

    def __init__(self, fleet: Fleet) -> None:
        self.fleet = fleet
        self.radius = arc_radius(fleet.car_settings)

    def act(self, way: Floats) -> Floats:
        """Return steering and speed wanted of each car, as shares of the greatest, (n, 2).

        Args:
            way: gone since the car turned back last, as `Memory.way` has it, m, (n,).
        """
        car, pose = self.fleet.car_settings, self.fleet.worlds.car[:, :3]
        at = self._nearest(pose, self.fleet.worlds.task)
        backing = _backing(pose, at, way)
        lane = -STIFFNESS * pose[:, 1] - DAMPING * pose[:, 2]
        forth = np.where(np.abs(pose[:, 1]) < LANE, lane, at.bend - STIFFNESS * at.off - DAMPING * at.turned)
        back = at.bend - STIFFNESS * at.off + DAMPING * at.turned
        steering = np.arctan(car.wheelbase * np.where(backing, back, forth))
        fastest = np.where(np.abs(pose[:, 2]) < 2.0 * SQUARE, CRUISE, APPROACH)
        forwards = np.clip(SLOWING * at.ahead, APPROACH, fastest)
        backwards = np.where(at.left < END, 0.0, -np.minimum(BACKING, CREEP + at.left))
        speed = np.where(backing, backwards, forwards)
        wanted = np.column_stack([steering / car.max_steering, speed / car.max_speed])
        return np.clip(wanted, -1.0, 1.0)

    def _nearest(self, pose: Floats, task: Floats) -> Nearest:
        """Return where on the arcs cars are nearest to them."""
        r, turn, ready = self.radius, task[:, TURN, None], task[:, READY_X]
        gone = np.linspace(0.0, 1.0, POINTS) * 2.0 * r * turn
        first = gone < r * turn
        angle = np.where(first, gone / r, 2.0 * turn - gone / r)
        along, across = r * np.sin(angle), r * (1.0 - np.cos(angle))
        x = np.where(first, task[:, READY_X, None] - along, task[:, GOAL_X, None] + along)
        y = np.where(first, -across, task[:, GOAL_Y, None] + across)
        away = np.hypot(x - pose[:, :1], y - pose[:, 1:2]) + 0.1 * np.abs(angle - pose[:, 2:])
        k, row = np.argmin(away, axis=1), np.arange(len(pose))
        reference, way = np.column_stack([x[row, k], y[row, k], angle[row, k]]), gone[row, k]
        bend = np.where(pose[:, 0] > ready, 0.0, np.where(way + AHEAD < r * turn[:, 0], -1.0, 1.0) / r)
        off, turned = _across(pose, reference), pose[:, 2] - reference[:, 2]
        return Nearest(ready - pose[:, 0], way, 2.0 * r * turn[:, 0] - way, off, turned, bend)


def _backing(pose: Floats, at: Nearest, way: Floats) -> NDArray[np.bool_]:
    """Return which cars back: those that have come to the arcs, or back already and are not off them."""
    lost = (np.abs(at.off) > LOST) | (np.abs(at.turned) > np.where(at.left < LAST, STRAIGHT, TURNED))
    square = (np.abs(pose[:, 1]) < SQUARE) & (np.abs(pose[:, 2]) < 2.0 * SQUARE)
    arrived = (at.ahead < READY) & square | (at.ahead < -BEYOND)
    return arrived | (way < 0.0) & ~(lost & (at.gone > 0.0))


def _across(pose: Floats, reference: Floats) -> Floats:
    """Return how far left of a reference's heading poses lie, m, (n,)."""
    dx, dy, turn = pose[:, 0] - reference[:, 0], pose[:, 1] - reference[:, 1], reference[:, 2]
    return np.cos(turn) * dy - np.sin(turn) * dx
