"""Map files of OpenDLV's simulation, and sonars among their walls.

A map is a text file with one wall a line, `x1,y1,x2,y2;` in m.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from acquisition import RecordingError, RecordingNotFoundError
from acquisition.arguments import checked
from acquisition.arrays import Floats
from acquisition.io.files import is_file, read_limited
from sonar_gym.sensing.scene import Scene, WallSegment

REFLECTANCE = 0.9  # of a wall: smooth and hard
MAX_WALLS = 10_000
Pose = tuple[float, float, float]  # x, y, yaw in the world: m, m, rad
ORIGIN: Pose = (0.0, 0.0, 0.0)  # where a car stands before its first Frame


@checked
def load_map(path: Path, reflectance: float = REFLECTANCE) -> Scene:
    """Return the walls of a map file.

    Args:
        path: of the file.
        reflectance: of all walls, 0..1; a map does not state it.

    Raises:
        RecordingNotFoundError: the file does not exist.
        RecordingError: a line is not a wall.
    """
    if not is_file(path):
        raise RecordingNotFoundError(f"{path}: no such map; give a text file with one wall a line, x1,y1,x2,y2; in m")
    try:
        lines = read_limited(path, RecordingError, "a map").decode().splitlines()
    except UnicodeDecodeError:
        raise RecordingError(f"{path}: not text; expected one wall a line, x1,y1,x2,y2; in m") from None
    walls = [_wall(path, number, line, reflectance) for number, line in enumerate(lines, 1) if line.strip()]
    if not 1 <= len(walls) <= MAX_WALLS:
        raise RecordingError(f"{path}: has {len(walls)} walls, expected 1 to {MAX_WALLS}")
    return Scene(walls)


def _wall(path: Path, number: int, line: str, reflectance: float) -> WallSegment:
    try:
        x1, y1, x2, y2 = (float(part) for part in line.strip().removesuffix(";").split(","))
    except ValueError:
        raise RecordingError(f"{path}, line {number}: {line!r}, expected x1,y1,x2,y2; in m") from None
    if not np.all(np.isfinite([x1, y1, x2, y2])):
        raise RecordingError(f"{path}, line {number}: {line!r}, expected finite numbers in m")
    return WallSegment(x1, y1, x2, y2, reflectance)


def interpolate_pose(times: Floats, poses: Floats, at: Sequence[float] | Floats) -> Floats:
    """Return poses at given times by linear interpolation, (m, 3); constant before the first and after the last.

    Args:
        times: increasing, s, (n,).
        poses: x, y, yaw: m, m, rad, (n, 3).
        at: times, s, (m,).
    """
    yaw = np.unwrap(poses[:, 2])
    return np.stack([np.interp(at, times, column) for column in (poses[:, 0], poses[:, 1], yaw)], axis=1)
