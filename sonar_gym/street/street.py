"""The street of the parking task: boxes on the right with gaps between them, of which one is wide enough.

The x axis is the centre of the lane; the car drives towards +x. The parking strip lies on the right, between its line
and the kerb. The scenario is that of Esmi (2016), section 6.1 and figure 6.1; its dimensions are chosen here.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any

import numpy as np

from acquisition import SettingError
from acquisition.arrays import Floats
from acquisition.limits import Limit, OneOf, Share, as_numbers, check_choice, check_number, check_settings
from sonar_gym.checks import check_fields, named
from sonar_gym.sensing.kernels import NO_HIT, touches
from sonar_gym.sensing.scene import Box, Scene, Texture, box_faces
from sonar_gym.street.obstacles import OBSTACLES, check_mappings, draw_obstacles
from sonar_gym.street.vehicle import CarSettings

REAR_ROOM = (0.02, 0.12)  # m; minimum and maximum space behind the car at the end of the reference path
TURN_ROOM = 0.27  # m; least excess of a gap over the car for one move, with no space behind the car
ARC_MARGIN = 1.1  # radius of the arcs of the reference path relative to the turning radius
START_BEFORE = 0.6  # m; least distance of the rear axle before the gap, so that the car passes both of its ends
MAX_TURN_DEG = 20.0  # deg; beyond it a short box cannot be turned within its extent


Length = Annotated[float, Limit(0.0, 100.0, "m")]
Turn = Annotated[float, Limit(0.0, MAX_TURN_DEG, "deg")]
SomeLength = Annotated[float, Limit(0.0, 100.0, "m", open_low=True)]


@dataclass(frozen=True)
class StreetSettings:
    """Distributions and fixed dimensions of streets; pairs are the limits of uniform distributions.

    Attributes:
        gap: length of the space to park in, m.
        decoy: length of the spaces that are too short, m.
        decoys: number of those spaces.
        box: length of a box, m.
        recess: distance of a box behind the strip's line, m.
        turn_deg: angle of a box to the kerb, deg, to either side; a turned box keeps its extent along the street.
        reflectance: reflectance of a box, 0..1.
        texture_deg: slope of the facets of a box, deg; see `scene.WallSegment`.
        kerb_reflectance: reflectance of the kerbs and of the wall that ends the street, 0..1.
        line: distance from the lane's centre to the strip's line, m.
        depth: depth of the strip, from its line to the kerb, m.
        far_side: distance from the lane's centre to the left kerb, m.
        lead: distance from the start to the first box, m.
        tail: distance from the last box to the end of the street, m.
        start: place of the start between the beginning of the street, 0, and the gap, 1; see `START_BEFORE`.
        start_offset: largest offset of the start from the lane's centre, m.
        start_heading_deg: largest heading error of the start, deg.
        obstacles: kinds of further obstacles beside the lane, one each, see `obstacles.OBSTACLES`; some of them move.
        floor_reflectance: reflectance of the floor, which sonars with a height hear, 0..1.
        floor_texture_deg: slope of the facets of the floor, deg.
    """

    gap: tuple[Length, Length] = (0.85, 1.15)
    decoy: tuple[Length, Length] = (0.15, 0.45)
    decoys: tuple[Annotated[int, Limit(0, 100)], Annotated[int, Limit(0, 100)]] = (0, 2)
    box: tuple[Length, Length] = (0.30, 0.70)
    recess: tuple[Length, Length] = (0.0, 0.03)
    turn_deg: tuple[Turn, Turn] = (0.0, 0.0)
    reflectance: tuple[Share, Share] = (0.1, 0.9)
    texture_deg: tuple[Texture, Texture] = (0.0, 10.0)
    kerb_reflectance: Share = 0.4
    line: SomeLength = 0.30
    depth: SomeLength = 0.35
    far_side: SomeLength = 0.75
    lead: Length = 0.60
    tail: SomeLength = 1.00
    start: tuple[Share, Share] = (0.0, 1.0)
    start_offset: Annotated[float, Limit(0.0, 10.0, "m")] = 0.03
    start_heading_deg: Annotated[float, Limit(0.0, 180.0, "deg")] = 3.0
    obstacles: tuple[Annotated[str, OneOf(OBSTACLES)], ...] = ()
    floor_reflectance: Share = 0.4
    floor_texture_deg: Texture = 20.0

    def __post_init__(self) -> None:
        """Raise SettingError for invalid pairs, invalid surfaces, and a gap not longer than a decoy."""
        check_settings(self)
        for name in ("gap", "decoy", "decoys", "box", "recess", "turn_deg", "reflectance", "texture_deg", "start"):
            pair = tuple(getattr(self, name))
            if pair[0] > pair[1]:
                raise SettingError(f"StreetSettings.{name} must be two numbers 0 <= low <= high, got {pair}")
            object.__setattr__(self, name, pair)
        object.__setattr__(self, "obstacles", tuple(self.obstacles))
        if self.gap[0] <= self.decoy[1]:
            raise SettingError(
                f"StreetSettings.gap must exceed decoy: shortest gap {self.gap[0]:g} m, "
                f"longest decoy {self.decoy[1]:g} m"
            )
        self._check_boxes()

    def _check_boxes(self) -> None:
        """Raise SettingError if the shortest or the thinnest box has no sides at the greatest angle to the kerb."""
        turned, slope = f"turned by {self.turn_deg[1]:g} deg", math.tan(math.radians(self.turn_deg[1]))
        thin, wide = self.depth - self.recess[1], self.depth - self.recess[0]
        if thin <= self.box[1] * slope:
            raise SettingError(
                f"StreetSettings.recess: a box {self.box[1]:g} m long and {turned} must be wider than "
                f"{self.box[1] * slope:g} m, but depth - recess is {thin:g} m: make depth greater or recess smaller"
            )
        if self.box[0] <= wide * slope:
            raise SettingError(
                f"StreetSettings.box: a box {wide:g} m wide and {turned} must be longer than {wide * slope:g} m, "
                f"got {self.box[0]:g} m: make box longer or turn_deg smaller"
            )

    @property
    def max_faces(self) -> int:
        """The greatest number of faces of such a street."""
        return 4 * (self.decoys[1] + 2 + len(self.obstacles)) + 3


LEVELS: dict[str, StreetSettings] = {
    "easy": StreetSettings(
        gap=(1.10, 1.40),
        decoys=(0, 0),
        recess=(0.0, 0.0),
        reflectance=(0.5, 0.9),
        start_offset=0.01,
        start_heading_deg=1.0,
    ),
    "normal": StreetSettings(),
    "hard": StreetSettings(
        gap=(0.75, 0.85),
        decoy=(0.25, 0.60),
        decoys=(1, 3),
        recess=(0.0, 0.05),
        reflectance=(0.05, 0.9),
        start=(0.0, 0.0),
        start_offset=0.05,
        start_heading_deg=5.0,
    ),
    "manoeuvre": StreetSettings(  # the gap is 15 % longer than the car, and the street ends behind the next box
        gap=(0.5175, 0.5175),
        decoy=(0.15, 0.40),
        decoys=(0, 1),
        box=(0.50, 0.70),
        turn_deg=(0.0, 8.0),
        tail=0.35,
    ),
}


Difficulty = Annotated[str, OneOf(LEVELS)]


def street_settings(difficulty: str, given: StreetSettings | Mapping[str, object] | None = None) -> StreetSettings:
    """Return the settings of a level, with some fields replaced, or complete settings as given.

    >>> street_settings("hard", {"decoys": [0, 0]}).gap
    (0.75, 0.85)
    """
    check_choice("difficulty", difficulty, list(LEVELS))
    return replaced(LEVELS[difficulty], given)


def replaced(settings: StreetSettings, given: Any, name: str = "street") -> StreetSettings:
    """Return settings with some fields replaced, or complete settings as given; `name` is that of the argument.

    Raises:
        SettingError: a field is unknown or invalid.
    """
    if isinstance(given, StreetSettings):
        return given
    given = {} if given is None else given
    check_fields(StreetSettings, given, name)
    with named(StreetSettings, name):
        return replace(settings, **given) if given else settings


def check_gap(gap: float, car: CarSettings) -> None:
    """Raise SettingError for a gap that a car does not fit in."""
    if gap <= car.length:
        raise SettingError(f"the gap is {gap:g} m long, but the car {car.length:g} m: make the gap longer")


@dataclass(frozen=True, eq=False)
class Street:
    """One street.

    Attributes:
        settings: settings from which the street was drawn.
        strip: begin, length, recess, reflectance, texture, angle to the kerb of the boxes on the strip, in driving
            order: m, m, m, 1, deg, deg, (k, 6).
        gap: begin and end of the space to park in, x in m.
        start: x, y, heading of the rear axle at the start: m, m, rad, (3,).
        obstacles: further obstacles.
    """

    settings: StreetSettings
    strip: Floats
    gap: tuple[float, float]
    start: Floats
    obstacles: tuple[Box, ...] = ()

    @property
    def end(self) -> float:
        """X of the wall at the end of the street, m."""
        return float(self.strip[-1, 0] + self.strip[-1, 1] + self.settings.tail)

    @property
    def line(self) -> float:
        """Y of the strip's line, m."""
        return -self.settings.line

    @property
    def kerb(self) -> float:
        """Y of the right kerb, m."""
        return -self.settings.line - self.settings.depth

    @property
    def boxes(self) -> tuple[Box, ...]:
        """The boxes on the strip, in driving order."""
        surfaces = self.strip[:, 3:5]
        return tuple(
            Box(*map(float, (*rectangle, *surface)))
            for rectangle, surface in zip(self._rectangles(), surfaces, strict=True)
        )

    def _rectangles(self) -> Floats:
        """Return centre, length, width and heading of the boxes, see `box_faces`."""
        begin, extent, recess = self.strip[:, :3].T
        depth, turn = self.settings.depth - recess, np.radians(self.strip[:, 5])
        c, sn = np.cos(turn), np.abs(np.sin(turn))
        # sides of the turned box whose extents along and across the street are those of the strip
        length, width = (c * extent - sn * depth) / (c * c - sn * sn), (c * depth - sn * extent) / (c * c - sn * sn)
        return np.column_stack([begin + 0.5 * extent, self.line - recess - 0.5 * depth, length, width, turn])

    @property
    def scene(self) -> Scene:
        """All obstacles: the boxes, the right kerb, the end wall, the left kerb, and the further ones; built anew."""
        kerb, left, end, boxes = self.kerb, self.settings.far_side, self.end, len(self.strip)
        walls = np.array([[-BEHIND, kerb, end, kerb], [end, kerb, end, left], [end, left, -BEHIND, left]])
        surfaces = np.concatenate(
            [np.repeat(self.strip[:, 3:5], 4, axis=0), [[self.settings.kerb_reflectance, 0.0]] * 3]
        )
        owner = np.concatenate([np.repeat(np.arange(boxes), 4), boxes + np.arange(3)])
        faces = np.concatenate([box_faces(self._rectangles()), walls])
        velocity = np.zeros((len(faces), 2))
        for k, box in enumerate(self.obstacles):
            faces = np.concatenate([faces, box.faces])
            surfaces = np.concatenate([surfaces, [[box.reflectance, box.texture_deg]] * 4])
            velocity = np.concatenate([velocity, [[box.vx, box.vy]] * 4])
            owner = np.concatenate([owner, [boxes + 3 + k] * 4])
        return Scene.of(faces, surfaces, owner, velocity)


BEHIND = 1.5  # m; length of the street behind the start


def draw_street(settings: StreetSettings, rng: np.random.Generator) -> Street:
    """Draw a street; the same state of `rng` gives the same street."""
    count = int(rng.integers(settings.decoys[0], settings.decoys[1] + 1))
    spaces = rng.uniform(*settings.decoy, size=count + 1)
    where = int(rng.integers(0, count + 1))
    spaces[where] = rng.uniform(*settings.gap)
    lengths = rng.uniform(*settings.box, size=count + 2)
    begins = settings.lead + np.cumsum(np.concatenate([[0.0], lengths[:-1] + spaces]))
    low, high = np.array([settings.recess, settings.reflectance, settings.texture_deg]).T
    surfaces = low + (high - low) * rng.random((count + 2, 3))
    gap = (float(begins[where] + lengths[where]), float(begins[where + 1]))
    offset, angle = rng.uniform(-1.0, 1.0, size=2)
    x = rng.uniform(*settings.start) * max(gap[0] - START_BEFORE, 0.0)
    start = np.array([x, offset * settings.start_offset, np.radians(angle * settings.start_heading_deg)])
    turns = rng.uniform(*settings.turn_deg, count + 2) * rng.choice([-1.0, 1.0], count + 2)
    street = Street(settings, np.column_stack([begins, lengths, surfaces, turns]), gap, start)
    if not settings.obstacles:
        return street
    return replace(street, obstacles=draw_obstacles(settings.obstacles, street.end, settings.far_side, rng))


BOX_FIELDS = {"begin": None, "length": None, "recess": 0.0, "reflectance": 0.5, "texture_deg": 0.0, "turn_deg": 0.0}


def street_of(settings: StreetSettings, boxes: Sequence[Mapping[str, float]]) -> Street:
    """Return a street with given boxes; the longest space between two of them is the gap.

    Args:
        settings: all other dimensions; the car starts at the centre of the lane.
        boxes: mappings of begin and length, m, and optionally recess, reflectance, texture_deg and turn_deg.

    >>> street = street_of(StreetSettings(), [{"begin": 0.6, "length": 0.4}, {"begin": 2.0, "length": 0.4}])
    >>> street.gap
    (1.0, 2.0)
    """
    check_mappings("boxes", boxes)
    unknown = [name for box in boxes for name in box if name not in BOX_FIELDS]
    if unknown:
        raise SettingError(f"boxes: unknown field {unknown[0]!r}; expected {', '.join(BOX_FIELDS)}")
    if len(boxes) < 2 or any(name not in box for box in boxes for name in ("begin", "length")):
        raise SettingError(f"boxes must be two or more, each with begin and length in m, got {list(boxes)}")
    rows = [[box.get(name, default) for name, default in BOX_FIELDS.items()] for box in boxes]
    strip = as_numbers("boxes", rows)
    strip = strip[np.lexsort(strip.T[::-1])]
    if not np.all(np.isfinite(strip)):
        raise SettingError(f"boxes must have finite fields, got {list(boxes)}")
    spaces = strip[1:, 0] - strip[:-1, :2].sum(axis=1)
    for turn in strip[:, list(BOX_FIELDS).index("turn_deg")]:
        check_number("boxes: turn_deg", turn, Limit(-MAX_TURN_DEG, MAX_TURN_DEG, "deg"))
    if np.min(spaces) < 0.0:
        raise SettingError(f"boxes overlap: a space between two of them is {np.min(spaces):g} m long")
    widest = int(np.argmax(spaces))
    gap = (float(strip[widest, :2].sum()), float(strip[widest + 1, 0]))
    street = Street(settings, strip, gap, np.zeros(3))
    _ = street.boxes  # validates the boxes
    return street


def start_of(given: Any) -> Floats:
    """Return x, y, heading of a start, m, m, rad, (3,); the heading is within half a turn.

    Raises:
        SettingError: the start is not three finite numbers.
    """
    start = as_numbers("reset option 'start'", given).copy()
    if start.shape != (3,) or not np.all(np.isfinite(start)):
        raise SettingError(f"reset option 'start' must be x, y, heading in m, m, rad, got {given}")
    start[2] = math.remainder(start[2], math.tau)
    return start


def placed(street: Street, start: Any, car: CarSettings) -> Street:
    """Return a street with another start.

    Raises:
        SettingError: the start is outside the street, or the car touches an obstacle or stands inside one.
    """
    start, low, high = start_of(start), street.kerb, street.settings.far_side
    x, y = float(start[0]), float(start[1])
    if not (-BEHIND <= x <= street.end and low <= y <= high):
        raise SettingError(
            f"reset option 'start' is at x {x:g} m, y {y:g} m, outside the street: x from {-BEHIND:g} to "
            f"{street.end:g} m, y from {low:g} to {high:g} m"
        )
    inside = any(box.contains(x, y) for box in (*street.boxes, *street.obstacles))
    if inside or touches(start, car.body, street.scene.segments) != NO_HIT:
        raise SettingError(f"reset option 'start': a car at x {x:g} m, y {y:g} m touches an obstacle: move the start")
    return replace(street, start=start)


@dataclass(frozen=True)
class Goal:
    """End and arcs of the reference path.

    Attributes:
        x, y: position of the rear axle at the end of the path, m.
        turn: angle of each of the two arcs, rad.
        ready_x: x at which the arcs begin on the lane, m.
    """

    x: float
    y: float
    turn: float
    ready_x: float

    @classmethod
    def of(cls, street: Street, car: CarSettings) -> Goal:
        """Return the goal in the middle of the strip, as far from the gap's first box as a single move allows."""
        x = street.gap[0] + car.rear_overhang + rear_room(street.gap[1] - street.gap[0], car)
        y, radius = 0.5 * (street.line + street.kerb), arc_radius(car)
        turn = float(np.arccos(min(max(1.0 + y / (2.0 * radius), -1.0), 1.0)))
        return cls(x, y, turn, float(x + 2.0 * radius * np.sin(turn)))


def rear_room(gap: float, car: CarSettings) -> float:
    """Return the space behind the car at the end of the reference path in a gap, m."""
    return min(max(gap - car.length - TURN_ROOM, REAR_ROOM[0]), REAR_ROOM[1])


def arc_radius(car: CarSettings) -> float:
    """Return the radius of the arcs of the reference path, m."""
    return ARC_MARGIN * car.turning_radius
