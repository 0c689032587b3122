"""What a car knows of its own way: the turns of its wheels and of its steering, with the errors that both have.

Systematic errors are those that Borenstein and Feng (1996, "Measurement and correction of systematic odometry errors")
find to rule on smooth floors: a wheel's diameter, which stretches every way alike, and a straight ahead that is none.
They are drawn once an episode. Random ones, from slip, grow with the square root of the way, as in Thrun, Burgard and
Fox (2005, "Probabilistic robotics", section 5.4).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquisition import SettingError
from sonar_gym.compiled import compiled

Floats = NDArray[np.float64]
ODOMETRY_TAG = 0x57E9  # another stream than those of the world and of the sonars


@dataclass(frozen=True)
class OdometrySettings:
    """Standard deviations of what is wrong with it; all 0 is exact.

    Attributes:
        scale: of the way gone, as a share; a wheel's diameter, drawn once an episode.
        pull: heading gained on a straight way, rad/m; a steering angle's zero, drawn once an episode.
        slip: of the way gone, m per square root of a metre.
        wander: of the heading, rad per square root of a metre.
    """

    scale: float = 0.0
    pull: float = 0.0
    slip: float = 0.0
    wander: float = 0.0

    def __post_init__(self) -> None:
        """Refuse what is no deviation."""
        for field in fields(self):
            value = getattr(self, field.name)
            if not (math.isfinite(value) and value >= 0.0):
                raise SettingError(f"OdometrySettings.{field.name} must be finite and >= 0, got {value:g}")

    @property
    def exact(self) -> bool:
        """Whether nothing is wrong with it."""
        return self == OdometrySettings()


# A wheel of 60 mm that is 1 mm off stretches the way by 1.7 %; 0.4 deg off at the steering of a wheelbase of 0.26 m
# turn the car by 1.5 deg a metre. Thrun et al. tune the random ones to the robot; these are ours.
ODOMETRIES: dict[str, OdometrySettings] = {
    "exact": OdometrySettings(),
    "wheels": OdometrySettings(scale=0.02, pull=float(np.radians(1.5)), slip=0.005, wander=float(np.radians(0.5))),
    "worn": OdometrySettings(scale=0.04, pull=float(np.radians(3.0)), slip=0.01, wander=float(np.radians(1.0))),
}
OdometryChoice = str | OdometrySettings | Mapping[str, Any]


def odometry(given: OdometryChoice) -> OdometrySettings:
    """Return settings by name, from a mapping of their fields, or as they are.

    >>> odometry("exact").exact
    True
    """
    if isinstance(given, str):
        if given not in ODOMETRIES:
            raise SettingError(f"odometry {given!r}: no such kind; expected {', '.join(ODOMETRIES)}, or settings")
        return ODOMETRIES[given]
    return given if isinstance(given, OdometrySettings) else OdometrySettings(**given)


X, Y, HEADING, SCALE, PULL, SLIP, WANDER = range(7)  # columns of what an odometer keeps


@compiled
def reckoned(
    estimate: Floats, before: Floats, after: Floats, stretch: float, pull: float, wander: float
) -> tuple[float, float, float]:
    """Return where a car takes itself to be after a step.

    Args:
        estimate: x, y, heading where it took itself to be before, (3,).
        before: where it really was, (3,).
        after: where it really is, (3,).
        stretch: share by which the way is overestimated.
        pull: heading gained per metre gone forwards, rad/m.
        wander: heading gained besides, rad.
    """
    c, s = math.cos(before[2]), math.sin(before[2])
    dx, dy = after[0] - before[0], after[1] - before[1]
    along, across = (1.0 + stretch) * (c * dx + s * dy), (1.0 + stretch) * (c * dy - s * dx)
    turn = (after[2] - before[2] + math.pi) % (2.0 * math.pi) - math.pi
    c, s = math.cos(estimate[2]), math.sin(estimate[2])
    heading = estimate[2] + turn + pull * along + wander
    return estimate[0] + c * along - s * across, estimate[1] + s * along + c * across, heading


@compiled
def count(kept: Floats, before: Floats, after: Floats) -> None:
    """Count a step between two poses of the world.

    Args:
        kept: x, y, heading; scale and pull of the episode; slip and wander of this step, (7,).
        before: x, y, heading where the car was, (3,).
        after: where it is, (3,).
    """
    way = math.hypot(after[0] - before[0], after[1] - before[1])
    stretch = kept[SCALE] + kept[SLIP] * math.sqrt(way) / max(way, 1e-12)
    now = reckoned(kept[:3], before, after, stretch, kept[PULL], kept[WANDER] * math.sqrt(way))
    kept[X], kept[Y], kept[HEADING] = now


class Odometer:
    """Counts the ways of cars from their starts, each in its start's frame.

    Args:
        settings: what is wrong with it.
        copies: cars, each with a random stream of its own.

    Attributes:
        kept: x, y, heading, and what is wrong with them in columns `SCALE` to `WANDER`, (copies, 7).
    """

    def __init__(self, settings: OdometrySettings, copies: int = 1) -> None:
        self.settings = settings
        self._exact = settings.exact
        self.rngs = [np.random.default_rng() for _ in range(copies)]
        self.kept = np.zeros((copies, 7))

    @property
    def pose(self) -> Floats:
        """Where the first car takes itself to be, (3,)."""
        return self.kept[0, :SCALE].copy()

    def seed(self, seed: int, copy: int = 0) -> None:
        """Start a stream anew; worlds and sonars seeded alike are left alone."""
        self.rngs[copy] = np.random.default_rng(np.random.SeedSequence([seed, ODOMETRY_TAG]))

    def begin(self, rows: Iterable[int] = (0,)) -> None:
        """Begin episodes: the cars stand at the origin, and have the wheels that they have."""
        for row in rows:
            self.kept[row] = 0.0
            if not self._exact:
                spread = self.settings.scale, self.settings.pull
                self.kept[row, SCALE : PULL + 1] = self.rngs[row].normal(size=2) * spread

    def slip(self, rows: Iterable[int] = (0,)) -> None:
        """Draw what slips in the next step."""
        if not self._exact:
            spread = self.settings.slip, self.settings.wander
            for row in rows:
                self.kept[row, SLIP : WANDER + 1] = self.rngs[row].normal(size=2) * spread

    def step(self, before: Floats, after: Floats) -> None:
        """Count a step of the first car between two poses of the world, (3,) each."""
        self.slip()
        count(self.kept[0], before, after)
