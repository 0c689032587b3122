"""Dead reckoning of a car from its wheels and steering, with systematic and random errors.

On smooth floors, two systematic errors dominate (Borenstein and Feng, 1996, "Measurement and correction of systematic
odometry errors"): the wheel diameter, which scales every distance, and a steering offset, which bends a straight line.
They are drawn once per episode. Random errors from slip grow with the square root of the distance, as in Thrun, Burgard
and Fox (2005, "Probabilistic robotics", section 5.4).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from acquisition.arrays import Floats
from acquisition.limits import Limit, OneOf, check_choice, check_settings
from sonar_gym.checks import settings_of
from sonar_gym.compiled import compiled

ODOMETRY_TAG = 0x57E9  # a random stream apart from those of the streets and of the sonars


Deviation = Annotated[float, Limit(0.0, 10.0)]


@dataclass(frozen=True)
class OdometrySettings:
    """Standard deviations of the odometry errors; all 0 means exact odometry.

    Attributes:
        scale: relative error of the distance, from the wheel diameter; drawn once per episode.
        pull: heading error per distance, from the steering offset, rad/m; drawn once per episode.
        slip: random error of the distance, m per square root of a metre.
        wander: random error of the heading, rad per square root of a metre.
    """

    scale: Deviation = 0.0
    pull: Deviation = 0.0
    slip: Deviation = 0.0
    wander: Deviation = 0.0

    def __post_init__(self) -> None:
        """Raise SettingError for values that are no standard deviations."""
        check_settings(self)

    @property
    def exact(self) -> bool:
        """Whether all errors are zero."""
        return self == OdometrySettings()


# A 60 mm wheel with an error of 1 mm scales distances by 1.7 %; a steering offset of 0.4 deg at a wheelbase of 0.26 m
# turns the car by 1.5 deg per metre. The random errors are chosen here; Thrun et al. tune them to the robot.
ODOMETRIES: dict[str, OdometrySettings] = {
    "exact": OdometrySettings(),
    "wheels": OdometrySettings(scale=0.02, pull=float(np.radians(1.5)), slip=0.005, wander=float(np.radians(0.5))),
    "worn": OdometrySettings(scale=0.04, pull=float(np.radians(3.0)), slip=0.01, wander=float(np.radians(1.0))),
}
OdometryName = Annotated[str, OneOf(ODOMETRIES)]
OdometryChoice = str | OdometrySettings | Mapping[str, object]


def odometry(given: OdometryChoice) -> OdometrySettings:
    """Return settings by name, from a mapping of their fields, or as given.

    >>> odometry("exact").exact
    True
    """
    if isinstance(given, str):
        check_choice("odometry", given, list(ODOMETRIES))
        return ODOMETRIES[given]
    return settings_of(OdometrySettings, given, "odometry")


X, Y, HEADING, SCALE, PULL, SLIP, WANDER = range(7)  # columns of `Odometer.state`


@compiled
def dead_reckoned(
    estimate: Floats, before: Floats, after: Floats, scale: float, pull: float, wander: float
) -> tuple[float, float, float]:
    """Return the estimated pose after a step.

    Args:
        estimate: estimated x, y, heading before the step, (3,).
        before: true pose before the step, (3,).
        after: true pose after the step, (3,).
        scale: relative error of the distance.
        pull: heading error per metre driven forwards, rad/m.
        wander: additional heading error, rad.
    """
    c, s = math.cos(before[2]), math.sin(before[2])
    dx, dy = after[0] - before[0], after[1] - before[1]
    along, across = (1.0 + scale) * (c * dx + s * dy), (1.0 + scale) * (c * dy - s * dx)
    turn = (after[2] - before[2] + math.pi) % (2.0 * math.pi) - math.pi
    c, s = math.cos(estimate[2]), math.sin(estimate[2])
    heading = estimate[2] + turn + pull * along + wander
    return estimate[0] + c * along - s * across, estimate[1] + s * along + c * across, heading


@compiled
def update_odometry(state: Floats, before: Floats, after: Floats) -> None:
    """Update the odometry after a step between two poses.

    Args:
        state: estimated x, y, heading; scale and pull of the episode; slip and wander of this step, (7,).
        before: true x, y, heading before the step, (3,).
        after: true x, y, heading after the step, (3,).
    """
    travel = math.hypot(after[0] - before[0], after[1] - before[1])
    scale = state[SCALE] + state[SLIP] * math.sqrt(travel) / max(travel, 1e-12)
    now = dead_reckoned(state[:3], before, after, scale, state[PULL], state[WANDER] * math.sqrt(travel))
    state[X], state[Y], state[HEADING] = now


class Odometer:
    """Odometry of several cars, each in the frame of its starting pose.

    Args:
        settings: standard deviations of the errors.
        copies: number of cars; each has its own random stream.

    Attributes:
        state: estimated x, y, heading, and the errors in columns `SCALE` to `WANDER`, (copies, 7).
    """

    def __init__(self, settings: OdometrySettings, copies: int = 1) -> None:
        self.settings = settings
        self._exact = settings.exact
        self.rngs = [np.random.default_rng() for _ in range(copies)]
        self.state = np.zeros((copies, 7))

    @property
    def pose(self) -> Floats:
        """Estimated pose of the first car, (3,)."""
        return self.state[0, :SCALE].copy()

    def seed(self, seed: int, copy: int = 0) -> None:
        """Restart the random stream of one car; streets and sonars with the same seed are not affected."""
        self.rngs[copy] = np.random.default_rng(np.random.SeedSequence([seed, ODOMETRY_TAG]))

    def begin(self, rows: Iterable[int] = (0,)) -> None:
        """Begin episodes: set the estimates to the origin and draw the systematic errors."""
        for row in rows:
            self.state[row] = 0.0
            if not self._exact:
                sd = self.settings.scale, self.settings.pull
                self.state[row, SCALE : PULL + 1] = self.rngs[row].normal(size=2) * sd

    def slip(self, rows: Iterable[int] = (0,)) -> None:
        """Draw the random errors of the next step."""
        if not self._exact:
            sd = self.settings.slip, self.settings.wander
            for row in rows:
                self.state[row, SLIP : WANDER + 1] = self.rngs[row].normal(size=2) * sd
