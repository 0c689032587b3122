"""What an agent remembers of an episode: the last readings, and strips of what its side sonars have passed.

One look at eight sonars does not tell where the space began that the car has just left behind. A memory keeps, in
odometry's frame, how far away things were on either side at every place along the lane, and shows them again relative
to where the car is now; so a network without any state of its own can park. Nothing but observations goes in.
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
from sonar_gym.parking.fleet import EGO, MAX_RANGE, ODOMETRY_SPAN
from sonar_gym.sensing.mounts import Layout, layout, mount_arrays

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Ints = NDArray[np.int64]
Observation = Mapping[str, NDArray[Any]]
RIGHT, LEFT = 0, 1  # of the car: the two strips
SIDEWAYS = math.radians(15.0)  # a sonar turned less than this from sideways looks along a strip
STRAIGHT = 0.25  # sine of the heading beyond which side sonars no longer look across the lane
STEP = 0.05  # m; between the places of a strip
STRIP = (-2.0, 10.0)  # m along the first heading that a strip covers
FAR = 1.0  # m; beyond, and where nothing is heard, a strip tells no difference
DOUBT = 0.1  # weight of silence, and of readings without credence, beside one that is certain
FULL = 4.0  # readings after which a strip's place forgets the first
MOVED = 0.005  # m; less than this does not turn the way back
NEAR = 0.3  # m; readings are shown as r / (r + NEAR), which spreads the near ones


@dataclass(frozen=True)
class MemorySettings:
    """What is kept and shown.

    Attributes:
        lags: how many of the last observations are shown.
        behind, ahead: reach of the strips from the rear axle, m.
        coarse: places of the left strip are shown so many steps apart.
        credence: whether credence is shown and weighs what is kept; without, every echo counts alike.
    """

    lags: int = 4
    behind: float = 1.9
    ahead: float = 0.5
    coarse: int = 4
    credence: bool = True

    def __post_init__(self) -> None:
        """Refuse a memory of nothing."""
        if self.lags < 1 or self.coarse < 1:
            raise SettingError(f"MemorySettings.lags and coarse must be >= 1, got {self.lags} and {self.coarse}")
        if not (0.0 <= self.behind <= 5.0 and 0.0 <= self.ahead <= 5.0):
            raise SettingError(f"MemorySettings: a strip reaches 0 to 5 m, got {self.behind:g} and {self.ahead:g} m")

    @property
    def places(self) -> Floats:
        """Where the strip on the right is shown, m from the rear axle."""
        return np.arange(-round(self.behind / STEP), round(self.ahead / STEP) + 1) * np.float64(STEP)

    def to_dict(self) -> dict[str, Any]:
        """Return plain data."""
        return asdict(self)


class Memory:
    """The memories of n cars, as arrays.

    Args:
        count: of cars.
        sonar_layout: of each car; sonars that look sideways write the strips.
        settings: what is kept and shown.
    """

    def __init__(self, count: int, sonar_layout: Layout = "eight", settings: MemorySettings | None = None) -> None:
        self.settings = settings or MemorySettings()
        mounts, _ = mount_arrays(layout(sonar_layout))
        off = [np.abs(_wrapped(mounts[:, 2] - turn)) for turn in (-0.5 * np.pi, 0.5 * np.pi)]
        self.count, self.sonars = count, len(mounts)
        self._mounts = mounts
        self._side = np.where(off[0] < SIDEWAYS, RIGHT, np.where(off[1] < SIDEWAYS, LEFT, -1)).astype(np.int64)
        cells = round((STRIP[1] - STRIP[0]) / STEP) + 1
        self._level = np.zeros((count, 2, cells))
        self._weight = np.zeros((count, 2, cells))
        self._last = np.full((count, self.sonars), np.nan)  # where each side sonar wrote last, m
        self._lately = np.zeros((count, self.settings.lags, 3 * self.sonars), dtype=np.float32)
        self._ego = np.zeros((count, EGO), dtype=np.float32)
        self._way = np.zeros((count, 2))  # x gone since the car last turned back, and since it may be turning back, m
        self._places = self.settings.places

    @property
    def way(self) -> Floats:
        """Metres gone along the first heading since each car turned back last, (n,); negative backwards."""
        return self._way[:, 0]

    @property
    def size(self) -> int:
        """How many numbers a memory shows."""
        left = len(self._places[:: self.settings.coarse])
        return self.settings.lags * 3 * self.sonars + EGO + 1 + 2 * len(self._places) + left

    def forget(self, rows: Ints) -> None:
        """Begin episodes: clear the memories of some cars."""
        self._level[rows], self._weight[rows], self._last[rows] = 0.0, 0.0, np.nan
        self._lately[rows], self._ego[rows], self._way[rows] = 0.0, 0.0, 0.0

    def see(self, rows: Ints, observation: Observation) -> None:
        """Take in what some cars observe.

        Args:
            rows: which cars, (r,).
            observation: `ranges`, `credence`, `echo`, (r, s), and `ego`, (r, 7).
        """
        ranges, echo, ego = (np.asarray(observation[name]) for name in ("ranges", "echo", "ego"))
        credence = np.asarray(observation["credence"]) if self.settings.credence else (echo > 0).astype(np.float32)
        shown = (ranges * MAX_RANGE).astype(np.float32)
        self._lately[rows, 1:] = self._lately[rows, :-1]
        self._lately[rows, 0] = np.concatenate([2.0 * shown / (shown + NEAR) - 1.0, credence, echo], axis=1)
        self._note_way(rows, ODOMETRY_SPAN[0] * (ego[:, 4] - self._ego[rows, 4]))
        self._ego[rows] = ego
        write(rows, self._level, self._weight, self._last, shown, credence, echo, ego, self._mounts, self._side)

    def _note_way(self, rows: Ints, gone: Floats) -> None:
        """Add what was gone, m, (r,), to the way since the car turned back, which begins anew where it does so."""
        way, turning = self._way[rows].T
        against = np.where(gone * way < 0.0, turning + gone, np.where(gone == 0.0, turning, 0.0))
        turned = np.abs(against) > MOVED
        self._way[rows] = np.column_stack([np.where(turned, against, way + gone), np.where(turned, 0.0, against)])

    def show(self, rows: Ints) -> Singles:
        """Return what is remembered, numbers of about unit size, (r, size)."""
        s, n = self.settings, len(rows)
        out = np.empty((n, self.size), dtype=np.float32)
        lately = s.lags * 3 * self.sonars
        out[:, :lately] = self._lately[rows].reshape(n, -1)
        out[:, lately : lately + EGO] = self._ego[rows] * EGO_SCALE
        out[:, lately + EGO] = np.tanh(WAY_SCALE * self._way[rows, 0])
        read(rows, self._level, self._weight, self._ego, self._places, s.coarse, out, lately + EGO + 1)
        return out


WAY_SCALE = 5.0  # 1/m; whether the car goes forwards or backwards now, and whether it has just begun to
EGO_SCALE = np.array([1.0, 1.0, 1.0, 2.0, 1.0, 4.0, 1.0], dtype=np.float32)


def _wrapped(angle: Floats) -> Floats:
    return (angle + np.pi) % (2.0 * np.pi) - np.pi


@njit(cache=True)
def place_of(x: float) -> float:
    """Return the place of a point along the lane in a strip, in steps from its beginning."""
    return (x - STRIP[0]) / STEP


@njit(cache=True)
def write(
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
    """Note in the strips what the side sonars read, between where they read last and where they are.

    Args:
        rows: which cars, (r,).
        level: y of what was met, in odometry's frame, m, (n, 2, c).
        weight: of what is known of it, (n, 2, c).
        last: where each sonar wrote last, m along the lane; NaN where it did not, (n, s).
        metres: readings, (r, s).
        credence: as observed, (r, s).
        echo: as observed, (r, s).
        ego: as observed, (r, 7).
        mounts: poses of the sonars, (s, 3).
        side: `RIGHT`, `LEFT` or -1 for sonars that look elsewhere, (s,).
    """
    for k in range(rows.shape[0]):
        i = rows[k]
        c, s = ego[k, 2], ego[k, 3]
        x0, y0 = ego[k, 4] * ODOMETRY_SPAN[0], ego[k, 5] * ODOMETRY_SPAN[1]
        straight = abs(s) < STRAIGHT and c > 0.0
        for j in range(side.shape[0]):
            if side[j] < 0:
                continue
            if not straight or echo[k, j] < -0.5:  # a sonar that gives no answer has seen nothing
                last[i, j] = np.nan
                continue
            x = x0 + c * mounts[j, 0] - s * mounts[j, 1]
            y = y0 + s * mounts[j, 0] + c * mounts[j, 1]
            away = min(metres[k, j], FAR)
            met = y - away if side[j] == RIGHT else y + away
            new = max(credence[k, j], DOUBT)
            begin = x if np.isnan(last[i, j]) else last[i, j]
            first, end = round(place_of(min(begin, x))), round(place_of(max(begin, x)))
            here = round(place_of(x))
            for cell in range(max(first, 0), min(end, level.shape[2] - 1) + 1):
                if cell == round(place_of(begin)) and cell != here:  # written when the sonar was there
                    continue
                old = weight[i, side[j], cell]
                level[i, side[j], cell] += (met - level[i, side[j], cell]) * new / (old + new)
                weight[i, side[j], cell] = min(old + new, FULL)
            last[i, j] = x


@njit(cache=True)
def between(level: Floats, weight: Floats, place: float) -> tuple[float, float]:
    """Return level and weight at a place between two steps; of the one that is known, where the other is not."""
    low = math.floor(place)
    if low < 0 or low + 1 >= level.shape[0]:
        return 0.0, 0.0
    share = place - low
    a, b = weight[low] * (1.0 - share), weight[low + 1] * share
    if a + b <= 0.0:
        return 0.0, 0.0
    if weight[low] > 0.0 and weight[low + 1] > 0.0:
        return (1.0 - share) * level[low] + share * level[low + 1], a + b
    return (level[low] if weight[low] > 0.0 else level[low + 1]), a + b


@njit(cache=True)
def read(
    rows: Ints, level: Floats, weight: Floats, ego: Singles, places: Floats, coarse: int, out: Singles, begin: int
) -> None:
    """Show the strips from where the cars are: on the right distance and weight at each place, on the left distance.

    Args:
        rows: which cars, (r,).
        level: as of `write`.
        weight: as of `write`.
        ego: last observed, (n, 7).
        places: shown, m from the rear axle, (p,).
        coarse: every so many of them on the left.
        out: to write into, (r, size).
        begin: column to begin at.
    """
    count = places.shape[0]
    for k in range(rows.shape[0]):
        i = rows[k]
        x, y = ego[i, 4] * ODOMETRY_SPAN[0], ego[i, 5] * ODOMETRY_SPAN[1]
        for p in range(count):
            met, known = between(level[i, RIGHT], weight[i, RIGHT], place_of(x + places[p]))
            out[k, begin + p] = 2.0 * min(max(y - met, -0.5), FAR) if known > 0.0 else 0.0
            out[k, begin + count + p] = known / (1.0 + known)
        column = begin + 2 * count
        for p in range(0, count, coarse):
            met, known = between(level[i, LEFT], weight[i, LEFT], place_of(x + places[p]))
            out[k, column] = min(max(met - y, -0.5), FAR + 0.5) if known > 0.0 else 0.0
            column += 1
