"""Colours, camera and brush of the rendered image."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import pygame
from numpy.typing import ArrayLike

Colour = tuple[int, int, int]
Point = tuple[float, float]

PAPER: Colour = (247, 246, 242)
INK: Colour = (34, 40, 49)
FAINT: Colour = (134, 142, 153)
HAIRLINE: Colour = (221, 221, 214)
ASPHALT: Colour = (88, 96, 108)
STRIP: Colour = (104, 112, 124)
PAVEMENT: Colour = (205, 201, 190)
MARKING: Colour = (240, 240, 236)
CAR: Colour = (42, 111, 219)
GLASS: Colour = (24, 40, 66)
TYRE: Colour = (22, 24, 28)
SPACE: Colour = (120, 214, 158)
TRUTH: Colour = (255, 255, 255)
GOOD: Colour = (38, 162, 118)
BAD: Colour = (205, 62, 66)
# credence 0, 1/2, 1; they also differ in lightness, for people with red-green colour blindness
CREDENCE: tuple[Colour, Colour, Colour] = ((214, 64, 69), (246, 190, 68), (38, 190, 150))
DARK_BOX: Colour = (78, 58, 44)  # reflectance 0
LIGHT_BOX: Colour = (226, 194, 148)  # reflectance 1


def blend(a: Colour, b: Colour, share: float) -> Colour:
    """Return the colour at a fraction `share` of the way from a to b."""
    r, g, b_ = (round(x + (y - x) * share) for x, y in zip(a, b, strict=True))
    return r, g, b_


def credence_colour(credence: float) -> Colour:
    """Return the colour of a credence, 0 to 1."""
    low, middle, high = CREDENCE
    credence = min(max(credence, 0.0), 1.0)
    return blend(low, middle, 2 * credence) if credence < 0.5 else blend(middle, high, 2 * credence - 1)


@dataclass(frozen=True)
class Camera:
    """Transformation from metres to pixels; y points up in the world and down in the image.

    Attributes:
        left, top: world coordinates of the upper left corner, m.
        scale: scale, px/m.
        x, y: pixel coordinates of the upper left corner, px.
    """

    left: float
    top: float
    scale: float
    x: float = 0.0
    y: float = 0.0

    def pixel(self, point: ArrayLike) -> Point:
        """Return the pixel of a point."""
        px, py = np.asarray(point, dtype=np.float64)[:2]
        return self.x + (px - self.left) * self.scale, self.y + (self.top - py) * self.scale

    def pixels(self, points: Iterable[ArrayLike]) -> list[Point]:
        """Return the pixels of points."""
        return [self.pixel(point) for point in points]


class Brush:
    """Draws on a surface, in coordinates of the final image; the surface is larger by `detail` for antialiasing.

    Args:
        surface: surface to draw on.
        detail: pixels of the surface per pixel of the image.
    """

    def __init__(self, surface: pygame.Surface, detail: int) -> None:
        pygame.font.init()
        self.surface = surface
        self.detail = detail
        self._fonts: dict[int, pygame.font.Font] = {}

    def _scaled(self, points: Iterable[Point]) -> list[Point]:
        return [(x * self.detail, y * self.detail) for x, y in points]

    def polygon(self, points: Sequence[Point], fill: Colour, alpha: int = 255) -> None:
        """Fill a polygon, transparent if `alpha` is below 255."""
        if alpha == 255:
            pygame.draw.polygon(self.surface, fill, self._scaled(points))
        else:
            self._blend_polygon(points, fill, alpha)

    def _blend_polygon(self, points: Sequence[Point], fill: Colour, alpha: int) -> None:
        """Fill a transparent polygon, on a layer no larger than the polygon."""
        up = np.array(self._scaled(points))
        low = np.floor(np.clip(up.min(axis=0), 0, self.surface.get_size())).astype(int)
        high = np.ceil(np.clip(up.max(axis=0), 0, self.surface.get_size())).astype(int) + 1
        size = np.minimum(high, self.surface.get_size()) - low
        if np.any(size <= 0):
            return
        layer = pygame.Surface(tuple(size), pygame.SRCALPHA)
        pygame.draw.polygon(layer, (*fill, alpha), [tuple(p) for p in up - low])
        self.surface.blit(layer, tuple(low))

    def line(self, points: Sequence[Point], colour: Colour, width: float = 1.0, closed: bool = False) -> None:
        """Draw a line through points."""
        thickness = max(1, round(width * self.detail))
        pygame.draw.lines(self.surface, colour, closed, self._scaled(points), thickness)

    def dashes(self, start: Point, end: Point, colour: Colour, dash: float, gap: float, width: float) -> None:
        """Draw a dashed line."""
        length = math.dist(start, end)
        for begin in np.arange(0.0, length, dash + gap):
            a, b = begin / length, min(begin + dash, length) / length
            ends = [(start[0] + t * (end[0] - start[0]), start[1] + t * (end[1] - start[1])) for t in (a, b)]
            self.line(ends, colour, width)

    def disc(self, centre: Point, radius: float, fill: Colour) -> None:
        """Fill a circle."""
        ((x, y),) = self._scaled([centre])
        pygame.draw.circle(self.surface, fill, (x, y), radius * self.detail)

    def ring(self, centre: Point, radius: float, colour: Colour, width: float = 2.0) -> None:
        """Draw a circle."""
        ((x, y),) = self._scaled([centre])
        pygame.draw.circle(self.surface, colour, (x, y), radius * self.detail, max(1, round(width * self.detail)))

    def panel(self, x: float, y: float, width: float, height: float, fill: Colour, radius: float = 0.0) -> None:
        """Fill a rectangle with rounded corners."""
        d = self.detail
        box = pygame.Rect(round(x * d), round(y * d), round(width * d), round(height * d))
        pygame.draw.rect(self.surface, fill, box, border_radius=round(radius * d))

    def text(self, text: str, pixel: Point, size: int, colour: Colour = INK, at: str = "w") -> None:
        """Write text; `at` is the side of the text at the given pixel: "w" left, "e" right, "c" centre."""
        image = self._font(size).render(text, True, colour)
        box = image.get_rect()
        x, y = round(pixel[0] * self.detail), round(pixel[1] * self.detail)
        side = {"w": "midleft", "e": "midright", "c": "center"}[at]
        setattr(box, side, (x, y))
        self.surface.blit(image, box)

    def _font(self, size: int) -> pygame.font.Font:
        if size not in self._fonts:
            self._fonts[size] = pygame.font.Font(None, round(size * 1.35 * self.detail))
        return self._fonts[size]


def wedge(apex: Point, axis: float, half: float, radius: float, parts: int = 24) -> list[Point]:
    """Return the outline of a sector in metres: apex, then the arc."""
    angles = np.linspace(axis - half, axis + half, parts)
    return [apex, *((apex[0] + radius * math.cos(a), apex[1] + radius * math.sin(a)) for a in angles)]
