"""Drive the parking environment with one sonar, and say how well its readings told the truth."""

from __future__ import annotations

from dataclasses import dataclass, field

import gymnasium
import numpy as np
from numpy.typing import NDArray

import sonar_gym
from sonar_gym.control.driver import Driver, Episode, ParkingDriver, run_episode

EVERY = 4  # steps from picture to picture


@dataclass(frozen=True)
class Drive:
    """One episode, in numbers and pictures.

    Attributes:
        success, collision: how it ended.
        steps: actions taken.
        error_mm: median of |reading - truth| over all echoes, mm.
        silent: share of looks at something in reach that gave no echo.
        frames: pictures.
    """

    success: bool
    collision: bool
    steps: int
    error_mm: float
    silent: float
    frames: list[NDArray[np.uint8]] = field(repr=False)

    @classmethod
    def of(cls, episode: Episode) -> Drive:
        """Sum an episode up."""
        echo = episode.echoes > 0
        error = np.abs(episode.readings - episode.truths)[echo]
        reach = np.isfinite(episode.truths) & (episode.truths < episode.readings.max())
        silent = 1.0 - echo[reach].mean() if reach.any() else 0.0
        median = 1000 * float(np.median(error)) if error.size else 0.0
        return cls(episode.success, episode.collision, episode.steps, median, float(silent), episode.frames)

    @property
    def told(self) -> str:
        """In one line."""
        end = "parked" if self.success else "hit something" if self.collision else "did not find its place"
        return (
            f"{end} after {self.steps} steps; readings off by {self.error_mm:.0f} mm (median), "
            f"{100 * self.silent:.0f} % silent"
        )


def drive(sonar: str, seed: int, driver: Driver | None = None) -> Drive:
    """Park once on the street of a seed, by the scripted driver where no other is given."""
    env = gymnasium.make(sonar_gym.ENV_ID, sonar=sonar, render_mode="rgb_array")
    try:
        return Drive.of(run_episode(env, driver or ParkingDriver(), seed, every=EVERY))
    finally:
        env.close()
