"""Scenes: straight reflecting faces with a reflectance each, and the cones of sonars cast on them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from acquisition import Ping, SettingError
from sonar_gym.sensing import kernels

Floats = NDArray[np.float64]
CORNERS = np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])  # of a square of side 2
EMPTY_M = 20.0  # m; distance given to a model for an empty cone: beyond what any of the sonars can hear


def check_surface(what: str, reflectance: float, texture_deg: float) -> None:
    """Refuse a surface that reflects more than all or less than nothing, or whose facets stand on edge."""
    if not 0.0 <= reflectance <= 1.0:
        raise SettingError(f"{what}.reflectance must lie in [0, 1], got {reflectance:g}")
    if not 0.0 <= texture_deg < 90.0:
        raise SettingError(f"{what}.texture_deg must lie in [0, 90) deg, got {texture_deg:g} deg")


@dataclass(frozen=True)
class Wall:
    """A straight face.

    Attributes:
        x1, y1, x2, y2: its ends, m.
        reflectance: 0..1.
        texture_deg: slope of the facets of a rough face: sound that meets it obliquely by less is thrown back as from
            a smooth face met squarely.
    """

    x1: float
    y1: float
    x2: float
    y2: float
    reflectance: float = 0.9
    texture_deg: float = 0.0

    def __post_init__(self) -> None:
        """Refuse what reflects more than all, or less than nothing."""
        check_surface("Wall", self.reflectance, self.texture_deg)

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
        texture_deg: slope of its facets, as of `Wall`.
    """

    x: float
    y: float
    length: float
    width: float
    heading: float = 0.0
    reflectance: float = 0.5
    texture_deg: float = 0.0

    def __post_init__(self) -> None:
        """Refuse a box without extent, and what reflects more than all, or less than nothing."""
        if self.length <= 0.0 or self.width <= 0.0:
            raise SettingError(f"Box sides must be > 0 m, got {self.length:g} m x {self.width:g} m")
        check_surface("Box", self.reflectance, self.texture_deg)

    @property
    def corners(self) -> Floats:
        """The corners in order, m, (4, 2)."""
        return self.faces[:, :2]

    @property
    def faces(self) -> Floats:
        """The faces as segments, m, (4, 4)."""
        return box_faces(np.array([[self.x, self.y, self.length, self.width, self.heading]]))


def box_faces(boxes: Floats) -> Floats:
    """Return the faces of boxes as segments, corner after corner, m, (4 b, 4).

    Args:
        boxes: rows of centre x, y, length, width, heading: m, m, m, m, rad, (b, 5).
    """
    half, c, s = 0.5 * boxes[:, None, 2:4], np.cos(boxes[:, None, 4]), np.sin(boxes[:, None, 4])
    local = CORNERS * half
    x = boxes[:, None, 0] + c * local[..., 0] - s * local[..., 1]
    y = boxes[:, None, 1] + s * local[..., 0] + c * local[..., 1]
    corners = np.stack([x, y], axis=-1)
    return np.concatenate([corners, corners[:, [1, 2, 3, 0]]], axis=-1).reshape(-1, 4)


@dataclass(frozen=True)
class Hits:
    """What s cones met.

    Attributes:
        distance: to the nearest point in the cone, m, (s,); the listening limit where the cone is empty.
        bearing: of that point off the beam axis, rad, (s,).
        incidence: between the ray and the surface normal, less the slope of a rough face's facets, rad, (s,).
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

    Attributes:
        segments: all faces, m, (m, 4).
        surface: reflectance and slope of the facets of each, 1 and rad, (m, 2).
        owner: number of the thing that each belongs to, (m,).

    >>> hits = Scene([Wall(2.0, -1.0, 2.0, 1.0)]).cast(np.array([[0.0, 0.0, 0.0]]), np.array([0.3]), limit=3.0)
    >>> float(hits.distance[0]), float(hits.incidence[0])
    (2.0, 0.0)
    """

    def __init__(self, things: Iterable[Wall | Box]) -> None:
        things = tuple(things)
        faces = [thing.faces for thing in things]
        owner = np.repeat(np.arange(len(faces)), [len(face) for face in faces])
        kind = np.array([[thing.reflectance, thing.texture_deg] for thing in things]).reshape(-1, 2)
        self._keep(np.vstack(faces) if faces else np.empty((0, 4)), kind[owner], owner)

    @classmethod
    def of(cls, segments: Floats, surface: Floats, owner: NDArray[np.int64]) -> Scene:
        """Return a scene of faces.

        Args:
            segments: m, (m, 4).
            surface: reflectance and texture in deg of each, (m, 2).
            owner: number of the thing that each belongs to, (m,).
        """
        scene = cls.__new__(cls)
        scene._keep(segments, surface, owner)
        return scene

    def _keep(self, segments: Floats, surface: Floats, owner: NDArray[np.int64]) -> None:
        self.segments, self.owner = segments, owner.astype(np.int64)
        self.surface = np.column_stack([surface[:, 0], np.radians(surface[:, 1])])
        # one entry more: an empty cone has index -1, which must find nothing rather than the last thing
        self._surface = np.vstack([self.surface, [0.0, 0.0]])
        self._owner = np.append(self.owner, kernels.NOTHING)

    def cast(self, poses: Floats, half: Floats, limit: float) -> Hits:
        """Cast cones.

        Args:
            poses: of the sensors, rows x, y, heading: m, m, rad, (s, 3).
            half: half opening angles, rad, (s,).
            limit: nothing farther is found, m.
        """
        distance, bearing, incidence, index, point = kernels.cast_cones(poses, half, self.segments, limit)
        reflectance, texture = self._surface[index].T
        met = np.maximum(incidence - texture, 0.0)
        return Hits(distance, bearing, met, reflectance, index >= 0, self._owner[index], point)
