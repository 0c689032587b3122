"""Park on the same streets with an ideal and noisy sonars, with and without weighting by credence.

All arms use the scripted driver. Differences in success have 95 % intervals and the p-value of McNemar's exact test,
from the streets on which exactly one of two arms parked.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Annotated

import pandas as pd
from annotated_types import MinLen

from acquisition.io.files import write_text
from acquisition.io.places import OutputFile
from acquisition.limits import Count, Limit, Seed
from noise import Faulty, SonarModel, load_model
from noise.faults import Noise, Short
from noise.store import ModelName
from sonar_gym.sensing.odometry import OdometryName
from sonar_gym.street.street import Difficulty
from training.agents.evaluate import Outcomes, ScriptedPool, evaluate
from training.common.progress import bar
from training.common.statistics import PairedComparison
from training.common.tables import markdown_table

IDEAL, SURVEY, FUSION = "ideal", "survey", "fusion"
SCATTER = 0.1  # m, of the fault NOISE
HEADER = ("sonar", "driver", "parked", "collided", "steps", "difference to ideal, points", "gain of fusion, points")


@dataclass(frozen=True)
class Args:
    """Settings of `sonar-gym compare-drivers`."""

    sonars: Annotated[tuple[ModelName, ...], MinLen(1)] = ("srf08-mlp",)
    """Names or folders of the sonar models to compare with the ideal one."""
    faults: Annotated[float, Limit(0.0, 0.5)] = 0.0
    """Share of readings that are arbitrary; an equal share has 0.1 m of scatter."""
    difficulty: Difficulty = "normal"
    """Difficulty of the streets: easy, normal, hard, manoeuvre."""
    odometry: OdometryName = "wheels"
    """Error of the odometry: exact, wheels, worn."""
    episodes: Count = 200
    """Number of streets; the same streets for all."""
    seed: Seed = 0
    """Seed of the first street; the others follow."""
    out: OutputFile | None = None
    """CSV file for all episodes, one per row."""


@dataclass(frozen=True)
class Arm:
    """Results of one sonar and one way to use its readings.

    Attributes:
        sonar: name of the sonar model.
        perception: perception of the scripted driver, "survey" or "fusion".
        outcomes: results of the episodes.
    """

    sonar: str
    perception: str
    outcomes: Outcomes

    @property
    def row(self) -> list[str]:
        """Cells of its row in the table."""
        one, parked = self.outcomes, self.outcomes.successes.count
        steps = f"{one.steps[one.success].mean():.0f}" if parked else "-"
        return [self.sonar, self.perception, f"{parked} of {len(one.seeds)}", str(one.collisions.count), steps]

    @property
    def frame(self) -> pd.DataFrame:
        """All its episodes, one per row."""
        one = self.outcomes
        ends = {"success": one.success, "collision": one.collision, "steps": one.steps, "seed": one.seeds}
        return pd.DataFrame({"sonar": self.sonar, "driver": self.perception, **ends})

    def against(self, reference: Arm) -> str:
        """Return the difference in success to a reference, "" for the reference itself."""
        return "" if self is reference else str(PairedComparison.of(reference.outcomes.success, self.outcomes.success))


def sonar_of(name: str, faults: float) -> SonarModel:
    """Return a sonar model with faults; the ideal one has none."""
    model = load_model(name)
    return Faulty(model, [Short(faults), Noise(faults, SCATTER)]) if faults > 0 and name != IDEAL else model


def drive(args: Args, name: str, perception: str, on_progress: Callable[[int, int], None]) -> Arm:
    """Drive all streets with one sonar and one perception."""
    settings = {"sonar": sonar_of(name, args.faults), "difficulty": args.difficulty, "odometry": args.odometry}
    seeds = range(args.seed, args.seed + args.episodes)
    pool = partial(ScriptedPool, perception=perception)
    return Arm(name, perception, evaluate(pool, settings, seeds, on_progress))


def compare(args: Args) -> list[Arm]:
    """Drive with the ideal sonar and all others, each with and without weighting by credence."""
    arms = []
    for name in (IDEAL, *(name for name in args.sonars if name != IDEAL)):
        for perception in (SURVEY, FUSION):
            with bar(f"{name}, {perception}", args.episodes) as on_progress:
                arms.append(drive(args, name, perception, on_progress))
    return arms


def table(arms: list[Arm]) -> str:
    """Return the comparison in Markdown."""
    unweighted = {arm.sonar: arm for arm in arms if arm.perception == SURVEY}
    rows = ((*arm.row, arm.against(unweighted[IDEAL]), arm.against(unweighted[arm.sonar])) for arm in arms)
    return markdown_table(HEADER, rows)


def main(args: Args) -> None:
    """Print the table, and write all episodes where a file is named."""
    arms = compare(args)
    faults = f", {100 * args.faults:g} % of readings arbitrary and as many scattered" if args.faults else ""
    last = args.seed + args.episodes - 1
    print(f"Difficulty {args.difficulty}, odometry {args.odometry}{faults}; streets of seeds {args.seed} to {last}.\n")
    print(table(arms))
    if args.out is not None:
        write_text(args.out, pd.concat([arm.frame for arm in arms]).to_csv(index=False))
