"""The published ledger is whole, and the page beside it tells of the same run."""

import gzip
import json
from pathlib import Path

import pytest

from training.proof.score import trials_of
from training.proof.seal import LedgerError, check

DOCS = Path(__file__).parents[3] / "docs"


def published():
    with gzip.open(DOCS / "proof-ledger.jsonl.gz", "rt", encoding="utf-8") as file:
        return [json.loads(line) for line in file]


def test_the_published_ledger_is_whole():
    lines = published()
    check(lines)
    assert len(trials_of(lines)) >= 300


def test_an_answer_changed_afterwards_is_found():
    lines = published()
    opened = next(line for line in lines if line["event"] == "opened")
    opened["answer"]["kind"] = "null"
    with pytest.raises(LedgerError):
        check(lines)


def test_the_page_tells_of_the_published_run():
    lines = published()
    settings = lines[0]["settings"]
    text = (DOCS / "proof.md").read_text(encoding="utf-8")
    assert f"{len(trials_of(lines))} blind trials" in text
    assert f"at commit `{settings['commit']}`" in text
    assert f"nonce `{settings['nonce']}`" in text
