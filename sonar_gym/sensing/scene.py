"""Scenes of straight reflecting faces, and the cones of sonars cast on them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from acquisition.arrays import Bits, Floats, Ints
from acquisition.limits import Limit, PositiveMetres, Share, check_settings
from sonar_gym.sensing import kernels

CORNERS = np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])  # of a square with sides of 2 m
EMPTY_M = 20.0  # m; distance given to a model for an empty cone: beyond the range of every sonar


Place = Annotated[float, Limit(-1e5, 1e5, "m")]
Speed = Annotated[float, Limit(-50.0, 50.0, "m/s")]
Texture = Annotated[float, Limit(0.0, 90.0, "deg", open_high=True)]


@dataclass(frozen=True)
class WallSegment:
    """A straight face.

    Attributes:
        x1, y1, x2, y2: end points, m.
        reflectance: reflectance, 0..1.
        texture_deg: slope of the facets of a rough face, deg; at incidence angles up to this slope the face reflects
            like a smooth face at normal incidence.
    """

    x1: Place
    y1: Place
    x2: Place
    y2: Place
    reflectance: Share = 0.9
    texture_deg: Texture = 0.0

    def __post_init__(self) -> None:
        """Raise SettingError for an invalid surface."""
        check_settings(self)

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
        heading: heading, rad.
        reflectance: reflectance, 0..1.
        texture_deg: slope of the facets, deg; see `WallSegment`.
        vx, vy: velocity, m/s; `x` and `y` are those at the beginning of an episode.
    """

    x: Place
    y: Place
    length: PositiveMetres
    width: PositiveMetres
    heading: Annotated[float, Limit(-1e3, 1e3, "rad")] = 0.0
    reflectance: Share = 0.5
    texture_deg: Texture = 0.0
    vx: Speed = 0.0
    vy: Speed = 0.0

    def __post_init__(self) -> None:
        """Raise SettingError for sides that are not positive and for an invalid surface."""
        check_settings(self)

    def contains(self, x: float, y: float) -> bool:
        """Return whether a point, m, lies in the box."""
        along, across = kernels.to_frame(x, y, np.array([self.x, self.y, self.heading]))
        return abs(along) <= 0.5 * self.length and abs(across) <= 0.5 * self.width

    @property
    def corners(self) -> Floats:
        """The corners in order, m, (4, 2)."""
        return self.faces[:, :2]

    @property
    def faces(self) -> Floats:
        """The faces as segments, m, (4, 4)."""
        return box_faces(np.array([[self.x, self.y, self.length, self.width, self.heading]]))


def box_faces(boxes: Floats) -> Floats:
    """Return the faces of boxes as segments, m, (4 b, 4).

    Args:
        boxes: centre x, y, length, width, heading of each box: m, m, m, m, rad, (b, 5).
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
        distance: distance of the nearest point, m, (s,); the limit of the cast where the cone is empty.
        bearing: bearing of that point off the beam axis, rad, (s,).
        incidence: angle between ray and surface normal, less the slope of the facets, at least 0, rad, (s,).
        reflectance: reflectance of the face, (s,); 0 where the cone is empty.
        in_cone: whether a face is in the cone, (s,).
        obstacle: number of the obstacle in its scene, (s,); -1 where the cone is empty.
        point: nearest point, m, (s, 2).
    """

    distance: Floats
    bearing: Floats
    incidence: Floats
    reflectance: Floats
    in_cone: Bits
    obstacle: Ints
    point: Floats


class Scene:
    """Obstacles that reflect sound and stop cars.

    Args:
        obstacles: walls and boxes.

    Attributes:
        segments: all faces, m, (m, 4).
        surface: reflectance and slope of the facets of each face, 1 and rad, (m, 2).
        owner: number of the obstacle of each face, (m,).
        velocity: velocity of each face, m/s, (m, 2).

    >>> hits = Scene([WallSegment(2.0, -1.0, 2.0, 1.0)]).cast(np.array([[0.0, 0.0, 0.0]]), np.array([0.3]), limit=3.0)
    >>> float(hits.distance[0]), float(hits.incidence[0])
    (2.0, 0.0)
    """

    def __init__(self, obstacles: Iterable[WallSegment | Box]) -> None:
        obstacles = tuple(obstacles)
        faces = [obstacle.faces for obstacle in obstacles]
        owner = np.repeat(np.arange(len(faces)), [len(face) for face in faces])
        surface = np.array([[obstacle.reflectance, obstacle.texture_deg] for obstacle in obstacles]).reshape(-1, 2)
        self._set_faces(np.vstack(faces) if faces else np.empty((0, 4)), surface[owner], owner)

    @classmethod
    def of(cls, segments: Floats, surface: Floats, owner: Ints, velocity: Floats | None = None) -> Scene:
        """Return a scene of given faces.

        Args:
            segments: faces, m, (m, 4).
            surface: reflectance and slope of the facets of each face, 1 and deg, (m, 2).
            owner: number of the obstacle of each face, (m,).
            velocity: velocity of each face, m/s, (m, 2); None if all are at rest.
        """
        scene = cls.__new__(cls)
        scene._set_faces(segments, surface, owner, velocity)
        return scene

    def _set_faces(self, segments: Floats, surface: Floats, owner: Ints, velocity: Floats | None = None) -> None:
        self.segments, self.owner = segments, owner.astype(np.int64)
        self.velocity = np.zeros((len(segments), 2)) if velocity is None else velocity
        self.surface = np.column_stack([surface[:, 0], np.radians(surface[:, 1])])
        # an extra last row: an empty cone has index -1
        self._surface = np.vstack([self.surface, [0.0, 0.0]])
        self._owner = np.append(self.owner, kernels.NO_HIT)

    def cast(self, poses: Floats, half: Floats, limit: float) -> Hits:
        """Return the nearest point in each of s cones.

        Args:
            poses: x, y, heading of the sensors, m, m, rad, (s, 3).
            half: half opening angles, rad, (s,).
            limit: maximum distance, m.
        """
        distance, bearing, incidence, index, point = kernels.cast_cones(poses, half, self.segments, limit)
        reflectance, texture = self._surface[index].T
        effective = np.maximum(incidence - texture, 0.0)
        return Hits(distance, bearing, effective, reflectance, index >= 0, self._owner[index], point)
