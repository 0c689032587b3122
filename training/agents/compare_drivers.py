"""Park in the same streets with an ideal sonar, with real ones, and with real ones weighed by their credence.

The scripted driver is the same throughout. What is given for each difference is its interval at 95 % and the exact
probability of McNemar's test, both from the streets on which one parked and the other did not.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import gymnasium
import numpy as np
import pandas as pd
from numpy.typing import NDArray

import sonar_gym
from acquisition import SettingError
from noise import Faulty, SonarModel, load_model
from noise.faults import Noise, Short
from sonar_gym.control.driver import ParkingDriver, run_episode
from training.common.paired import Paired
from training.common.progress import bar

IDEAL = "ideal"
SCATTER_M = 0.1  # of the fault NOISE
HEADINGS = ("sonar", "driver", "parked", "collided", "steps", "against ideal, points", "by fusion, points")


@dataclass(frozen=True)
class Args:
    """Settings of `sonar-gym compare-drivers`."""

    sonars: tuple[str, ...] = ("srf08-mlp",)
    """Sonars to compare with the ideal one, by name or folder."""
    faults: float = 0.0
    """Share of their readings that are arbitrary, and as many again that scatter by 0.1 m."""
    difficulty: str = "normal"
    """Of the streets: easy, normal or hard."""
    odometry: str = "wheels"
    """What the car knows of its way: exact, wheels or worn."""
    episodes: int = 200
    """Streets, the same for all."""
    seed: int = 0
    """Of the first street; the others follow."""
    out: Path | None = None
    """CSV of all episodes, a row each; none without."""


@dataclass(frozen=True)
class Arm:
    """One way to drive.

    Attributes:
        sonar: its name.
        perception: of the driver, "survey" or "fusion".
        success, collision: by street, (n,).
        steps: of the streets on which the car parked, (n,).
    """

    sonar: str
    perception: str
    success: NDArray[np.bool_]
    collision: NDArray[np.bool_]
    steps: NDArray[np.int64]

    @property
    def cells(self) -> list[str]:
        """Of its line in a table."""
        steps = f"{np.mean(self.steps[self.success]):.0f}" if self.success.any() else "-"
        n = len(self.success)
        return [self.sonar, self.perception, f"{self.success.sum()} of {n}", str(int(self.collision.sum())), steps]

    @property
    def frame(self) -> pd.DataFrame:
        """All its episodes, a row each."""
        ends = {"success": self.success, "collision": self.collision, "steps": self.steps}
        return pd.DataFrame({"sonar": self.sonar, "driver": self.perception, **ends})


def sonar_of(name: str, faults: float) -> SonarModel:
    """Return a sonar with faults; the ideal one has none."""
    model = load_model(name)
    return Faulty(model, [Short(faults), Noise(faults, SCATTER_M)]) if faults > 0 and name != IDEAL else model


def drive(args: Args, name: str, perception: str, tell: Callable[[int, int], None]) -> Arm:
    """Drive on all streets."""
    sonar = sonar_of(name, args.faults)
    env = gymnasium.make(sonar_gym.ENV_ID, sonar=sonar, difficulty=args.difficulty, odometry=args.odometry)
    driver, ends = ParkingDriver(perception=perception), []
    for k in range(args.episodes):
        episode = run_episode(env, driver, args.seed + k)
        ends.append((episode.success, episode.collision, episode.steps))
        tell(k + 1, args.episodes)
    success, collision, steps = np.array(ends).T
    return Arm(name, perception, success.astype(bool), collision.astype(bool), steps)


def compare(args: Args) -> list[Arm]:
    """Drive with the ideal sonar, and with each other one twice: readings as they are, and fused."""
    arms = []
    for name in (IDEAL, *(name for name in args.sonars if name != IDEAL)):
        for perception in ("survey", "fusion"):
            with bar(f"{name}, {perception}", args.episodes) as tell:
                arms.append(drive(args, name, perception, tell))
    return arms


def table(arms: list[Arm]) -> str:
    """Return the comparison in Markdown."""
    plain = {arm.sonar: arm for arm in arms if arm.perception == "survey"}
    lines = [f"| {' | '.join(HEADINGS)} |", "|" + "---|" * len(HEADINGS)]
    for arm in arms:
        ideal = "" if arm is plain[IDEAL] else str(Paired.of(plain[IDEAL].success, arm.success))
        fused = "" if arm.perception == "survey" else str(Paired.of(plain[arm.sonar].success, arm.success))
        lines.append(f"| {' | '.join([*arm.cells, ideal, fused])} |")
    return "\n".join(lines)


def main(args: Args) -> None:
    """Print the table, and keep all episodes where that is asked for."""
    if args.episodes < 1:
        raise SettingError(f"--episodes must be >= 1, got {args.episodes}")
    if not 0.0 <= args.faults <= 0.5:
        raise SettingError(f"--faults must lie in [0, 0.5], got {args.faults:g}: there are two kinds of them")
    arms = compare(args)
    faults = f", {100 * args.faults:g} % of readings arbitrary and as many scattered" if args.faults else ""
    last = args.seed + args.episodes - 1
    print(f"Difficulty {args.difficulty}, odometry {args.odometry}{faults}; streets of seeds {args.seed} to {last}.\n")
    print(table(arms))
    if args.out is not None:
        rows = pd.concat([arm.frame.assign(seed=np.arange(args.seed, last + 1)) for arm in arms])
        temporary = args.out.with_name(args.out.name + ".part")
        rows.to_csv(temporary, index=False)
        temporary.replace(args.out)
