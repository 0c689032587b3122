"""Compiled geometry and kinematics on plain arrays: pure functions for one world.

Segments are rows (x1, y1, x2, y2) in m; poses are rows (x, y, heading) in m, m, rad. Angles are positive anticlockwise.
"""

from __future__ import annotations

import math

import numpy as np

from acquisition.arrays import Floats, Ints
from sonar_gym.compiled import compiled

NO_HIT = -1  # index of the segment where a cone is empty
TIE = 1e-9  # m; two faces of one corner have equal distances up to rounding
CLEAR = 1e-6  # part of a leg at its ends in which no other face blocks it
SOUND_SPEED = 343.0  # m/s, air of 20 degC


@compiled
def clip_half_plane(f0: float, f1: float, low: float, high: float) -> tuple[float, float]:
    """Narrow [low, high] to the t with f0 + t (f1 - f0) >= 0; an empty interval has low > high."""
    slope = f1 - f0
    if slope == 0.0:
        return (low, high) if f0 >= 0.0 else (1.0, 0.0)
    t = -f0 / slope
    return (max(low, t), high) if slope > 0.0 else (low, min(high, t))


@compiled
def to_frame(x: float, y: float, pose: Floats) -> tuple[float, float]:
    """Transform a point from the world to the frame of a pose."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    dx, dy = x - pose[0], y - pose[1]
    return c * dx + s * dy, c * dy - s * dx


@compiled
def nearest_in_wedge(
    x1: float, y1: float, x2: float, y2: float, cosine: float, sine: float
) -> tuple[float, float, bool]:
    """Return the point of a segment nearest to the origin within a wedge about the x axis, and whether there is one.

    A wedge with an opening angle below pi is convex, so the part of the segment inside is one piece, and its nearest
    point is the foot of the perpendicular, clamped to the piece. The segment is (x1, y1, x2, y2); `cosine` and `sine`
    are those of half the opening angle.
    """
    left1, left2 = sine * x1 - cosine * y1, sine * x2 - cosine * y2
    right1, right2 = sine * x1 + cosine * y1, sine * x2 + cosine * y2
    if (left1 < 0.0 and left2 < 0.0) or (right1 < 0.0 and right2 < 0.0):
        return 0.0, 0.0, False  # most segments are rejected here, without a division
    low, high = clip_half_plane(left1, left2, 0.0, 1.0)
    low, high = clip_half_plane(right1, right2, low, high)
    if low > high:
        return 0.0, 0.0, False
    dx, dy = x2 - x1, y2 - y1
    length2 = dx * dx + dy * dy
    foot = -(x1 * dx + y1 * dy) / length2 if length2 > 0.0 else 0.0
    t = min(max(foot, low), high)
    return x1 + t * dx, y1 + t * dy, True


@compiled
def incidence_cosine(x: float, y: float, dx: float, dy: float) -> float:
    """Return the cosine of the angle between the ray to (x, y) and the normal of a face along (dx, dy), 0 to 1."""
    scale = math.sqrt((x * x + y * y) * (dx * dx + dy * dy))
    return min(1.0, abs(x * dy - y * dx) / scale) if scale > 0.0 else 1.0


@compiled
def out_of_frame(x: float, y: float, pose: Floats) -> tuple[float, float]:
    """Transform a point from the frame of a pose to the world."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    return pose[0] + c * x - s * y, pose[1] + s * x + c * y


@compiled
def cast_cone(
    x: float, y: float, heading: float, half: float, segments: Floats, limit: float
) -> tuple[float, float, float, int, float, float]:
    """Return the nearest point of any segment in one cone; see `cast_cones`. Segments behind the sensor are skipped."""
    best, best_cosine, index, at_x, at_y = limit, 0.0, NO_HIT, 0.0, 0.0
    c, s, cosine, sine = math.cos(heading), math.sin(heading), math.cos(half), math.sin(half)
    for k in range(segments.shape[0]):
        ax, ay, bx, by = segments[k, 0] - x, segments[k, 1] - y, segments[k, 2] - x, segments[k, 3] - y
        x1, x2 = c * ax + s * ay, c * bx + s * by
        if (x1 < 0.0 and x2 < 0.0) or (x1 > best + TIE and x2 > best + TIE):
            continue
        y1, y2 = c * ay - s * ax, c * by - s * bx
        px, py, inside = nearest_in_wedge(x1, y1, x2, y2, cosine, sine)
        distance = math.sqrt(px * px + py * py)
        if not inside or distance > best + TIE or distance > limit:
            continue
        cosine_here = incidence_cosine(px, py, x2 - x1, y2 - y1)
        if distance < best - TIE or index == NO_HIT or cosine_here > best_cosine:
            best, best_cosine, index, at_x, at_y = distance, cosine_here, k, px, py
    if index == NO_HIT:
        return limit, 0.0, 0.0, NO_HIT, x, y
    bearing = math.atan2(at_y, at_x) if best > TIE else 0.0  # no direction is defined on the face itself
    return best, bearing, math.acos(best_cosine), index, x + c * at_x - s * at_y, y + s * at_x + c * at_y


@compiled
def cast_cones(
    poses: Floats, half: Floats, segments: Floats, limit: float
) -> tuple[Floats, Floats, Floats, Ints, Floats]:
    """Return the nearest point of any segment in each cone.

    The line to the nearest point lies in the convex cone, so no other segment can block it: no occlusion test is
    needed.

    Args:
        poses: poses of the sensors, (s, 3).
        half: half opening angles, rad, below pi/2, (s,).
        segments: segments, m, (m, 4).
        limit: maximum distance, m.

    Returns:
        Distance, m, (s,), `limit` where the cone is empty; bearing off the axis, rad, (s,); incidence, rad, (s,), the
        smaller one where two faces meet; index of the segment, (s,), -1 for none; point in the world, m, (s, 2).
    """
    count = poses.shape[0]
    distance, bearing, incidence = np.empty(count), np.empty(count), np.empty(count)
    index, point = np.empty(count, np.int64), np.zeros((count, 2))
    for i in range(count):
        found = cast_cone(poses[i, 0], poses[i, 1], poses[i, 2], half[i], segments, limit)
        distance[i], bearing[i], incidence[i], index[i], x, y = found
        if index[i] != NO_HIT:
            point[i, 0], point[i, 1] = x, y
    return distance, bearing, incidence, index, point


@compiled
def blocked(x1: float, y1: float, x2: float, y2: float, segments: Floats, own: int) -> bool:
    """Return whether a face other than `own` crosses the straight line between two points."""
    dx, dy = x2 - x1, y2 - y1
    for k in range(segments.shape[0]):
        ex, ey = segments[k, 2] - segments[k, 0], segments[k, 3] - segments[k, 1]
        ax, ay = segments[k, 0] - x1, segments[k, 1] - y1
        turn = dx * ey - dy * ex
        sign, size = (1.0 if turn > 0.0 else -1.0), abs(turn)
        t, u = sign * (ax * ey - ay * ex), sign * (ax * dy - ay * dx)  # along line and face, times `size`
        if CLEAR * size < t < (1.0 - CLEAR) * size and 0.0 <= u <= size and k != own:
            return True
    return False


@compiled
def shift(segments: Floats, velocity: Floats, duration: float) -> None:
    """Move segments, m, (m, 4), with their velocities, m/s, (m, 2), for a duration in s, in place."""
    for k in range(segments.shape[0]):
        for axis in range(2):
            segments[k, axis] += velocity[k, axis] * duration
            segments[k, axis + 2] += velocity[k, axis] * duration


@compiled
def mounted(mounts: Floats, car: Floats) -> Floats:
    """Transform poses from the frame of the car to the world, (s, 3)."""
    out = np.empty_like(mounts)
    for i in range(mounts.shape[0]):
        out[i, 0], out[i, 1] = out_of_frame(mounts[i, 0], mounts[i, 1], car)
        out[i, 2] = car[2] + mounts[i, 2]
    return out


@compiled
def touches(pose: Floats, body: Floats, segments: Floats) -> int:
    """Return the first segment that intersects a rectangle, or -1.

    Args:
        pose: pose of the body's frame, (3,).
        body: rectangle in that frame, (rear, right, front, left), m.
        segments: segments, m, (m, 4).
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
    return NO_HIT


@compiled
def approach(value: float, target: float, rate: float, lag: float, dt: float) -> float:
    """Return a first-order lag's value after dt s: time constant `lag` s, slope at most `rate` per second."""
    change = (target - value) * (1.0 - math.exp(-dt / lag)) if lag > 0.0 else target - value
    return value + min(max(change, -rate * dt), rate * dt)


@compiled
def roll(pose: Floats, travel: float, curvature: float) -> tuple[float, float, float]:
    """Return the pose after the rear axle has moved `travel` m along an arc of `curvature` 1/m (exact).

    The chord of an arc with angle a has length travel sin(a/2)/(a/2) and direction a/2.
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
    """Drive a car for h s, in place.

    Args:
        state: x, y, heading, speed, steering angle: m, m, rad, m/s, rad, (5,); modified.
        steering: steering angle command, rad.
        speed: speed command, m/s.
        car: wheelbase m, steering rate rad/s, steering lag s, acceleration m/s^2, speed lag s, ...
        body: rectangle in the frame of the car, (rear, right, front, left), m.
        segments: obstacles, m, (m, 4).
        h: duration, s.

    Returns:
        The index of the segment touched or -1, and the curvature of the path, 1/m.
    """
    state[4] = approach(state[4], steering, car[1], car[2], h)
    state[3] = approach(state[3], speed, car[3], car[4], h)
    curvature = math.tan(state[4]) / car[0]
    state[0], state[1], state[2] = roll(state[:3], state[3] * h, curvature)
    return touches(state[:3], body, segments), curvature
