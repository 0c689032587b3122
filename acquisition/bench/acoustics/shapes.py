"""Reflectors: flat plates given by their outline, and the echo of one from any direction.

Kirchhoff's integral over a flat hard plate, in the time domain, falls into a mirror echo from the foot of the
perpendicular, where the plate holds it, and a wave from the outline (Maggi 1888, Rubinowicz 1917): with h the distance
of the plane and dphi the angle that a piece of outline at distance r subtends at the foot,

    echo = winding/(2h) delta(2h) - 1/(4 pi) sum h/r^2 dphi delta(2r).

For a disc met on its axis this is the exact 1/(2d) [delta(2d) - (d/R)^2 delta(2R)].
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from acquisition.bench.acoustics.air import Floats

PIECE = 4.0e-3  # m of outline a piece, along which the phase is taken to grow evenly


@dataclass(frozen=True)
class Disc:
    """A round plate."""

    radius: float

    @property
    def half(self) -> tuple[float, float]:
        """Half width and half height of the rectangle of the same area, m."""
        side = self.radius * np.sqrt(np.pi) / 2.0
        return side, side

    @property
    def area(self) -> float:
        """Of the plate, m^2."""
        return float(np.pi * self.radius**2)

    def holds(self, points: Floats) -> NDArray[np.bool_]:
        """Tell which points of its plane (n, 2) lie on it."""
        return np.asarray((points**2).sum(axis=-1) < self.radius**2)


@dataclass(frozen=True)
class Plate:
    """An upright rectangle."""

    width: float
    height: float

    @property
    def half(self) -> tuple[float, float]:
        """Half width and half height, m."""
        return self.width / 2.0, self.height / 2.0

    @property
    def area(self) -> float:
        """Of the plate, m^2."""
        return self.width * self.height

    def holds(self, points: Floats) -> NDArray[np.bool_]:
        """Tell which points of its plane (n, 2) lie on it."""
        return np.asarray((np.abs(points) < self.half).all(axis=-1))


@dataclass(frozen=True)
class Wall:
    """A plane without an end."""

    @property
    def half(self) -> tuple[float, float]:
        """Half width and half height, m."""
        return np.inf, np.inf


Shape = Disc | Plate | Wall

# the thesis's reflectors (Esmi 2016, section 3.2) by the reflectance that it gives them
MIRROR = Disc(0.100)
RUBBER = Plate(0.120, 0.130)
# amplitude factor of the surface over reflectance: ours. Nothing comes back from 0; solid rubber and glass are both
# hard to sound in air, and rubber's soft skin takes 2 dB.
SURFACE = ((0.0, 0.1, 0.9, 1.0), (0.0, 0.8, 1.0, 1.0))


def shape_of(reflectance: float) -> Shape:
    """Return the reflector that the thesis would have taken: the rubber plate below 0.5, the mirror from there."""
    return RUBBER if reflectance < 0.5 else MIRROR


def surface_of(reflectance: float) -> float:
    """Return the amplitude factor of a reflector's surface.

    >>> surface_of(0.9), surface_of(0.05)
    (1.0, 0.4)
    """
    return float(surfaces_of(np.array(reflectance)))


def surfaces_of(reflectance: Floats) -> Floats:
    """Return the amplitude factors of many surfaces, in the shape given."""
    return np.interp(reflectance, *SURFACE)


@lru_cache(maxsize=64)
def outline(shape: Disc | Plate) -> Floats:
    """Return the outline as points about the centre, counter-clockwise and closed, m, (pieces + 1, 2)."""
    if isinstance(shape, Disc):
        count = 2 * int(np.ceil(np.pi * shape.radius / PIECE))
        angle = np.linspace(0.0, 2.0 * np.pi, count + 1)
        # pieces are chords: the polygon of equal area keeps the mean radius
        scale = shape.radius * np.sqrt(angle[1] / np.sin(angle[1]))
        return scale * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1), (-1, -1)]) * np.array(shape.half)
    sides = [np.linspace(a, b, _pieces(a, b), endpoint=False) for a, b in pairwise(corners)]
    return np.concatenate([*sides, corners[-1:]])


def _pieces(a: Floats, b: Floats) -> int:
    return 2 * int(np.ceil(np.linalg.norm(b - a) / (2.0 * PIECE)))  # even, so that two can be taken as one


def subtended(corners: Floats) -> Floats:
    """Return the signed angle that each piece of an outline (..., pieces + 1, 2) subtends at the origin, rad."""
    x, y = corners[..., 0], corners[..., 1]
    a, b, c, d = x[..., :-1], y[..., :-1], x[..., 1:], y[..., 1:]
    return np.arctan2(a * d - b * c, a * c + b * d)
