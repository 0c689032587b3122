"""The reflectors in the cone of a sonar: the nearest visible point of each face, and which of them are given to a law.

Each visible face is a path with conditions of its own. Two faces that meet in a convex corner share its point, which is
one path. Compiled; segments and poses are as in `sonar_gym.sensing.kernels`.
"""

from __future__ import annotations

import math

import numpy as np

from acquisition.arrays import Floats, Ints
from sonar_gym.compiled import compiled
from sonar_gym.sensing.detection import detection
from sonar_gym.sensing.kernels import NO_HIT, SOUND_SPEED, blocked, cast_cone, clip_half_plane, incidence_cosine

# Columns: conditions, face and point; the shift of its reading and the sonar + 1 whose burst it is, 0 for the own one
DISTANCE, BEARING, INCIDENCE, REFLECTANCE, OBSTACLE, FACE, X, Y, TEXTURE, SHIFT, SOURCE = range(11)
N_PATH = 11
MAX_OWN_PATHS = 4  # paths of the own burst given to a law at one ping, those detected most often
MAX_PATHS = MAX_OWN_PATHS + 2  # and those of other sonars' bursts
MIN_DETECTION = 0.02  # a further path that is detected less often is not given to the law
# Paths that are detected less often than this count as equal, and the nearest comes first: which of several faces that
# are hardly ever detected is so most often would be decided by the errors of the table
HARDLY = 0.5
CERTAIN = 0.98  # a path detected more often hides all paths behind it: at most 1 in 50 of them would be read
SAME_POINT = 1e-6  # m
MIN_WIDTH = 1e-9  # tangent; narrower parts of a cone are empty
NO_FLOOR = (0.0, 0.0, 0.0)  # height above the floor, m, 0 for none; reflectance; slope of the facets, rad


@compiled
def clip_to_wedge(
    x1: float, y1: float, x2: float, y2: float, cosine: float, sine: float
) -> tuple[float, float, float, float, bool]:
    """Return the ends of the part of a segment in a wedge about the x axis, and whether there is one."""
    left1, left2 = sine * x1 - cosine * y1, sine * x2 - cosine * y2
    right1, right2 = sine * x1 + cosine * y1, sine * x2 + cosine * y2
    if (left1 < 0.0 and left2 < 0.0) or (right1 < 0.0 and right2 < 0.0):
        return 0.0, 0.0, 0.0, 0.0, False
    low, high = clip_half_plane(left1, left2, 0.0, 1.0)
    low, high = clip_half_plane(right1, right2, low, high)
    if low > high:
        return 0.0, 0.0, 0.0, 0.0, False
    dx, dy = x2 - x1, y2 - y1
    return x1 + low * dx, y1 + low * dy, x1 + high * dx, y1 + high * dy, True


@compiled
def nearest_of(x1: float, y1: float, x2: float, y2: float) -> tuple[float, float]:
    """Return the point of a segment nearest to the origin."""
    dx, dy = x2 - x1, y2 - y1
    length2 = dx * dx + dy * dy
    t = min(max(-(x1 * dx + y1 * dy) / length2, 0.0), 1.0) if length2 > 0.0 else 0.0
    return x1 + t * dx, y1 + t * dy


@compiled
def along_ray(piece: Floats, tangent: float) -> float:
    """Return x at which the ray y = tangent * x meets the line of a piece (x1, y1, x2, y2, ...)."""
    dx, dy = piece[2] - piece[0], piece[3] - piece[1]
    turn = dy - tangent * dx
    return piece[0] + (tangent * piece[0] - piece[1]) / turn * dx if turn != 0.0 else min(piece[0], piece[2])


@compiled
def pieces_in_cone(
    x: float, y: float, heading: float, half: float, segments: Floats, limit: float, pieces: Floats, faces: Ints
) -> int:
    """Write the parts of segments in a cone in the frame of the sensor, with their lowest and highest tangents.

    Args:
        x: position of the sensor, m.
        y: position of the sensor, m.
        heading: direction of the beam axis, rad.
        half: half opening angle, rad.
        segments: segments, m, (m, 4).
        limit: maximum distance, m.
        pieces: x1, y1, x2, y2, lowest and highest y / x, (m, 6); written.
        faces: number of the segment of each piece, (m,); written.

    Returns:
        The number of pieces.
    """
    c, s, cosine, sine, count = math.cos(heading), math.sin(heading), math.cos(half), math.sin(half), 0
    for k in range(segments.shape[0]):
        ax, ay, bx, by = segments[k, 0] - x, segments[k, 1] - y, segments[k, 2] - x, segments[k, 3] - y
        x1, x2 = c * ax + s * ay, c * bx + s * by
        if (x1 < 0.0 and x2 < 0.0) or (x1 > limit and x2 > limit):
            continue
        px, py, qx, qy, inside = clip_to_wedge(x1, c * ay - s * ax, x2, c * by - s * bx, cosine, sine)
        if not inside:
            continue
        nx, ny = nearest_of(px, py, qx, qy)
        if nx * nx + ny * ny > limit * limit:
            continue
        t1, t2 = py / max(px, 1e-9), qy / max(qx, 1e-9)
        piece = pieces[count]
        piece[0], piece[1], piece[2], piece[3], piece[4], piece[5] = px, py, qx, qy, min(t1, t2), max(t1, t2)
        faces[count] = k
        count += 1
    return count


@compiled
def sort(values: Floats, count: int) -> None:
    """Sort the first `count` values by insertion, which is fastest for the few faces in a cone."""
    for i in range(1, count):
        value, j = values[i], i
        while j > 0 and values[j - 1] > value:
            values[j] = values[j - 1]
            j -= 1
        values[j] = value


@compiled
def nearest_visible(pieces: Floats, count: int, cuts: Floats, points: Floats) -> None:
    """Write the nearest visible point of each piece: x, y and distance; the distance is infinite for a hidden piece.

    Between two neighbouring ends of pieces the same piece is nearest along every ray, because faces do not cross.
    """
    for k in range(count):
        points[k, 2] = math.inf
        cuts[2 * k], cuts[2 * k + 1] = pieces[k, 4], pieces[k, 5]
    sort(cuts, 2 * count)
    for i in range(2 * count - 1):
        low, high = cuts[i], cuts[i + 1]
        if high - low < MIN_WIDTH:
            continue
        middle, nearest, best = 0.5 * (low + high), math.inf, NO_HIT
        for k in range(count):
            if pieces[k, 4] <= middle <= pieces[k, 5]:
                at = along_ray(pieces[k], middle)
                if at < nearest:
                    nearest, best = at, k
        if best == NO_HIT:
            continue
        x1, x2 = along_ray(pieces[best], low), along_ray(pieces[best], high)
        px, py = nearest_of(x1, x1 * low, x2, x2 * high)
        distance = math.sqrt(px * px + py * py)
        if distance < points[best, 2]:
            points[best, 0], points[best, 1], points[best, 2] = px, py, distance


@compiled
def merge_corners(pieces: Floats, count: int, points: Floats, cosines: Floats) -> None:
    """Write the cosine of each point's incidence; of two faces that share a point, keep that closer to the normal."""
    for k in range(count):
        piece = pieces[k]
        cosines[k] = incidence_cosine(points[k, 0], points[k, 1], piece[2] - piece[0], piece[3] - piece[1])
        for j in range(k):
            if math.isinf(points[j, 2]) or math.isinf(points[k, 2]):
                continue
            if math.hypot(points[j, 0] - points[k, 0], points[j, 1] - points[k, 1]) < SAME_POINT:
                points[j if cosines[j] < cosines[k] else k, 2] = math.inf


@compiled
def detected(table: Floats, limit: float, path: Floats) -> float:
    """Return how often the reflector of a path is detected alone."""
    return detection(table, limit, path[DISTANCE], path[BEARING], path[INCIDENCE], path[REFLECTANCE])


@compiled
def select_paths(found: Floats, count: int, table: Floats, limit: float, out: Floats) -> int:
    """Write the paths that a law is given, the one detected most often last, and return their number.

    Args:
        found: all paths in the cone, (m, N_PATH).
        count: number of paths.
        table: see `detection_table`.
        limit: largest distance of the table, m.
        out: the selected paths, (MAX_PATHS, N_PATH); written.
    """
    expected, hidden_from = np.empty(count), math.inf
    for k in range(count):
        expected[k] = detected(table, limit, found[k])
        if expected[k] >= CERTAIN:
            hidden_from = min(hidden_from, found[k, DISTANCE])
    chosen, n = np.empty(MAX_OWN_PATHS, np.int64), 0
    while n < min(count, MAX_OWN_PATHS):
        best = NO_HIT
        for k in range(count):
            if expected[k] < 0.0 or found[k, DISTANCE] > hidden_from or (n > 0 and expected[k] < MIN_DETECTION):
                continue
            if (
                best == NO_HIT
                or max(expected[k], HARDLY) > max(expected[best], HARDLY)
                or (
                    max(expected[k], HARDLY) == max(expected[best], HARDLY)
                    and found[k, DISTANCE] < found[best, DISTANCE]
                )
            ):
                best = k
        if best == NO_HIT:
            break
        chosen[n], expected[best] = best, -1.0
        n += 1
    for k in range(n):
        out[n - 1 - k] = found[chosen[k]]
    return n


@compiled
def floor_path(
    x: float, y: float, heading: float, half: float, segments: Floats, owner: Ints, limit: float,
    floor: tuple[float, float, float], out: Floats,
) -> bool:  # fmt: skip
    """Write the path by the nearest point of the floor in the cone, ahead and down; return whether it can be seen.

    The floor is one more face, and has the number after that of the last obstacle. Arguments as in `cast_paths`.
    """
    height, reflectance, texture = floor
    if height <= 0.0 or height > limit * math.sin(half):
        return False
    ahead = height / math.tan(half)
    out[X], out[Y] = x + math.cos(heading) * ahead, y + math.sin(heading) * ahead
    out[DISTANCE], out[BEARING], out[REFLECTANCE] = height / math.sin(half), half, reflectance
    out[INCIDENCE], out[TEXTURE] = max(0.5 * math.pi - half - texture, 0.0), texture
    out[OBSTACLE], out[FACE] = owner.max() + 1 if owner.shape[0] > 0 else 0, segments.shape[0]
    return not blocked(x, y, out[X], out[Y], segments, NO_HIT)


@compiled
def meet_moving(path: Floats, x: float, y: float, velocity: Floats) -> None:
    """Move the point of a path to where its face is when the sound meets it.

    Args:
        path: the path, (N_PATH,); modified.
        x: position of the sensor, m.
        y: position of the sensor, m.
        velocity: velocity of each face, m/s, (m, 2).
    """
    face = int(path[FACE])
    if not 0 <= face < velocity.shape[0] or path[DISTANCE] <= SAME_POINT:
        return
    vx, vy = velocity[face, 0], velocity[face, 1]
    away = (vx * (path[X] - x) + vy * (path[Y] - y)) / path[DISTANCE]
    path[DISTANCE] /= 1.0 - away / SOUND_SPEED
    flight = path[DISTANCE] / SOUND_SPEED
    path[X], path[Y] = path[X] + vx * flight, path[Y] + vy * flight


@compiled
def cast_faces(
    x: float, y: float, heading: float, half: float, segments: Floats, surface: Floats, owner: Ints, limit: float,
    table: Floats, out: Floats,
) -> int:  # fmt: skip
    """Write the paths by faces, the one detected most often last, and return their number; as in `cast_paths`."""
    distance, bearing, incidence, face, at_x, at_y = cast_cone(x, y, heading, half, segments, limit)
    one = out[0]
    one[DISTANCE], one[BEARING], one[INCIDENCE], one[REFLECTANCE] = distance, bearing, 0.0, 0.0
    one[OBSTACLE], one[FACE], one[X], one[Y], one[TEXTURE] = NO_HIT, face, at_x, at_y, 0.0
    if face == NO_HIT:
        return 1
    one[INCIDENCE], one[REFLECTANCE] = max(incidence - surface[face, 1], 0.0), surface[face, 0]
    one[OBSTACLE], one[TEXTURE] = owner[face], surface[face, 1]
    if detected(table, limit, one) >= CERTAIN:
        return 1  # the nearest point hides all others
    size = segments.shape[0]
    pieces, faces = np.empty((size, 6)), np.empty(size, np.int64)
    count = pieces_in_cone(x, y, heading, half, segments, limit, pieces, faces)
    if count <= 1:
        return 1
    points, cosines, found, kept = np.empty((count, 3)), np.empty(count), np.zeros((count, N_PATH)), 0
    nearest_visible(pieces, count, np.empty(2 * count), points)
    merge_corners(pieces, count, points, cosines)
    c, s = math.cos(heading), math.sin(heading)
    for k in range(count):
        if points[k, 2] > limit:
            continue
        px, py, path = points[k, 0], points[k, 1], found[kept]
        path[DISTANCE], path[BEARING] = points[k, 2], math.atan2(py, px) if points[k, 2] > SAME_POINT else 0.0
        path[INCIDENCE] = max(math.acos(cosines[k]) - surface[faces[k], 1], 0.0)
        path[REFLECTANCE], path[OBSTACLE], path[FACE] = surface[faces[k], 0], owner[faces[k]], faces[k]
        path[X], path[Y], path[TEXTURE] = x + c * px - s * py, y + s * px + c * py, surface[faces[k], 1]
        kept += 1
    return select_paths(found, kept, table, limit, out)


@compiled
def add_floor(ground: Floats, count: int, table: Floats, limit: float, out: Floats) -> int:
    """Write the path by the floor before the others, and return their number; it takes the place of the least heard.

    The floor is never the main path, since it has no false alarms of its own: it returns little more than its own echo.
    """
    if detected(table, limit, ground) < MIN_DETECTION:
        return count
    for k in range(count):
        nearer = out[k, OBSTACLE] >= 0.0 and out[k, DISTANCE] < ground[DISTANCE]
        if nearer and detected(table, limit, out[k]) >= CERTAIN:
            return count
    if count < MAX_OWN_PATHS:
        for k in range(count, 0, -1):
            out[k] = out[k - 1]
        count += 1
    out[0] = ground
    return count


@compiled
def cast_paths(
    x: float,
    y: float,
    heading: float,
    half: float,
    segments: Floats,
    surface: Floats,
    owner: Ints,
    limit: float,
    table: Floats,
    out: Floats,
    floor: tuple[float, float, float] = NO_FLOOR,
) -> int:
    """Write the paths of a ping that its law is given, the one detected most often last, and return their number.

    An empty cone has one path with obstacle -1.

    Args:
        x: position of the sensor, m.
        y: position of the sensor, m.
        heading: direction of the beam axis, rad.
        half: half opening angle, rad, below pi/2.
        segments: faces, m, (m, 4).
        surface: reflectance and slope of the facets of each face, 1 and rad, (m, 2).
        owner: number of the obstacle of each face, (m,).
        limit: maximum distance, m.
        table: see `detection_table`; for distances up to `limit`.
        out: the paths, (MAX_PATHS, N_PATH); written.
        floor: height of the sensor above the floor, m, 0 for none; its reflectance; slope of its facets, rad.
    """
    out[:, SHIFT : SOURCE + 1] = 0.0
    count = cast_faces(x, y, heading, half, segments, surface, owner, limit, table, out)
    ground = out[MAX_PATHS - 1]  # as scratch
    if floor_path(x, y, heading, half, segments, owner, limit, floor, ground):
        return add_floor(ground, count, table, limit, out)
    return count
