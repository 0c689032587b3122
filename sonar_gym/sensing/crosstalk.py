"""Echoes of other sonars' bursts: by way of a face, from the mirror image of the other sonar.

The path from sonar A by a face to sonar B has the length from the image of A to B, and meets the face at a point that
both must see. B reads half that length, shifted by half the sound's way between the two firings: of a burst sent 20 ms
earlier, an echo from 3.5 to 6.4 m appears within 3 m. So the last burst of each sonar is heard, too. The law is given
the echo that has the same level alone: at half the length, at normal incidence, and at the root mean square of the two
bearings, because a beam's level falls with the square of the bearing (a Gaussian beam). The direct path of sonars that
face outwards is blocked by the car.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from acquisition.arrays import Bits, Floats, Ints
from sonar_gym.compiled import compiled
from sonar_gym.sensing.detection import LISTENING_M, MAX_BEARING, detection
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

# A face heard by way of sonar k of s has number k + 1 times this, and its own; of its previous burst, s + k + 1 times
FACE_STRIDE = 1000
OVERLAP_S = 2.0 * LISTENING_M / SOUND_SPEED  # of bursts sent earlier, echoes come from farther still
NOT_SENT = -np.inf
MIN_COSINE, MAX_SINE = math.cos(MAX_BEARING), math.sin(MAX_BEARING)
MIN_COSINE2 = MIN_COSINE**2


class Bursts(NamedTuple):
    """The m bursts that the s sonars of a car hear: first those of the n pings now, which are heard, then earlier ones.

    Attributes:
        pings: number of pings now, n.
        sonar: sonar of each burst, (m,).
        poses: poses of the sonars, (m, 3).
        axes: cosine and sine of their headings, (m, 2).
        sent: times of the bursts, s, (m,).
        reach: distance of the nearest own path that hides all behind it, m, (n,).
        best: how often the paths of other bursts are detected, 0 for none, (n, MAX_PATHS - MAX_OWN_PATHS); updated.
    """

    pings: int
    sonar: Ints
    poses: Floats
    axes: Floats
    sent: Floats
    reach: Floats
    best: Floats


class Surroundings(NamedTuple):
    """Faces, and how often a reflector is detected.

    Attributes:
        segments: faces, m, (k, 4).
        surface: reflectance and slope of the facets of each face, 1 and rad, (k, 2).
        owner: number of the obstacle of each face, (k,).
        limit: maximum range, m.
        table: see `detection.detection_table`; for distances up to `limit`.
        beyond: see `detection.listening_table`; for distances from there on.
    """

    segments: Floats
    surface: Floats
    owner: Ints
    limit: float
    table: Floats
    beyond: Floats


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
def off_axis(r: Bursts, j: int, x: float, y: float) -> float:
    """Return the angle of a point off the axis of the sonar of burst j, rad."""
    dx, dy = x - r.poses[j, 0], y - r.poses[j, 1]
    return math.atan2(abs(r.axes[j, 0] * dy - r.axes[j, 1] * dx), r.axes[j, 0] * dx + r.axes[j, 1] * dy)


@compiled
def write_level(r: Bursts, i: int, j: int, reflectance: float, around: Surroundings, out: Floats) -> float:
    """Write the conditions of the path at `out` as those of an own echo; return how often it is detected."""
    here, there = off_axis(r, i, out[X], out[Y]), off_axis(r, j, out[X], out[Y])
    out[BEARING], out[REFLECTANCE] = math.sqrt(0.5 * (here * here + there * there)), reflectance
    near = out[DISTANCE] <= around.limit
    table, far = (around.table, around.limit) if near else (around.beyond, LISTENING_M)
    return detection(table, far, out[DISTANCE], out[BEARING], 0.0, reflectance)


@compiled
def takes(r: Bursts, i: int, distance: float, often: float) -> bool:
    """Return whether a ping has room for a path of another burst: not hidden, and not weaker than those it has.

    Args:
        r: the bursts.
        i: number of the ping.
        distance: distance that it would read, m.
        often: how often the path is detected.
    """
    weakest = math.inf
    for k in range(r.best.shape[1]):
        weakest = min(weakest, r.best[i, k])
    return 0.0 < distance <= r.reach[i] and often > weakest


@compiled
def insert(r: Bursts, i: int, row: Floats, often: float, paths: Floats, counts: Ints) -> None:
    """Insert a path of another burst before the last own one, in place of the weakest if there are too many.

    Of all pings together, a car has at most `MAX_OWN_PATHS` paths per sonar; see `sonar.assign_places`.
    """
    best, s, weakest, held, every = r.best[i], r.sonar[i], 0, 0, 0
    for k in range(best.shape[0]):
        held += int(best[k] > 0.0)
        weakest = k if best[k] < best[weakest] else weakest
    for k in range(r.pings):
        every += counts[r.sonar[k]]
    count = counts[s]
    if best[weakest] > 0.0:
        paths[s, count - 1 - held + weakest] = row
    elif every < MAX_OWN_PATHS * counts.shape[0]:
        paths[s, count] = paths[s, count - 1]  # the own path that is detected most often stays last
        paths[s, count - 1] = row
        counts[s] += 1
    else:
        return
    best[weakest] = often


@compiled
def bursts(
    poses: Floats, fired: Bits, sent: Floats, before: Floats, around: Surroundings, paths: Floats, counts: Ints
) -> Bursts:
    """Return the bursts that the sonars of a car hear; see `add_crosstalk`."""
    count = poses.shape[0]
    r = Bursts(
        int(fired.sum()), np.empty(2 * count, np.int64), np.empty((2 * count, 3)), np.empty((2 * count, 2)),
        np.empty(2 * count), np.empty(count), np.zeros((count, MAX_PATHS - MAX_OWN_PATHS)),
    )  # fmt: skip
    j, latest = 0, NOT_SENT
    for s in range(count):
        if fired[s]:
            r.sonar[j], r.poses[j], r.sent[j] = s, poses[s], sent[s]
            r.reach[j] = reach_of(paths[s], counts[s], around.limit, around.table)
            j, latest = j + 1, max(latest, sent[s])
    for s in range(count):
        if before[s, 3] > latest - OVERLAP_S:
            r.sonar[j], r.poses[j], r.sent[j] = s, before[s, :3], before[s, 3]
            j += 1
    for k in range(j):
        r.axes[k, 0], r.axes[k, 1] = math.cos(r.poses[k, 2]), math.sin(r.poses[k, 2])
    return Bursts(r.pings, r.sonar[:j], r.poses[:j], r.axes[:j], r.sent[:j], r.reach, r.best)


@compiled
def farthest_of(reach: float, other_reach: float, shift: float) -> float:
    """Return the greatest distance of a path between a ping and another burst that either reads, m.

    Args:
        reach: of the ping, m.
        other_reach: of the other burst, m; -inf if that is an earlier one, which hears nothing now.
        shift: what the ping adds to the distance, m; the other burst subtracts it.
    """
    return min(max(reach - shift, other_reach + shift), LISTENING_M)


@compiled
def add_path(r: Bursts, i: int, j: int, k: int, around: Surroundings, row: Floats, paths: Floats, counts: Ints) -> None:
    """Add the path at `row` between ping i and burst j by face k to ping i, and to ping j in the opposite direction."""
    shift = 0.5 * SOUND_SPEED * (r.sent[j] - r.sent[i])  # of what i reads; j reads the opposite
    often = write_level(r, i, j, around.surface[k, 0], around, row)
    heard = takes(r, i, row[DISTANCE] + shift, often)
    heard_by_j = j < r.pings and takes(r, j, row[DISTANCE] - shift, often)
    if often < MIN_DETECTION or not (heard or heard_by_j):
        return
    for b in (i, j):
        if blocked(r.poses[b, 0], r.poses[b, 1], row[X], row[Y], around.segments, k):
            return
    row[TEXTURE] = around.surface[k, 1]
    earlier = 0 if j < r.pings else counts.shape[0]
    if heard_by_j:
        row[FACE], row[SHIFT], row[SOURCE] = FACE_STRIDE * (r.sonar[i] + 1) + k, -shift, r.sonar[i] + 1.0
        insert(r, j, row, often, paths, counts)
    if heard:
        row[FACE], row[SHIFT] = FACE_STRIDE * (earlier + r.sonar[j] + 1) + k, shift
        row[SOURCE] = r.sonar[j] + 1.0
        insert(r, i, row, often, paths, counts)


@compiled
def add_crosstalk(
    poses: Floats, fired: Bits, sent: Floats, before: Floats, around: Surroundings, paths: Floats, counts: Ints
) -> None:
    """Add the paths of other bursts to the pings of one car, in place; see `paths.cast_paths`.

    Args:
        poses: poses of the sonars, (s, 3).
        fired: whether each sonar has fired, (s,).
        sent: time of its ping, s, (s,).
        before: pose and time of the previous ping of each, m, m, rad, s, (s, 4), `NOT_SENT` for none; replaced by this
            one.
        around: faces, and how often a reflector is detected.
        paths: paths of the pings, (s, MAX_PATHS, N_PATH).
        counts: number of paths, (s,).
    """
    r, row = bursts(poses, fired, sent, before, around, paths, counts), np.zeros(N_PATH)
    if r.pings > 0:
        add_paths(r, around, row, paths, counts)
    for s in range(poses.shape[0]):
        if fired[s]:
            before[s, :3], before[s, 3] = poses[s], sent[s]


@compiled
def add_paths(r: Bursts, around: Surroundings, row: Floats, paths: Floats, counts: Ints) -> None:
    """Add the paths between all pings and bursts by all faces; `row` is scratch."""
    count, segments, reach, sent = r.sonar.shape[0], around.segments, r.reach, r.sent
    seen, sides, feet = np.empty(count, np.bool_), np.empty(count), np.empty(count)
    for k in range(segments.shape[0]):
        x1, y1, x2, y2 = segments[k, 0], segments[k, 1], segments[k, 2], segments[k, 3]
        length = max(math.sqrt((x2 - x1) ** 2 + (y2 - y1) ** 2), 1e-12)
        ux, uy = (x2 - x1) / length, (y2 - y1) / length
        for j in range(count):
            jx, jy, cj, sj = r.poses[j, 0], r.poses[j, 1], r.axes[j, 0], r.axes[j, 1]
            seen[j], sides[j], feet[j] = view_of(x1 - jx, y1 - jy, x2 - jx, y2 - jy, cj, sj, ux, uy)
            if not seen[j]:
                continue
            other_reach = reach[j] if j < r.pings else -np.inf
            for i in range(min(j, r.pings)):
                if not seen[i]:
                    continue
                farthest = farthest_of(reach[i], other_reach, 0.5 * SOUND_SPEED * (sent[j] - sent[i]))
                distance, t = mirror(sides[i], feet[i], sides[j], feet[j], length, farthest)
                x, y = x1 + t * ux, y1 + t * uy
                if (
                    distance <= farthest
                    and in_beam(x - jx, y - jy, cj, sj)
                    and in_beam(x - r.poses[i, 0], y - r.poses[i, 1], r.axes[i, 0], r.axes[i, 1])
                ):
                    row[DISTANCE], row[X], row[Y], row[OBSTACLE] = distance, x, y, around.owner[k]
                    add_path(r, i, j, k, around, row, paths, counts)
