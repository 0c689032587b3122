"""Mounts of the sonars on the car: position, cone and timing."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from io import IOBase
from typing import Annotated

import numpy as np

from acquisition import SettingError
from acquisition.arrays import Floats
from acquisition.limits import Limit, check_choice, check_settings, shown
from sonar_gym.checks import settings_of
from sonar_gym.sensing.kernels import mounted
from sonar_gym.sensing.timing import Times

MAX_MOUNTS = 256
CONE_DEG = 55.0  # full beam of SRF04 and SRF08 at -6 dB; Devantech, Sonar FAQ


Place = Annotated[float, Limit(-100.0, 100.0, "m")]
Time = Annotated[float, Limit(0.0, 3600.0, "s")]
Height = Annotated[float, Limit(0.0, 100.0, "m", open_low=True)]


@dataclass(frozen=True)
class Mount:
    """One sonar on the car.

    Attributes:
        name: display name.
        x, y: position before and left of the centre of the rear axle, m.
        heading_deg: direction of the beam axis, anticlockwise from straight ahead, deg.
        cone_deg: full opening angle, deg.
        period_s: time between pings, s; 0 for one ping per observation, sent one latency before it.
        phase_s: time of the first ping in an episode, s; sonars that would disturb each other fire at different times.
        latency_s: time from a ping to the arrival of its reading, s; at most the period. None: the time that an SRF08
            needs for the maximum range, 65 ms for 11 m.
        height_m: height above the floor, m; None for a sonar that does not hear the floor.
    """

    name: str
    x: Place
    y: Place
    heading_deg: Annotated[float, Limit(-3600.0, 3600.0, "deg")]
    cone_deg: Annotated[float, Limit(0.0, 180.0, "deg", open_low=True, open_high=True)] = CONE_DEG
    period_s: Time = 0.0
    phase_s: Time = 0.0
    latency_s: Time | None = None
    height_m: Height | None = None

    def __post_init__(self) -> None:
        """Raise SettingError for an invalid position, cone or time."""
        check_settings(self, lambda field: f"Mount.{field} of {shown(self.name)}")
        if self.latency_s is not None and 0.0 < self.period_s < self.latency_s:
            raise SettingError(
                f"Mount.latency_s of {self.name!r} is {self.latency_s:g} s, more than its period of {self.period_s:g} "
                "s: give a shorter latency or a longer period"
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
# Firing times of the eight sonars in a cycle of 0.1 s; neighbours never fire together. An SRF08 with a range of 3.01 m
# needs 17.6 ms for the sound and about 2 ms on the bus (Devantech, SRF08).
TURN_S = (0.02, 0.04, 0.08, 0.02, 0.06, 0.06, 0.04, 0.08)

LAYOUTS: dict[str, tuple[Mount, ...]] = {
    "eight": EIGHT,
    "eight in turn": tuple(
        replace(mount, period_s=0.1, phase_s=phase) for mount, phase in zip(EIGHT, TURN_S, strict=True)
    ),
    "eight without latency": tuple(replace(mount, latency_s=0.0) for mount in EIGHT),
    "four": (
        Mount("front", 0.36, 0.0, 0.0),
        Mount("right front", 0.26, -0.10, -90.0),
        Mount("right rear", 0.0, -0.10, -90.0),
        Mount("rear", -0.09, 0.0, 180.0),
    ),
}
Layout = str | Iterable[Mount | Mapping[str, object]]


def layout(given: Layout) -> tuple[Mount, ...]:
    """Return mounts by the name of a layout, or from mounts or mappings of their fields.

    >>> [mount.name for mount in layout("four")]
    ['front', 'right front', 'right rear', 'rear']
    """
    if isinstance(given, str):
        check_choice("sonar_layout", given, list(LAYOUTS))
        return LAYOUTS[given]
    if not isinstance(given, Iterable) or isinstance(given, Mapping | IOBase):
        raise SettingError(f"sonar_layout: expected the name of a layout or a list of mounts, got {shown(given)}")
    try:
        each = list(itertools.islice(given, MAX_MOUNTS + 1))  # it may have no end
    except TypeError:  # an array without dimensions
        raise SettingError(f"sonar_layout: expected a list of mounts, got {shown(given)}") from None
    mounts = tuple(settings_of(Mount, mount, "sonar_layout") for mount in each)
    if not 1 <= len(mounts) <= MAX_MOUNTS:
        more = "more than " if len(mounts) > MAX_MOUNTS else ""
        raise SettingError(f"sonar_layout has {more}{min(len(mounts), MAX_MOUNTS)} mounts, expected 1 to {MAX_MOUNTS}")
    return mounts


def mount_arrays(mounts: Sequence[Mount]) -> tuple[Floats, Floats]:
    """Return poses in the frame of the car, m, m, rad, (s, 3), and half opening angles, rad, (s,)."""
    poses = np.array([[m.x, m.y, np.radians(m.heading_deg)] for m in mounts], dtype=np.float64)
    return poses, np.radians([0.5 * float(m.cone_deg) for m in mounts])


def heights(mounts: Sequence[Mount]) -> Floats:
    """Return the heights of sonars above the floor, m, (s,); 0 for those that do not hear it."""
    return np.array([mount.height_m or 0.0 for mount in mounts], dtype=np.float64)


def times_of(mounts: Sequence[Mount]) -> Times:
    """Return period, phase and latency of sonars, s; NaN is the latency of the real sensor, see `timing.timing`."""
    latency = [np.nan if m.latency_s is None else m.latency_s for m in mounts]
    return [m.period_s for m in mounts], [m.phase_s for m in mounts], latency


def in_world(poses: Floats, car: Floats) -> Floats:
    """Transform poses from the frame of the car to the world, (s, 3); `car` is its x, y, heading."""
    return mounted(poses, car)
