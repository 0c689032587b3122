"""Write labelled pairs of a simulation and a recording: known causes, unmodelled faults, and no difference at all.

Each trial is a folder with `simulated.csv`, `recorded.csv`, three fresh recordings and `answer.json`.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from annotated_types import MinLen

from acquisition import SettingError
from acquisition.io.places import OutputFolder
from acquisition.limits import Count, OneOf, Seed, Workers
from training.common.progress import bar
from training.common.workers import worker_processes
from training.diagnosis.generators.ensemble import ALL_KINDS, FAMILIES, KINDS, kinds_of, make_trial
from training.diagnosis.generators.trial import save


@dataclass(frozen=True)
class Args:
    """Write N labelled trials.

    Attributes:
        out: folder in which each trial gets a folder.
        n: number of trials.
        families: of generators, in turn.
        kinds: of trials, in turn; a kind that a family lacks is left out there.
        pings: approximate number in each recording.
        seed: of all random numbers; the same seed gives the same files.
        workers: number of processes.
    """

    out: OutputFolder
    n: Count = 70
    families: Annotated[tuple[Annotated[str, OneOf(FAMILIES)], ...], MinLen(1)] = FAMILIES
    kinds: Annotated[tuple[Annotated[str, OneOf(ALL_KINDS)], ...], MinLen(1)] = KINDS
    pings: Count = 2000
    seed: Seed = 0
    workers: Workers = 1


def mix(families: tuple[str, ...], kinds: tuple[str, ...]) -> list[tuple[str, str]]:
    """Return the pairs of a family and a kind that exist, kind by kind.

    Raises:
        SettingError: unknown family or kind, or no pair that exists.
    """
    unknown = [kind for kind in kinds if kind not in ALL_KINDS]
    if unknown:
        raise SettingError(f"{unknown[0]!r} is not a kind of trial; choose from {', '.join(ALL_KINDS)}")
    pairs = [(family, kind) for kind in kinds for family in families if kind in kinds_of(family)]
    if not pairs:
        raise SettingError(f"no family of {', '.join(families)} has trials of kind {', '.join(kinds)}")
    return pairs


def write(out: Path, number: int, family: str, kind: str, pings: int, seed: int) -> Path:
    """Make one trial and write it; its random numbers depend on the seed and its number alone."""
    trial = make_trial(family, kind, np.random.default_rng([seed, number]), pings=pings)
    return save(trial, out / f"{number:05d}")


def main(args: Args) -> None:
    """Write the trials and print where they are."""
    pairs = mix(args.families, args.kinds)
    columns = zip(*((args.out, k, *pairs[k % len(pairs)], args.pings, args.seed) for k in range(args.n)), strict=True)
    with worker_processes(min(args.workers, args.n)) as pool, bar("trials", args.n) as update:
        for done, _ in enumerate(pool.map(write, *columns), 1):
            update(done, args.n)
    print(f"{args.n} trials in {args.out}, each with simulated.csv, recorded.csv, fresh recordings and answer.json")
