"""Verify the ledger of a proof: its hash chain, seals, recordings, scores, and that no planned trial is missing."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from random import SystemRandom
from typing import Annotated, Any

import tyro

from acquisition.limits import Limit, Workers
from noise.effects import CATALOGUE
from training.common.commit import ROOT
from training.common.workers import worker_processes
from training.diagnosis.judging.tasks import case_of
from training.proof.chain import Line, ProofError, load, of_event
from training.proof.deck import SCHEMA, cells_of, hashes
from training.proof.ledger import (
    CLOSED,
    DECK,
    LEFT_OUT,
    ORDER,
    RESUMED,
    SCORED,
    SEALED,
    VERDICT,
    answers_of,
    context_of,
    left_out_trials,
    lost_of,
    without_of,
)
from training.proof.page import Table, table_of
from training.proof.real import CASES
from training.proof.real import EVENT as REAL
from training.proof.run import given, hashes_of
from training.proof.sealing import SEALED as SEALS
from training.proof.sealing import unseal
from training.proof.secret import checked, has_secret, key_of, order_of, seed_of
from training.proof.work import Diagnose, answer_of, diagnosed, files_of, scored, task_of

ANNOUNCED = ROOT / "benchmarks" / "records" / "proof" / "announced.txt"
RESULT = {"verdict", "error", "seconds"}
# beginnings of rows that ledgers before `SCHEMA` counted by other rules: they cannot be compared
OTHER_RULES = ("strong ", "unmodelled: ", "stated probabilities", "unseen visits")
ENTRIES = {  # of each event, besides "event", "before" and "hash"
    SEALED: {"trial", "files", *SEALS},
    VERDICT: {"trial", "model_sha256", *RESULT},
    "disclosed": {"trial", "key"},
    SCORED: {"trial", "content"},
    LEFT_OUT: {"trial", "without", *RESULT},
    RESUMED: {"lost"},
    REAL: {"name", "hidden", "accepted", "files", *RESULT},
    CLOSED: {"disclosed", "lost", "table", "secret"},
}
Answers = dict[int, dict[str, Any]]


@dataclass(frozen=True)
class Args:
    """Settings of `sonar-gym verify-proof`."""

    ledger: Annotated[Path, tyro.conf.Positional]
    """Ledger that `sonar-gym prove` wrote, compressed by xz or not."""
    rediagnose: Annotated[int, Limit(0, 1_000_000)] = 0
    """Number of trials to diagnose again, about 20 s each; another machine may differ in last digits."""
    workers: Workers = 2
    """Number of processes."""
    announced: Path = ANNOUNCED
    """File with the hashes that the repository published."""
    unannounced: bool = False
    """Accept a ledger whose hashes were not published."""


def main(args: Args) -> None:
    """Print what holds, what does not and what cannot be checked; exit with 1 unless all holds."""
    lines = load(args.ledger)
    if not lines or lines[0]["event"] != DECK:
        raise ProofError(f"{args.ledger}: does not begin with a deck: expected a ledger that `sonar-gym prove` wrote")
    problems = problems_of(lines, args)
    for text in problems or passed(lines, args):
        print(("FAILED: " if problems else "holds: ") + text)
    print("\n".join(f"cannot be checked: {text}" for text in unchecked(lines, args)))
    if problems:
        raise SystemExit(1)


def problems_of(lines: Sequence[Line], args: Args) -> list[str]:
    """Return what is wrong with a ledger, and what to do where other code than the deck's looks at it."""
    problems = _problems(lines, args)
    if problems and lines and lines[0].get("source_sha256") != hashes()["source_sha256"]:
        problems.append(f"this code is not the deck's: check out commit {lines[0].get('commit')} and verify there")
    return problems


def _problems(lines: Sequence[Line], args: Args) -> list[str]:
    """Return what is wrong with a ledger; a check is made only where those before it hold."""
    try:
        problems = [*order_problems(lines)]
        if not problems:
            problems = [*content_problems(lines), *announcement_problems(lines, args)]
    except (LookupError, TypeError, ValueError, AttributeError) as error:
        return [f"an entry is missing or is not what it should be ({type(error).__name__}: {error})"]
    return problems or regeneration_problems(lines, args.workers, args.rediagnose)


def order_problems(lines: Sequence[Line]) -> Iterator[str]:
    """Yield what is wrong with the order of the events."""
    if not lines or lines[0]["event"] != DECK or lines[-1]["event"] != CLOSED:
        yield "the ledger does not begin with a deck and end with a closing line: it is unfinished, or was cut"
        return
    seen: dict[Any, list[str]] = {}
    missing = set() if has_secret(lines[0]) else {"secret"}
    for number, line in enumerate(lines[1:], 2):
        event = line["event"]
        if event not in ENTRIES or line.keys() - {"event", "before", "hash"} != ENTRIES[event] - missing:
            yield f"line {number}: not a line of a ledger"
            return
        if "trial" in line:
            seen.setdefault(line["trial"], []).append(event)
        elif event == CLOSED and number < len(lines):
            yield f"line {number}: a closing line before the end"
        elif event == REAL:
            seen.setdefault(line["name"], []).append(event)
    complete = ([*ORDER], [*ORDER, LEFT_OUT], [REAL])
    lost = lost_of(lines)
    for trial, events in seen.items():
        if events not in complete and not (trial in lost and events in ([SEALED], [SEALED, VERDICT])):
            yield f"trial {trial}: expected {', '.join(ORDER)}, found {', '.join(events)}"
    planned = range(lines[0]["trials"])
    if {trial for trial in seen if isinstance(trial, int)} != set(planned):
        yield f"the deck plans trials 0 to {planned[-1]}: some are missing, or others were added"


def content_problems(lines: Sequence[Line]) -> Iterator[str]:
    """Yield what is wrong with seals, numbers of trials, losses and scores."""
    try:
        answers = answers_of(lines)
    except ProofError as error:
        yield str(error)
        return
    yield from _of_plan(lines, answers)
    yield from _of_losses(lines)
    yield from _of_lines(lines)
    if lines[0]["schema"] >= SCHEMA:
        yield from _of_secret(lines)
    expected, found = left_out_trials(lines, answers), of_event(lines, LEFT_OUT)
    if sorted(found) != expected or any(tuple(found[t]["without"]) != without_of(answers[t]) for t in expected):
        yield "the trials without the true effect are not those that the deck requires"
    closing = lines[-1]
    if (closing["disclosed"], closing["lost"]) != (len(answers), lost_of(lines)):
        yield "the closing line counts other trials than the ledger holds"
    elif not follows(closing["table"], table_of(lines, answers), lines[0]["schema"]):
        yield "the table of the closing line does not follow from verdicts and answers"


def _of_lines(lines: Sequence[Line]) -> Iterator[str]:
    """Yield verdicts without scores, and real recordings of which another answer was accepted."""
    scores = of_event(lines, SCORED)
    for trial, verdict in of_event(lines, VERDICT).items():
        if trial in scores and scores[trial]["content"] is None and verdict["error"] is None:
            yield f"trial {trial}: it has a verdict and no scores"
    accepted = {case.name: list(case.accepted) for case in CASES}
    for line in lines:
        if line["event"] == REAL and line["accepted"] != accepted.get(line["name"]):
            yield f"recording {line['name']}: the accepted answers are not those of this code"


def _of_secret(lines: Sequence[Line]) -> Iterator[str]:
    """Yield trials that do not follow from the secret to which the deck is bound, lost ones included."""
    deck, sealed = lines[0], of_event(lines, SEALED)
    secret = checked(lines[-1]["secret"], deck)
    cells = order_of(secret, deck)
    for trial, seals in sealed.items():
        try:
            answer = unseal(seals, key_of(secret, trial).hex(), context_of(lines, trial))
        except ProofError:
            answer = {}
        found = answer.get("family"), answer.get("kind"), answer.get("seed")
        if found != (*cells[trial], seed_of(secret, trial)):
            yield f"trial {trial}: family, kind, seed or key does not follow from the secret of the deck"


def follows(table: Table, own: Table, schema: int) -> bool:
    """Return whether a table is that of this version, as far as the rules of the ledger's version are the same."""
    if schema >= SCHEMA:
        return table == own
    return table.keys() == own.keys() and all(_same_rows(table[scope], own[scope]) for scope in own)


def _same_rows(before: list[dict[str, Any]], now: list[dict[str, Any]]) -> bool:
    """Return whether rows agree in every number that both versions have, and no row that has values is missing."""
    known = {row["metric"]: row for row in now}
    kept = [row for row in before if not row["metric"].startswith(OTHER_RULES)]
    missing = {row["metric"] for row in now if row["n"]} - {row["metric"] for row in before}
    return not missing and all(row.items() <= known[row["metric"]].items() for row in kept)


def _of_plan(lines: Sequence[Line], answers: Answers) -> Iterator[str]:
    planned, lost = cells_of(lines[0]), lost_of(lines)
    found = Counter((answer["family"], answer["kind"]) for answer in answers.values())
    if sum(planned.values()) != lines[0]["trials"] or found - planned or (planned - found).total() != len(lost):
        yield "the families and kinds of the trials are not those of the deck"
    for trial, answer in answers.items():
        if answer["number"] != trial or answer["pings"] != lines[0]["pings"]:
            yield f"trial {trial}: the answer belongs to another trial or deck"
    if len({answer["seed"] for answer in answers.values()}) != len(answers):
        yield "two trials have the same seed"


def _of_losses(lines: Sequence[Line]) -> Iterator[str]:
    sealed, open_ = set[int](), set[int]()
    for number, line in enumerate(lines, 1):
        if line["event"] == SEALED:
            sealed.add(line["trial"])
            open_.add(line["trial"])
        elif line["event"] == "disclosed":
            open_.discard(line["trial"])
        elif line["event"] == RESUMED:
            if set(line["lost"]) != open_:
                yield f"line {number}: the lost trials are not those that were at work"
            open_ = set()


def announcement_problems(lines: Sequence[Line], args: Args) -> Iterator[str]:
    """Yield what differs from the hashes that the repository published."""
    if args.unannounced:
        return
    text = args.announced.read_text(encoding="utf-8") if args.announced.is_file() else ""
    entries = [line.split() for line in text.splitlines() if line.strip()]
    head, last = lines[0]["hash"], lines[-1]["hash"]
    if head not in (entry[1] for entry in entries if entry[0] == "deck"):
        yield f"the hash of the deck, {head}, is not in {args.announced}; --unannounced accepts a deck of your own"
        return
    closing = {entry[2] for entry in entries if entry[:2] == ["closed", head]}
    if last not in closing:
        yield f"the hash of the closing line, {last}, is not the one in {args.announced}"
    elif len(closing) > 1:
        yield f"{args.announced} has {len(closing)} closing lines of this deck: it was run more than once"


def regeneration_problems(
    lines: Sequence[Line], workers: int, rediagnose: int = 0, diagnose: Diagnose = diagnosed
) -> list[str]:
    """Return which recordings do not follow from the disclosed seeds, bit by bit, and which verdicts do not repeat."""
    answers, sealed = answers_of(lines), of_event(lines, SEALED)
    jobs = [(answers[t], sealed[t]["files"]) for t in sorted(answers)]
    verdicts, scores = of_event(lines, VERDICT), of_event(lines, SCORED)
    chosen = SystemRandom().sample(sorted(answers), min(rediagnose, len(answers)))  # which no forger can foresee
    again = [(answers[t], verdicts[t], scores[t]["content"], diagnose) for t in chosen]
    blind = of_event(lines, LEFT_OUT)
    without = [(answers[t], blind[t], diagnose) for t in chosen if t in blind]
    found = [*_mapped(regenerated, jobs, workers), *_mapped(rediagnosed, again, workers)]
    found += _mapped(rediagnosed_without, without, workers)
    return [text for text in found if text]


def _mapped(function: Callable[..., str], jobs: Sequence[tuple[Any, ...]], workers: int) -> list[str]:
    if workers == 1 or len(jobs) < 2:
        return [function(*job) for job in jobs]
    with worker_processes(min(workers, len(jobs))) as pool:
        return list(pool.map(function, *zip(*jobs, strict=True), chunksize=4))


def regenerated(answer: dict[str, Any], files: dict[str, str]) -> str:
    """Return "" where the recordings and the answer of a trial follow from its seed, else what differs."""
    case = case_of(task_of(answer))
    if hashes_of(files_of(case)) != files:
        return f"trial {answer['number']}: its recordings do not follow from its seed"
    same = as_plain(answer_of(task_of(answer), case)) == answer
    return "" if same else f"trial {answer['number']}: its answer does not follow from its seed"


def as_plain(content: Any) -> Any:
    """Return content as JSON holds it."""
    return json.loads(json.dumps(content))


def rediagnosed(answer: dict[str, Any], verdict: Line, content: Any, diagnose: Diagnose) -> str:
    """Return "" where verdict and scores of a trial repeat, else what differs."""
    result, model = diagnose(given(files_of(case_of(task_of(answer)))))
    if (result["verdict"], result["error"]) != (verdict["verdict"], verdict["error"]):
        return f"trial {answer['number']}: diagnosed again, it has another verdict"
    same = not model or as_plain(scored(answer, model)) == content
    return "" if same else f"trial {answer['number']}: diagnosed again, it has other scores"


def rediagnosed_without(answer: dict[str, Any], line: Line, diagnose: Diagnose) -> str:
    """Return "" where the verdict without the true effect repeats, else what differs."""
    result, _ = diagnose(given(files_of(case_of(task_of(answer)))), tuple(line["without"]))
    same = (result["verdict"], result["error"]) == (line["verdict"], line["error"])
    return "" if same else f"trial {answer['number']}: diagnosed again without the true effect, it has another verdict"


def passed(lines: Sequence[Line], args: Args) -> Iterator[str]:
    """Yield what was checked."""
    n, lost = lines[-1]["disclosed"], len(lost_of(lines))
    yield f"each of {len(lines):,} lines is bound to the one before"
    yield f"all {lines[0]['trials']} planned trials are there, each with one verdict; {lost} were interrupted and lost"
    yield f"{n} disclosed keys are those committed to, and open answers that no one could exchange"
    if has_secret(lines[0]):
        yield "all trials follow from the secret of the deck, which its hash fixed before they were run"
    yield f"the recordings and answers of {n} trials follow from the disclosed seeds, bit by bit"
    rules = "" if has_secret(lines[0]) else ", where rules are still the same"
    yield f"the table follows from verdicts, answers and scores{rules}; {min(args.rediagnose, n)} were diagnosed again"
    if not args.unannounced:
        yield f"deck and closing line are those in {args.announced}"


def unchecked(lines: Sequence[Line], args: Args) -> Iterator[str]:
    """Yield what no reader of a ledger can check."""
    yield "that the deck's hash was published before it was run: see the history of the file of published hashes"
    yield "that no other deck was run and thrown away unpublished, nor this one run before it was published"
    yield "that no run was interrupted because of a verdict: interruptions are counted above, but not those of copies"
    old = lines and not has_secret(lines[0])
    if old:
        yield "that the deck was run once: trials were drawn after it was published, and anew in a copy of the ledger"
    n = max(len(of_event(lines, SCORED)) - args.rediagnose, 0)
    yield f"verdicts, evidence and scores on fresh recordings of {n} trials: give --rediagnose to repeat them"
    yield "seconds, hashes of models, and verdicts on real recordings, which are no part of the project"
    yield "the first design's row of the page: `python -m benchmarks.first_design` repeats it"
    if old:
        rows = ", ".join(f'"{name.strip(" :")} …"' for name in OTHER_RULES)
        yield f"rows {rows} of the closing line, now counted by other rules: check out commit {lines[0].get('commit')}"
    if lines and lines[0].get("catalogue_sha256") != hashes()["catalogue_sha256"]:
        yield f"the catalogue of effects of the deck: this one has {len(CATALOGUE)} effects and another hash"
