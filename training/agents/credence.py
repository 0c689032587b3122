"""Count the credence of the shipped models' readings on the registered streets again, and ship the tables.

    sonar-gym make-credence

Needed after new noise models, a new agent, or a change of the streets or of what sonars hear. Takes about half an hour.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from acquisition.arrays import Floats
from acquisition.io.files import write_atomic
from acquisition.io.places import OutputFile
from noise import load_model
from sonar_gym.parking.fleet import MAX_RANGE
from sonar_gym.parking.prior import DRIVERS, Task, counted
from sonar_gym.parking.stored import SHIPPED, shipped_key
from sonar_gym.sensing.mounts import LAYOUTS
from sonar_gym.street.street import LEVELS
from sonar_gym.street.vehicle import CarSettings
from training.common.progress import bar

MODELS = ("gaussian", "srf08-mlp", "srf08-lstm", "srf08-hybrid")
DISTINCT_LAYOUTS = ("eight", "eight in turn", "four")  # latencies do not matter


@dataclass(frozen=True)
class Args:
    """Settings of `sonar-gym make-credence`."""

    out: OutputFile = SHIPPED
    """File to write the tables to; by default those of the package."""


def tasks(level: str, driver: str) -> list[Task]:
    """Return the tasks of a level and a driver, by layout."""
    return [Task(LEVELS[level], CarSettings(), LAYOUTS[name], MAX_RANGE, driver, True) for name in DISTINCT_LAYOUTS]


def tables(choices: list[tuple[str, str, str]]) -> Iterator[dict[str, Floats]]:
    """Yield the tables of each choice of model, level and driver, by their keys."""
    for name, level, driver in choices:
        model: Any = load_model(name)
        every = tasks(level, driver)
        keys = [shipped_key(model, task) for task in every]
        yield dict(zip(keys, counted(model, *every), strict=True))


def main(args: Args) -> None:
    """Count and write."""
    choices = list(product(MODELS, LEVELS, DRIVERS))
    found: dict[str, Floats] = {}
    with bar("driving", len(choices)) as progress:
        for k, each in enumerate(tables(choices)):
            found |= each
            progress(k + 1, len(choices))
    write(found, Path(args.out))
    print(f"{args.out}: {len(found)} sets of tables")


def write(found: dict[str, Floats], path: Path) -> None:
    """Write tables, those of fewer sonars filled with zeros, in half precision."""
    most = max(len(table) for table in found.values())
    stacked = [np.pad(table, ((0, most - len(table)), (0, 0))) for table in found.values()]
    keys, halves = np.array(list(found)), np.array(stacked, dtype=np.float16)
    write_atomic(path, lambda file: np.savez_compressed(file, keys=keys, tables=halves), binary=True)
