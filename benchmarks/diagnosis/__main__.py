"""Run development trials on all cores and print the table: python -m benchmarks.diagnosis --trials 100."""

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
    """How many."""
    seed: int = 0
    """Of units, laboratories and surveys."""
    out: Path = Path("runs/diagnosis")
    """Folder of the ledger, trials.csv; trials that are in it already are not run again."""
    only: tuple[str, ...] = ()
    """Causes to conceal, each at every size, instead of the usual mix."""
    workers: int = 2
    """Processes."""


def main(args: Args) -> None:
    """Run what is missing from the ledger, then print the table."""
    ledger = args.out / "trials.csv"
    known = pd.read_csv(ledger, keep_default_na=False) if ledger.exists() else pd.DataFrame()
    wanted = _wanted(args)
    left = {k: item for k, item in wanted.items() if known.empty or k not in set(known["trial"])}
    rows = known.to_dict("records")
    with bar("trials", len(wanted)) as tell, ProcessPoolExecutor(args.workers, initializer=one_thread) as pool:
        jobs = [pool.submit(run, k, name, size, args.seed) for k, (name, size) in left.items()]
        for job in as_completed(jobs):
            rows.append(row(job.result()))
            write_text(ledger, pd.DataFrame(rows).sort_values("trial").to_csv(index=False))
            tell(len(rows), len(wanted))
    print(table(pd.read_csv(ledger, keep_default_na=False)))


def _wanted(args: Args) -> dict[int, tuple[str, float]]:
    if not args.only:
        return dict(enumerate(schedule(args.trials, args.seed)))
    pairs = [(name, size) for name in args.only for size in SIZES]
    return {10_000 + 100 * [*BY_NAME, "null"].index(n) + SIZES.index(s): (n, s) for n, s in pairs}


def table(outcomes: pd.DataFrame) -> str:
    """Return shares by cause and over everything, as text."""
    missing = {f.name for f in fields(Outcome)} - set(outcomes.columns)
    if missing:
        raise SystemExit(
            f"the ledger lacks {', '.join(sorted(missing))}: it is of another version; choose another --out"
        )
    lines = [f"{'cause':24}{'trials':>7}{'right':>7}   verdicts"]
    for name, group in outcomes.groupby("causes", sort=False):
        lines.append(f"{name:24}{len(group):7d}{group['right'].mean():7.2f}   {_counted(group['verdict'])}")
    return "\n".join(lines)


def _counted(verdicts: Iterable[str]) -> str:
    return ", ".join(f"{n} {kind}" for kind, n in pd.Series(list(verdicts)).value_counts().items())


if __name__ == "__main__":
    main(tyro.cli(Args))
