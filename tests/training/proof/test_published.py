"""The published ledger is whole, and the page beside it tells of the same run."""

import gzip
import json
from pathlib import Path

import pytest

from training.proof.score import trials_of
from training.proof.seal import LedgerError, check

DOCS = Path(__file__).parents[3] / "docs"


LEDGERS = {  # and how many trials they hold at least
    "proof-ledger.jsonl.gz": 300,
    "proof-ledger-b558b2d.jsonl.gz": 150,
    "proof-ledger-f3a2a87.jsonl.gz": 250,
    "proof-ledger-69130c0.jsonl.gz": 184,
    "proof-ledger-511b13d.jsonl.gz": 300,
}


def published(name):
    with gzip.open(DOCS / name, "rt", encoding="utf-8") as file:
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


@pytest.mark.parametrize("name", LEDGERS)
def test_the_page_tells_of_every_published_run(name):
    lines = published(name)
    settings = lines[0]["settings"]
    text = (DOCS / "proof.md").read_text(encoding="utf-8")
    assert name in text
    assert f"{len(trials_of(lines))} blind trials" in text or f"first {len(trials_of(lines))} trials" in text
    assert f"at commit {settings['commit']}" in text.replace("`", "")
    assert f"--nonce {settings['nonce']}" in text.replace("\n", " ")
