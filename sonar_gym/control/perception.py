"""What the driver makes of its sonars on the way: how the lane lies, where the boxes end, where the kerb is.

`Survey` takes readings as they are, and odometry for the truth; `sonar_gym.control.fusion` does better. Both tell of the lane's
frame: metres along the lane and left of it, from where the rear axle stood first.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from sonar_gym.sensing.mounts import Mount, in_world, mount_arrays

Floats = NDArray[np.float64]
JUMP = 0.12  # m; a space is where a side sonar reads this much more than beside the boxes
WINDOW = 5  # readings; the running median that takes single wrong readings out
LEAST_RUN = 3  # readings; a shorter run of near or far is taken for a fault
HEADING_SPREAD = 0.03  # rad; how far off the lane the car may have been set down
READING_SPREAD = 0.02  # m; of a wall's distance, roughly
LEAST_CREDENCE = 0.2  # a reading less credible is treated as none
DEPTH = 0.35  # m from the boxes' faces to the kerb, where the kerb gave no echo


@dataclass(frozen=True)
class Space:
    """A space between two boxes, in the lane's frame.

    Attributes:
        begin, end: along the lane, m; `end` is infinity while it has not been seen.
    """

    begin: float
    end: float

    @property
    def length(self) -> float:
        """How long it is, m."""
        return self.end - self.begin


class Perception(Protocol):
    """What a driver knows of the street.

    Attributes:
        pose: of the rear axle in the lane's frame: m, m, rad, (3,).
        space: the one that was chosen, as it is known by now.
        kerb: where it lies beside that space, y in m.
    """

    @property
    def pose(self) -> Floats:
        """Where the car is."""
        ...

    @property
    def space(self) -> Space | None:
        """The space that was chosen."""
        ...

    @property
    def kerb(self) -> float:
        """Where the kerb lies."""
        ...

    def reset(self) -> None:
        """Forget the last episode."""
        ...

    def look(self, odometry: Floats, reading: Floats, credence: Floats) -> None:
        """Take in a step: pose since the start, (3,); readings, m, and their credence, 0 without an echo, (n,)."""
        ...

    def spaces(self) -> list[Space]:
        """Return the spaces that were passed so far, the last perhaps without its end."""
        ...

    def choose(self, space: Space) -> None:
        """Take a space to park in."""
        ...

    def room(self, name: str) -> float:
        """Return how far a sonar sees, m."""
        ...


class Survey:
    """Odometry for the truth, and a running median against wrong readings.

    Args:
        mounts: the sonars, in the order of the observation.
        max_range: what stands for silence, m.
    """

    def __init__(self, mounts: Sequence[Mount], max_range: float) -> None:
        self.index = {mount.name: i for i, mount in enumerate(mounts)}
        self.max_range = max_range
        self._poses, self._half = mount_arrays(mounts)
        self.reset()

    def reset(self) -> None:
        """Forget the last episode."""
        self.lane = 0.0  # heading of the lane in odometry's frame, rad
        self.space: Space | None = None
        self.kerb = -np.inf
        self._odometry = np.zeros(3)
        self._track: list[Floats] = []
        self._heard: list[Floats] = []

    @property
    def pose(self) -> Floats:
        """Where the car is in the lane's frame."""
        return self._in_lane(self._odometry)

    def look(self, odometry: Floats, reading: Floats, credence: Floats) -> None:
        """Keep where every sonar was and what it read, and fit the lane to the wall on the left."""
        self._odometry = odometry
        self._now = np.where(credence >= LEAST_CREDENCE, reading, self.max_range)
        if self.space is not None:
            return
        self._track.append(in_world(self._poses, odometry))
        self._heard.append(self._now)
        left = self.index["left"]
        track, heard = np.array(self._track)[:, left], np.array(self._heard)[:, left]
        echo = heard < self.max_range
        self.lane = lane_heading(track[echo, 0], track[echo, 1], heard[echo])

    def _in_lane(self, pose: Floats) -> Floats:
        """Return poses of odometry's frame in the lane's, (..., 3)."""
        c, s = np.cos(self.lane), np.sin(self.lane)
        x, y, heading = pose[..., 0], pose[..., 1], pose[..., 2]
        return np.stack([c * x + s * y, c * y - s * x, heading - self.lane], axis=-1)

    def _profile(self, name: str) -> tuple[Floats, Floats]:
        """Return where a sonar was in the lane's frame and what it read: (n, 3), (n,)."""
        i = self.index[name]
        return self._in_lane(np.array(self._track)[:, i]), np.array(self._heard)[:, i]

    def _seen_by(self, name: str) -> list[Space]:
        where, heard = self._profile(name)
        return spaces(where[:, 0], heard, self._half[self.index[name]])

    def spaces(self) -> list[Space]:
        """Return what the foremost sonar on the right has passed."""
        return self._seen_by("right front")

    def choose(self, space: Space) -> None:
        """Take a space; its beginning is the mean of what both sonars on the right say."""
        again = self._seen_by("right rear")
        close = [s.begin for s in again if abs(s.begin - space.begin) < 0.1]
        self.space = Space(float(np.mean([space.begin, *close])), space.end)
        self.kerb = self._kerb_y(self.space)

    def _kerb_y(self, space: Space) -> float:
        """Return where the kerb lies: the sonars on the right read it from the middle of the space."""
        face, kerb = [], []
        for name in ("right front", "right rear"):
            where, heard = self._profile(name)
            inside = (where[:, 0] > space.begin + 0.3) & (where[:, 0] < space.end - 0.3) & (heard < 1.0)
            kerb.extend(where[inside, 1] - heard[inside])
            face.append(float(np.median(where[:, 1])) - clearance(heard))
        expected = float(np.mean(face)) - DEPTH
        seen = [y for y in kerb if abs(y - expected) < 0.08]
        return float(np.median(seen)) if seen else expected

    def room(self, name: str) -> float:
        """Return what a sonar reads now, m."""
        return float(self._now[self.index[name]])


def lane_heading(x: Floats, y: Floats, wall: Floats) -> float:
    """Return the heading of the lane from distances to a wall along it, rad.

    A sonar beside a wall reads its perpendicular distance, so y + wall = offset + slope * x. The slope has a normal
    prior, and readings off the first fit by more than three spreads are left out of the second.

    Args:
        x: of the sonar, m, (n,).
        y: of the sonar, m, (n,).
        wall: what it read, m, (n,).
    """
    if len(x) < LEAST_RUN:
        return 0.0
    height = y + wall
    near = np.abs(height - np.median(height)) < 0.25
    slope = 0.0
    for _ in range(2):
        if near.sum() >= LEAST_RUN:
            slope, offset = _ridge(x[near], height[near])
            near = np.abs(height - offset - slope * x) < 3.0 * READING_SPREAD
    return float(np.arctan(slope))


def _ridge(x: Floats, height: Floats) -> tuple[float, float]:
    dx, dy = x - x.mean(), height - height.mean()
    slope = float(dx @ dy / (dx @ dx + (READING_SPREAD / HEADING_SPREAD) ** 2))
    return slope, float(height.mean() - slope * x.mean())


def spaces(along: Floats, reading: Floats, half: float) -> list[Space]:
    """Return the spaces that a sonar looking sideways has passed, the last perhaps without its end.

    Past the corner of a box by u, a cone of half angle h cuts the box's side at the range u / sin(h): so where the
    reading crosses a threshold, the corner lies threshold * sin(h) behind (or before) the sonar.

    Args:
        along: of the sonar along the lane, increasing, m, (n,).
        reading: what it read, m, (n,); any great number for silence.
        half: half opening angle of its cone, rad.
    """
    smooth = median_filter(reading, size=WINDOW, mode="nearest")
    threshold = clearance(smooth) + JUMP
    corner = threshold * np.sin(half)
    out: list[Space] = []
    before_first_box = True
    for begin, end, far in runs(smooth > threshold):
        if far and not before_first_box:
            first = _crossing(along, smooth, begin, threshold) - corner
            last = _crossing(along, smooth, end, threshold) + corner if end < len(along) else np.inf
            out.append(Space(first, last))
        before_first_box = before_first_box and far
    return out


def clearance(reading: Floats) -> float:
    """Return how far the boxes are: most near readings agree on it; 0.2 m before there is one."""
    near = reading[reading < 0.4]
    return float(np.median(near)) if len(near) else 0.2


def runs(far: NDArray[np.bool_]) -> list[tuple[int, int, bool]]:
    """Return begin, end and kind of the runs of equal values, those too short joined to the one before."""
    out: list[tuple[int, int, bool]] = []
    edges = np.flatnonzero(np.diff(far)) + 1
    for begin, end in zip(np.r_[0, edges], np.r_[edges, len(far)], strict=True):
        kind = bool(far[begin])
        if out and (end - begin < LEAST_RUN or out[-1][2] == kind):
            out[-1] = (out[-1][0], int(end), out[-1][2])
        else:
            out.append((int(begin), int(end), kind))
    return out


def _crossing(along: Floats, smooth: Floats, index: int, threshold: float) -> float:
    """Return where the reading crosses the threshold between two places, by a straight line."""
    low, high = smooth[index - 1], min(smooth[index], 3.0 * threshold)
    share = (threshold - low) / (high - low) if high != low else 0.5
    return float(along[index - 1] + np.clip(share, 0.0, 1.0) * (along[index] - along[index - 1]))
