"""Echoes of other sonars' bursts: by way of a face, from the mirror image of the other sonar.

The path from sonar A by a face to sonar B has the length from the image of A to B, and meets the face at a point that
both must see. B reads half that length, shifted by half the sound's way between the two firings. The law is given the
echo that has the same level alone: at half the length, at normal incidence, and at the root mean square of the two
bearings, because a beam's level falls with the square of the bearing (a Gaussian beam). The direct path of sonars that
face outwards is blocked by the car.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from acquisition.arrays import Bits, Floats, Ints
from sonar_gym.compiled import compiled
from sonar_gym.sensing.detection import MAX_BEARING, detection
from sonar_gym.sensing.kernels import SOUND_SPEED, blocked
from sonar_gym.sensing.paths import (
    BEARING,
    CERTAIN,
    DISTANCE,
    FACE,
    INCIDENCE,
    MAX_OWN_PATHS,
    MAX_PATHS,
    MIN_DETECTION,
    N_PATH,
    OBSTACLE,
    REFLECTANCE,
    SHIFT,
    SOURCE,
    TEXTURE,
    X,
    Y,
)

FACE_STRIDE = 1000  # a face heard by way of sonar k has number k + 1 times this, and its own
MIN_COSINE, MAX_SINE = math.cos(MAX_BEARING), math.sin(MAX_BEARING)
MIN_COSINE2 = MIN_COSINE**2


class Receivers(NamedTuple):
    """What the s sonars of a car receive.

    Attributes:
        poses: poses of the sonars, (s, 3).
        axes: cosine and sine of their headings, (s, 2).
        fired: whether each has fired, (s,).
        sent: time of its ping, s, (s,).
        own: number of its own paths, (s,).
        reach: distance of the nearest own path that hides all behind it, m, (s,).
        best: how often its paths of other bursts are detected, 0 for none, (s, MAX_PATHS - MAX_OWN_PATHS); updated.
        paths: paths of its ping, (s, MAX_PATHS, N_PATH); updated.
        counts: number of these, (s,); updated.
    """

    poses: Floats
    axes: Floats
    fired: Bits
    sent: Floats
    own: Ints
    reach: Floats
    best: Floats
    paths: Floats
    counts: Ints


@compiled
def view_of(
    dx1: float, dy1: float, dx2: float, dy2: float, cosine: float, sine: float, ux: float, uy: float
) -> tuple[bool, float, float]:
    """Return whether a sonar may see a face, its signed distance from the face's line, and its foot along it, m.

    Args:
        dx1: end of the face from the sonar along x, m; so the other ends and axes.
        dy1: see `dx1`.
        dx2: see `dx1`.
        dy2: see `dx1`.
        cosine: of the heading of the sonar.
        sine: of the heading of the sonar.
        ux: direction of the face along x.
        uy: direction of the face along y.
    """
    x1, y1 = cosine * dx1 + sine * dy1, MIN_COSINE * (cosine * dy1 - sine * dx1)
    x2, y2 = cosine * dx2 + sine * dy2, MIN_COSINE * (cosine * dy2 - sine * dx2)
    behind = x1 < 0.0 and x2 < 0.0
    left = MAX_SINE * x1 < y1 and MAX_SINE * x2 < y2
    right = MAX_SINE * x1 < -y1 and MAX_SINE * x2 < -y2
    return not (behind or left or right), uy * dx1 - ux * dy1, -(ux * dx1 + uy * dy1)


@compiled
def mirror(
    side_a: float, foot_a: float, side_b: float, foot_b: float, length: float, farthest: float
) -> tuple[float, float]:
    """Return the distance of the path from A by a face to B, and its foot along the face, m; infinite if there is none.

    Args:
        side_a: distance of A from the face's line, m; its sign tells the sides apart.
        foot_a: foot of A along the face, m.
        side_b: that of B, m.
        foot_b: that of B, m.
        length: length of the face, m.
        farthest: greatest distance, m.
    """
    across, along = abs(side_a + side_b), foot_b - foot_a
    if side_a * side_b <= 0.0 or across > 2.0 * farthest:
        return math.inf, 0.0
    t = foot_a + abs(side_a) / across * along
    distance = 0.5 * math.sqrt(across * across + along * along)
    return (distance, t) if 0.0 <= t <= length and distance <= farthest else (math.inf, 0.0)


@compiled
def reach_of(paths: Floats, count: int, limit: float, table: Floats) -> float:
    """Return the distance of the nearest own path that hides all behind it, m."""
    reach = limit
    for j in range(count):
        own = paths[j]
        if own[OBSTACLE] >= 0.0 and own[DISTANCE] < reach:
            often = detection(table, limit, own[DISTANCE], own[BEARING], own[INCIDENCE], own[REFLECTANCE])
            reach = own[DISTANCE] if often >= CERTAIN else reach
    return reach


@compiled
def in_beam(dx: float, dy: float, cosine: float, sine: float) -> bool:
    """Return whether a point from a sonar, m, is at most `MAX_BEARING` off its axis."""
    ahead = cosine * dx + sine * dy
    return ahead > 0.0 and ahead * ahead >= MIN_COSINE2 * (dx * dx + dy * dy)


@compiled
def off_axis(r: Receivers, s: int, x: float, y: float) -> float:
    """Return the angle of a point off the axis of a sonar, rad."""
    dx, dy = x - r.poses[s, 0], y - r.poses[s, 1]
    return math.atan2(abs(r.axes[s, 0] * dy - r.axes[s, 1] * dx), r.axes[s, 0] * dx + r.axes[s, 1] * dy)


@compiled
def write_level(r: Receivers, a: int, b: int, reflectance: float, limit: float, table: Floats, out: Floats) -> float:
    """Write the conditions of the path at `out` as those of an own echo; return how often it is detected."""
    theta_a, theta_b = off_axis(r, a, out[X], out[Y]), off_axis(r, b, out[X], out[Y])
    out[BEARING], out[REFLECTANCE] = math.sqrt(0.5 * (theta_a * theta_a + theta_b * theta_b)), reflectance
    return detection(table, limit, out[DISTANCE], out[BEARING], 0.0, reflectance)


@compiled
def takes(r: Receivers, b: int, distance: float, often: float) -> bool:
    """Return whether a sonar's ping has room for a path of another burst: not hidden, and not weaker than those it has.

    Args:
        r: the sonars.
        b: number of the sonar.
        distance: distance that it would read, m.
        often: how often the path is detected.
    """
    weakest = math.inf
    for k in range(r.best.shape[1]):
        weakest = min(weakest, r.best[b, k])
    return 0.0 < distance <= r.reach[b] and often > weakest


@compiled
def insert(r: Receivers, b: int, row: Floats, often: float) -> None:
    """Insert a path of another burst before the last own one, in place of the weakest if there are too many.

    Of all sonars together, a car has at most `MAX_OWN_PATHS` paths per sonar; see `sonar.assign_places`.
    """
    best, paths, weakest, every = r.best[b], r.paths[b], 0, 0
    for k in range(best.shape[0]):
        weakest = k if best[k] < best[weakest] else weakest
    for s in range(r.fired.shape[0]):
        every += r.counts[s] if r.fired[s] else 0
    if best[weakest] == 0.0:
        if every >= MAX_OWN_PATHS * r.fired.shape[0]:
            return
        count = r.counts[b]  # the own path that is detected most often stays last
        paths[count] = paths[count - 1]
        paths[count - 1] = row
        r.counts[b] += 1
    else:
        paths[r.own[b] - 1 + weakest] = row
    best[weakest] = often


@compiled
def receivers(
    poses: Floats, fired: Bits, sent: Floats, limit: float, table: Floats, paths: Floats, counts: Ints
) -> Receivers:
    """Return what the sonars of a car receive before the bursts of others are added; see `add_crosstalk`."""
    count = poses.shape[0]
    r = Receivers(
        poses, np.empty((count, 2)), fired, sent, counts.copy(), np.zeros(count),
        np.zeros((count, MAX_PATHS - MAX_OWN_PATHS)), paths, counts,
    )  # fmt: skip
    for s in range(count):
        r.axes[s, 0], r.axes[s, 1] = math.cos(poses[s, 2]), math.sin(poses[s, 2])
        if fired[s]:
            r.reach[s] = reach_of(paths[s], counts[s], limit, table)
    return r


@compiled
def add_pair(
    r: Receivers, a: int, b: int, k: int, segments: Floats, surface: Floats, limit: float, table: Floats, row: Floats
) -> None:
    """Add the path at `row` between sonars A and B by face k, which is the same in both directions, to both pings."""
    shift = 0.5 * SOUND_SPEED * (r.sent[a] - r.sent[b])  # of what B reads; A reads the opposite
    often = write_level(r, a, b, surface[k, 0], limit, table, row)
    b_takes, a_takes = takes(r, b, row[DISTANCE] + shift, often), takes(r, a, row[DISTANCE] - shift, often)
    if often < MIN_DETECTION or not (b_takes or a_takes):
        return
    for s in (a, b):
        if blocked(r.poses[s, 0], r.poses[s, 1], row[X], row[Y], segments, k):
            return
    row[TEXTURE] = surface[k, 1]
    if b_takes:
        row[FACE], row[SHIFT], row[SOURCE] = FACE_STRIDE * (a + 1) + k, shift, a + 1.0
        insert(r, b, row, often)
    if a_takes:
        row[FACE], row[SHIFT], row[SOURCE] = FACE_STRIDE * (b + 1) + k, -shift, b + 1.0
        insert(r, a, row, often)


@compiled
def add_crosstalk(
    poses: Floats,
    fired: Bits,
    sent: Floats,
    segments: Floats,
    surface: Floats,
    owner: Ints,
    limit: float,
    table: Floats,
    paths: Floats,
    counts: Ints,
) -> None:
    """Add the paths of other sonars' bursts to the pings of one car, in place; see `paths.cast_paths`.

    Args:
        poses: poses of the sonars, (s, 3).
        fired: whether each sonar has fired, (s,).
        sent: time of its ping, s, (s,).
        segments: faces, m, (m, 4).
        surface: reflectance and slope of the facets of each face, 1 and rad, (m, 2).
        owner: number of the obstacle of each face, (m,).
        limit: maximum distance, m.
        table: see `detection.detection_table`.
        paths: paths of the pings, (s, MAX_PATHS, N_PATH).
        counts: number of paths, (s,).
    """
    r, row, count = receivers(poses, fired, sent, limit, table, paths, counts), np.zeros(N_PATH), poses.shape[0]
    seen, sides, feet = np.empty(count, np.bool_), np.empty(count), np.empty(count)
    late = 0.5 * SOUND_SPEED * (sent.max() - sent.min())
    for k in range(segments.shape[0]):
        x1, y1, x2, y2 = segments[k, 0], segments[k, 1], segments[k, 2], segments[k, 3]
        length = max(math.sqrt((x2 - x1) ** 2 + (y2 - y1) ** 2), 1e-12)
        ux, uy = (x2 - x1) / length, (y2 - y1) / length
        for b in range(count):
            bx, by, cb, sb = poses[b, 0], poses[b, 1], r.axes[b, 0], r.axes[b, 1]
            seen[b], sides[b], feet[b] = view_of(x1 - bx, y1 - by, x2 - bx, y2 - by, cb, sb, ux, uy)
            if not (seen[b] and fired[b]):
                seen[b] = False
                continue
            for a in range(b):
                if not seen[a]:
                    continue
                farthest = min(max(r.reach[a], r.reach[b]) + late, limit)
                distance, t = mirror(sides[a], feet[a], sides[b], feet[b], length, farthest)
                x, y = x1 + t * ux, y1 + t * uy
                if (
                    distance <= farthest
                    and in_beam(x - bx, y - by, cb, sb)
                    and in_beam(x - poses[a, 0], y - poses[a, 1], r.axes[a, 0], r.axes[a, 1])
                ):
                    row[DISTANCE], row[X], row[Y], row[OBSTACLE] = distance, x, y, owner[k]
                    add_pair(r, a, b, k, segments, surface, limit, table, row)
