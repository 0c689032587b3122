"""What else stands about: the stand's post, floor, ceiling and walls with their images, small things, people."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from itertools import combinations, combinations_with_replacement
from typing import NamedTuple

import numpy as np

from acquisition.bench.acoustics.air import Floats
from acquisition.bench.acoustics.arrivals import CEILING, CLUTTER, FACE, FLOOR, POST, SIDES, WALL, Arrivals, Integers
from acquisition.bench.acoustics.scene import Scene, strip
from acquisition.bench.acoustics.shapes import Disc, Plate, Wall, outline
from acquisition.bench.setup import Post, Room, Scatterer

DETOUR_PIECES = 2  # pieces of outline taken as one where it is met by a detour
NEAR_EDGE = 2e-3  # m; a mirror echo that passes an outline more narrowly does so at this distance
SPECKS_PER_M2 = 8000.0  # of a rough face: one a square wavelength or so
PATCHES_PER_M2, FIELD = 40.0, (6.0, 4.0)  # of a rough floor; m ahead and across


class Surface(NamedTuple):
    """A great flat surface: its group, the axis that it is square to, where it cuts it, m, and its amplitude factor."""

    group: int
    axis: int
    place: float
    factor: float


def surfaces(room: Room) -> list[Surface]:
    """Return the surfaces that a room has."""
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


def arrivals(scene: Scene) -> Arrivals:
    """Return every way that is there in n scenes at rest."""
    found = [*scene.near(), *_room(scene), *_detours(scene), *_clutter(scene)]
    if scene.setup.roughness_m > 0.0:
        found += _rough_faces(scene)
    if scene.setup.post is not None:
        found.append(post(scene, scene.setup.post))
    return Arrivals.joined(found)


def _passed(scene: Scene, points: Floats) -> Floats:
    """Return what is left of a way to points (k, 3) and back, by the beam and past the reflectors, (n, k)."""
    every = np.broadcast_to(points, (len(scene), *points.shape))
    return (scene.beam(every) * scene.shadow(every)) ** 2


def _room(scene: Scene) -> Iterator[Arrivals]:
    """Yield the echoes of the room's surfaces: images of first order, of its corners, and to and fro between two."""
    found = surfaces(scene.setup.room)
    if not found:
        return
    images = [*((one,) for one in found), *((a, b) for a, b in combinations(found, 2) if a.axis != b.axis)]
    points = np.array([_at(*image) for image in images])
    length = np.sqrt((points**2).sum(axis=1))
    factor = np.array([np.prod([surface.factor for surface in image]) for image in images])
    amplitude = factor * _passed(scene, points) / (2.0 * length)
    for k, image in enumerate(images):
        yield Arrivals.of(scene.rows, image[0].group, np.full(len(scene), length[k]), amplitude[:, k])
    for a, b in combinations(found, 2):
        if a.axis == b.axis:
            ends = scene.beam(np.broadcast_to([_at(a), _at(b)], (len(scene), 2, 3))).prod(axis=1)
            apart = abs(a.place - b.place)
            yield Arrivals.of(
                scene.rows, a.group, np.full(len(scene), apart), a.factor * b.factor * ends * 2.0 / (2.0 * apart)
            )


def _at(*planes: Surface) -> Floats:
    """Return the point on all of some surfaces that is nearest to the sensor, m, (3,)."""
    point = np.zeros(3)
    for surface in planes:
        point[surface.axis] = surface.place
    return point


def _detours(scene: Scene) -> Iterator[Arrivals]:
    """Yield the ways over the reflector that meet a surface of the room on the way there, on the way back, or both."""
    found = surfaces(scene.setup.room)
    for shape, rows in scene.kinds:
        if found and not isinstance(shape, Wall):
            yield _detour(scene, shape, rows, found)


def _detour(scene: Scene, shape: Disc | Plate, rows: Integers, found: list[Surface]) -> Arrivals:
    """Return the ways sensor - surface - reflector - surface - sensor, both senses of each.

    As from the sensor itself, Kirchhoff's integral is a mirror echo and a wave from the outline, here of sound that
    comes from one image of the sensor and goes to another. The beam is taken at the reflector's centre.
    """
    place, sent = _seen_from(scene, rows, found)
    pairs = list(combinations_with_replacement(range(len(found) + 1), 2))[1:]  # the first meets no surface at all
    there, back = np.array(pairs).T
    senses = np.where(there == back, 1.0, 2.0)
    factor = senses[:, None] * sent[there] * sent[back] * scene.surface[rows]
    away = np.sqrt((place**2).sum(axis=-1))
    # no more comes back than from a mirror, nor than from the whole plate in step
    most = np.minimum(1.0, 2.0 * shape.area / scene.wavelength[rows] / np.minimum(away[there], away[back]))
    loud = ~scene.faint(factor * most / (away[there] + away[back]), 0.5 * (away[there] + away[back]), rows)
    pair, pick = np.nonzero(loud & (place[there, :, 2] > 0.0) & (place[back, :, 2] > 0.0))
    first, second = (place[end[pair], pick] for end in (there, back))
    length, echo = between_images(shape, first, second, scene.wavelength[rows][pick])
    group = np.array([surface.group for surface in found])[back[pair] - 1]
    return Arrivals.of(rows[pick], group, length, factor[pair, pick][:, None] * echo)


def between_images(shape: Disc | Plate, first: Floats, second: Floats, wavelength: Floats) -> tuple[Floats, Floats]:
    """Return half lengths and amplitudes of what a plate sends from one place to another, (k, 1 + pieces) each.

    With S' the source's mirror image behind the plate, r from there and s from the receiver to a piece dl of outline,

        echo = inside/|S'P| delta(|S'P|) + 1/(4 pi) sum (r x s).dl / (r s (r s + r.s)) delta(r + s).

    Args:
        shape: of the plate.
        first: its centre as seen from the source, along its width, height and normal, m, (k, 3).
        second: and as seen from the receiver.
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
    share = w1 / (w1 + w2)  # of the way from S' to P at which it passes the plate
    foot = np.concatenate([-u1 + share * (u1 - u2), -v1 + share * (v1 - v2)], axis=1)
    inside = shape.holds(foot)[:, None] / straight
    return 0.5 * np.concatenate([straight, r + s], axis=1), np.concatenate([inside, edge], axis=1)


def _seen_from(scene: Scene, rows: Integers, found: list[Surface]) -> tuple[Floats, Floats]:
    """Return m reflectors as seen from the sensor and from its images in s surfaces.

    Their places along their own axes, m, (s + 1, m, 3), and what beam and surface leave of the sound, (s + 1, m).
    """
    centre = scene.poses.centre[rows]
    image = np.zeros((len(found) + 1, 1, 3))
    mirrored, factor = np.repeat(centre[None], len(image), axis=0), np.ones((len(image), 1))
    for k, surface in enumerate(found, 1):
        image[k, 0, surface.axis] = 2.0 * surface.place
        mirrored[k, :, surface.axis] = 2.0 * surface.place - mirrored[k, :, surface.axis]
        factor[k] = surface.factor
    way = centre - image
    axes = np.stack([axis[rows] for axis in scene.poses.axes], axis=1)
    return np.einsum("smx,max->sma", way, axes), factor * scene.beam(mirrored.swapaxes(0, 1), rows).T


def post(scene: Scene, of: Post) -> Arrivals:
    """Return the echo of the stand's upright, seen past the reflector, and of the corner of its foot and the floor."""
    ahead = scene.poses.axes[2] * np.array([1.0, 1.0, 0.0])
    ahead = ahead / np.maximum(np.linalg.norm(ahead, axis=-1, keepdims=True), 1e-9)
    axis = scene.poses.centre * np.array([1.0, 1.0, 0.0]) + of.behind * ahead
    front = np.linalg.norm(axis, axis=-1) - of.radius
    there = front > 0.0
    front = np.where(there, front, 1.0)
    seen = np.where(there, _passed_each(scene, axis), 0.0)
    ways = [
        Arrivals.of(scene.rows, POST, length, share * seen / (2.0 * front))
        for length, share in PROFILES[of.profile](scene, of, axis, ahead, front)
    ]
    room = scene.setup.room
    if room.height is not None:
        foot = axis - np.array([0.0, 0.0, room.height])
        length = np.linalg.norm(foot, axis=-1)
        corner = room.floor_factor * np.sqrt(of.radius / front) * scene.beam(foot) ** 2 / (2.0 * length)
        ways.append(Arrivals.of(scene.rows, POST, length, np.where(there, corner, 0.0)))
    return Arrivals.joined(ways)


def _passed_each(scene: Scene, points: Floats) -> Floats:
    """Return what is left of a way to one point a scene (n, 3) and back, (n,)."""
    return (scene.beam(points) * scene.shadow(points[:, None])[:, 0]) ** 2


def _round(scene: Scene, of: Post, axis: Floats, ahead: Floats, front: Floats) -> Iterator[tuple[Floats, Floats]]:
    """Yield half length and amplitude against a wall of a long cylinder."""
    yield front, np.sqrt(of.radius / (of.radius + front))


def _flat(scene: Scene, of: Post, axis: Floats, ahead: Floats, front: Floats) -> Iterator[tuple[Floats, Floats]]:
    """Yield the same of an upright strip that faces as the reflector does."""
    yield _strip(scene, of.radius, axis, ahead)


def _square(scene: Scene, of: Post, axis: Floats, ahead: Floats, front: Floats) -> Iterator[tuple[Floats, Floats]]:
    """Yield the same of each face of a square bar that looks towards the sensor."""
    aside = np.stack([-ahead[:, 1], ahead[:, 0], ahead[:, 2]], axis=-1)
    for normal in (ahead, -ahead, aside, -aside):
        yield _strip(scene, of.radius, axis - of.radius * normal, normal)


PROFILES = {"round": _round, "flat": _flat, "square": _square}


def _strip(scene: Scene, half: float, middle: Floats, normal: Floats) -> tuple[Floats, Floats]:
    """Return half length and amplitude against a wall at its nearest point of an upright strip, (n,) each.

    Fresnel's integral over the width counts the phase from the foot of the perpendicular; sound comes back from the
    strip's nearest edge where the foot lies beside it. Nothing comes from behind.
    """
    h = (middle * normal).sum(axis=-1)
    away = np.abs(middle[:, 0] * normal[:, 1] - middle[:, 1] * normal[:, 0])
    looks = h > 0.0
    h = np.where(looks, h, 1.0)
    share = np.conj(strip(away, np.full(len(h), half), 2.0 / np.sqrt(scene.wavelength * h)))
    length = np.hypot(h, np.maximum(away - half, 0.0))
    turn = np.exp(4j * np.pi * (length - h) / scene.wavelength)
    return length, np.where(looks, share * turn, 0.0)


def _clutter(scene: Scene) -> Iterator[Arrivals]:
    room = scene.setup.room
    if room.clutter:
        yield scattered(scene, room.clutter)
    if room.height is not None and room.floor_scatter_db is not None:
        yield _rough_floor(scene, room.height, room.floor_scatter_db)


def scattered(scene: Scene, things: tuple[Scatterer, ...]) -> Arrivals:
    """Return the echoes of small things."""
    points = np.array([thing.position_m for thing in things])
    length = np.sqrt((points**2).sum(axis=1))
    strength = 10.0 ** (np.array([thing.strength_db for thing in things]) / 20.0)
    amplitude = strength * _passed(scene, points) / length**2
    return Arrivals.of(scene.rows, CLUTTER, length[None], amplitude)


def _rough_floor(scene: Scene, height: float, scatter_db: float) -> Arrivals:
    """Return what a rough floor scatters back, patch by patch; by Lambert's law, with the sine of grazing squared."""
    patch, phase = _patches(PATCHES_PER_M2)
    points = np.concatenate([patch, np.full((len(patch), 1), -height)], axis=1)
    length = np.sqrt((points**2).sum(axis=1))
    strength = np.sqrt(10.0 ** (scatter_db / 10.0) / PATCHES_PER_M2) * height / length
    every = np.broadcast_to(points, (len(scene), *points.shape))
    return Arrivals.of(scene.rows, FLOOR, length[None], phase * strength * scene.beam(every) ** 2 / length**2)


def _rough_faces(scene: Scene) -> Iterator[Arrivals]:
    """Yield what rough reflectors scatter to all sides, patch by patch, by Lambert's law: always the same roughness."""
    for shape, rows in scene.kinds:
        if isinstance(shape, Wall):
            continue
        side, up, normal = (axis[rows][:, None] for axis in scene.poses.axes)
        place, phase = _specks(shape)
        points = scene.poses.centre[rows][:, None] + place[:, :1] * side + place[:, 1:] * up
        length = np.sqrt((points**2).sum(axis=-1))
        facing = np.maximum((points * normal).sum(axis=-1), 0.0) / length
        strength = np.sqrt(scene.scattering[rows, None] * shape.area / len(place) / np.pi) * facing
        yield Arrivals.of(rows, FACE, length, phase * strength * scene.beam(points, rows) ** 2 / length**2)


@lru_cache(maxsize=64)
def _specks(shape: Disc | Plate) -> tuple[Floats, Floats]:
    """Return where the patches of a rough face lie about its centre, m, and with what phase they scatter."""
    rng = np.random.default_rng(0x0F_ACE)
    half = np.max(shape.half) * 2.0 / np.sqrt(np.pi)  # holds a disc and a plate
    drawn = rng.uniform(-half, half, (int(SPECKS_PER_M2 * 4.0 * half**2), 2))
    place = drawn[shape.holds(drawn)]
    return place, np.exp(2j * np.pi * rng.random(len(place)))


@lru_cache(maxsize=1)
def _patches(density: float) -> tuple[Floats, Floats]:
    """Return where the patches of a rough floor lie, m, and with what phase they scatter: always the same floor."""
    rng = np.random.default_rng(0xF100)
    count = int(density * FIELD[0] * FIELD[1])
    place = rng.uniform([0.0, -0.5 * FIELD[1]], [FIELD[0], 0.5 * FIELD[1]], (count, 2))
    return place, np.exp(2j * np.pi * rng.random(count))
