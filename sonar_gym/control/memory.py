"""Observation memory of an agent: the recent observations, and lateral profiles of the surroundings along the lane.

A single observation of eight sonars does not show where a space begins that the car has already passed. The memory
stores, on a grid along the first axis of the odometry frame, the distance of objects on either side, and returns it
relative to the current pose. A feed-forward policy can therefore park. It uses observations only.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from acquisition import SettingError
from acquisition.arrays import Floats, Ints, Singles
from sonar_gym.parking.fleet import EGO, MAX_RANGE, ODOMETRY_SPAN
from sonar_gym.sensing.mounts import Layout, layout, mount_arrays

Observation = Mapping[str, NDArray[Any]]
RIGHT, LEFT = 0, 1  # index of the lateral profile
SIDE_TOLERANCE = math.radians(15.0)  # greatest deviation of a side sonar from perpendicular to the car
MAX_HEADING_SINE = 0.25  # beyond it the side sonars no longer point across the lane
GRID_STEP = 0.05  # m
GRID_LIMITS = (-2.0, 10.0)  # m along the first axis of the odometry frame
MAX_DISTANCE = 1.0  # m; lateral distances are clipped to it, and no echo counts as it
MIN_WEIGHT = 0.1  # weight of no echo, and of a reading without credence, relative to a certain reading
MAX_WEIGHT = 4.0  # readings; the weight of a grid point saturates here, so old readings are forgotten
REVERSAL_TOLERANCE = 0.005  # m; shorter motions do not count as a change of direction
RANGE_SCALE = 0.3  # m; the feature of a reading r is 2 r / (r + RANGE_SCALE) - 1, which resolves short ranges
TRAVEL_SCALE = 5.0  # 1/m; the feature is tanh(TRAVEL_SCALE * distance since the last reversal)
EGO_SCALE = np.array([1.0, 1.0, 1.0, 2.0, 1.0, 4.0, 1.0], dtype=np.float32)


@dataclass(frozen=True)
class MemorySettings:
    """Settings of the observation memory.

    Attributes:
        lags: number of recent observations in the features.
        behind, ahead: extent of the profiles from the rear axle, m.
        coarse: the left profile contains every `coarse`-th grid point.
        credence: whether credence is a feature and weights the profiles; if not, all echoes have equal weight.
        echo: whether the memory knows which sonars received an echo; if not, no echo is an echo at the maximum range.
    """

    lags: int = 4
    behind: float = 1.9
    ahead: float = 0.5
    coarse: int = 4
    credence: bool = True
    echo: bool = True

    def __post_init__(self) -> None:
        """Raise SettingError for invalid values."""
        if self.lags < 1 or self.coarse < 1:
            raise SettingError(f"MemorySettings.lags and coarse must be >= 1, got {self.lags} and {self.coarse}")
        if not (0.0 <= self.behind <= 5.0 and 0.0 <= self.ahead <= 5.0):
            raise SettingError(
                f"MemorySettings.behind and ahead must be in 0..5 m, got {self.behind:g} and {self.ahead:g} m"
            )

    @property
    def places(self) -> Floats:
        """Grid points of the right profile, m from the rear axle."""
        return np.arange(-round(self.behind / GRID_STEP), round(self.ahead / GRID_STEP) + 1) * np.float64(GRID_STEP)

    def to_dict(self) -> dict[str, Any]:
        """Return the settings as JSON data."""
        return asdict(self)


class ObservationMemory:
    """Observation memories of n cars, as arrays.

    Args:
        count: number of cars.
        sonar_layout: sonars of each car; those that point sideways write the profiles.
        settings: extent and content of the features.
    """

    def __init__(self, count: int, sonar_layout: Layout = "eight", settings: MemorySettings | None = None) -> None:
        self.settings = settings or MemorySettings()
        mounts, _ = mount_arrays(layout(sonar_layout))
        off = [np.abs(_wrapped(mounts[:, 2] - turn)) for turn in (-0.5 * np.pi, 0.5 * np.pi)]
        self.count, self.sonars = count, len(mounts)
        self._mounts = mounts
        self._side = np.where(off[0] < SIDE_TOLERANCE, RIGHT, np.where(off[1] < SIDE_TOLERANCE, LEFT, -1))
        self._side = self._side.astype(np.int64)
        points = round((GRID_LIMITS[1] - GRID_LIMITS[0]) / GRID_STEP) + 1
        self._level = np.zeros((count, 2, points))
        self._weight = np.zeros((count, 2, points))
        self._last = np.full((count, self.sonars), np.nan)  # x at which each side sonar wrote last, m
        self._recent = np.zeros((count, self.settings.lags, 3 * self.sonars), dtype=np.float32)
        self._ego = np.zeros((count, EGO), dtype=np.float32)
        self._travel = np.zeros((count, 2))  # m along x since the last reversal, and since a possible new one
        self._places = self.settings.places

    @property
    def travel(self) -> Floats:
        """Distance along the first axis of the odometry frame since the last reversal, m, (n,); negative backwards."""
        return self._travel[:, 0]

    @property
    def size(self) -> int:
        """Number of features."""
        left = len(self._places[:: self.settings.coarse])
        return self.settings.lags * 3 * self.sonars + EGO + 1 + 2 * len(self._places) + left

    def reset(self, rows: Ints) -> None:
        """Begin the episodes of some cars: clear their memories."""
        self._level[rows], self._weight[rows], self._last[rows] = 0.0, 0.0, np.nan
        self._recent[rows], self._ego[rows], self._travel[rows] = 0.0, 0.0, 0.0

    def update(self, rows: Ints, observation: Observation) -> None:
        """Store the observations of some cars.

        Args:
            rows: indices of the cars, (r,).
            observation: `ranges`, `credence`, `echo`, (r, s), and `ego`, (r, 7).
        """
        ranges, echo, ego = (np.asarray(observation[name]) for name in ("ranges", "echo", "ego"))
        echo = echo if self.settings.echo else np.ones_like(echo)
        credence = np.asarray(observation["credence"]) if self.settings.credence else (echo > 0).astype(np.float32)
        metres = (ranges * MAX_RANGE).astype(np.float32)
        self._recent[rows, 1:] = self._recent[rows, :-1]
        self._recent[rows, 0] = np.concatenate([2.0 * metres / (metres + RANGE_SCALE) - 1.0, credence, echo], axis=1)
        self._update_travel(rows, ODOMETRY_SPAN[0] * (ego[:, 4] - self._ego[rows, 4]))
        self._ego[rows] = ego
        write_profiles(
            rows, self._level, self._weight, self._last, metres, credence, echo, ego, self._mounts, self._side
        )

    def _update_travel(self, rows: Ints, moved: Floats) -> None:
        """Add a motion along x, m, (r,), to the distance since the last reversal; a reversal restarts it."""
        travel, turning = self._travel[rows].T
        against = np.where(moved * travel < 0.0, turning + moved, np.where(moved == 0.0, turning, 0.0))
        turned_back = np.abs(against) > REVERSAL_TOLERANCE
        travel, against = np.where(turned_back, against, travel + moved), np.where(turned_back, 0.0, against)
        self._travel[rows] = np.column_stack([travel, against])

    def features(self, rows: Ints) -> Singles:
        """Return the features of some cars, of order 1, (r, size)."""
        s, n = self.settings, len(rows)
        out = np.empty((n, self.size), dtype=np.float32)
        recent = s.lags * 3 * self.sonars
        out[:, :recent] = self._recent[rows].reshape(n, -1)
        out[:, recent : recent + EGO] = self._ego[rows] * EGO_SCALE
        out[:, recent + EGO] = np.tanh(TRAVEL_SCALE * self._travel[rows, 0])
        read_profiles(rows, self._level, self._weight, self._ego, self._places, s.coarse, out, recent + EGO + 1)
        return out


def _wrapped(angle: Floats) -> Floats:
    return (angle + np.pi) % (2.0 * np.pi) - np.pi


@njit(cache=True)
def grid_position(x: float) -> float:
    """Return the position of x, m, on the grid of the profiles, in steps from its beginning."""
    return (x - GRID_LIMITS[0]) / GRID_STEP


@njit(cache=True)
def write_profiles(
    rows: Ints,
    level: Floats,
    weight: Floats,
    last: Floats,
    metres: Singles,
    credence: Singles,
    echo: Singles,
    ego: Singles,
    mounts: Floats,
    side: Ints,
) -> None:
    """Write the readings of the side sonars to the grid points between their last and their current position.

    Args:
        rows: indices of the cars, (r,).
        level: y of the objects in the odometry frame, m, (n, 2, points); updated.
        weight: accumulated weight of the readings, (n, 2, points); updated.
        last: x at which each sonar wrote last, m; NaN if it did not, (n, s); updated.
        metres: readings, m, (r, s).
        credence: as observed, (r, s).
        echo: as observed, (r, s).
        ego: as observed, (r, 7).
        mounts: poses of the sonars on the car, (s, 3).
        side: `RIGHT`, `LEFT`, or -1 for sonars that do not point sideways, (s,).
    """
    for k in range(rows.shape[0]):
        i = rows[k]
        c, s = ego[k, 2], ego[k, 3]
        x0, y0 = ego[k, 4] * ODOMETRY_SPAN[0], ego[k, 5] * ODOMETRY_SPAN[1]
        straight = abs(s) < MAX_HEADING_SINE and c > 0.0
        for j in range(side.shape[0]):
            if side[j] < 0:
                continue
            if not straight or echo[k, j] < -0.5:  # -1: the sonar gave no answer
                last[i, j] = np.nan
                continue
            x = x0 + c * mounts[j, 0] - s * mounts[j, 1]
            y = y0 + s * mounts[j, 0] + c * mounts[j, 1]
            away = min(metres[k, j], MAX_DISTANCE)
            y_object = y - away if side[j] == RIGHT else y + away
            new = max(credence[k, j], MIN_WEIGHT)
            begin = x if np.isnan(last[i, j]) else last[i, j]
            first, end = round(grid_position(min(begin, x))), round(grid_position(max(begin, x)))
            here = round(grid_position(x))
            for point in range(max(first, 0), min(end, level.shape[2] - 1) + 1):
                if point == round(grid_position(begin)) and point != here:  # written when the sonar was there
                    continue
                old = weight[i, side[j], point]
                level[i, side[j], point] += (y_object - level[i, side[j], point]) * new / (old + new)
                weight[i, side[j], point] = min(old + new, MAX_WEIGHT)
            last[i, j] = x


@njit(cache=True)
def interpolate(level: Floats, weight: Floats, position: float) -> tuple[float, float]:
    """Return level and weight between two grid points; a point without weight is ignored."""
    low = math.floor(position)
    if low < 0 or low + 1 >= level.shape[0]:
        return 0.0, 0.0
    share = position - low
    a, b = weight[low] * (1.0 - share), weight[low + 1] * share
    if a + b <= 0.0:
        return 0.0, 0.0
    if weight[low] > 0.0 and weight[low + 1] > 0.0:
        return (1.0 - share) * level[low] + share * level[low + 1], a + b
    return (level[low] if weight[low] > 0.0 else level[low + 1]), a + b


@njit(cache=True)
def read_profiles(
    rows: Ints, level: Floats, weight: Floats, ego: Singles, places: Floats, coarse: int, out: Singles, begin: int
) -> None:
    """Write the profiles relative to the cars into `out`: distance and weight on the right, distance on the left.

    Args:
        rows: indices of the cars, (r,).
        level: as of `write_profiles`.
        weight: as of `write_profiles`.
        ego: last observed, (n, 7).
        places: grid points, m from the rear axle, (p,).
        coarse: step between the grid points of the left profile.
        out: features to write into, (r, size).
        begin: first column to write.
    """
    count = places.shape[0]
    for k in range(rows.shape[0]):
        i = rows[k]
        x, y = ego[i, 4] * ODOMETRY_SPAN[0], ego[i, 5] * ODOMETRY_SPAN[1]
        for p in range(count):
            y_object, known = interpolate(level[i, RIGHT], weight[i, RIGHT], grid_position(x + places[p]))
            out[k, begin + p] = 2.0 * min(max(y - y_object, -0.5), MAX_DISTANCE) if known > 0.0 else 0.0
            out[k, begin + count + p] = known / (1.0 + known)
        column = begin + 2 * count
        for p in range(0, count, coarse):
            y_object, known = interpolate(level[i, LEFT], weight[i, LEFT], grid_position(x + places[p]))
            out[k, column] = min(max(y_object - y, -0.5), MAX_DISTANCE + 0.5) if known > 0.0 else 0.0
            column += 1
