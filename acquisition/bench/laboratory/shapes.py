"""Reflectors: flat plates described by their outline.

Kirchhoff's integral over a flat hard plate, in the time domain, is the sum of a mirror echo from the foot of the
perpendicular, if the plate contains it, and a wave from the outline (Maggi 1888, Rubinowicz 1917): with h the distance
of the plane and dphi the angle that a piece of outline at distance r subtends at the foot,

    echo = winding/(2h) delta(2h) - 1/(4 pi) sum h/r^2 dphi delta(2r).

For a disc on the axis this is the exact 1/(2d) [delta(2d) - (d/R)^2 delta(2R)].
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from acquisition.arrays import Floats

PIECE = 4.0e-3  # m, length of a piece of outline, along which the phase is linear


@dataclass(frozen=True)
class Disc:
    """Round plate; radius in m."""

    radius: float

    @property
    def half(self) -> tuple[float, float]:
        """Half width and half height of the rectangle of the same area, m."""
        side = self.radius * np.sqrt(np.pi) / 2.0
        return side, side

    @property
    def area(self) -> float:
        """Area, m^2."""
        return float(np.pi * self.radius**2)

    def contains(self, points: Floats) -> NDArray[np.bool_]:
        """Return which points of its plane (n, 2) lie on it."""
        return np.asarray((points**2).sum(axis=-1) < self.radius**2)


@dataclass(frozen=True)
class Plate:
    """Upright rectangle; width and height in m."""

    width: float
    height: float

    @property
    def half(self) -> tuple[float, float]:
        """Half width and half height, m."""
        return self.width / 2.0, self.height / 2.0

    @property
    def area(self) -> float:
        """Area, m^2."""
        return self.width * self.height

    def contains(self, points: Floats) -> NDArray[np.bool_]:
        """Return which points of its plane (n, 2) lie on it."""
        return np.asarray((np.abs(points) < self.half).all(axis=-1))


@dataclass(frozen=True)
class Wall:
    """Infinite plane."""

    @property
    def half(self) -> tuple[float, float]:
        """Half width and half height, m."""
        return np.inf, np.inf


Shape = Disc | Plate | Wall

# reflectors of Esmi (2016), section 3.2
MIRROR = Disc(0.100)
RUBBER = Plate(0.120, 0.130)
# amplitude factor by reflectance, a project choice: 0 returns nothing; solid rubber and glass are both acoustically
# hard in air, and the soft surface of rubber costs 2 dB
SURFACE = ((0.0, 0.1, 0.9, 1.0), (0.0, 0.8, 1.0, 1.0))


def shape_of(reflectance: float) -> Shape:
    """Return the thesis's reflector for a reflectance: the rubber plate below 0.5, otherwise the mirror."""
    return RUBBER if reflectance < 0.5 else MIRROR


def surface_of(reflectance: float) -> float:
    """Return the amplitude factor of a reflector's surface.

    >>> surface_of(0.9), surface_of(0.05)
    (1.0, 0.4)
    """
    return float(surfaces_of(np.array(reflectance)))


def surfaces_of(reflectance: Floats) -> Floats:
    """Return the amplitude factors of surfaces, in the shape of the reflectances."""
    return np.interp(reflectance, *SURFACE)


@lru_cache(maxsize=64)
def outline(shape: Disc | Plate) -> Floats:
    """Return the closed outline about the centre, counter-clockwise, m, (pieces + 1, 2)."""
    if isinstance(shape, Disc):
        count = 2 * int(np.ceil(np.pi * shape.radius / PIECE))
        angle = np.linspace(0.0, 2.0 * np.pi, count + 1)
        # pieces are chords: a polygon of equal area has the same mean radius
        scale = shape.radius * np.sqrt(angle[1] / np.sin(angle[1]))
        return scale * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1), (-1, -1)]) * np.array(shape.half)
    sides = [np.linspace(a, b, _pieces(a, b), endpoint=False) for a, b in pairwise(corners)]
    return np.concatenate([*sides, corners[-1:]])


def _pieces(a: Floats, b: Floats) -> int:
    return 2 * int(np.ceil(np.linalg.norm(b - a) / (2.0 * PIECE)))  # even, so that pairs can be merged


def subtended(corners: Floats) -> Floats:
    """Return the signed angle that each piece of an outline (..., pieces + 1, 2) subtends at the origin, rad."""
    x, y = corners[..., 0], corners[..., 1]
    a, b, c, d = x[..., :-1], y[..., :-1], x[..., 1:], y[..., 1:]
    return np.arctan2(a * d - b * c, a * c + b * d)
