"""Perception of the scripted controller: heading of the lane, spaces between the boxes, and position of the kerb.

`RawPerception` takes odometry and readings at face value; `sonar_gym.control.fusion` filters them. Both work in the
lane frame: x along the lane and y to its left, in m, with the origin at the initial position of the rear axle.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.ndimage import median_filter

from acquisition.arrays import Bits, Floats
from sonar_gym.sensing.mounts import Mount, in_world, mount_arrays

JUMP = 0.12  # m; in a space, a side sonar reads at least this much more than beside the boxes
WINDOW = 5  # readings in the running median, which removes isolated outliers
MIN_RUN = 3  # readings; a shorter run of near or far readings is treated as outliers
HEADING_SD = 0.03  # rad; prior of the initial heading relative to the lane
READING_SD = 0.02  # m; of readings of the wall, roughly
MIN_CREDENCE = 0.2  # a reading with less credence is treated as no echo
DEPTH = 0.35  # m from the faces of the boxes to the kerb; used if the kerb gave no echo


@dataclass(frozen=True)
class ParkingSpace:
    """A space between two boxes, in the lane frame.

    Attributes:
        begin, end: limits along the lane, m; `end` is infinite until the sonar has passed it.
    """

    begin: float
    end: float

    @property
    def length(self) -> float:
        """Length, m."""
        return self.end - self.begin


class Perception(Protocol):
    """Estimate of the car's pose and of the street.

    Attributes:
        pose: pose of the rear axle in the lane frame: m, m, rad, (3,).
        space: the selected space, by its current estimate; None before a selection.
        kerb: y of the kerb beside that space, m.
    """

    @property
    def pose(self) -> Floats:
        """Pose of the rear axle."""
        ...

    @property
    def space(self) -> ParkingSpace | None:
        """The selected space."""
        ...

    @property
    def kerb(self) -> float:
        """Position of the kerb."""
        ...

    def reset(self) -> None:
        """Begin an episode."""
        ...

    def update(self, odometry: Floats, reading: Floats, credence: Floats) -> None:
        """Process a step: pose since the start, (3,); readings, m, (n,), and credence, 0 without an echo, (n,)."""
        ...

    def spaces(self) -> list[ParkingSpace]:
        """Return the spaces passed so far; the last may have no end yet."""
        ...

    def select(self, space: ParkingSpace) -> None:
        """Select the space to park in."""
        ...

    def clearance(self, name: str) -> float:
        """Return the free distance in front of a sonar, m."""
        ...


class RawPerception:
    """Perception by odometry without correction, and a running median of the readings.

    Args:
        mounts: sonars in the order of the observation.
        max_range: value that stands for no echo, m.
    """

    def __init__(self, mounts: Sequence[Mount], max_range: float) -> None:
        self.index = {mount.name: i for i, mount in enumerate(mounts)}
        self.max_range = max_range
        self._poses, self._half = mount_arrays(mounts)
        self.reset()

    def reset(self) -> None:
        """Begin an episode."""
        self.lane = 0.0  # heading of the lane in the odometry frame, rad
        self.space: ParkingSpace | None = None
        self.kerb = -np.inf
        self._odometry = np.zeros(3)
        self._track: list[Floats] = []
        self._readings: list[Floats] = []

    @property
    def pose(self) -> Floats:
        """Pose of the rear axle in the lane frame: m, m, rad, (3,)."""
        return self._in_lane(self._odometry)

    def update(self, odometry: Floats, reading: Floats, credence: Floats) -> None:
        """Store poses and readings of all sonars, and fit the heading of the lane to the wall on the left."""
        self._odometry = odometry
        self._now = np.where(credence >= MIN_CREDENCE, reading, self.max_range)
        if self.space is not None:
            return
        self._track.append(in_world(self._poses, odometry))
        self._readings.append(self._now)
        left = self.index["left"]
        track, wall = np.array(self._track)[:, left], np.array(self._readings)[:, left]
        echo = wall < self.max_range
        self.lane = lane_heading(track[echo, 0], track[echo, 1], wall[echo])

    def _in_lane(self, pose: Floats) -> Floats:
        """Transform poses from the odometry frame to the lane frame, (..., 3)."""
        c, s = np.cos(self.lane), np.sin(self.lane)
        x, y, heading = pose[..., 0], pose[..., 1], pose[..., 2]
        return np.stack([c * x + s * y, c * y - s * x, heading - self.lane], axis=-1)

    def _profile(self, name: str) -> tuple[Floats, Floats]:
        """Return the poses of a sonar in the lane frame, (n, 3), and its readings, m, (n,)."""
        i = self.index[name]
        return self._in_lane(np.array(self._track)[:, i]), np.array(self._readings)[:, i]

    def _spaces_of(self, name: str) -> list[ParkingSpace]:
        poses, reading = self._profile(name)
        return find_spaces(poses[:, 0], reading, self._half[self.index[name]])

    def spaces(self) -> list[ParkingSpace]:
        """Return the spaces that the front sonar on the right has passed."""
        return self._spaces_of("right front")

    def select(self, space: ParkingSpace) -> None:
        """Select a space; its beginning is the mean of the estimates of both sonars on the right."""
        again = self._spaces_of("right rear")
        close = [s.begin for s in again if abs(s.begin - space.begin) < 0.1]
        self.space = ParkingSpace(float(np.mean([space.begin, *close])), space.end)
        self.kerb = self._kerb_y(self.space)

    def _kerb_y(self, space: ParkingSpace) -> float:
        """Return y of the kerb, m, from the readings of the sonars on the right in the middle of the space."""
        face, kerb = [], []
        for name in ("right front", "right rear"):
            poses, reading = self._profile(name)
            inside = (poses[:, 0] > space.begin + 0.3) & (poses[:, 0] < space.end - 0.3) & (reading < 1.0)
            kerb.extend(poses[inside, 1] - reading[inside])
            face.append(float(np.median(poses[:, 1])) - box_distance(reading))
        expected = float(np.mean(face)) - DEPTH
        near = [y for y in kerb if abs(y - expected) < 0.08]
        return float(np.median(near)) if near else expected

    def clearance(self, name: str) -> float:
        """Return the current reading of a sonar, m."""
        return float(self._now[self.index[name]])


def lane_heading(x: Floats, y: Floats, wall: Floats) -> float:
    """Return the heading of the lane, rad, from distances to a wall parallel to it.

    A sonar beside a wall reads its perpendicular distance, so y + wall = offset + slope * x. The slope has a normal
    prior; readings more than three standard deviations off the first fit are excluded from the second.

    Args:
        x: position of the sonar, m, (n,).
        y: position of the sonar, m, (n,).
        wall: readings, m, (n,).
    """
    if len(x) < MIN_RUN:
        return 0.0
    height = y + wall
    near = np.abs(height - np.median(height)) < 0.25
    slope = 0.0
    for _ in range(2):
        if near.sum() >= MIN_RUN:
            slope, offset = _ridge(x[near], height[near])
            near = np.abs(height - offset - slope * x) < 3.0 * READING_SD
    return float(np.arctan(slope))


def _ridge(x: Floats, height: Floats) -> tuple[float, float]:
    dx, dy = x - x.mean(), height - height.mean()
    slope = float(dx @ dy / (dx @ dx + (READING_SD / HEADING_SD) ** 2))
    return slope, float(height.mean() - slope * x.mean())


def find_spaces(along: Floats, reading: Floats, half: float) -> list[ParkingSpace]:
    """Return the spaces that a sideways sonar has passed; the last may have no end yet.

    When the sonar is a distance u past the corner of a box, a cone of half angle h meets the end of the box at the
    range u / sin(h). So where the reading crosses a threshold, the corner lies threshold * sin(h) behind (or ahead of)
    the sonar.

    Args:
        along: positions of the sonar along the lane, increasing, m, (n,).
        reading: m, (n,); any large number for no echo.
        half: half opening angle of the cone, rad.
    """
    smooth = median_filter(reading, size=WINDOW, mode="nearest")
    threshold = box_distance(smooth) + JUMP
    corner = threshold * np.sin(half)
    out: list[ParkingSpace] = []
    before_first_box = True
    for begin, end, far in find_runs(smooth > threshold):
        if far and not before_first_box:
            first = _crossing(along, smooth, begin, threshold) - corner
            last = _crossing(along, smooth, end, threshold) + corner if end < len(along) else np.inf
            out.append(ParkingSpace(first, last))
        before_first_box = before_first_box and far
    return out


def box_distance(reading: Floats) -> float:
    """Return the distance of the boxes, m: the median of the near readings, or 0.2 m if there are none."""
    near = reading[reading < 0.4]
    return float(np.median(near)) if len(near) else 0.2


def find_runs(far: Bits) -> list[tuple[int, int, bool]]:
    """Return begin, end and value of the runs of equal values; a run that is too short joins the one before."""
    out: list[tuple[int, int, bool]] = []
    edges = np.flatnonzero(np.diff(far)) + 1
    for begin, end in zip(np.r_[0, edges], np.r_[edges, len(far)], strict=True):
        kind = bool(far[begin])
        if out and (end - begin < MIN_RUN or out[-1][2] == kind):
            out[-1] = (out[-1][0], int(end), out[-1][2])
        else:
            out.append((int(begin), int(end), kind))
    return out


def _crossing(along: Floats, smooth: Floats, index: int, threshold: float) -> float:
    """Return the position at which the reading crosses the threshold, by linear interpolation, m."""
    low, high = smooth[index - 1], min(smooth[index], 3.0 * threshold)
    share = (threshold - low) / (high - low) if high != low else 0.5
    return float(along[index - 1] + np.clip(share, 0.0, 1.0) * (along[index] - along[index - 1]))
