"""Diagnoses of real recordings with a hidden column or fact, compared with what was hidden.

The recordings are not part of the project; each lies in a folder of its own.
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
from training.common.tables import markdown_table
from training.proof.real import CASES, Case

HEADER = ("recording", "hidden", "verdict", "right", "CRPS on the test set, mm")


@dataclass(frozen=True)
class Args:
    """Settings of `sonar-gym prove-real`."""

    recordings: Path
    """Folder of the real recordings."""
    out: Path
    """Output folder: the page real.md, and the results real.json; recordings with a result are skipped."""
    seed: int = 0
    """Seed of the diagnosis."""


def main(args: Args) -> None:
    """Diagnose the available recordings and write the page."""
    here = [case for case in CASES if (args.recordings / case.name).is_dir()]
    if not here:
        names = ", ".join(case.name for case in CASES)
        raise SettingError(f"{args.recordings}: contains none of the recordings {names}")
    done: dict[str, Any] = _read(args.out / "real.json")
    with bar("recordings", len(here)) as update:
        for count, case in enumerate(here, start=1):
            if case.name not in done:
                done[case.name] = diagnosed(case, args.recordings / case.name, args.seed)
                write_text(args.out / "real.json", json.dumps(done, indent=1) + "\n")
            update(count, len(here))
    write_text(args.out / "real.md", page([case for case in here if case.name in done], done))
    print(f"{len(here)} recordings in {args.out / 'real.md'}")


def diagnosed(case: Case, folder: Path, seed: int) -> dict[str, Any]:
    """Return verdict and score of one recording."""
    hidden = case.made(folder)
    found = diagnose(IdealModel(), hidden.recorded, simulated=hidden.simulated, seed=seed)
    return {"commit": commit(), "verdict": found.to_verdict(), "score": hidden.score or {}}


def page(cases: Sequence[Case], done: dict[str, Any]) -> str:
    """Return the page as Markdown."""
    table = markdown_table(HEADER, [_row(case, done[case.name]["verdict"]) for case in cases])
    notes = [f"- {case.name}: {_scores(done[case.name]['score'])}" for case in cases if done[case.name]["score"]]
    unexplained = {case.name: done[case.name]["verdict"]["unknown"]["description"] for case in cases}
    rest = [f"- {name}: {description}" for name, description in unexplained.items() if description]
    parts = [table]
    parts += ["Comparison with what was hidden:", "\n".join(notes)] if notes else []
    parts += ["Unexplained structure, as described by the diagnosis:", "\n".join(rest)] if rest else []
    return "\n\n".join(parts) + "\n"


def _row(case: Case, verdict: dict[str, Any]) -> list[str]:
    before, after = (verdict["held_out"][key]["crps_mm"] for key in ("before", "after"))
    return [case.name, case.hidden, _in_words(verdict), _fits(case, verdict), f"{before:.1f} → {after:.1f}"]


def _in_words(verdict: dict[str, Any]) -> str:
    each = [" or ".join([e["effect"], *e["indistinguishable_from"]]) for e in verdict["effects"]]
    return f"{verdict['verdict']}: {'; '.join(each)}" if each else str(verdict["verdict"])


def _fits(case: Case, verdict: dict[str, Any]) -> str:
    """Return whether a verdict names the expected causes."""
    groups = [{e["effect"], *e["indistinguishable_from"]} for e in verdict["effects"]]
    right = [bool(group & set(case.expected)) for group in groups]
    if verdict["verdict"] in ("none", "unknown") or not any(right):
        return "no"
    others = [e["effect"] for e, fits in zip(verdict["effects"], right, strict=True) if not fits]
    return f"in part: also {', '.join(others)}" if others else "yes"


def _scores(score: dict[str, float]) -> str:
    return "; ".join(f"{name} {value:.2f}" for name, value in score.items())


def _read(path: Path) -> dict[str, Any]:
    return dict(json.loads(path.read_text())) if path.exists() else {}
