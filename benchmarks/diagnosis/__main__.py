"""Development trials of the diagnosis: python -m benchmarks.diagnosis --trials 100."""

from __future__ import annotations

from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, fields
from pathlib import Path

import pandas as pd
import tyro

from acquisition.io.files import write_text
from benchmarks.diagnosis.causes import BY_NAME
from benchmarks.diagnosis.trials import SIZES, Outcome, row, run, schedule
from noise.fitting.threads import one_thread
from training.common.progress import bar


@dataclass(frozen=True)
class Args:
    """Settings of the development trials."""

    trials: int = 100
    """Number of trials."""
    seed: int = 0
    """Seed of units, laboratories and surveys."""
    out: Path = Path("runs/diagnosis")
    """Output folder of trials.csv; trials in this file are not run again."""
    only: tuple[str, ...] = ()
    """Causes to conceal, each at every size, instead of the default mix."""
    workers: int = 2
    """Number of processes."""


def main(args: Args) -> None:
    """Run the missing trials and print the table."""
    path = args.out / "trials.csv"
    known = pd.read_csv(path, keep_default_na=False) if path.exists() else pd.DataFrame()
    requested = _requested(args)
    missing = {k: item for k, item in requested.items() if known.empty or k not in set(known["trial"])}
    rows = known.to_dict("records")
    with bar("trials", len(requested)) as update, ProcessPoolExecutor(args.workers, initializer=one_thread) as pool:
        jobs = [pool.submit(run, k, name, size, args.seed) for k, (name, size) in missing.items()]
        for job in as_completed(jobs):
            rows.append(row(job.result()))
            write_text(path, pd.DataFrame(rows).sort_values("trial").to_csv(index=False))
            update(len(rows), len(requested))
    print(table(pd.read_csv(path, keep_default_na=False)))


def _requested(args: Args) -> dict[int, tuple[str, float]]:
    if not args.only:
        return dict(enumerate(schedule(args.trials, args.seed)))
    pairs = [(name, size) for name in args.only for size in SIZES]
    return {10_000 + 100 * [*BY_NAME, "null"].index(n) + SIZES.index(s): (n, s) for n, s in pairs}


def table(outcomes: pd.DataFrame) -> str:
    """Return the share of right verdicts by cause, as text."""
    missing = {f.name for f in fields(Outcome)} - set(outcomes.columns)
    if missing:
        raise SystemExit(
            f"trials.csv lacks the columns {', '.join(sorted(missing))} of this version; choose another --out"
        )
    lines = [f"{'cause':24}{'trials':>7}{'right':>7}   verdicts"]
    for name, group in outcomes.groupby("causes", sort=False):
        lines.append(f"{name:24}{len(group):7d}{group['right'].mean():7.2f}   {_counted(group['verdict'])}")
    return "\n".join(lines)


def _counted(verdicts: Iterable[str]) -> str:
    return ", ".join(f"{n} {kind}" for kind, n in pd.Series(list(verdicts)).value_counts().items())


if __name__ == "__main__":
    main(tyro.cli(Args))
