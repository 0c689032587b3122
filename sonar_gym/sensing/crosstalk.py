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
MIN_COSINE2 = math.cos(MAX_BEARING) ** 2
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


@compiled
def mirror_point(ax: float, ay: float, bx: float, by: float, segment: Floats) -> tuple[float, float, float]:
    """Return where a face reflects sound from (ax, ay) to (bx, by), and the length of the path; 0 for nowhere, m."""
    ex, ey = segment[2] - segment[0], segment[3] - segment[1]
    length2 = ex * ex + ey * ey
    side_a, side_b = (
        ex * (ay - segment[1]) - ey * (ax - segment[0]),
        ex * (by - segment[1]) - ey * (bx - segment[0]),
    )
    if side_a * side_b <= 0.0:
        return 0.0, 0.0, 0.0
    share = side_a / (side_a + side_b)  # of the way along the face from the foot of A to that of B
    foot_a = (ex * (ax - segment[0]) + ey * (ay - segment[1])) / length2
    foot_b = (ex * (bx - segment[0]) + ey * (by - segment[1])) / length2
    t = foot_a + share * (foot_b - foot_a)
    if not 0.0 <= t <= 1.0:
        return 0.0, 0.0, 0.0
    across, along = (abs(side_a) + abs(side_b)) / math.sqrt(length2), (foot_b - foot_a) * math.sqrt(length2)
    return segment[0] + t * ex, segment[1] + t * ey, math.sqrt(across * across + along * along)


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
    cosines, sines = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    best, row = np.zeros(MAX_PATHS - MAX_OWN_PATHS), np.zeros(paths.shape[2])
    for b in range(poses.shape[0]):
        best[:] = 0.0
        own_count, reach = counts[b], limit
        for j in range(own_count):
            own = paths[b, j]
            if own[OBSTACLE] >= 0.0 and own[DISTANCE] < reach:
                often = detection(table, limit, own[DISTANCE], own[BEARING], own[INCIDENCE], own[REFLECTANCE])
                reach = own[DISTANCE] if often >= CERTAIN else reach
        for a in range(poses.shape[0]):
            shift = 0.5 * SOUND_SPEED * (sent[a] - sent[b])
            if a == b or not (fired[a] and fired[b]) or abs(shift) >= limit:
                continue
            for k in range(segments.shape[0]):
                x, y, length = mirror_point(poses[a, 0], poses[a, 1], poses[b, 0], poses[b, 1], segments[k])
                if length <= 0.0 or 0.5 * length > limit or not 0.0 < 0.5 * length + shift <= reach:
                    continue
                if not (
                    in_front(x, y, poses[b], cosines[b], sines[b]) and in_front(x, y, poses[a], cosines[a], sines[a])
                ):
                    continue
                theta_a, theta_b = off_axis(x, y, poses[a]), off_axis(x, y, poses[b])
                bearing = math.sqrt(0.5 * (theta_a * theta_a + theta_b * theta_b))
                often = detection(table, limit, 0.5 * length, bearing, 0.0, surface[k, 0])
                weakest = int(np.argmin(best))
                if often < MIN_DETECTION or often <= best[weakest]:
                    continue
                if blocked(poses[a, 0], poses[a, 1], x, y, segments, k) or blocked(
                    poses[b, 0], poses[b, 1], x, y, segments, k
                ):
                    continue
                row[DISTANCE], row[BEARING], row[INCIDENCE], row[REFLECTANCE] = (
                    0.5 * length,
                    bearing,
                    0.0,
                    surface[k, 0],
                )
                row[OBSTACLE], row[FACE], row[X], row[Y] = owner[k], FACE_STRIDE * (a + 1) + k, x, y
                row[TEXTURE], row[SHIFT], row[SOURCE] = surface[k, 1], shift, a + 1.0
                if best[weakest] == 0.0:  # the own path that is detected most often stays last
                    paths[b, counts[b]] = paths[b, counts[b] - 1]
                    paths[b, counts[b] - 1] = row
                    counts[b] += 1
                else:
                    paths[b, own_count - 1 + weakest] = row
                best[weakest] = often
