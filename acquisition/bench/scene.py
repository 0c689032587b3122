"""The ways of the sound between a unit and what stands around it, from geometry alone.

Axes: x ahead of the housing, y to its left, z up, the sensor at the origin. Every way is a group of arrivals; an
arrival has a length (half the way that the sound goes, m) and an amplitude (pressure against that at 1 m from the
transmitter on its axis, before the air takes its share).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from acquisition.bench.air import CARRIER, Floats
from acquisition.bench.setup import Post, Room, Scatterer, Setup
from acquisition.bench.shapes import Shape, Wall, facets, outline, shape_of, subtended, surface_of
from acquisition.bench.transducer import Complexes, Piston
from acquisition.bench.unit import Unit

HOUSING = 0.043 * 0.020  # m^2, the sensor's own face, which sends an echo on its way again
FACET = 2.5e-3  # m, under a third of the wavelength
LEAK, FACE, BOUNCE, POST, FLOOR, CEILING, WALL, CLUTTER = range(8)
GROUPS = ("leak", "face", "bounce", "post", "floor", "ceiling", "wall", "clutter")


@dataclass(frozen=True)
class Arrivals:
    """Sound that comes back by one group of ways: half lengths, m, (k,), and complex amplitudes, (k,)."""

    length: Floats
    amplitude: Complexes

    @classmethod
    def of(cls, *ways: tuple[float, complex]) -> Arrivals:
        """Build from pairs of length and amplitude."""
        table = np.array(ways, dtype=np.complex128).reshape(-1, 2)
        return cls(table[:, 0].real, table[:, 1])

    def __add__(self, other: Arrivals) -> Arrivals:
        """Return both together."""
        return Arrivals(np.append(self.length, other.length), np.append(self.amplitude, other.amplitude))


@dataclass(frozen=True)
class Pose:
    """Where a reflector stands: polar distance, m, bearing, incidence and backward tilt, rad."""

    distance: float
    bearing: float
    incidence: float
    tilt: float = 0.0

    @property
    def centre(self) -> Floats:
        """Return the centre, m, (3,)."""
        return self.distance * np.array([np.cos(self.bearing), np.sin(self.bearing), 0.0])

    @property
    def axes(self) -> Floats:
        """Return unit vectors along the plate's width, its height and its normal, (3, 3)."""
        yaw, tilt = self.bearing - self.incidence, self.tilt
        ahead, side = np.array([np.cos(yaw), np.sin(yaw), 0.0]), np.array([-np.sin(yaw), np.cos(yaw), 0.0])
        up = np.array([0.0, 0.0, 1.0])
        return np.stack([side, np.cos(tilt) * up - np.sin(tilt) * ahead, np.cos(tilt) * ahead + np.sin(tilt) * up])


@dataclass(frozen=True)
class Scene:
    """A unit in front of a reflector; `speed` of sound in m/s fixes wavelength and beam."""

    unit: Unit
    setup: Setup
    pose: Pose
    reflectance: float
    speed: float

    @property
    def wavelength(self) -> float:
        """Of the carrier, m."""
        return self.speed / CARRIER

    @property
    def shape(self) -> Shape:
        """Of the reflector."""
        return self.setup.reflector or shape_of(self.reflectance)

    def beam(self, points: Floats) -> Floats:
        """Return one leg's directivity towards points (..., 3)."""
        yaw, pitch = self.unit.yaw, self.unit.pitch
        axis = np.array([np.cos(yaw) * np.cos(pitch), np.sin(yaw) * np.cos(pitch), np.sin(pitch)])
        cosine = points @ axis / np.maximum(np.sqrt((points**2).sum(axis=-1)), 1e-9)
        return Piston(2.0 * np.pi * self.unit.radius / self.wavelength)(np.arccos(np.clip(cosine, -1.0, 1.0)))

    def groups(self) -> dict[int, Arrivals]:
        """Return the arrivals of every group that has any."""
        found = {LEAK: self.leak(), FACE: self.face()}
        found[BOUNCE] = self.bounce(found[FACE])
        found |= dict(self._stand()) | dict(self._room())
        return {name: arrivals for name, arrivals in found.items() if len(arrivals.length)}

    def leak(self) -> Arrivals:
        """Return the sound that goes from transmitter to receiver directly."""
        return Arrivals.of((0.5 * self.unit.leak_delay * self.speed, 10.0 ** (self.unit.leak_db / 20.0)))

    def face(self) -> Arrivals:
        """Return the mirror echo of the reflector, where it has one, first; then the waves from its outline."""
        surface = surface_of(self.reflectance)
        side, up, normal = self.pose.axes
        centre = self.pose.centre
        h = float(centre @ normal)
        if surface == 0.0 or h <= 0.0:
            return Arrivals.of()
        mirror = surface * float(self.beam(h * normal)) ** 2 / (2.0 * h)
        if isinstance(self.shape, Wall):
            return Arrivals.of((h, mirror))
        points = outline(self.shape)
        foot = np.array([-(centre @ side), -(centre @ up)])
        angle = subtended(points, foot)
        middle = 0.5 * (points[:-1] + points[1:])
        length = np.sqrt(h**2 + ((middle - foot) ** 2).sum(axis=1))
        place = centre + middle @ np.stack([side, up])
        edge = -surface * self.beam(place) ** 2 * h / length**2 * angle / (4.0 * np.pi)
        held = round(float(angle.sum()) / (2.0 * np.pi))
        return Arrivals.of((h, mirror * held)) + Arrivals(length, edge.astype(np.complex128))

    def bounce(self, face: Arrivals) -> Arrivals:
        """Return the echo that the sensor's own face sends to the reflector a second time."""
        if not len(face.length) or face.amplitude[0] == 0.0:
            return Arrivals.of()
        again = face.amplitude[0] * HOUSING / self.wavelength
        return Arrivals(face.length + face.length[0], face.amplitude * again)

    def shadow(self, point: Floats) -> float:
        """Return what passes the reflector on the way to a point behind it, as amplitude one way."""
        side, up, normal = self.pose.axes
        reach, plane = float(point @ normal), float(self.pose.centre @ normal)
        if surface_of(self.reflectance) == 0.0 or not 0.0 < plane < reach:
            return 1.0
        crossing = point * plane / reach
        near, far = np.linalg.norm(crossing), np.linalg.norm(point - crossing)
        scale = float(np.sqrt(2.0 * (near + far) / (self.wavelength * near * far)))
        offset = crossing - self.pose.centre
        width, height = self.shape.half
        covered = _covered(float(offset @ side), width, scale) * _covered(float(offset @ up), height, scale)
        return float(abs(1.0 - covered))

    def _stand(self) -> Iterator[tuple[int, Arrivals]]:
        if self.setup.post is not None:
            yield POST, self.post(self.setup.post)

    def post(self, post: Post) -> Arrivals:
        """Return the echo of the stand's upright: a long cylinder, seen past the reflector."""
        normal = self.pose.axes[2] * np.array([1.0, 1.0, 0.0])
        axis = self.pose.centre + post.behind * normal / np.linalg.norm(normal)
        front = float(np.linalg.norm(axis)) - post.radius
        if front <= 0.0:
            return Arrivals.of()
        pressure = np.sqrt(post.radius / (post.radius + front)) / (2.0 * front)
        ways: list[tuple[float, complex]] = [(front, pressure * float(self.beam(axis)) ** 2 * self.shadow(axis) ** 2)]
        room = self.setup.room
        if room.height is not None:  # its foot and the floor form a corner
            ways.append(self._corner(axis, -room.height, room.floor_factor * np.sqrt(post.radius / front)))
        return Arrivals.of(*ways)

    def _corner(self, foot: Floats, z: float, factor: float) -> tuple[float, complex]:
        """Return the echo of a right-angled corner, which sends sound back where it came from."""
        place = np.array([foot[0], foot[1], z])
        length = float(np.linalg.norm(place))
        return length, factor * float(self.beam(place)) ** 2 / (2.0 * length)

    def _room(self) -> Iterator[tuple[int, Arrivals]]:
        room = self.setup.room
        if room.height is not None:
            yield FLOOR, self._surface(-room.height, room.floor_factor, room)
        if room.height is not None and room.ceiling is not None:
            yield CEILING, self._surface(room.ceiling - room.height, room.ceiling_factor, room)
        if room.wall is not None:
            ahead = np.array([room.wall, 0.0, 0.0])
            passed = float(self.beam(ahead)) ** 2 * self.shadow(ahead) ** 2
            yield WALL, Arrivals.of((room.wall, room.wall_factor * passed / (2.0 * room.wall)))

        if room.clutter:
            yield CLUTTER, Arrivals.of(*map(self._scattered, room.clutter))

    def _scattered(self, thing: Scatterer) -> tuple[float, complex]:
        place = np.array(thing.position_m)
        length = float(np.linalg.norm(place))
        passed = float(self.beam(place)) ** 2 * self.shadow(place) ** 2
        return length, 10.0 ** (thing.strength_db / 20.0) * passed / length**2

    def _surface(self, z: float, factor: float, room: Room) -> Arrivals:
        """Return the echoes by a level surface at height z over the beam's axis, images of first order."""
        below = np.array([0.0, 0.0, z])
        ways: list[tuple[float, complex]] = [(abs(z), factor * float(self.beam(below)) ** 2 / (2.0 * abs(z)))]
        if room.wall is not None:
            ways.append(self._corner(np.array([room.wall, 0.0]), z, factor * room.wall_factor))
        return Arrivals.of(*ways) + self._by_way_of(z, factor)

    def _by_way_of(self, z: float, factor: float) -> Arrivals:
        """Return the ways sensor - level surface - reflector - sensor and back, from the reflector's facets.

        Each facet sends on i k/(2 pi) dS/(r1 r2) of what it gets (Kirchhoff), r1 counted from the sensor's image.
        The beam is taken at the reflector's centre: by this detour it looks small.
        """
        surface = surface_of(self.reflectance)
        if surface == 0.0 or isinstance(self.shape, Wall):
            return Arrivals.of()
        side, up, normal = self.pose.axes
        centre = self.pose.centre
        plane, area = facets(self.shape, FACET)
        image = np.array([0.0, 0.0, 2.0 * z])
        place = centre + plane @ np.stack([side, up])
        from_image = place - image
        r1, r2 = np.sqrt((from_image**2).sum(axis=1)), np.sqrt((place**2).sum(axis=1))
        slant = 0.5 * (from_image @ normal / r1 + place @ normal / r2)
        launch = (centre - image) * np.array([1.0, 1.0, -1.0])
        beams = float(self.beam(launch)) * float(self.beam(centre))
        density = 1j / self.wavelength * area * 2.0 * factor * surface * beams
        return Arrivals(0.5 * (r1 + r2), density * slant / (r1 * r2))


def _covered(offset: float, half: float, scale: float) -> complex:
    """Return the share of a wave that a strip takes out of it (Fresnel's integrals)."""
    if np.isinf(half):
        return 1.0 + 0.0j
    low, high = _fresnel((np.array([-half, half]) - offset) * scale)
    return complex((high - low) / (1.0 + 1.0j))


def _fresnel(v: Floats) -> Complexes:
    grid, value = _fresnel_table()
    inside = np.interp(np.abs(v), grid, value.real) + 1j * np.interp(np.abs(v), grid, value.imag)
    return np.sign(v) * np.where(np.abs(v) > grid[-1], 0.5 + 0.5j, inside)


@lru_cache(maxsize=1)
def _fresnel_table() -> tuple[Floats, Complexes]:
    grid = np.linspace(0.0, 12.0, 24_001)
    wave = np.exp(0.5j * np.pi * grid**2)
    steps = 0.5 * (wave[1:] + wave[:-1]) * grid[1]
    return grid, np.concatenate([[0.0], np.cumsum(steps)])
