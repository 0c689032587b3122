"""The first design's verdicts on the trials of a ledger: recorded once each, for that ledger alone."""

import json
import re
import shutil

import pytest

from benchmarks.first_design import record
from training.proof.chain import ProofError
from training.proof.ledger import answers_of, records_of
from training.proof.page import FIRST_DESIGN, PAGE, compared, publish
from training.proof.run import LEDGER


def said(verdict, effect):
    kind = {"effect": effect, "probability": 0.8, "gain_nats": 40.0, "indistinguishable_from": []}
    return {"verdict": {"verdict": verdict, "p_value": 0.01, "effects": [{**kind, "statement": ""}]}, "error": None}


@pytest.fixture
def ledger(finished, tmp_path):
    return shutil.copy(finished[0] / LEDGER, tmp_path / LEDGER)


def row(folder, lines):
    publish(lines, folder, folder)
    (found,) = [line for line in (folder / PAGE).read_text().splitlines() if "first design" in line]
    return found


def test_each_trial_is_diagnosed_once_and_counted(finished, ledger):
    lines, asked = finished[2], []

    def diagnose(files):
        asked.append(sorted(files))
        return {**said("named", "no effect"), "seconds": 1.0}

    null, known = compared(records_of(lines, answers_of(lines)))
    for _ in range(2):
        assert record(ledger, 2, diagnose) == ledger.parent / FIRST_DESIGN
        assert asked == [["recorded.csv", "simulated.csv"]] * (len(null) + len(known))
    assert re.findall(r"(\d+) % \((\d+)\)", row(ledger.parent, lines)) == [
        ("100", str(len(null))),
        *([("100", str(len(known))), ("0", str(len(known)))] if known else []),
    ]


def test_a_record_cut_short_goes_on(finished, ledger):
    path = record(ledger, 1, lambda files: {**said("none", "spike"), "seconds": 1.0})
    whole = path.read_text().splitlines()
    path.write_text("\n".join(whole[:3])[:-5])
    again = record(ledger, 1, lambda files: {**said("none", "spike"), "seconds": 1.0}).read_text().splitlines()
    assert sorted(again) == sorted(whole)
    assert row(ledger.parent, finished[2]).split("|")[2].strip().startswith("0 %")


def test_a_record_of_another_deck_is_not_published(finished, ledger):
    (ledger.parent / FIRST_DESIGN).write_text(json.dumps({"deck": "0" * 64}) + "\n")
    with pytest.raises(ProofError, match="is of deck 000"):
        publish(finished[2], ledger.parent, ledger.parent)
