"""Diagnose labelled trials, hard cases and halves of real recordings; write the table of targets.

An interrupted run goes on with the same command. Figures of another version of the code need another folder.
"""

from __future__ import annotations

import json
import shlex
import sys
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from annotated_types import MinLen

from acquisition.io.places import OutputFile, OutputFolder
from acquisition.limits import Count, OneOf, Seed, Workers
from noise.discrepancy.judge.decision import WEIGHTS
from training.common.commit import commit
from training.diagnosis.generators.ensemble import ALL_KINDS, FAMILIES, KINDS
from training.diagnosis.judging.page import as_json, judged, markdown
from training.diagnosis.judging.record import Record
from training.diagnosis.judging.run import read, run
from training.diagnosis.judging.tasks import hard_cases, trials

LEFT_OUT = ("fixed", "driving")  # families that judge the decision model and never fit it


@dataclass(frozen=True)
class Args:
    """Measure the diagnosis.

    Attributes:
        out: folder of the records and of the table as JSON.
        n: number of trials of each family and kind.
        families: of generators.
        kinds: of trials.
        pings: approximate number in each recording.
        seed: of all random numbers; trials of the decision model's fit have another seed.
        workers: number of processes.
        hard: whether hard cases, real recordings and timed trials are included.
        page: Markdown file to write; `table.md` in `out` by default.
        only_table: write the table of the records that exist.
    """

    out: OutputFolder = Path("runs/judge")
    n: Count = 10
    families: Annotated[tuple[Annotated[str, OneOf(FAMILIES)], ...], MinLen(1)] = FAMILIES
    kinds: Annotated[tuple[Annotated[str, OneOf(ALL_KINDS)], ...], MinLen(1)] = KINDS
    pings: Count = 2000
    seed: Seed = 0
    workers: Workers = 1
    hard: bool = True
    page: OutputFile | None = None
    only_table: bool = False


def main(args: Args) -> None:
    """Run the trials and write the table."""
    version = commit()
    tasks = trials(args.families, args.kinds, args.n, args.seed, args.pings)
    tasks += hard_cases(args.seed, args.pings) if args.hard else []
    records = read(args.out) if args.only_table else run(tasks, args.out, args.workers)
    left_out = json.loads(WEIGHTS.read_text())["card"].get("families left out", LEFT_OUT)
    content = judged(records, left_out)
    text = markdown(content, heading(records, version), left_out)
    page = args.page or args.out / "table.md"
    page.parent.mkdir(parents=True, exist_ok=True)
    page.write_text(text, encoding="utf-8")
    (args.out / "table.json").write_text(json.dumps(as_json(content), indent=1), encoding="utf-8")
    print(text)
    print(f"written: {page} and {args.out / 'table.json'}")


def heading(records: Sequence[Record], version: str) -> str:
    """Return where the figures come from: command line, commits, trials, and a warning where the fit saw them."""
    commits = Counter(record["commit"] for record in records)
    kinds = Counter(record["kind"] for record in records if record["family"] in FAMILIES)
    card = json.loads(WEIGHTS.read_text())["card"]
    seen = [r for r in records if r["seed"] in card.get("seeds", ()) and r["family"] in card.get("families used", ())]
    lines = [
        f"Made by `sonar-gym {shlex.join(sys.argv[1:])}` at commit {version}; diagnosed at commit "
        f"{', '.join(f'{name} ({count:,})' for name, count in commits.items())}.",
        f"Trials: {', '.join(f'{name} {count:,}' for name, count in kinds.items())}.",
    ]
    if seen:
        lines.append(f"**{len(seen):,} of these trials were used to fit the decision model.**")
    return "\n".join(lines)
