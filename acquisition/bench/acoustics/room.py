"""Echo paths by way of the stand's post, floor, ceiling, walls and small objects."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from itertools import combinations, combinations_with_replacement
from typing import NamedTuple

import numpy as np

from acquisition.arrays import Floats, Ints
from acquisition.bench.acoustics.arrivals import CEILING, CLUTTER, FACE, FLOOR, POST, SIDES, WALL, Arrivals
from acquisition.bench.acoustics.geometry import PathGeometry, strip
from acquisition.bench.laboratory.setup import Post, Room, Scatterer
from acquisition.bench.laboratory.shapes import Disc, Plate, Wall, outline

PostEcho = Iterator[tuple[Floats, Floats]]
DETOUR_PIECES = 2  # number of pieces of outline merged into one for indirect paths
NEAR_EDGE = 2e-3  # m, smallest distance between a mirror echo and the outline, against the singularity there
FACE_PATCHES_PER_M2 = 8000.0  # of a rough face: about one per square wavelength
FLOOR_PATCHES_PER_M2, FLOOR_SIZE_M = 40.0, (6.0, 4.0)  # of a rough floor; extent ahead and across


class Surface(NamedTuple):
    """Large flat surface: group, index of the axis normal to it, coordinate on that axis, m, and amplitude factor."""

    group: int
    axis: int
    place: float
    factor: float


def surfaces(room: Room) -> list[Surface]:
    """Return the surfaces of a room."""
    floor = None if room.height is None else -room.height
    above = None if room.height is None or room.ceiling is None else room.ceiling - room.height
    given = (
        (FLOOR, 2, floor, room.floor_factor),
        (CEILING, 2, above, room.ceiling_factor),
        (WALL, 0, room.wall, room.wall_factor),
        (SIDES, 1, room.left, room.wall_factor),
        (SIDES, 1, None if room.right is None else -room.right, room.wall_factor),
    )
    return [Surface(group, axis, place, factor) for group, axis, place, factor in given if place is not None]


def arrivals(geometry: PathGeometry) -> Arrivals:
    """Return all echo paths of n scenes."""
    found = [*geometry.reflector_paths(), *_image_echoes(geometry), *_detours(geometry), *_clutter(geometry)]
    if geometry.setup.roughness_m > 0.0:
        found += _rough_faces(geometry)
    if geometry.setup.post is not None:
        found.append(post(geometry, geometry.setup.post))
    return Arrivals.joined(found)


def _two_way_gain(geometry: PathGeometry, points: Floats) -> Floats:
    """Return the two-way amplitude factor of beam and shadow for points (k, 3), (n, k)."""
    every = np.broadcast_to(points, (len(geometry), *points.shape))
    return (geometry.beam(every) * geometry.shadow(every)) ** 2


def _image_echoes(geometry: PathGeometry) -> Iterator[Arrivals]:
    """Yield the room's echoes: images of first order, of corners, and between opposite surfaces."""
    found = surfaces(geometry.setup.room)
    if not found:
        return
    images = [*((one,) for one in found), *((a, b) for a, b in combinations(found, 2) if a.axis != b.axis)]
    points = np.array([_nearest_point(*image) for image in images])
    length = np.sqrt((points**2).sum(axis=1))
    factor = np.array([np.prod([surface.factor for surface in image]) for image in images])
    amplitude = factor * _two_way_gain(geometry, points) / (2.0 * length)
    for k, image in enumerate(images):
        yield Arrivals.of(geometry.rows, image[0].group, np.full(len(geometry), length[k]), amplitude[:, k])
    for a, b in combinations(found, 2):
        if a.axis == b.axis:
            ends = geometry.beam(np.broadcast_to([_nearest_point(a), _nearest_point(b)], (len(geometry), 2, 3))).prod(
                axis=1
            )
            apart = abs(a.place - b.place)
            yield Arrivals.of(
                geometry.rows, a.group, np.full(len(geometry), apart), a.factor * b.factor * ends * 2.0 / (2.0 * apart)
            )


def _nearest_point(*planes: Surface) -> Floats:
    """Return the point common to some surfaces that is nearest to the sensor, m, (3,)."""
    point = np.zeros(3)
    for surface in planes:
        point[surface.axis] = surface.place
    return point


def _detours(geometry: PathGeometry) -> Iterator[Arrivals]:
    """Yield the paths by way of a reflector and a surface of the room, there, back or both."""
    found = surfaces(geometry.setup.room)
    for shape, rows in geometry.shapes:
        if found and not isinstance(shape, Wall):
            yield _detour(geometry, shape, rows, found)


def _detour(geometry: PathGeometry, shape: Disc | Plate, rows: Ints, found: list[Surface]) -> Arrivals:
    """Return the paths sensor - surface - reflector - surface - sensor, in both directions.

    Kirchhoff's integral is again a mirror echo and a wave from the outline, here of sound from one image of the sensor
    to another. The beam pattern is that towards the reflector's centre.
    """
    place, sent = _image_views(geometry, rows, found)
    pairs = list(combinations_with_replacement(range(len(found) + 1), 2))[1:]  # the first pair is the direct path
    there, back = np.array(pairs).T
    senses = np.where(there == back, 1.0, 2.0)
    factor = senses[:, None] * sent[there] * sent[back] * geometry.surface[rows]
    away = np.sqrt((place**2).sum(axis=-1))
    # the echo exceeds neither that of a mirror nor that of a plate that reflects in phase
    max_echo = np.minimum(1.0, 2.0 * shape.area / geometry.wavelength[rows] / np.minimum(away[there], away[back]))
    loud = ~geometry.negligible(factor * max_echo / (away[there] + away[back]), 0.5 * (away[there] + away[back]), rows)
    pair, pick = np.nonzero(loud & (place[there, :, 2] > 0.0) & (place[back, :, 2] > 0.0))
    first, second = (place[end[pair], pick] for end in (there, back))
    length, echo = between_images(shape, first, second, geometry.wavelength[rows][pick])
    group = np.array([surface.group for surface in found])[back[pair] - 1]
    return Arrivals.of(rows[pick], group, length, factor[pair, pick][:, None] * echo)


def between_images(shape: Disc | Plate, first: Floats, second: Floats, wavelength: Floats) -> tuple[Floats, Floats]:
    """Return half lengths and amplitudes of a plate's echo from one point to another, (k, 1 + pieces) each.

    With S' the source's mirror image behind the plate, r from there and s from the receiver P to a piece dl of outline,

        echo = inside/|S'P| delta(|S'P|) + 1/(4 pi) sum (r x s).dl / (r s (r s + r.s)) delta(r + s).

    Args:
        shape: of the plate.
        first: its centre relative to the source, along its width, height and normal, m, (k, 3).
        second: its centre relative to the receiver, likewise.
        wavelength: m, (k,).
    """
    points = outline(shape)[::DETOUR_PIECES]
    middle, step = 0.5 * (points[1:] + points[:-1]), np.diff(points, axis=0)
    (u1, v1, w1), (u2, v2, w2) = (end.T[:, :, None] for end in (first, second))
    ax, ay, bx, by = u1 + middle[:, 0], v1 + middle[:, 1], u2 + middle[:, 0], v2 + middle[:, 1]
    r, s = np.sqrt(ax**2 + ay**2 + w1**2), np.sqrt(bx**2 + by**2 + w2**2)
    along = (ax / r + bx / s) * step[:, 0] + (ay / r + by / s) * step[:, 1]
    # r = (ax, ay, -w1), s = (bx, by, w2)
    cross = (ay * w2 + w1 * by) * step[:, 0] - (ax * w2 + w1 * bx) * step[:, 1]
    near = np.maximum(r * s + ax * bx + ay * by - w1 * w2, NEAR_EDGE**2)
    edge = cross / (4.0 * np.pi * r * s * near) * np.sinc(along / wavelength[:, None])
    straight = np.sqrt((u1 - u2) ** 2 + (v1 - v2) ** 2 + (w1 + w2) ** 2)
    share = w1 / (w1 + w2)  # fraction of the path from S' to P at the plane of the plate
    foot = np.concatenate([-u1 + share * (u1 - u2), -v1 + share * (v1 - v2)], axis=1)
    inside = shape.contains(foot)[:, None] / straight
    return 0.5 * np.concatenate([straight, r + s], axis=1), np.concatenate([inside, edge], axis=1)


def _image_views(geometry: PathGeometry, rows: Ints, found: list[Surface]) -> tuple[Floats, Floats]:
    """Return m reflectors relative to the sensor and to its images in s surfaces.

    Positions along the reflectors' own axes, m, (s + 1, m, 3), and one-way amplitude factors, (s + 1, m).
    """
    centre = geometry.poses.centre[rows]
    image = np.zeros((len(found) + 1, 1, 3))
    mirrored, factor = np.repeat(centre[None], len(image), axis=0), np.ones((len(image), 1))
    for k, surface in enumerate(found, 1):
        image[k, 0, surface.axis] = 2.0 * surface.place
        mirrored[k, :, surface.axis] = 2.0 * surface.place - mirrored[k, :, surface.axis]
        factor[k] = surface.factor
    relative = centre - image
    axes = np.stack([axis[rows] for axis in geometry.poses.axes], axis=1)
    return np.einsum("smx,max->sma", relative, axes), factor * geometry.beam(mirrored.swapaxes(0, 1), rows).T


def post(geometry: PathGeometry, of: Post) -> Arrivals:
    """Return the echo of the stand's post, diffracted by the reflector, and of the corner between post and floor."""
    ahead = geometry.poses.axes[2] * np.array([1.0, 1.0, 0.0])
    ahead = ahead / np.maximum(np.linalg.norm(ahead, axis=-1, keepdims=True), 1e-9)
    axis = geometry.poses.centre * np.array([1.0, 1.0, 0.0]) + of.behind * ahead
    front = np.linalg.norm(axis, axis=-1) - of.radius
    there = front > 0.0
    front = np.where(there, front, 1.0)
    seen = np.where(there, _two_way_gain_each(geometry, axis), 0.0)
    paths = [
        Arrivals.of(geometry.rows, POST, length, share * seen / (2.0 * front))
        for length, share in PROFILES[of.profile](geometry, of, axis, ahead, front)
    ]
    room = geometry.setup.room
    if room.height is not None:
        foot = axis - np.array([0.0, 0.0, room.height])
        length = np.linalg.norm(foot, axis=-1)
        corner = room.floor_factor * np.sqrt(of.radius / front) * geometry.beam(foot) ** 2 / (2.0 * length)
        paths.append(Arrivals.of(geometry.rows, POST, length, np.where(there, corner, 0.0)))
    return Arrivals.joined(paths)


def _two_way_gain_each(geometry: PathGeometry, points: Floats) -> Floats:
    """Return the two-way amplitude factor of one point per scene, (n, 3), as (n,)."""
    return (geometry.beam(points) * geometry.shadow(points[:, None])[:, 0]) ** 2


def _round_post(geometry: PathGeometry, of: Post, axis: Floats, ahead: Floats, front: Floats) -> PostEcho:
    """Yield half length and amplitude relative to a wall of a long cylinder."""
    yield front, np.sqrt(of.radius / (of.radius + front))


def _flat_post(geometry: PathGeometry, of: Post, axis: Floats, ahead: Floats, front: Floats) -> PostEcho:
    """Yield the same of an upright strip parallel to the reflector."""
    yield _strip_echo(geometry, of.radius, axis, ahead)


def _square_post(geometry: PathGeometry, of: Post, axis: Floats, ahead: Floats, front: Floats) -> PostEcho:
    """Yield the same of each face of a square bar that faces the sensor."""
    aside = np.stack([-ahead[:, 1], ahead[:, 0], ahead[:, 2]], axis=-1)
    for normal in (ahead, -ahead, aside, -aside):
        yield _strip_echo(geometry, of.radius, axis - of.radius * normal, normal)


PROFILES = {"round": _round_post, "flat": _flat_post, "square": _square_post}


def _strip_echo(geometry: PathGeometry, half: float, middle: Floats, normal: Floats) -> tuple[Floats, Floats]:
    """Return half length and amplitude of an upright strip relative to a wall at its nearest point, (n,) each.

    Fresnel's integral over the width refers the phase to the foot of the perpendicular; if the foot lies beside the
    strip, the nearest edge returns the sound. The back of the strip returns nothing.
    """
    h = (middle * normal).sum(axis=-1)
    away = np.abs(middle[:, 0] * normal[:, 1] - middle[:, 1] * normal[:, 0])
    faces = h > 0.0
    h = np.where(faces, h, 1.0)
    share = np.conj(strip(away, np.full(len(h), half), 2.0 / np.sqrt(geometry.wavelength * h)))
    length = np.hypot(h, np.maximum(away - half, 0.0))
    turn = np.exp(4j * np.pi * (length - h) / geometry.wavelength)
    return length, np.where(faces, share * turn, 0.0)


def _clutter(geometry: PathGeometry) -> Iterator[Arrivals]:
    room = geometry.setup.room
    if room.clutter:
        yield clutter_echoes(geometry, room.clutter)
    if room.height is not None and room.floor_scatter_db is not None:
        yield _rough_floor(geometry, room.height, room.floor_scatter_db)


def clutter_echoes(geometry: PathGeometry, scatterers: tuple[Scatterer, ...]) -> Arrivals:
    """Return the echoes of small objects."""
    points = np.array([scatterer.position_m for scatterer in scatterers])
    length = np.sqrt((points**2).sum(axis=1))
    strength = 10.0 ** (np.array([scatterer.strength_db for scatterer in scatterers]) / 20.0)
    amplitude = strength * _two_way_gain(geometry, points) / length**2
    return Arrivals.of(geometry.rows, CLUTTER, length[None], amplitude)


def _rough_floor(geometry: PathGeometry, height: float, scatter_db: float) -> Arrivals:
    """Return the diffuse echo of a rough floor, patch by patch (Lambert's law: squared sine of the grazing angle)."""
    patch, phase = _floor_patches(FLOOR_PATCHES_PER_M2)
    points = np.concatenate([patch, np.full((len(patch), 1), -height)], axis=1)
    length = np.sqrt((points**2).sum(axis=1))
    strength = np.sqrt(10.0 ** (scatter_db / 10.0) / FLOOR_PATCHES_PER_M2) * height / length
    every = np.broadcast_to(points, (len(geometry), *points.shape))
    return Arrivals.of(geometry.rows, FLOOR, length[None], phase * strength * geometry.beam(every) ** 2 / length**2)


def _rough_faces(geometry: PathGeometry) -> Iterator[Arrivals]:
    """Yield the diffuse echo of rough reflectors, patch by patch (Lambert's law); the roughness is always the same."""
    for shape, rows in geometry.shapes:
        if isinstance(shape, Wall):
            continue
        side, up, normal = (axis[rows][:, None] for axis in geometry.poses.axes)
        place, phase = _face_patches(shape)
        points = geometry.poses.centre[rows][:, None] + place[:, :1] * side + place[:, 1:] * up
        length = np.sqrt((points**2).sum(axis=-1))
        facing = np.maximum((points * normal).sum(axis=-1), 0.0) / length
        strength = np.sqrt(geometry.scattering[rows, None] * shape.area / len(place) / np.pi) * facing
        yield Arrivals.of(rows, FACE, length, phase * strength * geometry.beam(points, rows) ** 2 / length**2)


@lru_cache(maxsize=64)
def _face_patches(shape: Disc | Plate) -> tuple[Floats, Floats]:
    """Return positions about the centre, m, and phases of the patches of a rough face."""
    rng = np.random.default_rng(0x0F_ACE)
    half = np.max(shape.half) * 2.0 / np.sqrt(np.pi)  # of a square that contains a disc or a plate
    drawn = rng.uniform(-half, half, (int(FACE_PATCHES_PER_M2 * 4.0 * half**2), 2))
    place = drawn[shape.contains(drawn)]
    return place, np.exp(2j * np.pi * rng.random(len(place)))


@lru_cache(maxsize=1)
def _floor_patches(density: float) -> tuple[Floats, Floats]:
    """Return positions, m, and phases of the patches of a rough floor, the same floor in each call."""
    rng = np.random.default_rng(0xF100)
    count = int(density * FLOOR_SIZE_M[0] * FLOOR_SIZE_M[1])
    place = rng.uniform([0.0, -0.5 * FLOOR_SIZE_M[1]], [FLOOR_SIZE_M[0], 0.5 * FLOOR_SIZE_M[1]], (count, 2))
    return place, np.exp(2j * np.pi * rng.random(count))
