"""Geometry on plain arrays, compiled by numba: pure functions, one world at a time.

Segments are rows (x1, y1, x2, y2) in m; poses are rows (x, y, heading) in m, m, rad. Angles count anticlockwise.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from sonar_gym.compiled import compiled

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
NOTHING = -1  # index of the hit where a cone is empty
TIE = 1e-9  # m; two faces that meet in a corner are equally near up to rounding


@compiled
def clip_half_plane(f0: float, f1: float, low: float, high: float) -> tuple[float, float]:
    """Narrow [low, high] to where f0 + t (f1 - f0) >= 0; an empty interval has low > high."""
    slope = f1 - f0
    if slope == 0.0:
        return (low, high) if f0 >= 0.0 else (1.0, 0.0)
    t = -f0 / slope
    return (max(low, t), high) if slope > 0.0 else (low, min(high, t))


@compiled
def to_frame(x: float, y: float, pose: Floats) -> tuple[float, float]:
    """Return a point of the world in the frame of a pose."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    dx, dy = x - pose[0], y - pose[1]
    return c * dx + s * dy, c * dy - s * dx


@compiled
def nearest_in_wedge(
    x1: float, y1: float, x2: float, y2: float, cosine: float, sine: float
) -> tuple[float, float, bool]:
    """Return the point of a segment nearest to the origin among those within a wedge about the x axis.

    A wedge below half a turn is convex, so the segment's part inside is one piece, and the nearest point of a piece
    is the foot of the perpendicular, clamped to it. Cosine and sine are those of half the wedge's opening angle.
    """
    left1, left2 = sine * x1 - cosine * y1, sine * x2 - cosine * y2
    right1, right2 = sine * x1 + cosine * y1, sine * x2 + cosine * y2
    if (left1 < 0.0 and left2 < 0.0) or (right1 < 0.0 and right2 < 0.0):
        return 0.0, 0.0, False  # most are passed over here, without a division
    low, high = clip_half_plane(left1, left2, 0.0, 1.0)
    low, high = clip_half_plane(right1, right2, low, high)
    if low > high:
        return 0.0, 0.0, False
    dx, dy = x2 - x1, y2 - y1
    square = dx * dx + dy * dy
    foot = -(x1 * dx + y1 * dy) / square if square > 0.0 else 0.0
    t = min(max(foot, low), high)
    return x1 + t * dx, y1 + t * dy, True


@compiled
def squareness(x: float, y: float, dx: float, dy: float) -> float:
    """Return the cosine of the angle between the ray to (x, y) and the normal of a face along (dx, dy), 0 to 1."""
    scale = math.sqrt((x * x + y * y) * (dx * dx + dy * dy))
    return min(1.0, abs(x * dy - y * dx) / scale) if scale > 0.0 else 1.0


@compiled
def out_of_frame(x: float, y: float, pose: Floats) -> tuple[float, float]:
    """Return a point in the frame of a pose in the world."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    return pose[0] + c * x - s * y, pose[1] + s * x + c * y


@compiled
def cast_cone(
    x: float, y: float, heading: float, half: float, segments: Floats, limit: float
) -> tuple[float, float, float, int, float, float]:
    """Find the nearest point of any segment within one cone; see `cast_cones`. Faces wholly behind are passed over."""
    best, square, index, at_x, at_y = limit, 0.0, NOTHING, 0.0, 0.0
    c, s, cosine, sine = math.cos(heading), math.sin(heading), math.cos(half), math.sin(half)
    for k in range(segments.shape[0]):
        ax, ay, bx, by = segments[k, 0] - x, segments[k, 1] - y, segments[k, 2] - x, segments[k, 3] - y
        x1, x2 = c * ax + s * ay, c * bx + s * by
        if (x1 < 0.0 and x2 < 0.0) or (x1 > best + TIE and x2 > best + TIE):
            continue
        y1, y2 = c * ay - s * ax, c * by - s * bx
        px, py, inside = nearest_in_wedge(x1, y1, x2, y2, cosine, sine)
        away = math.sqrt(px * px + py * py)
        if not inside or away > best + TIE or away > limit:
            continue
        met = squareness(px, py, x2 - x1, y2 - y1)
        if away < best - TIE or index == NOTHING or met > square:
            best, square, index, at_x, at_y = away, met, k, px, py
    if index == NOTHING:
        return limit, 0.0, 0.0, NOTHING, x, y
    bearing = math.atan2(at_y, at_x) if best > TIE else 0.0  # on the face itself no direction is left
    return best, bearing, math.acos(square), index, x + c * at_x - s * at_y, y + s * at_x + c * at_y


@compiled
def cast_cones(
    poses: Floats, half: Floats, segments: Floats, limit: float
) -> tuple[Floats, Floats, Floats, Ints, Floats]:
    """Find for each cone the nearest point of any segment within it.

    The line to the nearest point of all lies inside the convex cone, so nothing can stand in its way: no occlusion
    test is needed.

    Args:
        poses: of the sensors, (s, 3).
        half: half opening angles, rad, below pi/2, (s,).
        segments: (m, 4).
        limit: nothing farther is found, m.

    Returns:
        distance, m, (s,), `limit` where the cone is empty; bearing off the axis, rad, (s,); incidence to the
        surface normal, rad, (s,), of the face met more squarely where two meet; segment's index, (s,), -1 for none;
        point in the world, m, (s, 2).
    """
    count = poses.shape[0]
    distance, bearing, incidence = np.empty(count), np.empty(count), np.empty(count)
    index, point = np.empty(count, np.int64), np.zeros((count, 2))
    for i in range(count):
        found = cast_cone(poses[i, 0], poses[i, 1], poses[i, 2], half[i], segments, limit)
        distance[i], bearing[i], incidence[i], index[i], x, y = found
        if index[i] != NOTHING:
            point[i, 0], point[i, 1] = x, y
    return distance, bearing, incidence, index, point


@compiled
def mounted(mounts: Floats, car: Floats) -> Floats:
    """Return poses of the car's frame in the world, (s, 3)."""
    out = np.empty_like(mounts)
    for i in range(mounts.shape[0]):
        out[i, 0], out[i, 1] = out_of_frame(mounts[i, 0], mounts[i, 1], car)
        out[i, 2] = car[2] + mounts[i, 2]
    return out


@compiled
def touches(pose: Floats, body: Floats, segments: Floats) -> int:
    """Return the first segment that meets a rectangle, or -1.

    Args:
        pose: of the body's frame, (3,).
        body: the rectangle in that frame, (rear, right, front, left), m.
        segments: (m, 4).
    """
    c, s = math.cos(pose[2]), math.sin(pose[2])
    for k in range(segments.shape[0]):
        ax, ay, bx, by = (
            segments[k, 0] - pose[0],
            segments[k, 1] - pose[1],
            segments[k, 2] - pose[0],
            segments[k, 3] - pose[1],
        )
        x1, x2 = c * ax + s * ay, c * bx + s * by
        if max(x1, x2) < body[0] or min(x1, x2) > body[2]:
            continue
        y1, y2 = c * ay - s * ax, c * by - s * bx
        low, high = clip_half_plane(x1 - body[0], x2 - body[0], 0.0, 1.0)
        low, high = clip_half_plane(body[2] - x1, body[2] - x2, low, high)
        low, high = clip_half_plane(y1 - body[1], y2 - body[1], low, high)
        low, high = clip_half_plane(body[3] - y1, body[3] - y2, low, high)
        if low <= high:
            return k
    return NOTHING


@compiled
def approach(value: float, target: float, rate: float, lag: float, dt: float) -> float:
    """Return a first-order follower's value after dt s: time constant `lag` s, slope at most `rate` a second."""
    change = (target - value) * (1.0 - math.exp(-dt / lag)) if lag > 0.0 else target - value
    return value + min(max(change, -rate * dt), rate * dt)


@compiled
def roll(pose: Floats, travel: float, curvature: float) -> tuple[float, float, float]:
    """Return a pose after `travel` m of the rear axle along an arc of `curvature` 1/m: exact.

    The chord of an arc of angle a is travel * sin(a/2)/(a/2) long and leaves at half the angle.
    """
    turn = travel * curvature
    half = 0.5 * turn
    chord = travel * (math.sin(half) / half if abs(half) > 1e-9 else 1.0)
    along = pose[2] + half
    heading = (pose[2] + turn + math.pi) % (2.0 * math.pi) - math.pi
    return pose[0] + chord * math.cos(along), pose[1] + chord * math.sin(along), heading


@compiled
def drive_part(
    state: Floats, steering: float, speed: float, car: Floats, body: Floats, segments: Floats, h: float
) -> tuple[int, float]:
    """Drive a car for h s in place; it stops dead where its body touches a segment. See `drive`.

    Returns:
        The index of the segment touched or -1, and the curvature of the way, 1/m.
    """
    state[4] = approach(state[4], steering, car[1], car[2], h)
    state[3] = approach(state[3], speed, car[3], car[4], h)
    curvature = math.tan(state[4]) / car[0]
    state[0], state[1], state[2] = roll(state[:3], state[3] * h, curvature)
    return touches(state[:3], body, segments), curvature


@compiled
def drive(
    state: Floats, steering: float, speed: float, car: Floats, body: Floats, segments: Floats, dt: float, parts: int
) -> tuple[Floats, int]:
    """Drive a car for dt s in equal parts; it stops dead where its body touches a segment.

    Args:
        state: x, y, heading, speed, steering angle: m, m, rad, m/s, rad.
        steering: wanted steering angle, rad.
        speed: wanted speed, m/s.
        car: wheelbase m, steering rate rad/s, steering lag s, acceleration m/s^2, speed lag s, ...
        body: the rectangle in the car's frame, (rear, right, front, left), m.
        segments: what must not be touched, (m, 4).
        dt: duration, s.
        parts: number of equal parts of dt.

    Returns:
        The state after dt, and the index of the segment touched or -1.
    """
    out, hit = state.copy(), NOTHING
    for _ in range(parts):
        hit, _ = drive_part(out, steering, speed, car, body, segments, dt / parts)
        if hit != NOTHING:
            out[3] = 0.0
            break
    return out, hit
