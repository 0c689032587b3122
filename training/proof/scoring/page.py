"""The published page: what fails first, the targets, then accuracy, confusion, baselines, and how it was run."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from training.proof.scoring.methods import baselines
from training.proof.scoring.score import Line, Scored, by_separation, confusion, judged, table, trials_of
from training.proof.scoring.settled import lines as lines_of_next

FAMILY = "family"
PICTURE = "proof.png"


def page(lines: Sequence[dict[str, Any]]) -> str:
    """Return the page of a ledger as Markdown."""
    trials = trials_of(lines)
    settings = lines[0]["settings"]
    rig = [t for t in trials if t.kind != FAMILY]
    own = [t for t in trials if t.kind == FAMILY]
    targets = [*table(rig), *judged(lines_of_next(rig))]
    parts = [_head(settings, trials), _short(targets)]
    parts += ["## Targets, on the waveform rig", _targets(targets)]
    parts += ["## Accuracy against separation", f"![Accuracy against separation]({PICTURE})", _separation(rig)]
    parts += ["## Beside others", _baselines(rig)]
    parts += ["## What was said of what", _confusion(rig)]
    if own:
        parts += ["## On the diagnosis's own family of laws", _targets(_of_family(own))]
    left = [t for t in rig if "left_out" in t.scores]
    if left:
        parts += ["## With the true effect taken out of the catalogue", _left_out(left)]
    return "\n\n".join(parts) + "\n"


def _head(settings: dict[str, Any], trials: Sequence[Scored]) -> str:
    counted = {kind: sum(t.kind == kind for t in trials) for kind in dict.fromkeys(t.kind for t in trials)}
    words = ", ".join(f"{n} {kind}" for kind, n in sorted(counted.items()))
    hours = sum(t.seconds for t in trials) / 3600.0
    return (
        "# The proof\n\n"
        f"{len(trials)} blind trials ({words}) at commit `{settings['commit']}`, protocol {settings['protocol']}, "
        f"seed {settings['seed']}, nonce `{settings['nonce']}`; {hours:.1f} hours of diagnosing on one core. "
        "Each answer was sealed by its salted hash before the diagnosis saw the recordings, and opened after its "
        "verdict was written down; the ledger beside this page holds every trial."
    )


def _short(lines: Sequence[Line]) -> str:
    missed = [line for line in lines if line.met is False]
    if not missed:
        return "Every target that could be measured is met."
    told = "\n".join(f"- {line.metric}: {_number(line)} (target {line.target})" for line in missed)
    return f"## What falls short\n\n{told}"


def _number(line: Line) -> str:
    percent = "%" in line.target
    scale, digits = (100.0, 0) if percent else (1.0, 2)
    if not np.isfinite(line.value):
        return "–"
    text = f"{scale * line.value:.{digits}f}{' %' if percent else ''}"
    if np.isfinite(line.low):
        text += f" ({scale * line.low:.{digits}f} to {scale * line.high:.{digits}f})"
    return text


def _targets(lines: Sequence[Line]) -> str:
    rows = ["| metric | target | measured (95 % limits) | trials | met |", "|---|---|---|---|---|"]
    for line in lines:
        met = {True: "yes", False: "no", None: "too few trials"}[line.met]
        rows.append(f"| {line.metric} | {line.target} | {_number(line)} | {line.trials} | {met} |")
    return "\n".join(rows)


def _of_family(trials: Sequence[Scored]) -> list[Line]:
    return [line for line in table(trials) if line.trials and not line.metric.startswith("seconds")]


def _separation(trials: Sequence[Scored]) -> str:
    rows = ["| nats of the oracle | trials | answered | right | right, of those answered |", "|---|---|---|---|---|"]
    for band in by_separation(trials):
        last = f"{100 * band.good:.0f} %" if np.isfinite(band.good) else "–"
        rows.append(
            f"| {band.words} | {band.trials} | {100 * band.answered:.0f} % | {100 * band.right:.0f} % | {last} |"
        )
    return "\n".join(rows)


def _baselines(trials: Sequence[Scored]) -> str:
    head = "| method | alarms on null | noticed, ≥ 15 nats | rightly named | median gap closed |"
    return "\n".join([head, "|---|---|---|---|---|", *(f"| {' | '.join(row)} |" for row in baselines(trials))])


def _confusion(trials: Sequence[Scored]) -> str:
    rows = ["| concealed | said |", "|---|---|"]
    for truth, told in sorted(confusion(trials).items()):
        rows.append(
            f"| {truth} | {', '.join(f'{n} {what}' for what, n in sorted(told.items(), key=lambda i: -i[1]))} |"
        )
    return "\n".join(rows)


def _left_out(trials: Sequence[Scored]) -> str:
    rows = ["| concealed, and left out | nats | said without it | said with it |", "|---|---|---|---|"]
    for t in sorted(trials, key=lambda t: t.answer["causes"][0]["name"]):
        verdict = t.scores["left_out"]
        names = " ".join(e["effect"] for e in verdict["effects"]) if verdict["verdict"] != "unknown" else ""
        told = f"{verdict['verdict']} {names}".strip()
        within = f"{t.said} {' '.join(e['effect'] for e in t.verdict['effects'])}" if t.claimed else t.said
        rows.append(f"| {t.answer['causes'][0]['name']} | {t.nats:.0f} | {told} | {within} |")
    return "\n".join(rows)
