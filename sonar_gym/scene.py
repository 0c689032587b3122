"""Scenes: straight reflecting faces with a reflectance each, and the cones of sonars cast on them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from acquisition import Ping, SettingError
from sonar_gym import kernels

Floats = NDArray[np.float64]
EMPTY_M = 20.0  # m; distance given to a model for an empty cone: beyond what any of the sonars can hear


@dataclass(frozen=True)
class Wall:
    """A straight face.

    Attributes:
        x1, y1, x2, y2: its ends, m.
        reflectance: 0..1.
    """

    x1: float
    y1: float
    x2: float
    y2: float
    reflectance: float = 0.9

    def __post_init__(self) -> None:
        """Refuse what reflects more than all, or less than nothing."""
        if not 0.0 <= self.reflectance <= 1.0:
            raise SettingError(f"Wall.reflectance must lie in [0, 1], got {self.reflectance:g}")

    @property
    def faces(self) -> Floats:
        """The face as one segment, m, (1, 4)."""
        return np.array([[self.x1, self.y1, self.x2, self.y2]])


@dataclass(frozen=True)
class Box:
    """A rectangular obstacle.

    Attributes:
        x, y: its centre, m.
        length, width: its sides along and across its heading, m.
        heading: rad.
        reflectance: 0..1.
    """

    x: float
    y: float
    length: float
    width: float
    heading: float = 0.0
    reflectance: float = 0.5

    def __post_init__(self) -> None:
        """Refuse a box without extent, and what reflects more than all, or less than nothing."""
        if self.length <= 0.0 or self.width <= 0.0:
            raise SettingError(f"Box sides must be > 0 m, got {self.length:g} m x {self.width:g} m")
        if not 0.0 <= self.reflectance <= 1.0:
            raise SettingError(f"Box.reflectance must lie in [0, 1], got {self.reflectance:g}")

    @property
    def corners(self) -> Floats:
        """The corners in order, m, (4, 2)."""
        half = 0.5 * np.array([self.length, self.width])
        c, s = np.cos(self.heading), np.sin(self.heading)
        return np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * half @ np.array([[c, s], [-s, c]]) + [self.x, self.y]

    @property
    def faces(self) -> Floats:
        """The faces as segments, m, (4, 4)."""
        corners = self.corners
        return np.hstack([corners, np.roll(corners, -1, axis=0)])


@dataclass(frozen=True)
class Hits:
    """What s cones met.

    Attributes:
        distance: to the nearest point in the cone, m, (s,); the listening limit where the cone is empty.
        bearing: of that point off the beam axis, rad, (s,).
        incidence: between the ray and the surface normal, rad, (s,).
        reflectance: of the face, (s,); 0 where the cone is empty.
        seen: whether there was anything in the cone, (s,).
        thing: number of the wall or box in its scene, (s,); -1 where the cone is empty.
        point: the nearest point, m, (s, 2).
    """

    distance: Floats
    bearing: Floats
    incidence: Floats
    reflectance: Floats
    seen: NDArray[np.bool_]
    thing: NDArray[np.int64]
    point: Floats

    def ping(self, time: float) -> Ping:
        """Return the conditions that the sensors faced at a time in s; each sensor is a run of its own."""
        n = len(self.distance)
        return Ping(
            distance=np.where(self.seen, self.distance, EMPTY_M),
            angle=self.bearing,
            incidence=self.incidence,
            reflectance=self.reflectance,
            time=np.full(n, time),
            run=np.arange(n),
        )


class Scene:
    """Things that reflect sound and stop cars.

    Args:
        things: walls and boxes.

    >>> hits = Scene([Wall(2.0, -1.0, 2.0, 1.0)]).cast(np.array([[0.0, 0.0, 0.0]]), np.array([0.3]), limit=3.0)
    >>> float(hits.distance[0]), float(hits.incidence[0])
    (2.0, 0.0)
    """

    def __init__(self, things: Iterable[Wall | Box]) -> None:
        self.things: Sequence[Wall | Box] = tuple(things)
        faces = [thing.faces for thing in self.things]
        self.segments = np.vstack(faces) if faces else np.empty((0, 4))
        self.owner = np.repeat(np.arange(len(faces)), [len(face) for face in faces]).astype(np.int64)
        # one entry more: an empty cone has index -1, which must find nothing rather than the last thing
        self._reflectance = np.array([*(self.things[k].reflectance for k in self.owner), 0.0])
        self._owner = np.append(self.owner, kernels.NOTHING)

    def cast(self, poses: Floats, half: Floats, limit: float) -> Hits:
        """Cast cones.

        Args:
            poses: of the sensors, rows x, y, heading: m, m, rad, (s, 3).
            half: half opening angles, rad, (s,).
            limit: nothing farther is found, m.
        """
        distance, bearing, incidence, index, point = kernels.cast_cones(poses, half, self.segments, limit)
        return Hits(distance, bearing, incidence, self._reflectance[index], index >= 0, self._owner[index], point)
