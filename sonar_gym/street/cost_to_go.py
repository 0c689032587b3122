"""The cost to go of the parking task: the length of the shortest way of a car into a space, as a table of its poses.

A car cannot move sideways, so a pose beside the space can be farther from its aim than one ahead of it. The table holds
the least cost of a path of arcs that touches nothing: its length, which counts several times close to a box or kerb,
and a cost of each change of direction. It is computed from
the poses in the space outwards, by Dijkstra's algorithm over cells of poses, each of which keeps the pose in which a
path arrives (Dolgov et al. 2010, "Path planning for autonomous vehicles in unknown semi-structured environments").
"""

from __future__ import annotations

import heapq
import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from acquisition.arrays import Floats, Singles
from sonar_gym.compiled import compiled
from sonar_gym.sensing.kernels import NO_HIT, out_of_frame, roll, touches
from sonar_gym.street.street import StreetSettings, arc_radius
from sonar_gym.street.vehicle import CarSettings

PARKED_ANGLE = math.radians(10.0)  # greatest angle of a parked car to the kerb
PARKED_OVERHANG = 0.02  # m; how far a parked body may stand over the strip's line
CHANGE_M = 0.3  # cost of a change of direction, m
NEAR_M, NEAR_FACTOR = 0.06, 5.0  # distance that is close, m, and the cost of a metre there, m
NEAR_OF_SPARE = 1.0 / 6.0  # what is close at the most, relative to the length that a space exceeds the car by
BEHIND_M, BEYOND_M, SIDE_M = 0.3, 1.3, 0.15  # extent of a table: before the space, from its begin on, left of the lane
DEEPEST_M = 2.0  # greatest extent into the space
MAX_TURN = math.radians(70.0)
CELLS_OF_SPARE = 9.0  # cells in the length that a space exceeds the car by
FINEST_M, COARSEST_M = 0.006, 0.015  # m; limits of the length of a cell
TURN_PER_M = math.radians(200.0)  # angle of a cell per metre of its length, rad
FADE_M = 0.5  # m before the table from which the heading of its edge is straight ahead
UNREACHED = np.float32(1e6)
TIE_M = 1e-5  # m; equal costs up to rounding
FORWARD, BACKWARD = 0, 1
N_GRID = 12  # first value of a table, its cells along x, y and heading, its lowest pose, its steps, its car's radius
FIRST, CELLS, LOW, STEP, RADIUS = 0, 1, 4, 7, 10


class Space(NamedTuple):
    """What a table depends on.

    Attributes:
        length: length of the space, m.
        line: distance from the lane's centre to the strip's line, m.
        depth: depth of the strip, m.
        far_side: distance from the lane's centre to the left kerb, m.
        car: measures of the car.
    """

    length: float
    line: float
    depth: float
    far_side: float
    car: CarSettings

    @classmethod
    def of(cls, streets: StreetSettings, car: CarSettings, gap: float | None = None) -> Space:
        """Return the shortest space of such streets, or one of `gap` m; ways into it lead into longer ones, too."""
        return cls(streets.gap[0] if gap is None else gap, streets.line, streets.depth, streets.far_side, car)

    @property
    def spare(self) -> float:
        """Length that the space exceeds the car by, m."""
        return self.length - self.car.length

    @property
    def wide_body(self) -> Floats:
        """Rectangle of the car with what is close around it, m, (4,)."""
        return self.car.body + min(NEAR_M, NEAR_OF_SPARE * self.spare) * np.array([-1.0, -1.0, 1.0, 1.0])

    @property
    def outline(self) -> Floats:
        """The space between two boxes without end, and the left kerb, as segments, m, (6, 4)."""
        line, kerb, end, far = -self.line, -self.line - self.depth, self.length, 100.0
        sides = [[-far, line, 0.0, line], [0.0, line, 0.0, kerb], [0.0, kerb, end, kerb], [end, kerb, end, line]]
        return np.array([*sides, [end, line, far, line], [-far, self.far_side, far, self.far_side]])


class Grid(NamedTuple):
    """Cells of poses: their number along x, y and heading, and the first centre and the step: m, m, rad, (3,) each."""

    cells: tuple[int, int, int]
    low: Floats
    step: Floats


def tabulated(gap: float, shortest: float, car: CarSettings) -> float:
    """Return the length of the space whose table a gap has, so that there are few tables, m.

    It is up to 5 cm shorter than the gap, but not shorter than any that is drawn: a table of the shortest would end the
    ways into a longer gap before a box where there is none, and cars wait there.

    Args:
        gap: length of the gap, m.
        shortest: length of the shortest gap that is drawn, m; a gap that is made shorter has steps of 1 cm.
        car: the car, which is not longer.
    """
    gap += 1e-6
    least = shortest if gap > shortest else max(math.floor(100.0 * gap) / 100.0, car.length)
    return max(math.floor(20.0 * gap) / 20.0, least)


def grid_of(space: Space) -> Grid:
    """Return the cells of a table; the less room there is, the smaller they are."""
    size = min(max(space.spare / CELLS_OF_SPARE, FINEST_M), COARSEST_M)
    lowest = -space.line - min(space.depth, 2.0 * space.car.length, DEEPEST_M) + 0.5 * space.car.width
    half_turn = math.ceil(MAX_TURN / (TURN_PER_M * size))
    rows = max(1, math.ceil((SIDE_M - lowest) / size))  # a car may be wider than all that is tabulated
    cells = math.ceil((BEHIND_M + BEYOND_M) / size), rows, 2 * half_turn + 1
    low = np.array([-BEHIND_M, lowest + 0.25 * size, -half_turn * TURN_PER_M * size])
    return Grid(cells, low, np.array([size, size, TURN_PER_M * size]))


@lru_cache(maxsize=64)
def cost_table(space: Space) -> tuple[Floats, Singles]:
    """Return the header of a table, (N_GRID,), and its values, m; 0 everywhere if a car cannot park in the space."""
    grid, car = grid_of(space), space.car
    reached = search(grid.cells, grid.low, grid.step, car.body, space.wide_body, space.outline, np.array(space[:4]),
                     arc_radius(car))  # fmt: skip
    values = reached.min(axis=1).reshape(grid.cells)
    if values.min() == UNREACHED:
        values[:] = 0.0
    fill(values, grid.step, arc_radius(car))
    header = np.array([0.0, *grid.cells, *grid.low, *grid.step, arc_radius(car), 0.0])
    return header, values.ravel()


@compiled
def stands_in(pose: Floats, body: Floats, space: Floats) -> bool:
    """Return whether a car stands in a space: parallel to the kerb, and with no corner outside; see `Space`."""
    if abs(pose[2]) > PARKED_ANGLE:
        return False
    for x, y in ((body[0], body[1]), (body[0], body[3]), (body[2], body[1]), (body[2], body[3])):
        at_x, at_y = out_of_frame(x, y, pose)
        if not 0.0 <= at_x <= space[0] or at_y > -space[1] + PARKED_OVERHANG:
            return False
    return True


@compiled
def cell_of(pose: Floats, cells: tuple[int, int, int], low: Floats, step: Floats) -> int:
    """Return the number of the cell of a pose, or -1 outside all."""
    out = 0
    for k in range(3):
        place = math.floor((pose[k] - low[k]) / step[k] + 0.5)
        if place < 0 or place >= cells[k]:
            return -1
        out = out * cells[k] + place
    return out


@compiled
def pose_of(cell: int, cells: tuple[int, int, int], low: Floats, step: Floats, pose: Floats) -> None:
    """Write the centre of a cell."""
    for k in (2, 1, 0):
        pose[k] = low[k] + step[k] * (cell % cells[k])
        cell //= cells[k]


@compiled
def price(middle: Floats, pose: Floats, body: Floats, wide: Floats, outline: Floats) -> float:
    """Return the cost per metre of an arc by its middle and its end, infinite if the car touches something there."""
    if touches(middle, body, outline) != NO_HIT or touches(pose, body, outline) != NO_HIT:
        return math.inf
    return 1.0 if touches(pose, wide, outline) == NO_HIT else NEAR_FACTOR


@compiled
def search(
    cells: tuple[int, int, int], low: Floats, step: Floats, body: Floats, wide: Floats, outline: Floats,
    space: Floats, radius: float,
) -> Singles:  # fmt: skip
    """Return the cost to go of each cell, with the last motion backwards in time forwards or backwards, m, (n, 2).

    A way out of the space is a way into it that is driven in reverse, so the search begins with all poses in the space.

    Args:
        cells: number of cells along x, y and heading.
        low: centre of the first cell, (3,).
        step: size of a cell, (3,).
        body: rectangle of the car, (4,).
        wide: the same with what is close around it, (4,).
        outline: obstacles, m, (m, 4).
        space: length, line, depth and far side, see `Space`.
        radius: turning radius, m.
    """
    count, length = cells[0] * cells[1] * cells[2], 2.0 * step[0]
    cost, arrival = np.full((count, 2), UNREACHED, np.float32), np.empty((count, 2, 3), np.float32)
    done, middle, pose = np.zeros((count, 2), np.bool_), np.empty(3), np.empty(3)
    queue = [(0.0, 0)]
    queue.clear()
    for cell in range(count):
        pose_of(cell, cells, low, step, pose)
        if stands_in(pose, body, space) and touches(pose, body, outline) == NO_HIT:
            for way in (FORWARD, BACKWARD):
                cost[cell, way], arrival[cell, way] = 0.0, pose
                heapq.heappush(queue, (0.0, 2 * cell + way))
    while len(queue) > 0:
        now, key = heapq.heappop(queue)
        cell, way = key // 2, key % 2
        if done[cell, way]:
            continue
        done[cell, way] = True
        for to in (FORWARD, BACKWARD):
            change = CHANGE_M if to != way and now > 0.0 else 0.0
            for bend in (-1.0, 0.0, 1.0):
                half = step[0] if to == FORWARD else -step[0]
                pose[:] = arrival[cell, way]
                middle[0], middle[1], middle[2] = roll(pose, half, bend / radius)
                pose[0], pose[1], pose[2] = roll(middle, half, bend / radius)
                other = cell_of(pose, cells, low, step)
                # most ways end where a shorter one ended, which is known before it is known what they touch
                if other < 0 or now + change + length >= cost[other, to] - TIE_M:
                    continue
                total = now + change + length * price(middle, pose, body, wide, outline)
                if total < cost[other, to] - TIE_M:
                    cost[other, to], arrival[other, to] = total, pose
                    heapq.heappush(queue, (total, 2 * other + to))
    return cost


@compiled
def fill(values: NDArray[np.float32], step: Floats, radius: float) -> None:
    """Give cells from which no way leads into the space the value of the nearest reached cell and the distance from it.

    The nearest, not the cheapest: else a cell inside a box would have the value of the space behind it.

    Args:
        values: values of the cells, (x, y, heading); modified.
        step: size of a cell, (3,).
        radius: metres per radian of the distance.
    """
    shape, sizes = values.shape, (step[0], step[1], step[2] * radius)
    away = np.where(values < UNREACHED, 0.0, np.inf)
    for turn in range(4):  # both directions along each axis, twice
        order = 1 if turn % 2 == 0 else -1
        for a in range(shape[0]):
            for b in range(shape[1]):
                for c in range(shape[2]):
                    i, j, k = (a, b, c) if order > 0 else (shape[0] - 1 - a, shape[1] - 1 - b, shape[2] - 1 - c)
                    for axis in range(3):
                        p, q, r = i - order * (axis == 0), j - order * (axis == 1), k - order * (axis == 2)
                        if not (0 <= p < shape[0] and 0 <= q < shape[1] and 0 <= r < shape[2]):
                            continue
                        if away[p, q, r] + sizes[axis] < away[i, j, k]:
                            away[i, j, k] = away[p, q, r] + sizes[axis]
                            values[i, j, k] = values[p, q, r] + np.float32(sizes[axis])


@compiled
def cost_to_go(x: float, y: float, turn: float, grid: Floats, values: Singles) -> float:
    """Return the cost to go of a pose, m, by interpolation; outside the table, with the distance from it.

    Before the table the heading of its edge is turned towards the lane: what is short from there, a way straight into
    the space, is blocked by boxes farther back.

    Args:
        x: from the begin of the space, m.
        y: from the lane's centre, m.
        turn: heading, rad.
        grid: header of the table, (N_GRID,).
        values: values of all tables, m.
    """
    before = max(grid[LOW] - x, 0.0)
    shown = turn * max(1.0 - before / FADE_M, 0.0)
    total, place, share = grid[RADIUS] * abs(turn - shown), np.empty(3, np.int64), np.empty(3)
    pose = (float(x), float(y), float(shown))
    for k in range(3):
        size = grid[STEP + k]
        cells = (pose[k] - grid[LOW + k]) / size
        inside = min(max(cells, 0.0), grid[CELLS + k] - 1.0)
        total += abs(cells - inside) * size * (grid[RADIUS] if k == 2 else 1.0)
        place[k] = min(int(inside), int(grid[CELLS + k]) - 2)
        share[k] = inside - place[k]
    first, ny, nt = int(grid[FIRST]), int(grid[CELLS + 1]), int(grid[CELLS + 2])
    for corner in range(8):
        i, j, k = corner & 1, corner >> 1 & 1, corner >> 2
        weight = (share[0] if i else 1.0 - share[0]) * (share[1] if j else 1.0 - share[1])
        weight *= share[2] if k else 1.0 - share[2]
        total += weight * values[first + ((place[0] + i) * ny + place[1] + j) * nt + place[2] + k]
    return total


@compiled
def costs_to_go(poses: Floats, grid: Floats, values: Singles) -> Floats:
    """Return the costs to go of poses relative to the begin of the space, (k, 3), m, (k,)."""
    out = np.empty(poses.shape[0])
    for i in range(poses.shape[0]):
        out[i] = cost_to_go(poses[i, 0], poses[i, 1], poses[i, 2], grid, values)
    return out


class CostTables:
    """Tables of several spaces in one array.

    Attributes:
        grids: headers, (k, N_GRID).
        values: values of all tables, m.
    """

    def __init__(self) -> None:
        self.grids, self.values = np.zeros((0, N_GRID)), np.zeros(0, np.float32)
        self._numbers: dict[Space, int] = {}

    def number(self, space: Space) -> int:
        """Return the number of the table of a space, which is added if it is new."""
        if space not in self._numbers:
            header, values = cost_table(space)
            self._numbers[space] = len(self._numbers)
            first = np.array([[len(self.values), *header[1:]]])
            self.grids = np.concatenate([self.grids, first])
            self.values = np.concatenate([self.values, values])
        return self._numbers[space]
