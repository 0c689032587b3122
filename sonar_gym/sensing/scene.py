"""Scenes of straight reflecting faces, and casting of sonar cones on them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from acquisition import Ping, SettingError
from sonar_gym.sensing import kernels

Floats = NDArray[np.float64]
CORNERS = np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])  # corners of a square with side 2
EMPTY_M = 20.0  # m; distance given to a model for an empty cone, beyond the range of every sonar


def check_surface(what: str, reflectance: float, texture_deg: float) -> None:
    """Raise SettingError for a reflectance outside 0..1 or a texture outside 0..90 deg."""
    if not 0.0 <= reflectance <= 1.0:
        raise SettingError(f"{what}.reflectance must lie in [0, 1], got {reflectance:g}")
    if not 0.0 <= texture_deg < 90.0:
        raise SettingError(f"{what}.texture_deg must lie in [0, 90) deg, got {texture_deg:g} deg")


@dataclass(frozen=True)
class WallSegment:
    """A straight face.

    Attributes:
        x1, y1, x2, y2: end points, m.
        reflectance: 0..1.
        texture_deg: slope of the facets of a rough face, deg. The face reflects at incidence angles up to this slope as
            a smooth face does at normal incidence.
    """

    x1: float
    y1: float
    x2: float
    y2: float
    reflectance: float = 0.9
    texture_deg: float = 0.0

    def __post_init__(self) -> None:
        """Raise SettingError for an invalid surface."""
        check_surface("WallSegment", self.reflectance, self.texture_deg)

    @property
    def faces(self) -> Floats:
        """The face as one segment, m, (1, 4)."""
        return np.array([[self.x1, self.y1, self.x2, self.y2]])


@dataclass(frozen=True)
class Box:
    """A rectangular obstacle.

    Attributes:
        x, y: centre, m.
        length, width: sides along and across the heading, m.
        heading: rad.
        reflectance: 0..1.
        texture_deg: slope of the facets, see `WallSegment`.
    """

    x: float
    y: float
    length: float
    width: float
    heading: float = 0.0
    reflectance: float = 0.5
    texture_deg: float = 0.0

    def __post_init__(self) -> None:
        """Raise SettingError for a box without extent or with an invalid surface."""
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
    """Return the faces of b boxes as segments, m, (4 b, 4).

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
    """Nearest points in s cones.

    Attributes:
        distance: distance of the nearest point, m, (s,); the range limit for an empty cone.
        bearing: angle of that point off the beam axis, rad, (s,).
        incidence: angle between ray and surface normal, less the slope of the facets of a rough face, rad, (s,).
        reflectance: reflectance of the face, (s,); 0 for an empty cone.
        seen: whether the cone holds a reflector, (s,).
        object_index: index of the wall or box in its scene, (s,); -1 for an empty cone.
        point: the nearest point, m, (s, 2).
    """

    distance: Floats
    bearing: Floats
    incidence: Floats
    reflectance: Floats
    seen: NDArray[np.bool_]
    item: NDArray[np.int64]
    point: Floats

    def ping(self, time: float) -> Ping:
        """Return the conditions of the sensors at a time in s. Each sensor is its own run."""
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
    """Obstacles that reflect sound.

    Args:
        objects: walls and boxes.

    Attributes:
        segments: all faces, m, (m, 4).
        surface: reflectance and slope of the facets of each face, 1 and rad, (m, 2).
        owner: index of the object of each face, (m,).

    >>> hits = Scene([WallSegment(2.0, -1.0, 2.0, 1.0)]).cast(np.array([[0.0, 0.0, 0.0]]), np.array([0.3]), limit=3.0)
    >>> float(hits.distance[0]), float(hits.incidence[0])
    (2.0, 0.0)
    """

    def __init__(self, objects: Iterable[WallSegment | Box]) -> None:
        objects = tuple(objects)
        faces = [item.faces for item in objects]
        owner = np.repeat(np.arange(len(faces)), [len(face) for face in faces])
        kind = np.array([[item.reflectance, item.texture_deg] for item in objects]).reshape(-1, 2)
        self._store(np.vstack(faces) if faces else np.empty((0, 4)), kind[owner], owner)

    @classmethod
    def of(cls, segments: Floats, surface: Floats, owner: NDArray[np.int64]) -> Scene:
        """Return a scene of given faces.

        Args:
            segments: m, (m, 4).
            surface: reflectance and texture in deg of each face, (m, 2).
            owner: index of the object of each face, (m,).
        """
        scene = cls.__new__(cls)
        scene._store(segments, surface, owner)
        return scene

    def _store(self, segments: Floats, surface: Floats, owner: NDArray[np.int64]) -> None:
        self.segments, self.owner = segments, owner.astype(np.int64)
        self.surface = np.column_stack([surface[:, 0], np.radians(surface[:, 1])])
        # one extra entry: an empty cone has index -1, which must not select the last object
        self._surface = np.vstack([self.surface, [0.0, 0.0]])
        self._owner = np.append(self.owner, kernels.NOTHING)

    def cast(self, poses: Floats, half: Floats, limit: float) -> Hits:
        """Cast cones.

        Args:
            poses: poses of the sensors, rows x, y, heading: m, m, rad, (s, 3).
            half: half opening angles, rad, (s,).
            limit: maximum range, m.
        """
        distance, bearing, incidence, index, point = kernels.cast_cones(poses, half, self.segments, limit)
        reflectance, texture = self._surface[index].T
        met = np.maximum(incidence - texture, 0.0)
        return Hits(distance, bearing, met, reflectance, index >= 0, self._owner[index], point)
