"""Echo paths between the sensor and the reflectors of many scenes.

Axes: x ahead of the housing, y to its left, z up, the sensor at the origin. All quantities are computed for n scenes at
once; arrays have the scene as their first axis.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from acquisition.arrays import Floats, Ints
from acquisition.bench.acoustics.arrivals import BOUNCE, FACE, LEAK, Arrivals, Complexes
from acquisition.bench.acoustics.transducer import directivity
from acquisition.bench.laboratory.air import CARRIER, Air
from acquisition.bench.laboratory.setup import Setup
from acquisition.bench.laboratory.shapes import Disc, Plate, Shape, Wall, outline, shape_of, subtended, surfaces_of
from acquisition.bench.laboratory.unit import Unit
from acquisition.bench.visits import TILT
from acquisition.ping import Ping

HOUSING_AREA = 0.043 * 0.020  # m^2, area of the sensor's face, which reflects echoes
# a wall at 6 m in air of 1.29 dB/m just reaches the threshold at full gain
REFERENCE = 12.0 * 10.0 ** (1.29 * 12.0 / 20.0)
NEGLIGIBLE = 0.02  # level relative to the threshold at full gain below which a path is omitted


def amplitude_scale(unit: Unit, supply: float = 1.0) -> float:
    """Return the level, relative to the threshold at full gain, of an amplitude of 1 (the pressure at 1 m)."""
    return REFERENCE * supply * float(10.0 ** (unit.sensitivity_db / 20.0))


@dataclass(frozen=True)
class Poses:
    """Positions and orientations of reflectors, each (n,).

    Attributes:
        distance: slant distance to the centre, m.
        bearing, incidence: rad; the normal points `bearing - incidence` to the left.
        tilt: of the top towards the sensor, rad.
        above: height of the centre above the sensor, m.
    """

    distance: Floats
    bearing: Floats
    incidence: Floats
    tilt: Floats
    above: Floats

    @cached_property
    def centre(self) -> Floats:
        """Centres, m, (n, 3)."""
        level = np.sqrt(np.maximum(self.distance**2 - self.above**2, 1e-6))
        return np.stack([level * np.cos(self.bearing), level * np.sin(self.bearing), self.above], axis=-1)

    @cached_property
    def axes(self) -> tuple[Floats, Floats, Floats]:
        """Unit vectors along each plate's width, height and normal, (n, 3) each."""
        yaw, none = self.bearing - self.incidence, np.zeros(len(self.tilt))
        ahead = np.stack([np.cos(yaw), np.sin(yaw), none], axis=-1)
        side = np.stack([-np.sin(yaw), np.cos(yaw), none], axis=-1)
        cosine, sine = np.cos(self.tilt)[:, None], np.sin(self.tilt)[:, None]
        up = np.array([0.0, 0.0, 1.0])
        return side, cosine * up - sine * ahead, cosine * ahead + sine * up


@dataclass(frozen=True)
class PathGeometry:
    """Sensor in front of n reflectors, each in its own air.

    Attributes:
        unit: the sensor.
        setup: the laboratory.
        poses: of the reflectors.
        reflectance: (n,).
        air: of each scene.
    """

    unit: Unit
    setup: Setup
    poses: Poses
    reflectance: Floats
    air: Air

    @classmethod
    def of(cls, unit: Unit, setup: Setup, placed: Ping, air: Air) -> PathGeometry:
        """Build from pings as returned by `Rig.place`; a vertical temperature gradient bends the paths."""
        lean = placed.covariates.get(TILT, np.zeros(len(placed)))
        bend = setup.gradient.bend(air)
        # in coordinates of straight rays the reflector is higher and its top nearer (circles of curvature `bend`)
        above = setup.above_m + 0.5 * bend * placed.distance**2
        lean = lean + bend * placed.distance
        return cls(
            unit,
            setup,
            Poses(placed.distance, placed.angle, placed.incidence, lean, np.broadcast_to(above, lean.shape)),
            placed.reflectance,
            air.with_extra_absorption(setup.extra_absorption_db),
        )

    def __len__(self) -> int:
        """Return the number of scenes."""
        return len(self.reflectance)

    @cached_property
    def rows(self) -> Ints:
        """Indices of the scenes."""
        return np.arange(len(self))

    @cached_property
    def wavelength(self) -> Floats:
        """Wavelength of the carrier, m, (n,)."""
        return self.air.speed / CARRIER

    @cached_property
    def ka(self) -> Floats:
        """Wave number times radius of the pistons, (n,)."""
        return 2.0 * np.pi * self.unit.radius / self.wavelength

    @cached_property
    def axis(self) -> Floats:
        """Axis of the beam, a unit vector (3,)."""
        yaw, pitch = self.unit.yaw, self.unit.pitch
        return np.array([np.cos(yaw) * np.cos(pitch), np.sin(yaw) * np.cos(pitch), np.sin(pitch)])

    @cached_property
    def surface(self) -> Floats:
        """Amplitude factors of the mirror echoes, (n,), reduced by roughness (Ament 1953)."""
        return surfaces_of(self.reflectance) * np.exp(-2.0 * self._unevenness**2)

    @cached_property
    def scattering(self) -> Floats:
        """Fraction of the incident power that roughness scatters diffusely, (n,)."""
        return surfaces_of(self.reflectance) ** 2 * -np.expm1(-4.0 * self._unevenness**2)

    @cached_property
    def _unevenness(self) -> Floats:
        """One-way root mean square phase due to roughness, rad, (n,)."""
        return 2.0 * np.pi / self.wavelength * self.setup.roughness_m * np.cos(self.poses.incidence)

    @cached_property
    def shapes(self) -> list[tuple[Shape, Ints]]:
        """Each shape with the scenes in which it reflects."""
        if self.setup.reflector is not None:
            return [(self.setup.reflector, np.flatnonzero(self.surface > 0.0))]
        low = self.reflectance < 0.5
        rows = [np.flatnonzero((self.surface > 0.0) & which) for which in (low, ~low)]
        return [(shape_of(value), pick) for value, pick in zip((0.0, 1.0), rows, strict=True) if len(pick)]

    @cached_property
    def half(self) -> tuple[Floats, Floats]:
        """Half width and half height of the rectangle of each reflector's area, m, (n,) each."""
        wide, high = np.zeros(len(self)), np.zeros(len(self))
        for shape, rows in self.shapes:
            wide[rows], high[rows] = shape.half
        return wide, high

    def beam(self, points: Floats, rows: Ints | slice = slice(None)) -> Floats:
        """Return the one-way beam pattern towards points (m, 3) or (m, k, 3) of some scenes."""
        away = np.maximum(np.sqrt((points**2).sum(axis=-1)), 1e-9)
        return self.beam_at_cosine(points @ self.axis / away, rows)

    def beam_at_cosine(self, cosine: Floats, rows: Ints | slice = slice(None)) -> Floats:
        """Return the one-way beam pattern at angles of given cosines off the axis, (m,) or (m, k), of some scenes."""
        ka = self.ka[rows]
        straight = directivity(ka[:, None] if cosine.ndim == 2 else ka, cosine)
        return straight if self.unit.spill == 0.0 else straight + self.unit.spill

    def negligible(self, amplitude: Floats, path: Floats, rows: Ints | slice = slice(None)) -> np.ndarray:
        """Return where an amplitude over a half path length (m,) is far below the threshold at full gain, (m,)."""
        loss = 10.0 ** (-0.1 * self.air.absorption_db[rows] * path)
        return amplitude_scale(self.unit, self.setup.supply) * np.abs(amplitude) * loss < NEGLIGIBLE

    def reflector_paths(self) -> Iterator[Arrivals]:
        """Yield the direct leak, the reflectors' echoes, and their second and third round trips."""
        delay = 0.5 * self.unit.leak_delay * self.air.speed
        yield Arrivals.of(self.rows, LEAK, delay, 10.0 ** (self.unit.leak_db / 20.0) * np.ones(len(self)))
        for shape, rows in self.shapes:
            h, mirror, face = self._face(shape, rows)
            yield face
            yield from self._multiple_echoes(rows, h, mirror, face)

    def _face(self, shape: Shape, rows: Ints) -> tuple[Floats, Floats, Arrivals]:
        """Return distance and mirror echo of the planes of m reflectors, (m,) each, and all echoes of their faces."""
        side, up, normal = (axis[rows] for axis in self.poses.axes)
        centre = self.poses.centre[rows]
        h = (centre * normal).sum(axis=-1)
        ahead = np.maximum(h, 1e-9)
        mirror = np.where(h > 0.0, self.surface[rows] * self.beam(normal, rows) ** 2 / (2.0 * ahead), 0.0)
        if isinstance(shape, Wall):
            return h, mirror, Arrivals.of(rows, FACE, h, mirror)
        foot = -np.stack([(centre * side).sum(axis=-1), (centre * up).sum(axis=-1)], axis=-1)
        winding, length, edge = self._outline(shape, rows, np.where(h > 0.0, h, np.nan), foot)
        mirror = mirror * winding
        return h, mirror, Arrivals.joined([Arrivals.of(rows, FACE, h, mirror), Arrivals.of(rows, FACE, length, edge)])

    def _outline(self, shape: Disc | Plate, rows: Ints, h: Floats, foot: Floats) -> tuple[Floats, Floats, Floats]:
        """Return winding numbers of m outlines about their feet, (m,), and half length and amplitude per piece, (m, k).

        Along a piece the phase grows by 2 pi times twice the difference of its ends' distances over the wavelength.
        """
        side, up, _ = (axis[rows] for axis in self.poses.axes)
        points = outline(shape)
        angle = subtended(points - foot[:, None])
        ends = np.sqrt(h[:, None] ** 2 + ((points - foot[:, None]) ** 2).sum(axis=-1))
        middle = 0.5 * (points[:-1] + points[1:])
        length = np.sqrt(h[:, None] ** 2 + ((middle - foot[:, None]) ** 2).sum(axis=-1))
        along = np.stack([side @ self.axis, up @ self.axis], axis=0)
        cosine = ((self.poses.centre[rows] @ self.axis)[:, None] + along.T @ middle.T) / length
        spread = np.sinc(2.0 * np.diff(ends, axis=1) / self.wavelength[rows, None])
        strength = -self.surface[rows] * h / (4.0 * np.pi)
        edge = strength[:, None] * self.beam_at_cosine(cosine, rows) ** 2 * angle * spread / length**2
        return np.rint(angle.sum(axis=1) / (2.0 * np.pi)), length, np.nan_to_num(edge)

    def _multiple_echoes(self, rows: Ints, h: Floats, mirror: Floats, face: Arrivals) -> Iterator[Arrivals]:
        """Yield the echoes that the sensor's housing reflects back to the reflectors."""
        factor, reach = np.zeros(len(self)), np.zeros(len(self))
        factor[rows] = mirror * HOUSING_AREA / self.wavelength[rows]
        reach[rows] = h
        factor[self.negligible(2.0 * factor * np.abs(factor) * self.wavelength / HOUSING_AREA, 2.0 * reach)] = 0.0
        paths = face[factor[face.row] != 0.0]
        strength, extra = factor[paths.row], reach[paths.row]
        yield Arrivals.of(paths.row, BOUNCE, paths.length + extra, paths.amplitude * strength)
        yield Arrivals.of(self.rows, BOUNCE, 3.0 * reach, factor**3 * self.wavelength / HOUSING_AREA)

    def shadow(self, points: Floats) -> Floats:
        """Return the one-way amplitude factor of diffraction past the reflectors, to points (n, k, 3), (n, k)."""
        side, up, normal = self.poses.axes
        reach = np.einsum("nkx,nx->nk", points, normal)
        plane = (self.poses.centre * normal).sum(axis=-1)[:, None]
        hidden = (self.surface[:, None] > 0.0) & (plane > 0.0) & (plane < reach)
        share = np.where(hidden, plane / np.where(reach > 0.0, reach, 1.0), 0.5)
        away = np.maximum(np.sqrt((points**2).sum(axis=-1)), 1e-9)
        near, far = share * away, (1.0 - share) * away
        scale = np.sqrt(2.0 * away / (self.wavelength[:, None] * np.maximum(near * far, 1e-12)))
        offset = share[..., None] * points - self.poses.centre[:, None]
        covered = np.ones(reach.shape, dtype=np.complex128)
        for axis, half in zip((side, up), self.half, strict=True):
            covered *= strip(np.einsum("nkx,nx->nk", offset, axis), half[:, None], scale)
        return np.where(hidden, np.abs(1.0 - covered), 1.0)


def strip(offset: Floats, half: Floats, scale: Floats) -> Complexes:
    """Return the fraction of a wave that a strip intercepts (Fresnel integrals).

    Args:
        offset: distance of the foot of the wave from the strip's centre line, m.
        half: half width of the strip, m; may be infinite.
        scale: scale of the Fresnel integrals, 1/m.
    """
    low, high = _fresnel((-half - offset) * scale), _fresnel((half - offset) * scale)
    return (high - low) / (1.0 + 1.0j)


FRESNEL_STEP, FRESNEL_LENGTH = 5e-4, 24_000


def _fresnel(v: Floats) -> Complexes:
    place = np.minimum(np.abs(v) / FRESNEL_STEP, FRESNEL_LENGTH - 1.0)
    at = place.astype(np.int64)
    table = _fresnel_table()
    inside = table[at] + (place - at) * (table[at + 1] - table[at])
    return np.sign(v) * np.where(np.abs(v) > FRESNEL_STEP * (FRESNEL_LENGTH - 1), 0.5 + 0.5j, inside)


@lru_cache(maxsize=1)
def _fresnel_table() -> Complexes:
    wave = np.exp(0.5j * np.pi * (np.arange(FRESNEL_LENGTH + 1) * FRESNEL_STEP) ** 2)
    return np.concatenate([[0.0], np.cumsum(0.5 * (wave[1:] + wave[:-1]) * FRESNEL_STEP)])
