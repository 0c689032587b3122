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


SIDE, FOOT, SEEN = range(3)  # columns of `views`
N_VIEW = 3


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
def write_view(pose: Floats, axis: Floats, segment: Floats, face: tuple[float, float, float], view: Floats) -> None:
    """Write how a sonar stands to a face: signed distance from its line, foot along it, m, and if it may see it.

    Args:
        pose: pose of the sonar, (3,).
        axis: cosine and sine of its heading, (2,).
        segment: the face, m, (4,).
        face: its direction and length, see `direction`.
        view: written, (N_VIEW,).
    """
    ax, ay, bx, by = segment[0] - pose[0], segment[1] - pose[1], segment[2] - pose[0], segment[3] - pose[1]
    x1, y1 = axis[0] * ax + axis[1] * ay, MIN_COSINE * (axis[0] * ay - axis[1] * ax)
    x2, y2 = axis[0] * bx + axis[1] * by, MIN_COSINE * (axis[0] * by - axis[1] * bx)
    behind = x1 < 0.0 and x2 < 0.0
    left = MAX_SINE * x1 < y1 and MAX_SINE * x2 < y2
    right = MAX_SINE * x1 < -y1 and MAX_SINE * x2 < -y2
    view[SEEN] = 0.0 if behind or left or right else 1.0
    view[SIDE], view[FOOT] = face[1] * ax - face[0] * ay, -(face[0] * ax + face[1] * ay)


@compiled
def direction(segment: Floats) -> tuple[float, float, float]:
    """Return the direction of a face as a unit vector, and its length, m."""
    ex, ey = segment[2] - segment[0], segment[3] - segment[1]
    length = max(math.sqrt(ex * ex + ey * ey), 1e-12)
    return ex / length, ey / length, length


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
def write_mirror(
    a: Floats, b: Floats, segment: Floats, face: tuple[float, float, float], farthest: float, out: Floats
) -> bool:
    """Write distance and point of the path from A by a face to B; return whether there is one.

    Args:
        a: view of A, (N_VIEW,).
        b: view of B; both must be on one side of the face.
        segment: the face, m, (4,).
        face: its direction and length, see `direction`.
        farthest: greatest distance, m.
        out: the path, (N_PATH,).
    """
    across = abs(a[SIDE] + b[SIDE])
    if a[SEEN] == 0.0 or a[SIDE] * b[SIDE] <= 0.0 or across > 2.0 * farthest:
        return False
    along = b[FOOT] - a[FOOT]
    t = a[FOOT] + abs(a[SIDE]) / across * along
    if not 0.0 <= t <= face[2]:
        return False
    out[DISTANCE] = 0.5 * math.sqrt(across * across + along * along)
    out[X], out[Y] = segment[0] + t * face[0], segment[1] + t * face[1]
    return out[DISTANCE] <= farthest


@compiled
def off_axis(x: float, y: float, pose: Floats, axis: Floats) -> float:
    """Return the angle of a point off the axis of a sonar, rad; infinite beyond `MAX_BEARING`."""
    dx, dy = x - pose[0], y - pose[1]
    ahead = axis[0] * dx + axis[1] * dy
    if ahead <= 0.0 or ahead * ahead < MIN_COSINE2 * (dx * dx + dy * dy):
        return math.inf
    return math.atan2(abs(axis[0] * dy - axis[1] * dx), ahead)


@compiled
def level(r: Receivers, a: int, b: int, reflectance: float, limit: float, table: Floats, out: Floats) -> float:
    """Write the conditions of the path at `out` as those of an own echo; return how often it is detected."""
    theta_b = off_axis(out[X], out[Y], r.poses[b], r.axes[b])
    if math.isinf(theta_b):
        return 0.0
    theta_a = off_axis(out[X], out[Y], r.poses[a], r.axes[a])
    if math.isinf(theta_a):
        return 0.0
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
    """Insert a path of another burst before the last own one, in place of the weakest if there are too many."""
    best, paths, weakest, held = r.best[b], r.paths[b], 0, 0
    for k in range(best.shape[0]):
        held += int(best[k] > 0.0)
        weakest = k if best[k] < best[weakest] else weakest
    if best[weakest] == 0.0:  # the own path that is detected most often stays last
        count = r.own[b] + held
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
    to_b, to_a, certain = row[DISTANCE] + shift, row[DISTANCE] - shift, 1.0
    if not (takes(r, b, to_b, certain) or takes(r, a, to_a, certain)):
        return
    often = level(r, a, b, surface[k, 0], limit, table, row)
    b_takes, a_takes = takes(r, b, to_b, often), takes(r, a, to_a, often)
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
    r, row = receivers(poses, fired, sent, limit, table, paths, counts), np.zeros(N_PATH)
    views, late = np.empty((poses.shape[0], N_VIEW)), 0.5 * SOUND_SPEED * (sent.max() - sent.min())
    for k in range(segments.shape[0]):
        row[OBSTACLE], face = owner[k], direction(segments[k])
        for b in range(poses.shape[0]):
            views[b, SEEN] = 0.0
            if not fired[b]:
                continue
            write_view(poses[b], r.axes[b], segments[k], face, views[b])
            if views[b, SEEN] == 0.0:
                continue
            for a in range(b):
                farthest = min(max(r.reach[a], r.reach[b]) + late, limit)
                if write_mirror(views[a], views[b], segments[k], face, farthest, row):
                    add_pair(r, a, b, k, segments, surface, limit, table, row)
