"""From the lines of a ledger to its trials, their answers, and the records that are scored."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from noise.effects import CATALOGUE
from training.diagnosis.generators.ensemble import SINGLE
from training.diagnosis.judging.record import Record
from training.proof.chain import Line, of_event
from training.proof.sealing import unseal
from training.proof.work import task_of

# events of a ledger; DECK and CLOSED appear once, RESUMED at each continuation, the others once for a trial
DECK, RESUMED, CLOSED = "deck", "resumed", "closed"
SEALED, VERDICT, DISCLOSED, SCORED, LEFT_OUT = "sealed", "verdict", "disclosed", "scored", "left_out"
ORDER = (SEALED, VERDICT, DISCLOSED, SCORED)  # of the events of a trial


def context_of(lines: Sequence[Line], trial: int) -> str:
    """Return what the answer of a trial is bound to: the deck and the number of the trial."""
    return f"{lines[0]['hash']} {trial}"


def answers_of(lines: Sequence[Line]) -> dict[int, dict[str, Any]]:
    """Return the disclosed answers by trial.

    Raises:
        ProofError: a key does not open its answer.
    """
    sealed = of_event(lines, SEALED)
    keys = of_event(lines, DISCLOSED)
    return {trial: unseal(sealed[trial], keys[trial]["key"], context_of(lines, trial)) for trial in sorted(keys)}


def lost_of(lines: Sequence[Line]) -> list[int]:
    """Return the trials that were interrupted: their keys are gone, and they are never run again."""
    return sorted(trial for line in lines if line["event"] == RESUMED for trial in line["lost"])


def records_of(lines: Sequence[Line], answers: Mapping[int, dict[str, Any]]) -> list[Record]:
    """Return the records of all disclosed trials, in the order of their numbers."""
    verdicts, scores = of_event(lines, VERDICT), of_event(lines, SCORED)
    return [_record(lines[0], answers[t], verdicts[t], scores.get(t)) for t in sorted(answers)]


def _record(deck: Line, answer: dict[str, Any], verdict: Line, scored: Line | None) -> Record:
    head = {**answer, "id": task_of(answer).id, "trial": verdict["trial"], "commit": deck["commit"]}
    result = {name: verdict[name] for name in ("verdict", "error", "seconds")}
    content = (scored and scored["content"]) or {"error": "the diagnosis was lost before it was scored"}
    return {**head, **result, **content, "error": result["error"] or content.get("error")}


def left_out_trials(lines: Sequence[Line], answers: Mapping[int, dict[str, Any]]) -> list[int]:
    """Return the trials that are also diagnosed without the true effect: the first single causes with a verdict."""
    verdicts = of_event(lines, VERDICT)
    single = [t for t in sorted(answers) if answers[t]["kind"] == SINGLE and verdicts[t]["error"] is None]
    return single[: lines[0]["left_out"]]


def without_of(answer: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the ids of the catalogue that name the true causes."""
    return tuple(name for cause in answer["causes"] for name in cause["accepted"] if name in CATALOGUE)


def left_out_records(lines: Sequence[Line], answers: Mapping[int, dict[str, Any]]) -> list[Record]:
    """Return the verdicts without the true effect, in which every cause is wrong."""
    found = of_event(lines, LEFT_OUT)
    return [
        {**answers[t], "causes": [], "verdict": line["verdict"], "error": line["error"]} for t, line in found.items()
    ]
