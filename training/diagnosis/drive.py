"""One parking episode with a given sonar, with the accuracy of its readings."""

from __future__ import annotations

from dataclasses import dataclass, field

import gymnasium
import numpy as np
from numpy.typing import NDArray

import sonar_gym
from sonar_gym.control.driver import Controller, Episode, ParkingDriver, run_episode

EVERY = 4  # steps between frames


@dataclass(frozen=True)
class Drive:
    """Results of one episode.

    Attributes:
        success: whether the car parked.
        collision: whether it collided.
        steps: number of actions.
        error_mm: median of |reading - truth| over all echoes, mm; NaN without an echo.
        silent: share of pings without an echo among those with a target in range.
        frames: pictures, (height, width, 3) uint8.
    """

    success: bool
    collision: bool
    steps: int
    error_mm: float
    silent: float
    frames: list[NDArray[np.uint8]] = field(repr=False)

    @classmethod
    def of(cls, episode: Episode) -> Drive:
        """Return the results of an episode."""
        echo = episode.echoes > 0
        error = np.abs(episode.readings - episode.truths)[echo]
        reach = np.isfinite(episode.truths) & (episode.truths < episode.readings.max())
        silent = 1.0 - echo[reach].mean() if reach.any() else 0.0
        median = 1000 * float(np.median(error)) if error.size else float("nan")
        return cls(episode.success, episode.collision, episode.steps, median, float(silent), episode.frames)

    @property
    def end(self) -> str:
        """How the drive ended, in a word or three."""
        return "parked" if self.success else "collided" if self.collision else "did not park"

    @property
    def error(self) -> str:
        """Median error as text."""
        return "unknown" if np.isnan(self.error_mm) else f"{self.error_mm:.0f} mm"

    @property
    def summary(self) -> str:
        """Result as one line of text."""
        return f"{self.end} after {self.steps} steps; median error {self.error}, {100 * self.silent:.0f} % no echo"


def drive(sonar: str, seed: int, driver: Controller | None = None) -> Drive:
    """Park once on the street of a seed, by default with the scripted driver."""
    env = gymnasium.make(sonar_gym.ENV_ID, sonar=sonar, render_mode="rgb_array")
    try:
        return Drive.of(run_episode(env, driver or ParkingDriver(), seed, every=EVERY))
    finally:
        env.close()
