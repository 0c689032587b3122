"""Score a driver on fixed streets with the waveform rig, worn wheels and damaged sonars, and print the leaderboard.

A driver is "scripted", the name or folder of an agent, the file of a model of Stable-Baselines3, or module:callable, a
function from a number of cars to an object with the methods of `DriverPool`. Each row holds checksums of the driver,
of all that defines the streets and of itself, which are verified before the table is printed.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from acquisition import SettingError
from acquisition.io.places import OutputFolder
from acquisition.limits import OneOf
from noise.fitting.threads import one_thread
from training.agents.drivers import Driver, digest_of, pool_by_name
from training.agents.evaluate import driver_name
from training.agents.leaderboard.rows import check_free, read_rows, row_of, table, write_row
from training.agents.leaderboard.tracks import drive_all
from training.agents.zoo.settings import ALGORITHMS
from training.common.commit import commit
from training.common.progress import progress_bars

NO_NAME = re.compile(r"[^\w .+-]")  # characters that a row's name cannot have


@dataclass(frozen=True)
class Args:
    """Settings of `sonar-gym leaderboard`."""

    driver: Annotated[Driver | None, tyro.conf.Positional] = None
    """Driver to score; none: only verify and print the rows."""
    name: str | None = None
    """Name of its row; by default that of the driver."""
    algorithm: Annotated[str, OneOf(ALGORITHMS)] = "ppo"
    """Algorithm of a model of Stable-Baselines3."""
    out: OutputFolder = Path("runs/leaderboard")
    """Folder of the rows, one file per driver."""

    def __post_init__(self) -> None:
        """Raise SettingError for a name that is no name of a file."""
        if self.name is not None and (NO_NAME.search(self.name) or not self.name.strip(" .")):
            raise SettingError(
                f"--name {self.name!r}: it becomes a file: use letters, digits, spaces, and . _ + - only"
            )

    @property
    def row_name(self) -> str:
        """Name of the row."""
        return self.name if self.name is not None else NO_NAME.sub("-", driver_name(self.driver or ""))


def main(args: Args) -> None:
    """Score the driver if one is given, and print the verified table."""
    if args.driver is not None:
        about = {
            "name": args.row_name,
            "driver": driver_name(args.driver),
            "algorithm": args.algorithm,
            "driver_sha256": digest_of(args.driver),
            "commit": commit(),
        }
        check_free(args.out, about["name"], about["driver_sha256"])
        with one_thread(), progress_bars() as on_progress:
            outcomes = drive_all(pool_by_name(args.driver, args.algorithm), on_progress)
        write_row(args.out, row_of(about, outcomes))
    rows = read_rows(args.out)
    if not rows:
        raise SettingError(f"{args.out}: no rows; give a driver to score")
    print(table(rows))
