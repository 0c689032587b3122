"""Echoes of other sonars' bursts: by way of a face, from the mirror image of the other sonar.

The path from sonar A by a face to sonar B has the length from the image of A to B, and meets the face at a point that
both must see. B reads half that length, shifted by half the sound's way between the two firings. The law is given the
echo that has the same level alone: at half the length, at normal incidence, and at the root mean square of the two
bearings, because a beam's level falls with the square of the bearing (a Gaussian beam). The direct path of sonars that
face outwards is blocked by the car.
"""

from __future__ import annotations

import math

import numpy as np

from acquisition.arrays import Bits, Floats, Ints
from sonar_gym.compiled import compiled
from sonar_gym.sensing.detection import MAX_BEARING, detection
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

SOUND_SPEED = 343.0  # m/s, air of 20 degC
FACE_STRIDE = 1000  # a face heard by way of sonar k has number k + 1 times this, and its own
MIN_COSINE, MAX_SINE = math.cos(MAX_BEARING), math.sin(MAX_BEARING)
MIN_COSINE2 = MIN_COSINE**2
CLEAR = 1e-6  # part of a leg at its ends in which no other face blocks it


@compiled
def off_axis(x: float, y: float, pose: Floats) -> float:
    """Return the angle of a point off the axis of a sonar, rad."""
    return abs((math.atan2(y - pose[1], x - pose[0]) - pose[2] + math.pi) % (2.0 * math.pi) - math.pi)


@compiled
def in_front(x: float, y: float, pose: Floats, cosine: float, sine: float) -> bool:
    """Return whether a point is within `MAX_BEARING` of the axis of a sonar, whose direction is given."""
    dx, dy = x - pose[0], y - pose[1]
    ahead = cosine * dx + sine * dy
    return ahead > 0.0 and ahead * ahead >= MIN_COSINE2 * (dx * dx + dy * dy)


@compiled
def blocked(x1: float, y1: float, x2: float, y2: float, segments: Floats, own: int) -> bool:
    """Return whether a face other than `own` crosses the straight line between two points."""
    dx, dy = x2 - x1, y2 - y1
    for k in range(segments.shape[0]):
        ex, ey = segments[k, 2] - segments[k, 0], segments[k, 3] - segments[k, 1]
        turn = dx * ey - dy * ex
        if k == own or turn == 0.0:
            continue
        t = ((segments[k, 0] - x1) * ey - (segments[k, 1] - y1) * ex) / turn
        u = ((segments[k, 0] - x1) * dy - (segments[k, 1] - y1) * dx) / turn
        if CLEAR < t < 1.0 - CLEAR and 0.0 <= u <= 1.0:
            return True
    return False


SIDE, FOOT, SEEN = range(3)  # columns of `views`
N_VIEW = 3


@compiled
def write_view(pose: Floats, cosine: float, sine: float, segment: Floats, view: Floats) -> None:
    """Write how a sonar stands to a face: signed distance from its line, foot along it, m, and if it may see it."""
    ax, ay = segment[0] - pose[0], segment[1] - pose[1]
    ex, ey = segment[2] - segment[0], segment[3] - segment[1]
    x1, y1 = cosine * ax + sine * ay, cosine * ay - sine * ax
    x2, y2 = x1 + cosine * ex + sine * ey, y1 + cosine * ey - sine * ex
    behind = x1 < 0.0 and x2 < 0.0
    left = MAX_SINE * x1 < MIN_COSINE * y1 and MAX_SINE * x2 < MIN_COSINE * y2
    right = MAX_SINE * x1 < -MIN_COSINE * y1 and MAX_SINE * x2 < -MIN_COSINE * y2
    view[SEEN] = 0.0 if behind or left or right else 1.0
    if view[SEEN] > 0.0:
        length = math.sqrt(ex * ex + ey * ey)
        view[SIDE], view[FOOT] = (ey * ax - ex * ay) / length, -(ex * ax + ey * ay) / length


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
def write_mirror(view_a: Floats, view_b: Floats, segment: Floats, out: Floats) -> bool:
    """Write distance and point of the path from A by a face to B, if both see one side of it at a point on it."""
    if view_a[SEEN] == 0.0 or view_a[SIDE] * view_b[SIDE] <= 0.0:
        return False
    ex, ey = segment[2] - segment[0], segment[3] - segment[1]
    across, along = abs(view_a[SIDE] + view_b[SIDE]), view_b[FOOT] - view_a[FOOT]
    size = math.sqrt(ex * ex + ey * ey)
    t = (view_a[FOOT] + abs(view_a[SIDE]) / across * along) / size
    out[DISTANCE] = 0.5 * math.sqrt(across * across + along * along)
    out[X], out[Y] = segment[0] + t * ex, segment[1] + t * ey
    return 0.0 <= t <= 1.0


@compiled
def insert(row: Floats, often: float, paths: Floats, own_count: int, best: Floats) -> int:
    """Insert a path of another burst before the last own one, in place of the weakest if there are too many.

    Args:
        row: the path.
        often: how often it is detected.
        paths: paths of the ping.
        own_count: number of its own paths.
        best: how often those of other bursts are detected, 0 for none; updated.

    Returns:
        The number of paths added.
    """
    weakest = int(np.argmin(best))
    added = int(best[weakest] == 0.0)
    if added:  # the own path that is detected most often stays last
        count = own_count + int(np.sum(best > 0.0))
        paths[count] = paths[count - 1]
        paths[count - 1] = row
    else:
        paths[own_count - 1 + weakest] = row
    best[weakest] = often
    return added


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
    count, faces = poses.shape[0], segments.shape[0]
    views, row = np.empty((count, faces, N_VIEW)), np.zeros(N_PATH)
    axes, best = np.empty((count, 2)), np.empty(MAX_PATHS - MAX_OWN_PATHS)
    for s in range(count):
        axes[s, 0], axes[s, 1] = math.cos(poses[s, 2]), math.sin(poses[s, 2])
        for k in range(faces):
            write_view(poses[s], axes[s, 0], axes[s, 1], segments[k], views[s, k])
    for b in range(count):
        if not fired[b]:
            continue
        best[:] = 0.0
        own_count, reach = counts[b], reach_of(paths[b], counts[b], limit, table)
        for k in range(faces):
            if views[b, k, SEEN] == 0.0:
                continue
            for a in range(count):
                shift = 0.5 * SOUND_SPEED * (sent[a] - sent[b])
                if a == b or not fired[a] or not write_mirror(views[a, k], views[b, k], segments[k], row):
                    continue
                if row[DISTANCE] > limit or not 0.0 < row[DISTANCE] + shift <= reach:
                    continue
                often = level(poses, axes, a, b, surface[k, 0], limit, table, row)
                if often < MIN_DETECTION or often <= best.min():
                    continue
                if blocked(poses[a, 0], poses[a, 1], row[X], row[Y], segments, k) or blocked(
                    poses[b, 0], poses[b, 1], row[X], row[Y], segments, k
                ):
                    continue
                row[OBSTACLE], row[FACE], row[TEXTURE] = owner[k], FACE_STRIDE * (a + 1) + k, surface[k, 1]
                row[SHIFT], row[SOURCE] = shift, a + 1.0
                counts[b] += insert(row, often, paths[b], own_count, best)


@compiled
def level(
    poses: Floats, axes: Floats, a: int, b: int, reflectance: float, limit: float, table: Floats, out: Floats
) -> float:
    """Write the conditions of the path at `out` as those of an own echo; return how often it is detected."""
    x, y = out[X], out[Y]
    if not (in_front(x, y, poses[b], axes[b, 0], axes[b, 1]) and in_front(x, y, poses[a], axes[a, 0], axes[a, 1])):
        return 0.0
    theta_a, theta_b = off_axis(x, y, poses[a]), off_axis(x, y, poses[b])
    out[BEARING], out[REFLECTANCE] = math.sqrt(0.5 * (theta_a * theta_a + theta_b * theta_b)), reflectance
    return detection(table, limit, out[DISTANCE], out[BEARING], 0.0, reflectance)
