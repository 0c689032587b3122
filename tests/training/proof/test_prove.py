"""A run can be stopped, loses nothing but the trials at work, and publishes what its ledger holds."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any, ClassVar

import pytest

from training.diagnosis.prove import Args, main
from training.proof.crew import ENGINES
from training.proof.desk import ROOT, Desk, DeskError
from training.proof.seal import OPENED, SEALED, VERDICT, LedgerError, check, read

pytest.importorskip("torch")


class Told:
    """A bench that makes up its answers, and keeps note of what it is asked in which order."""

    asked: ClassVar[list[tuple[str, dict[str, Any]]]] = []
    dies: ClassVar[dict[str, int]] = {}
    says: ClassVar[str] = "none"
    kind: ClassVar[str] = "null"
    names: ClassVar[list[dict[str, Any]]] = []
    wants: ClassVar[list[dict[str, Any]]] = []

    def ask(self, module: str, question: dict[str, Any]) -> dict[str, Any]:
        """Return an answer made up."""
        self.asked.append((module, question))
        if self.dies.get(module, 0) > 0:
            self.dies[module] -= 1
            raise DeskError(f"{module} died")
        if module == "generate":
            return {"answer": {"trial": question["trial"], "kind": self.kind, "causes": []}, "files": {}}
        held = {"after": {"log_likelihood_per_ping": 0.0}}
        verdict = {"verdict": self.says, "effects": self.names, "where": [], "p_value": 1.0, "held_out": held}
        verdict["next_measurement"] = verdict["next_settings"] = self.wants
        if question.get("follow"):
            return {"told": [{"replaces": "spike", "effect": "stuck", "observed": 1.0, "pings": 5}]}
        if module == "examine":
            return {"verdict": verdict, "seconds": 1.0}
        scores = {
            "separation_nats": 0.0,
            "least_nats": 0.0,
            "vault_before": 0.0,
            "vault_oracle": 0.0,
            "oracle_widths": {},
        }
        return {**scores, "classifier_nats": 0.0, "classifier_z": 0.0, "kernel_p": 1.0}

    def tidy(self, folder: str, keep: bool) -> None:
        """Nothing is kept."""

    def close(self) -> None:
        """Nothing runs."""


@pytest.fixture(autouse=True)
def told(monkeypatch):
    """Run on made-up answers, from one commit."""
    monkeypatch.setitem(ENGINES, "local", Told)
    monkeypatch.setattr("training.diagnosis.prove.commit", lambda: "0123456789ab")
    monkeypatch.setattr(Told, "asked", [])
    monkeypatch.setattr(Told, "dies", {})
    return Told


def lines(folder: Path) -> list[dict[str, Any]]:
    return read((folder / "ledger.jsonl").read_text(), "ledger")


def test_each_trial_is_sealed_judged_and_opened_in_this_order(tmp_path):
    main(Args(tmp_path, trials=3, workers=1))
    kept = lines(tmp_path)
    assert [each["event"] for each in kept[1:]] == [SEALED, VERDICT, OPENED] * 3
    check(kept)
    assert "3 blind trials (3 null)" in (tmp_path / "proof.md").read_text()


@pytest.fixture
def asking(monkeypatch, told):
    """Let every verdict be confounded, and ask for a measurement."""
    wants = [{"do": "go to 2 m", "separates": ["spike", "stuck"], "pings": 5, "conditions": [{}], "also": {}}]
    monkeypatch.setattr(told, "wants", wants)
    monkeypatch.setattr(told, "says", "confounded")
    monkeypatch.setattr(told, "names", [{"effect": "spike", "indistinguishable_from": ["stuck"], "parameters": {}}])
    return wants


@pytest.mark.parametrize("kind", ["effect", "pair", "matched", "confounded"])
def test_what_a_verdict_asks_for_next_is_measured_before_its_answer_is_opened(
    tmp_path, told, asking, monkeypatch, kind
):
    monkeypatch.setattr(told, "kind", kind)
    main(Args(tmp_path, trials=1, workers=1))
    assert [m for m, q in told.asked] == ["generate", "examine", "assess", "generate", "examine"]
    assert told.asked[3][1]["measure"] == asking
    opened = [line for line in lines(tmp_path) if line["event"] == OPENED]
    assert opened[0]["scores"]["followed"][0]["pings"] == 5


@pytest.mark.parametrize("kind", ["null", "stranger", "family"])
def test_where_nothing_can_be_told_apart_a_claim_is_opened_without_a_measurement(
    tmp_path, told, asking, monkeypatch, kind
):
    monkeypatch.setattr(told, "kind", kind)
    main(Args(tmp_path, trials=1, workers=1))
    assert [m for m, q in told.asked] == ["generate", "examine", "assess"]
    assert [line["scores"]["followed"] for line in lines(tmp_path) if line["event"] == OPENED] == [None]


def test_the_diagnosis_is_told_a_folder_and_nothing_else(tmp_path, told):
    main(Args(tmp_path, trials=2, workers=1))
    asked = [question for module, question in told.asked if module == "examine"]
    assert [set(question) for question in asked] == [{"folder"}] * 2


def test_no_answer_stands_in_the_ledger_before_its_verdict(tmp_path):
    main(Args(tmp_path, trials=2, workers=1))
    for each in lines(tmp_path):
        assert ("answer" in each) == (each["event"] == OPENED)


def test_a_run_that_was_stopped_goes_on_and_asks_no_verdict_twice(tmp_path, told):
    told.dies["assess"] = 2
    with pytest.raises(DeskError, match="assess died"):
        main(Args(tmp_path, trials=1, workers=1))
    assert [each["event"] for each in lines(tmp_path)[1:]] == [SEALED, VERDICT]
    assert "0 blind trials" in (tmp_path / "proof.md").read_text()
    told.asked.clear()
    main(Args(tmp_path, trials=2, workers=1))
    assert [m for m, q in told.asked] == ["generate", "assess", "generate", "examine", "assess"]
    assert sorted(each["trial"] for each in lines(tmp_path) if each["event"] == OPENED) == [0, 1]


def test_a_worker_that_dies_costs_one_try_of_one_trial(tmp_path, told):
    told.dies["examine"] = 1
    main(Args(tmp_path, trials=3, workers=1))
    assert sorted(each["trial"] for each in lines(tmp_path) if each["event"] == OPENED) == [0, 1, 2]
    check(lines(tmp_path))


def test_an_answer_that_changed_between_two_runs_is_told(tmp_path, told, monkeypatch):
    told.dies["examine"] = 2
    with pytest.raises(DeskError):
        main(Args(tmp_path, trials=1, workers=1))
    honest = Told.ask

    def changed(self: Told, module: str, question: dict[str, Any]) -> dict[str, Any]:
        reply = honest(self, module, question)
        return {**reply, "answer": {**reply["answer"], "kind": "pair"}} if module == "generate" else reply

    monkeypatch.setattr(Told, "ask", changed)
    with pytest.raises(LedgerError, match="another hash"):
        main(Args(tmp_path, trials=1, workers=1))


def test_a_run_that_says_wrong_things_publishes_them(tmp_path, monkeypatch):
    monkeypatch.setattr(Told, "says", "unknown")
    main(Args(tmp_path, trials=2, workers=1))
    assert "| nothing | 2 unknown |" in (tmp_path / "proof.md").read_text()


def test_other_settings_in_the_same_folder_are_refused(tmp_path):
    main(Args(tmp_path, trials=1, workers=1))
    with pytest.raises(LedgerError, match="choose another --out"):
        main(Args(tmp_path, trials=1, workers=1, nonce="other"))


def test_a_process_that_dies_says_so_and_one_that_fails_says_why(tmp_path, monkeypatch):
    (tmp_path / "dies.py").write_text("raise SystemExit(3)\n")
    (tmp_path / "fails.py").write_text(
        "from training.proof.desk import serve\n\ndef answer(asked):\n    raise ValueError('seven')\n\nserve(answer)\n"
    )
    for name in ("training", "acquisition"):
        (tmp_path / name).symlink_to(ROOT / name)
    monkeypatch.setattr("training.proof.desk.ROOT", tmp_path)
    with pytest.raises(DeskError, match=r"dies died with exit code"):
        Desk("dies").ask({})
    desk = Desk("fails")
    with pytest.raises(DeskError, match="ValueError: seven"):
        desk.ask({})
    desk.close()


@pytest.mark.timeout(600)
def test_one_true_trial_from_secret_to_score(tmp_path):
    """The whole chain of processes on the smallest of surveys, within minutes."""
    desks = {name: Desk(f"training.proof.{name}") for name in ("generate", "examine", "assess")}
    folder = str(tmp_path / "trials" / "00000")
    asked = {"trial": 0, "secret": "s", "kind": "effect", "name": "zero_offset", "size": 1.0}
    answer = desks["generate"].ask({**asked, "folder": folder})["answer"]
    verdict = desks["examine"].ask({"folder": folder})["verdict"]
    scores = desks["assess"].ask({"folder": folder, "answer": answer, "verdict": verdict, "quick": True})
    for desk in desks.values():
        desk.close()
    assert answer["causes"][0]["name"] == "zero_offset"
    assert verdict["verdict"] in ("named", "confounded")
    assert scores["separation_nats"] > 15.0
    assert scores["vault_oracle"] > scores["vault_before"]


@pytest.mark.slow
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("engine", ["local", "ray"])
def test_a_killed_run_goes_on_and_the_ledger_stays_whole(tmp_path, engine):
    if engine == "ray":
        pytest.importorskip("ray", reason="the extra 'ray' is not installed")
    command = [sys.executable, "-m", "training.cli", "prove", "--out", str(tmp_path), "--trials", "2", "--quick"]
    command += ["--engine", engine, "--workers", "2"]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    first = subprocess.Popen(command, cwd=ROOT, env=environment)
    ledger = tmp_path / "ledger.jsonl"
    while first.poll() is None and not (ledger.exists() and SEALED in ledger.read_text()):
        time.sleep(0.2)
    first.send_signal(signal.SIGKILL)
    first.wait()
    sealed = [json.loads(each) for each in ledger.read_text().splitlines() if SEALED in each]
    subprocess.run(command, cwd=ROOT, env=environment, check=True)
    kept = lines(tmp_path)
    check(kept)
    assert sorted(each["trial"] for each in kept if each["event"] == OPENED) == [0, 1]
    assert [each for each in kept if each["event"] == SEALED][: len(sealed)] == sealed
