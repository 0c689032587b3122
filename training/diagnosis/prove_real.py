"""Diagnose real recordings with a column or fact of theirs hidden, and hold the verdicts against it.

The recordings are not part of the project: give the folder that holds them, each in a folder of its own.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from acquisition import SettingError
from acquisition.io.files import write_text
from noise import IdealModel
from noise.discrepancy import diagnose
from training.common.commit import commit
from training.common.progress import bar
from training.proof.real import CASES, Case


@dataclass(frozen=True)
class Args:
    """Settings of `sonar-gym prove-real`."""

    recordings: Path
    """Folder of the real recordings."""
    out: Path
    """Folder of the page, real.md, and of what it was made of, real.json; what is there already is not done again."""
    seed: int = 0
    """Of the diagnosis."""


def main(args: Args) -> None:
    """Diagnose what is there, and publish."""
    here = [case for case in CASES if (args.recordings / case.name).is_dir()]
    if not here:
        names = ", ".join(case.name for case in CASES)
        raise SettingError(f"{args.recordings}: holds none of {names}")
    done: dict[str, Any] = _read(args.out / "real.json")
    with bar("recordings", len(here)) as tell:
        for count, case in enumerate(here, start=1):
            if case.name not in done:
                done[case.name] = diagnosed(case, args.recordings / case.name, args.seed)
                write_text(args.out / "real.json", json.dumps(done, indent=1) + "\n")
            tell(count, len(here))
    write_text(args.out / "real.md", page([case for case in here if case.name in done], done))
    print(f"{len(here)} recordings in {args.out / 'real.md'}")


def diagnosed(case: Case, folder: Path, seed: int) -> dict[str, Any]:
    """Return the verdict on one recording, and its score."""
    hidden = case.made(folder)
    found = diagnose(IdealModel(), hidden.recorded, simulated=hidden.simulated, seed=seed)
    return {"commit": commit(), "verdict": found.to_verdict(), "score": hidden.score or {}}


def page(cases: Sequence[Case], done: dict[str, Any]) -> str:
    """Return the page as Markdown."""
    rows = ["| recording | hidden | said | an answer that fits | held-out CRPS, mm |", "|---|---|---|---|---|"]
    for case in cases:
        verdict = done[case.name]["verdict"]
        held = verdict["held_out"]
        scores = f"{held['before']['crps_mm']:.1f} → {held['after']['crps_mm']:.1f}"
        rows.append(f"| {case.name} | {case.hidden} | {_said(verdict)} | {_fits(case, verdict)} | {scores} |")
    notes = [f"- {case.name}: {_scores(done[case.name]['score'])}" for case in cases if done[case.name]["score"]]
    left = [
        f"- {case.name}: {done[case.name]['verdict']['unknown']['description']}" for case in cases if _left(done, case)
    ]
    parts = ["\n".join(rows)]
    parts += ["Held against what was hidden:", "\n".join(notes)] if notes else []
    parts += ["What was left over, as the tool described it:", "\n".join(left)] if left else []
    return "\n\n".join(parts) + "\n"


def _left(done: dict[str, Any], case: Case) -> bool:
    return bool(done[case.name]["verdict"]["unknown"]["description"])


def _said(verdict: dict[str, Any]) -> str:
    """Return a verdict in one cell."""
    each = [" or ".join([e["effect"], *e["indistinguishable_from"]]) for e in verdict["effects"]]
    return f"{verdict['verdict']}: {'; '.join(each)}" if each else str(verdict["verdict"])


def _fits(case: Case, verdict: dict[str, Any]) -> str:
    """Tell whether a verdict holds one of the answers that fit."""
    if verdict["verdict"] in ("none", "unknown"):
        return "no"
    told = {name for e in verdict["effects"] for name in (e["effect"], *e["indistinguishable_from"])}
    more = [
        e["effect"] for e in verdict["effects"] if not {e["effect"], *e["indistinguishable_from"]} & set(case.expected)
    ]
    return ("yes" if not more else f"in part: also {', '.join(more)}") if told & set(case.expected) else "no"


def _scores(score: dict[str, float]) -> str:
    return "; ".join(f"{name} {value:.2f}" for name, value in score.items())


def _read(path: Path) -> dict[str, Any]:
    return dict(json.loads(path.read_text())) if path.exists() else {}
