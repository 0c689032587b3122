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

from acquisition.bench.air import Floats

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


@dataclass(frozen=True)
class Plate:
    """An upright rectangle."""

    width: float
    height: float

    @property
    def half(self) -> tuple[float, float]:
        """Half width and half height, m."""
        return self.width / 2.0, self.height / 2.0


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
        count = int(np.ceil(2.0 * np.pi * shape.radius / PIECE))
        angle = np.linspace(0.0, 2.0 * np.pi, count + 1)
        # pieces are chords: the polygon of equal area keeps the mean radius
        scale = shape.radius * np.sqrt(angle[1] / np.sin(angle[1]))
        return scale * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1), (-1, -1)]) * np.array(shape.half)
    sides = [np.linspace(a, b, _pieces(a, b), endpoint=False) for a, b in pairwise(corners)]
    return np.concatenate([*sides, corners[-1:]])


def _pieces(a: Floats, b: Floats) -> int:
    return int(np.ceil(np.linalg.norm(b - a) / PIECE))


@lru_cache(maxsize=64)
def facets(shape: Disc | Plate, step: float) -> tuple[Floats, Floats]:
    """Return the centres of a plate's facets about its centre, m, (m, 2), and the sides of one, m, (2,).

    Of a disc, the facets that its rim cuts are kept or left whole, and the sides corrected so that the area is right.
    """
    half = (shape.radius, shape.radius) if isinstance(shape, Disc) else shape.half
    count = [int(np.ceil(2.0 * h / step)) for h in half]
    axes = [(np.arange(n) + 0.5) / n * 2.0 * h - h for n, h in zip(count, half, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    if isinstance(shape, Disc):
        grid = grid[(grid**2).sum(axis=1) < shape.radius**2]
        return grid, np.full(2, shape.radius * np.sqrt(np.pi / len(grid)))
    return grid, np.array([2.0 * h / n for n, h in zip(count, half, strict=True)])


def subtended(corners: Floats) -> Floats:
    """Return the signed angle that each piece of an outline (..., pieces + 1, 2) subtends at the origin, rad."""
    x, y = corners[..., 0], corners[..., 1]
    a, b, c, d = x[..., :-1], y[..., :-1], x[..., 1:], y[..., 1:]
    return np.arctan2(a * d - b * c, a * c + b * d)
