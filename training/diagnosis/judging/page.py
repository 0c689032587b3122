"""The page of targets: misses first, then all rows by family, and the hard cases; as Markdown and as JSON."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from noise.discrepancy.thresholds import LISTED
from training.common.tables import markdown_table
from training.diagnosis.judging.record import Record
from training.diagnosis.judging.rows import Records, Row, rows
from training.diagnosis.judging.scoring import PARTS, STRONG_NATS, STRONG_P, STRONG_SIZE, leads, stated
from training.diagnosis.judging.tasks import HARD_CASE, REAL, TIMED

SECONDS = {2_000: 5.0, 10_000: 15.0, 133_100: 40.0}  # pings -> target of the design, s
NOTES = f"""A strong trial has causes of size ≥ {STRONG_SIZE} (1 is plain to see) and a test with p < {STRONG_P}.
"{STRONG_NATS:g} nats apart" does not use the test: by so many a second simulation describes a fresh recording worse
than a second recording. In brackets: the number of values (a/b: only a of b trials have a gap), and the 95 % interval
(Wilson; bootstrap for medians and percentiles). A gap is the difference in CRPS, with silence counted, between the
simulation's own readings and a second recording in the same visits, where it exceeds two standard errors; on unseen
visits a forest of the recording stands for the second, with the error of a fresh recording. Within 10 %: readings are
clipped to this error. "Corrected readings" are the simulation's own with what differs applied (`Diagnosis.correct`).
Part of an unmodelled hold, loss or step is
{", ".join(f"`{name}`" for name in PARTS.values())}: such a name is not wrong. Times: beside other work.
Not measured: the width of intervals relative to an oracle, and whether the next measurement settles. Causes below
{100 * LISTED:g} % are not listed. Sealed trials: [the proof](proof.md)."""


@dataclass(frozen=True)
class Judged:
    """Content of the page.

    Attributes:
        scopes: name of a set of trials -> its rows; "all", "left out of the fit", then each family.
        special: hard cases, real recordings, and timed trials.
    """

    scopes: dict[str, list[Row]]
    special: list[Record]


def judged(records: Records, left_out: Sequence[str]) -> Judged:
    """Return the rows of all scopes.

    Args:
        records: of trials and of hard cases.
        left_out: families that the decision model never saw.
    """
    special = [record for record in records if record["family"] in (HARD_CASE, REAL, TIMED)]
    plain = [record for record in records if record["family"] not in (HARD_CASE, REAL, TIMED)]
    families = list(dict.fromkeys(record["family"] for record in plain))
    scopes = {"all families": plain, "left out of the fit": [r for r in plain if r["family"] in left_out]}
    scopes |= {family: [r for r in plain if r["family"] == family] for family in families}
    return Judged({name: rows(some) for name, some in scopes.items() if some}, special)


def markdown(content: Judged, heading: str, left_out: Sequence[str]) -> str:
    """Return the page; `heading` holds commit, command line and counts."""
    parts = ["# The diagnosis, measured\n", heading]
    if content.scopes:
        parts += ["", NOTES, "", "## Misses", "", _misses(dict(list(content.scopes.items())[:2]))]
        parts += ["", "## Targets", "", _left_out(left_out), ""]
        parts.append(_by_scope(content))
    parts += ["", "## Hard cases", "", _special_table(content.special)]
    parts += ["", "## Halves of real recordings", "", _real_table(content.special)]
    return "\n".join(parts) + "\n"


def _left_out(families: Sequence[str]) -> str:
    return f"Left out of the fit: {', '.join(families)}."


def as_json(content: Judged) -> dict[str, Any]:
    """Return the rows as plain data, with "hit" true, false or null."""
    return {name: [{**asdict(row), "hit": row.hit} for row in found] for name, found in content.scopes.items()}


def _misses(scopes: dict[str, list[Row]]) -> str:
    """Return a row for each target that any of the scopes misses."""
    every = list(zip(*scopes.values(), strict=True))
    lines = [(same[0].metric, same[0].aim, *map(_cell, same)) for same in every if any(r.hit is False for r in same)]
    return markdown_table(("metric", "target", *scopes), lines)


def _cell(row: Row, interval: bool = True) -> str:
    """Return value, number of values, and the interval if it is wanted; bold where the target is missed."""
    span = f"; {row.number(row.low)} – {row.number(row.high)}" if interval and row.low == row.low else ""
    text = f"{row.number(row.value)} ({row.count}{span})" if row.n else "–"
    return f"**{text}**" if row.hit is False else text


def _by_scope(content: Judged) -> str:
    scopes = content.scopes
    first = scopes.get("all families", [])
    lines = [
        (row.metric, row.aim, *(_cell(found[k], interval=False) for found in scopes.values()))
        for k, row in enumerate(first)
        if row.n
    ]
    return markdown_table(("metric", "target", *scopes), lines)


def is_right(record: Record) -> bool:
    """Return whether a hard case is answered: none without a cause, else the leading cause right and no second."""
    if record["error"] is not None:
        return False
    if record["family"] == TIMED:
        return bool(record["seconds"] <= SECONDS[record["pings"]])
    if record["fault"]:
        return record["verdict"]["verdict"] != "none"
    if not record["causes"]:
        return record["verdict"]["verdict"] in ("none", "too_little_data")
    return leads(record) and len(record["verdict"]["causes"]) == len(record["causes"])


def _special_table(records: Iterable[Record]) -> str:
    header = ("case", "pings", "expected", "verdict", "named, with probability", "seconds", "right")
    records = sorted(records, key=is_right)
    counts = Counter((record["family"], is_right(record)) for record in records)
    families = dict.fromkeys(name for name, _ in counts)
    totals = [f"{name}: {counts[name, True]} right, {counts[name, False]} wrong" for name in families]
    lines = [_line(record) for record in records if record["family"] != REAL and not is_right(record)]
    return "; ".join(totals) + ("\n\n" + markdown_table(header, lines) if lines else "")


def _real_table(records: Iterable[Record]) -> str:
    """Return a row for each recording and a column for each change that was planted on one of its halves."""
    split = {tuple(r["kind"].rsplit(": ", 1)): r for r in records if r["family"] == REAL}
    changes = list(dict.fromkeys(change for _, change in split))
    rows = [
        (name, *(_answer(split[name, change]) if (name, change) in split else "not run" for change in changes))
        for name in dict.fromkeys(name for name, _ in split)
    ]
    return markdown_table(("recording", *changes), rows) if rows else "None was there."


def _answer(record: Record) -> str:
    """Return "right", or what is wrong: the verdict, and the causes with their probabilities."""
    if is_right(record):
        return "right"
    if record["error"] is not None:
        return "**error**"
    return f"**{record['verdict']['verdict']}** {_named(record)}".strip()


def _named(record: Record) -> str:
    """Return the causes with their probabilities, those that a reader need not weigh left out."""
    return ", ".join(f"{name} {p:.2f}" for name, p in stated(record) if p >= LISTED)


def _line(record: Record) -> tuple[str, ...]:
    truth = ", ".join(cause["effect"] for cause in record["causes"]) or record["fault"] or "none"
    case = f"{record['family']}: {record['kind']}"
    if record["error"] is not None:
        return case, f"{record['n']:,}", truth, f"error: {record['error']}"[:80], "–", "–", "**no**"
    named = _named(record) or "–"
    verdict, right = record["verdict"]["verdict"], "yes" if is_right(record) else "**no**"
    return case, f"{record['n']:,}", truth, verdict, named, f"{record['seconds']:.0f}", right
