"""The street of the parking task: boxes on the right, gaps between them, one of them wide enough.

The lane's centre is the x axis, driven towards +x. The parking strip lies on the right, between its line and the
kerb. Esmi (2016), section 6.1 and figure 6.1, tells the scenario; its measures are ours.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from acquisition import SettingError
from sonar_gym.scene import Box, Scene, Wall
from sonar_gym.vehicle import CarSettings

Floats = NDArray[np.float64]
KERB_REFLECTANCE = 0.4
ARC_MARGIN = 1.1  # arcs of the reference path are this much wider than the tightest turn
PATH_STEP = 0.01  # m between poses of the reference path


@dataclass(frozen=True)
class StreetSettings:
    """What is drawn for each episode, and the fixed measures; pairs are the limits of a uniform draw.

    Attributes:
        gap: length of the space to park in, m.
        decoy: length of the spaces too short to park in, m.
        decoys: least and greatest number of those spaces.
        box: length of a box, m.
        recess: how far a box stands back from the strip's line, m.
        reflectance: of a box, 0..1.
        line: from the lane's centre to the strip's line, m.
        depth: of the strip, from its line to the kerb, m.
        far_side: from the lane's centre to the kerb on the left, m.
        lead: from the car's start to the first box, m.
        tail: from the last box to the street's end, m.
        start_offset: greatest offset of the start from the lane's centre, m.
        start_heading_deg: greatest error of the start's heading.
    """

    gap: tuple[float, float] = (0.85, 1.15)
    decoy: tuple[float, float] = (0.15, 0.45)
    decoys: tuple[int, int] = (0, 2)
    box: tuple[float, float] = (0.30, 0.70)
    recess: tuple[float, float] = (0.0, 0.03)
    reflectance: tuple[float, float] = (0.1, 0.9)
    line: float = 0.30
    depth: float = 0.35
    far_side: float = 0.75
    lead: float = 0.60
    tail: float = 1.00
    start_offset: float = 0.03
    start_heading_deg: float = 3.0

    def __post_init__(self) -> None:
        """Refuse pairs out of order and a gap no wider than a decoy."""
        for name in ("gap", "decoy", "decoys", "box", "recess", "reflectance"):
            pair = tuple(getattr(self, name))
            if len(pair) != 2 or not 0 <= pair[0] <= pair[1]:
                raise SettingError(f"StreetSettings.{name} must be two numbers 0 <= low <= high, got {pair}")
            object.__setattr__(self, name, pair)
        if self.gap[0] <= self.decoy[1]:
            raise SettingError(
                f"StreetSettings.gap must exceed decoy: least gap {self.gap[0]:g} m, greatest decoy {self.decoy[1]:g} m"
            )


@dataclass(frozen=True)
class Street:
    """One drawn street.

    Attributes:
        settings: it was drawn from.
        boxes: on the strip, from the first met to the last.
        gap: where the space to park in begins and ends, m.
        start: x, y, heading of the car's rear axle: m, m, rad, (3,).
        end: x of the wall that closes the street, m.
        scene: everything that reflects and stops.
    """

    settings: StreetSettings
    boxes: tuple[Box, ...]
    gap: tuple[float, float]
    start: Floats
    end: float
    scene: Scene = field(repr=False)

    @property
    def line(self) -> float:
        """Where the strip's line lies, y in m."""
        return -self.settings.line

    @property
    def kerb(self) -> float:
        """Where the kerb lies, y in m."""
        return -self.settings.line - self.settings.depth


BEHIND = 1.5  # m of street behind the start


def draw_street(settings: StreetSettings, rng: np.random.Generator) -> Street:
    """Draw a street; the same state of `rng` gives the same street."""
    count = int(rng.integers(settings.decoys[0], settings.decoys[1] + 1))
    spaces = rng.uniform(*settings.decoy, size=count + 1)
    place = int(rng.integers(0, count + 1))
    spaces[place] = rng.uniform(*settings.gap)
    lengths = rng.uniform(*settings.box, size=count + 2)
    begins = settings.lead + np.cumsum(np.r_[0.0, lengths[:-1] + spaces])
    boxes = tuple(_box(settings, x, length, rng) for x, length in zip(begins, lengths, strict=True))
    gap = (float(begins[place] + lengths[place]), float(begins[place + 1]))
    heading = np.radians(rng.uniform(-1.0, 1.0) * settings.start_heading_deg)
    start = np.array([0.0, rng.uniform(-1.0, 1.0) * settings.start_offset, heading])
    end = float(begins[-1] + lengths[-1] + settings.tail)
    return Street(settings, boxes, gap, start, end, Scene([*boxes, *_walls(settings, end)]))


def _box(settings: StreetSettings, x: float, length: float, rng: np.random.Generator) -> Box:
    recess = rng.uniform(*settings.recess)
    width = settings.depth - recess
    y = -settings.line - recess - 0.5 * width
    return Box(float(x + 0.5 * length), y, float(length), width, 0.0, float(rng.uniform(*settings.reflectance)))


def _walls(settings: StreetSettings, end: float) -> list[Wall]:
    kerb = -settings.line - settings.depth
    left = settings.far_side
    return [
        Wall(-BEHIND, kerb, end, kerb, KERB_REFLECTANCE),
        Wall(end, kerb, end, left, KERB_REFLECTANCE),
        Wall(end, left, -BEHIND, left, KERB_REFLECTANCE),
    ]


def reference_path(street: Street, car: CarSettings, rear_room: float = 0.12) -> Floats:
    """Return a path by which the street can be mastered: along the lane, then back in two equal arcs.

    Args:
        street: to park in.
        car: that parks.
        rear_room: left behind the car at the end, m.

    Returns:
        Rows x, y, heading of the rear axle and m left to the end, (k, 4).
    """
    radius = ARC_MARGIN * car.turning_radius
    goal_x = street.gap[0] + car.rear_overhang + rear_room
    goal_y = 0.5 * (street.line + street.kerb)
    turn = float(np.arccos(np.clip(1.0 + goal_y / (2.0 * radius), -1.0, 1.0)))
    ready_x = goal_x + 2.0 * radius * np.sin(turn)
    angle = np.linspace(0.0, turn, max(2, int(turn * radius / PATH_STEP)))
    lane_x = np.arange(-BEHIND, ready_x, PATH_STEP)
    lane = np.column_stack([lane_x, 0 * lane_x, 0 * lane_x])
    first = np.column_stack([ready_x - radius * np.sin(angle), radius * (np.cos(angle) - 1.0), angle])
    second = np.column_stack([goal_x + radius * np.sin(angle), goal_y + radius * (1.0 - np.cos(angle)), angle])[::-1]
    poses = np.vstack([lane, first, second])
    steps = np.hypot(*np.diff(poses[:, :2], axis=0).T)
    left = np.r_[np.cumsum(steps[::-1])[::-1], 0.0]
    return np.column_stack([poses, left])
