"""Where the sonars sit on the car, as data."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquisition import SettingError
from sonar_gym.sensing.kernels import mounted

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
        period_s: from ping to ping; 0 for one ping at every observation.
        phase_s: time of the first ping since the episode began; sonars that would disturb each other fire in turn.
        latency_s: from a ping to its reading's arrival; no later than the next ping.
    """

    name: str
    x: float
    y: float
    heading_deg: float
    cone_deg: float = CONE_DEG
    period_s: float = 0.0
    phase_s: float = 0.0
    latency_s: float = 0.0

    def __post_init__(self) -> None:
        """Refuse a cone that is none, and times that are none."""
        if not 0.0 < self.cone_deg < 180.0:
            raise SettingError(f"Mount.cone_deg of {self.name!r} must lie in (0, 180) deg, got {self.cone_deg:g} deg")
        for name in ("period_s", "phase_s", "latency_s"):
            if not 0.0 <= getattr(self, name) < np.inf:
                raise SettingError(f"Mount.{name} of {self.name!r} must be >= 0 s, got {getattr(self, name):g} s")
        if 0.0 < self.period_s < self.latency_s:
            raise SettingError(
                f"Mount.latency_s of {self.name!r} is {self.latency_s:g} s, more than its period of {self.period_s:g} "
                "s: a sonar cannot fire before its reading is in"
            )


EIGHT = (
    Mount("front", 0.36, 0.0, 0.0),
    Mount("front left", 0.34, 0.09, 35.0),
    Mount("front right", 0.34, -0.09, -35.0),
    Mount("right front", 0.26, -0.10, -90.0),
    Mount("right rear", 0.0, -0.10, -90.0),
    Mount("left", 0.13, 0.10, 90.0),
    Mount("rear right", -0.08, -0.09, -145.0),
    Mount("rear", -0.09, 0.0, 180.0),
)
# Which of the eight fires when, in a cycle of 0.1 s: neighbours never together. An SRF08 that listens for 3.01 m has
# its reading after 17.6 ms of sound and some 2 ms on the bus (Devantech, SRF08).
TURN_S = (0.02, 0.04, 0.08, 0.02, 0.06, 0.06, 0.04, 0.08)
LATENCY_S = 0.020

LAYOUTS: dict[str, tuple[Mount, ...]] = {
    "eight": EIGHT,
    "eight in turn": tuple(
        replace(mount, period_s=0.1, phase_s=phase, latency_s=LATENCY_S)
        for mount, phase in zip(EIGHT, TURN_S, strict=True)
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


def timing_array(mounts: Sequence[Mount], step_s: float) -> Floats:
    """Return period, phase and latency of each sonar, s, (s, 3).

    Args:
        mounts: the sonars.
        step_s: from observation to observation; no sonar may fire more often.
    """
    for mount in mounts:
        if 0.0 < mount.period_s < step_s:
            raise SettingError(
                f"Mount.period_s of {mount.name!r} is {mount.period_s:g} s, less than the {step_s:g} s from one "
                "observation to the next: give 0 for a ping at each"
            )
        if mount.period_s == 0.0 and mount.latency_s > step_s:
            raise SettingError(
                f"Mount.latency_s of {mount.name!r} is {mount.latency_s:g} s, more than the {step_s:g} s to its next "
                "ping: give a longer period_s"
            )
    return np.array([[m.period_s, m.phase_s, m.latency_s] for m in mounts])


def in_world(poses: Floats, car: Floats) -> Floats:
    """Return poses of the car's frame in the world, (s, 3), for a car at x, y, heading."""
    return mounted(poses, car)
