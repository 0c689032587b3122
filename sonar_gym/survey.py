"""What the driver makes of its sonars on the way: how the lane lies, where the boxes end, where the kerb is.

Everything is told in odometry's frame: metres along and left of the first heading, at the rear axle.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

Floats = NDArray[np.float64]
JUMP = 0.12  # m; a space is where a side sonar reads this much more than beside the boxes
WINDOW = 5  # readings; the running median that takes single wrong readings out
LEAST_RUN = 3  # readings; a shorter run of near or far is taken for a fault
HEADING_SPREAD = 0.03  # rad; how far off the lane the car may have been set down
READING_SPREAD = 0.02  # m; of a wall's distance, roughly


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
