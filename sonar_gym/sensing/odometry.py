"""Odometry of the car from wheel and steering sensors, with systematic and random errors.

The systematic errors are the dominant ones on smooth floors (Borenstein and Feng 1996, "Measurement and correction of
systematic odometry errors"): the wheel diameter, which scales all distances, and an offset of the steering angle. They
are drawn once per episode. The random errors, from slip, grow with the square root of the distance (Thrun, Burgard and
Fox 2005, "Probabilistic robotics", section 5.4).
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
ODOMETRY_TAG = 0x57E9  # separates this stream from those of the world and of the sonars


@dataclass(frozen=True)
class OdometrySettings:
    """Standard deviations of the errors; all 0 is exact odometry.

    Attributes:
        scale: relative error of distance (wheel diameter), drawn once per episode.
        pull: heading error per distance (offset of the steering angle), rad/m, drawn once per episode.
        slip: random error of distance, m per square root of a metre.
        wander: random error of heading, rad per square root of a metre.
    """

    scale: float = 0.0
    pull: float = 0.0
    slip: float = 0.0
    wander: float = 0.0

    def __post_init__(self) -> None:
        """Raise SettingError for negative or non-finite values."""
        for field in fields(self):
            value = getattr(self, field.name)
            if not (math.isfinite(value) and value >= 0.0):
                raise SettingError(f"OdometrySettings.{field.name} must be finite and >= 0, got {value:g}")

    @property
    def exact(self) -> bool:
        """Whether all errors are 0."""
        return self == OdometrySettings()


# An error of 1 mm in a wheel diameter of 60 mm scales distances by 1.7 %. A steering offset of 0.4 deg at a wheelbase
# of 0.26 m turns the car by 1.5 deg per metre. Thrun et al. tune the random errors to the robot; these are chosen here.
ODOMETRIES: dict[str, OdometrySettings] = {
    "exact": OdometrySettings(),
    "wheels": OdometrySettings(scale=0.02, pull=float(np.radians(1.5)), slip=0.005, wander=float(np.radians(0.5))),
    "worn": OdometrySettings(scale=0.04, pull=float(np.radians(3.0)), slip=0.01, wander=float(np.radians(1.0))),
}
OdometryChoice = str | OdometrySettings | Mapping[str, Any]


def odometry(given: OdometryChoice) -> OdometrySettings:
    """Return settings given by name, as a mapping of their fields, or as an instance.

    >>> odometry("exact").exact
    True
    """
    if isinstance(given, str):
        if given not in ODOMETRIES:
            raise SettingError(f"odometry {given!r}: no such kind; expected {', '.join(ODOMETRIES)}, or settings")
        return ODOMETRIES[given]
    return given if isinstance(given, OdometrySettings) else OdometrySettings(**given)


X, Y, HEADING, SCALE, PULL, SLIP, WANDER = range(7)  # columns of the state of an odometer


@compiled
def dead_reckoned(
    estimate: Floats, before: Floats, after: Floats, stretch: float, pull: float, wander: float
) -> tuple[float, float, float]:
    """Return the estimated pose of a car after a step.

    Args:
        estimate: estimated x, y, heading before the step, (3,).
        before: true pose before the step, (3,).
        after: true pose after the step, (3,).
        stretch: relative error of the distance.
        pull: heading error per distance driven forwards, rad/m.
        wander: further heading error, rad.
    """
    c, s = math.cos(before[2]), math.sin(before[2])
    dx, dy = after[0] - before[0], after[1] - before[1]
    along, across = (1.0 + stretch) * (c * dx + s * dy), (1.0 + stretch) * (c * dy - s * dx)
    turn = (after[2] - before[2] + math.pi) % (2.0 * math.pi) - math.pi
    c, s = math.cos(estimate[2]), math.sin(estimate[2])
    heading = estimate[2] + turn + pull * along + wander
    return estimate[0] + c * along - s * across, estimate[1] + s * along + c * across, heading


@compiled
def integrate(state: Floats, before: Floats, after: Floats) -> None:
    """Integrate one step between two true poses.

    Args:
        state: x, y, heading; scale and pull of the episode; slip and wander of this step, (7,); updated in place.
        before: true x, y, heading before the step, (3,).
        after: true pose after the step, (3,).
    """
    way = math.hypot(after[0] - before[0], after[1] - before[1])
    stretch = state[SCALE] + state[SLIP] * math.sqrt(way) / max(way, 1e-12)
    now = dead_reckoned(state[:3], before, after, stretch, state[PULL], state[WANDER] * math.sqrt(way))
    state[X], state[Y], state[HEADING] = now


class Odometer:
    """Odometry of several cars, each in the frame of its start.

    Args:
        settings: standard deviations of the errors.
        copies: number of cars, each with its own random stream.

    Attributes:
        state: x, y, heading, and errors in columns `SCALE` to `WANDER`, (copies, 7).
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
        """Seed the stream of a copy. It differs from those of the world and of the sonars."""
        self.rngs[copy] = np.random.default_rng(np.random.SeedSequence([seed, ODOMETRY_TAG]))

    def begin(self, rows: Iterable[int] = (0,)) -> None:
        """Begin episodes at the origin, and draw the systematic errors."""
        for row in rows:
            self.state[row] = 0.0
            if not self._exact:
                spread = self.settings.scale, self.settings.pull
                self.state[row, SCALE : PULL + 1] = self.rngs[row].normal(size=2) * spread

    def slip(self, rows: Iterable[int] = (0,)) -> None:
        """Draw the random errors of the next step."""
        if not self._exact:
            spread = self.settings.slip, self.settings.wander
            for row in rows:
                self.state[row, SLIP : WANDER + 1] = self.rngs[row].normal(size=2) * spread

    def step(self, before: Floats, after: Floats) -> None:
        """Integrate one step of the first car between two true poses, (3,) each."""
        self.slip()
        integrate(self.state[0], before, after)
