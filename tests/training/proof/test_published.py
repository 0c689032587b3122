"""The published ledgers are complete, and a changed answer is detected in each."""

import json
import lzma
from pathlib import Path

import pytest

from training.proof.scoring.score import trials_of
from training.proof.seal import LedgerError, check

RECORDS = Path(__file__).parents[3] / "benchmarks" / "records" / "proof"


LEDGERS = {  # name: least number of trials
    "ledger-2da6429.jsonl.xz": 300,
    "ledger-b558b2d.jsonl.xz": 150,
    "ledger-f3a2a87.jsonl.xz": 250,
    "ledger-69130c0.jsonl.xz": 184,
    "ledger-511b13d.jsonl.xz": 300,
}


def published(name):
    with lzma.open(RECORDS / name, "rt", encoding="utf-8") as file:
        return [json.loads(line) for line in file]


@pytest.mark.parametrize("name", LEDGERS)
def test_a_published_ledger_is_whole(name):
    lines = published(name)
    check(lines)
    assert len(trials_of(lines)) >= LEDGERS[name]


@pytest.mark.parametrize("name", LEDGERS)
def test_an_answer_changed_afterwards_is_found(name):
    lines = published(name)
    opened = next(line for line in lines if line["event"] == "opened" and line["answer"]["kind"] != "null")
    opened["answer"]["kind"] = "null"
    with pytest.raises(LedgerError):
        check(lines)
