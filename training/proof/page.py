"""The page of a proof: one table with misses first, three figures, baselines; everything follows from the ledger."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import binomtest

from acquisition.io.files import write_bytes, write_text
from noise.effects import CATALOGUE
from noise.metrics import reliability
from training.common.canvas import AFTER, BEFORE, SOFT, Axes, panels
from training.common.tables import markdown_table
from training.diagnosis.generators.ensemble import FAMILIES, SAME, SINGLE
from training.diagnosis.judging.page import is_right
from training.diagnosis.judging.record import Record
from training.diagnosis.judging.rows import NAMED, Row, at_least, at_most, rows, share
from training.diagnosis.judging.scoring import (
    PARTS,
    STRONG_SIZE,
    covered,
    gap_closed,
    leads,
    misled,
    separation,
    stated,
    statements,
)
from training.diagnosis.judging.tasks import HARD_CASE
from training.proof.baselines import LEVEL
from training.proof.chain import Line, ProofError
from training.proof.deck import SCHEMA
from training.proof.ledger import answers_of, left_out_records, lost_of, records_of
from training.proof.real import EVENT as REAL
from training.proof.secret import has_secret

PAGE, FAMILIES_PAGE, PICTURE = "proof.md", "proof-families.md", "proof.png"
FIRST_DESIGN = "first-design.jsonl"  # beside the ledger, by `python -m benchmarks.first_design`
SILENT = ("none", "too_little_data")
EDGES = (0.0, 2.0, 5.0, 15.0, 50.0, 150.0, np.inf)  # of bins of separation, nats
UNFITTED, ALL = "families never fitted", "all families"
Table = dict[str, list[dict[str, Any]]]
BASELINES: tuple[tuple[str, Callable[[Record], bool] | None, Callable[[Record], bool] | None, str | None], ...] = (
    ("this package", lambda r: r["verdict"]["verdict"] not in SILENT, leads, "corrected"),
    ("oracle", None, lambda r: True, "again"),
    ("classifier two-sample test", lambda r: r["baselines"]["classifier_p"] <= LEVEL, None, None),
    ("kernel two-sample test (MMD)", lambda r: r["baselines"]["mmd_p"] <= LEVEL, None, None),
    (
        "likelihood ratios of independent pings",
        lambda r: bool(r["baselines"]["independent"]),
        lambda r: r["baselines"]["independent"] in r["causes"][0]["accepted"],
        None,
    ),
    ("Gaussian-process discrepancy", None, None, "process"),
    ("four-part beam model, EM", None, None, "beam"),
)


def table_of(lines: Sequence[Line], answers: dict[int, dict[str, Any]]) -> Table:
    """Return the rows of all scopes as plain numbers with six digits, which every machine reproduces."""
    return {name: [_plain(row) for row in found] for name, found in scopes(lines, answers).items()}


def scopes(lines: Sequence[Line], answers: dict[int, dict[str, Any]]) -> dict[str, list[Row]]:
    """Return the rows of families that the decision model was never fitted to, of all, and of each."""
    records = records_of(lines, answers)
    ensemble = [record for record in records if record["family"] != HARD_CASE]
    parts = {UNFITTED: [r for r in ensemble if r["family"] in lines[0]["unfitted"]], ALL: ensemble}
    parts |= {family: [r for r in ensemble if r["family"] == family] for family in FAMILIES}
    found = {name: rows(some) for name, some in parts.items() if some}
    found.setdefault(ALL, []).extend(_special(lines, answers, records))
    return found


def _special(lines: Sequence[Line], answers: dict[int, dict[str, Any]], records: list[Record]) -> Iterator[Row]:
    matched = [record for record in records if record["family"] == HARD_CASE]
    yield share("matched marginals: true cause most probable, no second", at_least(0.9), map(is_right, matched))
    blind = (record["error"] is None and not misled(record) for record in left_out_records(lines, answers))
    yield share("true effect not in the catalogue: no wrong cause believed", at_least(0.95), blind)
    lost = lost_of(lines)
    yield share("trial lost by an interruption", at_most(0.0), (t in lost for t in range(lines[0]["trials"])))


def _plain(row: Row) -> dict[str, Any]:
    numbers = {name: getattr(row, name) for name in ("value", "low", "high")}
    plain = {name: float(f"{value:.6g}") if np.isfinite(value) else None for name, value in numbers.items()}
    return {"metric": row.metric, "target": row.aim, "n": row.n, "without": row.without, "hit": row.hit, **plain}


def publish(lines: Sequence[Line], pages: Path, out: Path) -> str:
    """Write the page with its figure, and the table of each family; return how many targets are met.

    Args:
        lines: of the ledger.
        pages: folder of the page.
        out: folder of the table of each family, and of the first design's verdicts if they are recorded.
    """
    answers = answers_of(lines)
    write_bytes(pages / PICTURE, picture(lines))
    found = scopes(lines, answers)
    write_text(pages / PAGE, page(lines, records_of(lines, answers), found, verdicts_before(out / FIRST_DESIGN, lines)))
    write_text(out / FAMILIES_PAGE, f"# Targets of each family of generators\n\n{family_table(found)}\n")
    hits = Counter(row.hit for row in found[ALL])
    return f"targets met over all families: {hits[True]} of {hits[True] + hits[False]}; page: {pages / PAGE}"


def picture(lines: Sequence[Line]) -> bytes:
    """Return accuracy, calibration and coverage of the trials as PNG."""
    records = [record for record in records_of(lines, answers_of(lines)) if record["error"] is None]
    drawn = [lambda axes, f=f: f(axes, records) for f in (draw_accuracy, draw_calibration, draw_coverage)]
    return panels(drawn, (13.5, 4.0))


def verdicts_before(path: Path, lines: Sequence[Line]) -> dict[int, Record]:
    """Return the first design's verdicts by trial in the present form; empty where they are not recorded.

    Raises:
        ProofError: they are of another deck.
    """
    text = path.read_text(encoding="utf-8") if path.is_file() else ""
    head, *each = [json.loads(line) for line in text.splitlines()] or [{"deck": lines[0]["hash"]}]
    if head["deck"] != lines[0]["hash"]:
        raise ProofError(f"{path}: is of deck {head['deck']}, not of {lines[0]['hash']}; move it away")
    found = {line["trial"]: line["verdict"] for line in each if line["error"] is None}
    return {
        trial: {"verdict": said["verdict"], "causes": [{**effect, "alternatives": []} for effect in said["effects"]]}
        for trial, said in found.items()
    }


def page(
    lines: Sequence[Line], records: Sequence[Record], found: dict[str, list[Row]], before: Mapping[int, Record]
) -> str:
    """Return the page as Markdown; `before` has the first design's verdicts by trial."""
    deck, lost = lines[0], lost_of(lines)
    failed = failures(records)
    records = [record for record in records if record["error"] is None]
    kinds = Counter(record["kind"] for record in records)
    hits = Counter(row.hit for row in found[ALL])
    real = [line for line in lines if line["event"] == REAL]
    return TEXT.format(
        trials=deck["trials"],
        kinds=", ".join(f"{n} {kind}" for kind, n in sorted(kinds.items())),
        lost=len(lost),
        commit=deck["commit"],
        failed=f" {failed}" if failed else "",
        met=hits[True],
        of=hits[True] + hits[False],
        rules="" if deck["schema"] >= SCHEMA else LATER_RULES,
        table=target_table(found),
        parts=", ".join(f"`{name}`" for name in PARTS.values()),
        baselines=baseline_table(records, before),
        real=real_table(real) if real else "None were at hand.",
        deck=deck["hash"],
        drawn=SECRET if has_secret(deck) else DRAWN,
        again="" if has_secret(deck) else " or run again",
        last=lines[-1]["hash"],
        picture=PICTURE,
    )


def failures(records: Sequence[Record]) -> str:
    """Return how many trials ended in an error, which, and in what error, as a sentence; empty if none did."""
    trials: dict[str, list[str]] = {}
    for record in records:
        if record["error"]:
            trials.setdefault(record["error"].splitlines()[0], []).append(str(record["trial"]))
    each = "; ".join(f"{', '.join(numbers)}: {error}" for error, numbers in trials.items())
    n = sum(map(len, trials.values()))
    return f"{n} {'trial' if n == 1 else 'trials'} ended in an error ({each})." if n else ""


def target_table(found: dict[str, list[Row]]) -> str:
    """Return the table of targets, misses first; families that were never fitted stand before all families."""
    never = {row.metric: row for row in found.get(UNFITTED, [])}
    both = [(never.get(row.metric, replace(row, n=0, value=np.nan)), row) for row in found[ALL]]
    both.sort(key=lambda pair: (pair[0].hit is not False and pair[1].hit is not False, pair[1].hit is None))
    header = ("metric", "target", UNFITTED, ALL, "95 % interval, all")
    return markdown_table(header, [(b.metric, b.aim, _cell(a), _cell(b), _interval(b)) for a, b in both if b.n])


def _cell(row: Row) -> str:
    text = f"{row.number(row.value)} ({row.count})" if row.n else "–"
    return f"**{text}**" if row.hit is False else text


def _interval(row: Row) -> str:
    return f"{row.number(row.low)} to {row.number(row.high)}" if np.isfinite(row.low) else "–"


def family_table(found: dict[str, list[Row]]) -> str:
    """Return the rows of each family."""
    families = [name for name in FAMILIES if name in found]
    columns = {name: {row.metric: row for row in found[name]} for name in families}
    shown = [row.metric for row in found[ALL] if families and row.metric in columns[families[0]]]
    return markdown_table(("metric", *families), [(m, *(_cell(columns[f][m]) for f in families)) for m in shown])


def compared(records: Sequence[Record]) -> tuple[list[Record], list[Record]]:
    """Return the trials that baselines are compared on: nulls, and single causes of half the plain size."""
    single = (r for r in records if r["kind"] == SINGLE)
    return [r for r in records if r["kind"] == SAME], [r for r in single if r["causes"][0]["size"] >= STRONG_SIZE]


def baseline_table(records: Sequence[Record], before: Mapping[int, Record]) -> str:
    """Return what this package, its first design and the baselines reach on the same trials."""
    null, known = compared(records)
    chance = [len(set(r["causes"][0]["accepted"]) & CATALOGUE.keys()) / len(CATALOGUE) for r in known]
    table: list[tuple[str, ...]] = [("chance", "–", "–", _percent(chance), "0.00")]
    for name, alarm, right, model in BASELINES:
        gaps = [gap for r in known if model and r["scores"] and (gap := gap_closed(r, model)) is not None]
        said = (_percent([alarm(r) for r in group]) if alarm else "–" for group in (null, known))
        named = _percent([right(r) for r in known]) if right else "–"
        table.append((name, *said, named, f"{np.median(gaps):.2f}" if gaps else "–"))
    if before:
        earlier = [
            [{**r, "verdict": before[r["trial"]]} for r in group if r["trial"] in before] for group in (null, known)
        ]
        alarms = (_percent([r["verdict"]["verdict"] not in SILENT for r in group]) for group in earlier)
        table.insert(2, ("its first design, commit 802bd60", *alarms, _percent(list(map(leads, earlier[1]))), "–"))
    return markdown_table(("method", "alarms, nulls", "alarms, causes", "cause right", "median gap closed"), table)


def _percent(values: Sequence[float]) -> str:
    return f"{100 * np.mean(values):.0f} % ({len(values)})" if len(values) else "–"


def real_table(real: Sequence[Line]) -> str:
    """Return the verdicts on real recordings."""
    table = []
    for line in real:
        named = stated(line) if line["verdict"] else []
        best = max(named, key=lambda pair: pair[1])[0] if named else "–"
        verdict = line["verdict"]["verdict"] if line["verdict"] else line["error"]
        right = verdict in NAMED and best in line["accepted"]
        table.append((line["name"], line["hidden"], verdict, best, "yes" if right else "**no**"))
    return markdown_table(("recording", "hidden", "verdict", "most probable", "right"), table)


def draw_accuracy(axes: Axes, records: Sequence[Record]) -> None:
    """Draw how many single causes are answered, and answered rightly, against the separation of the files."""
    single = [r for r in records if r["kind"] == SINGLE]
    curves = ((leads, "true cause leads", AFTER, -0.1), (lambda r: bool(stated(r)), "answered", SOFT, 0.1))
    for says, label, colour, shift in curves:
        for k, (low, high) in enumerate(pairwise(EDGES)):
            _point(axes, k + shift, [says(r) for r in single if low <= separation(r) < high], colour)
        axes.plot([], [], "o", color=colour, label=label)
    names = [f"{low:g}–{high:g}" if np.isfinite(high) else f"≥ {low:g}" for low, high in pairwise(EDGES)]
    axes.set_xticks(range(len(names)), names)
    axes.set(
        xlim=(-0.5, len(names) - 0.5),
        ylim=(-0.02, 1.02),
        xlabel="separation of fresh readings (nats)",
        title="Single causes",
    )
    axes.legend()


def draw_calibration(axes: Axes, records: Sequence[Record]) -> None:
    """Draw how often statements are true against their stated probability."""
    pairs = [(*pair, k) for k, record in enumerate(records) for pair in statements(record)]
    axes.plot([0, 1], [0, 1], color=SOFT, lw=1)
    if pairs:
        stated_p, true, group = (np.array(column) for column in zip(*pairs, strict=True))
        found = reliability(stated_p, true.astype(bool), group)
        filled = found.pings > 0
        axes.plot(found.predicted[filled], found.observed[filled], "o-", color=AFTER)
    axes.set(xlabel="stated probability", ylabel="share true", title="Calibration of causes")


def draw_coverage(axes: Axes, records: Sequence[Record]) -> None:
    """Draw, for each family, how often 90 % intervals hold the truth, and the share that true causes are given."""
    for k, family in enumerate(FAMILIES):
        some = [r for r in records if r["family"] == family]
        _point(axes, k - 0.1, [hit for r in some for hit in covered(r)], AFTER)
        true = [(r, {a for cause in r["causes"] for a in cause["accepted"]}) for r in some if r["kind"] == SINGLE]
        shares = [c["share"] or 0.0 for r, ids in true for c in r["verdict"]["causes"] if c["effect"] in ids]
        axes.plot(np.full(len(shares), k + 0.15), np.clip(shares, 0, 1), "_", color=BEFORE, alpha=0.6)
    axes.axhline(0.9, color=SOFT, lw=1)
    for marker, label, colour in (("o", "intervals hold the truth", AFTER), ("_", "shares of true causes", BEFORE)):
        axes.plot([], [], marker, color=colour, label=label)
    axes.set_xticks(range(len(FAMILIES)), FAMILIES, rotation=30)
    axes.set(xlim=(-0.5, len(FAMILIES) - 0.5), ylim=(-0.02, 1.02), title="Coverage and shares")
    axes.legend()


def _point(axes: Axes, x: float, outcomes: Sequence[bool], colour: str) -> None:
    """Draw a share with its Wilson interval."""
    if outcomes:
        interval = binomtest(int(sum(outcomes)), len(outcomes)).proportion_ci(method="wilson")
        axes.plot([x, x], [interval.low, interval.high], color=colour, lw=1)
        axes.plot([x], [np.mean(outcomes)], "o", color=colour)


DRAWN = "Family, kind, seed and key come from the operating system's generator"
LATER_RULES = " Rules of counting were corrected after this deck was closed (CHANGELOG)."
SECRET = """Family, kind, seed and key follow from a secret of the operating system's generator. Its hash stands in the
   deck; the closing line discloses it"""
TEXT = """# The diagnosis on concealed effects

{trials} blind trials ({kinds}; {lost} lost by interruptions) at commit {commit}.
**{met} of {of} targets are met over all families of generators.**{rules}{failed}

## What was asked

A generator writes a recording of a simulated and one of a real sonar, which differ by nothing, by one or two effects of
the catalogue, by a fault that a grammar composed at random, or by the simulator. Sizes are log-uniform between an
eighth and three times a plain effect.

## How it was sealed

1. {drawn}. The answer is encrypted (ChaCha20-Poly1305); ciphertext, hash of the key and hashes of all recordings are
   written to the ledger.
2. A new process gets two CSV files in an empty folder, a cleaned environment, and nothing else.
3. Its verdict is written to the ledger, then the key is.
4. The corrected model, whose hash stands beside the verdict, is scored on recordings under fresh conditions.

Each line holds the hash of the line before; that of the deck is published before the run.

## Result

Misses are bold and first; a/b: only a of b trials have a gap to close. Families never fitted are those that the
decision model's fit left out. Beside the ledger, `proof-families.md` has each. Part of an unmodelled hold, loss or step
is {parts}: such a name is not wrong.

{table}

![Accuracy, calibration, coverage]({picture})

## Baselines

Nulls, and single causes of at least half the plain size. The oracle is a second recording of the real sonar. The
two-sample tests also see conditions, which differ between the files of a null.

{baselines}

## Real recordings with one fact hidden

{real}

## Verify

<!-- parsed -->
```sh
sonar-gym verify-proof benchmarks/records/proof/ledger.jsonl.xz    # --rediagnose N also repeats N verdicts
sonar-gym prove --out proof --workers 2                            # a deck of your own; stop at any time
```

`verify-proof` recomputes hashes, seals and the table, regenerates all recordings from the disclosed seeds bit by bit,
and says what nobody can check afterwards. Verdicts repeat at the commit of the deck. An interruption loses the trials
at work: they are counted as lost and never run again.

Deck `{deck}`, closing line `{last}`.

## What it does not show

- Simulated trials show internal validity only: that effects are found as these generators make them.
- Sealing keeps the answer from the diagnosis. It cannot show that no deck was run and thrown away{again}, nor that
  its developers did not learn from earlier trials of the same generators.
"""
