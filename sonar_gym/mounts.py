"""Where the sonars sit on the car, as data."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquisition import SettingError
from sonar_gym.kernels import mounted

Floats = NDArray[np.float64]
CONE_DEG = 55.0  # full beam of SRF04 and SRF08 at -6 dB; Devantech, Sonar FAQ


@dataclass(frozen=True)
class Mount:
    """One sonar on the car.

    Attributes:
        name: for people.
        x, y: before and left of the rear axle, m.
        heading_deg: of the beam axis, anticlockwise from straight ahead.
        cone_deg: full opening angle.
    """

    name: str
    x: float
    y: float
    heading_deg: float
    cone_deg: float = CONE_DEG

    def __post_init__(self) -> None:
        """Refuse a cone that is none."""
        if not 0.0 < self.cone_deg < 180.0:
            raise SettingError(f"Mount.cone_deg of {self.name!r} must lie in (0, 180) deg, got {self.cone_deg:g} deg")


LAYOUTS: dict[str, tuple[Mount, ...]] = {
    "eight": (
        Mount("front", 0.36, 0.0, 0.0),
        Mount("front left", 0.34, 0.09, 35.0),
        Mount("front right", 0.34, -0.09, -35.0),
        Mount("right front", 0.26, -0.10, -90.0),
        Mount("right rear", 0.0, -0.10, -90.0),
        Mount("left", 0.13, 0.10, 90.0),
        Mount("rear right", -0.08, -0.09, -145.0),
        Mount("rear", -0.09, 0.0, 180.0),
    ),
    "four": (
        Mount("front", 0.36, 0.0, 0.0),
        Mount("right front", 0.26, -0.10, -90.0),
        Mount("right rear", 0.0, -0.10, -90.0),
        Mount("rear", -0.09, 0.0, 180.0),
    ),
}
Layout = str | Iterable[Mount | Mapping[str, Any]]


def layout(given: Layout) -> tuple[Mount, ...]:
    """Return mounts by the name of a layout, or from mounts or mappings of their fields.

    >>> [mount.name for mount in layout("four")]
    ['front', 'right front', 'right rear', 'rear']
    """
    if isinstance(given, str):
        if given not in LAYOUTS:
            raise SettingError(
                f"sonar_layout {given!r}: no such layout; expected {', '.join(LAYOUTS)}, or a list of mounts"
            )
        return LAYOUTS[given]
    mounts = tuple(mount if isinstance(mount, Mount) else Mount(**mount) for mount in given)
    if not mounts:
        raise SettingError("sonar_layout holds 0 mounts, expected 1 or more")
    return mounts


def mount_arrays(mounts: Sequence[Mount]) -> tuple[Floats, Floats]:
    """Return poses in the car's frame, (s, 3) in m, m, rad, and half opening angles, rad, (s,)."""
    poses = np.array([[m.x, m.y, np.radians(m.heading_deg)] for m in mounts])
    return poses, np.radians([0.5 * m.cone_deg for m in mounts])


def in_world(poses: Floats, car: Floats) -> Floats:
    """Return poses of the car's frame in the world, (s, 3), for a car at x, y, heading."""
    return mounted(poses, car)
