"""Trials are planned, sealed before they are diagnosed, and never diagnosed twice, wherever a run was interrupted."""

import json
import os
import pickle
from collections import Counter
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from noise.discrepancy.baseline.forest import AnalogueForest
from noise.effects import CATALOGUE
from noise.fitting.batch import Batch
from noise.fitting.empirical import EmpiricalModel
from tests.training.proof.conftest import args_of, run_stub, stub_diagnose
from training.common.checksum import canonical, sha256
from training.diagnosis.generators.ensemble import FAMILIES
from training.diagnosis.judging.tasks import Task, case_of
from training.proof import work
from training.proof.chain import FIRST, ProofError, linked, load, parse
from training.proof.deck import planned
from training.proof.ledger import answers_of, lost_of
from training.proof.parcel import packed, unpacked
from training.proof.real import FOLDER
from training.proof.run import LEDGER, Args, given, main, opened
from training.proof.secret import FILE, secret_of
from training.proof.verify import Args as VerifyArgs
from training.proof.verify import problems_of
from training.proof.work import diagnosed, environment, files_of

N_KILLS = 3


def problems(path):
    return problems_of(load(path), VerifyArgs(path, workers=1, unannounced=True))


def test_the_deck_holds_what_was_promised():
    counts = planned(300)
    by_kind, by_family = Counter(), Counter()
    for (family, kind), n in counts.items():
        by_kind[kind] += n
        by_family[family] += n
    assert counts.total() == 300
    assert min(by_kind["same"], by_kind["unmodelled"]) >= 60
    assert by_kind["pair"] >= 40
    assert min(by_family[family] for family in FAMILIES) >= 30
    assert {planned(n).total() for n in range(1, 40)} == set(range(1, 40))


def test_a_finished_ledger_has_every_trial_once_and_no_two_alike(finished):
    _, _, lines = finished
    answers = answers_of(lines)
    found = Counter((answer["family"], answer["kind"]) for answer in answers.values())
    assert found == planned(len(answers))
    assert len({answer["seed"] for answer in answers.values()}) == len(answers)


def test_an_answer_is_committed_to_before_its_diagnosis_begins(tmp_path, monkeypatch):
    monkeypatch.delenv(FOLDER, raising=False)  # real recordings conceal a fact, and no answer

    def diagnose(files, without=()):
        sealed = [json.loads(line) for line in (tmp_path / LEDGER).read_text().splitlines()]
        committed = {line["files"]["recorded.csv"] for line in sealed if line["event"] == "sealed"}
        assert sha256(files["recorded.csv"]) in committed
        return stub_diagnose(files, without)

    run_stub(args_of(tmp_path, 3), diagnose)


@pytest.mark.parametrize("seed", range(N_KILLS))
def test_a_run_killed_at_any_byte_goes_on_without_a_second_verdict(finished, tmp_path, seed):
    out, data, _ = finished
    first = data.index(b"\n") + 1
    place = int(np.random.default_rng(seed).integers(first, len(data)))
    (tmp_path / LEDGER).write_bytes(data[:place])
    (tmp_path / FILE).write_bytes((out / FILE).read_bytes())
    before = parse(data[: data.rfind(b"\n", 0, place) + 1], "before")
    lines = run_stub(args_of(tmp_path))
    assert lines[: len(before)] == before
    verdicts = Counter(line["trial"] for line in lines if line["event"] == "verdict")
    assert set(verdicts.values()) == {1}
    assert len(lost_of(lines)) <= args_of(tmp_path).workers
    assert problems(tmp_path / LEDGER) == []


def test_a_copy_that_is_run_again_has_the_same_trials(finished, tmp_path):
    out, data, lines = finished
    (tmp_path / LEDGER).write_bytes(data[: data.index(b"\n") + 1])
    (tmp_path / FILE).write_bytes((out / FILE).read_bytes())
    again = run_stub(args_of(tmp_path))
    assert answers_of(again) == answers_of(lines)
    assert again[-1]["table"] == lines[-1]["table"]


def test_a_deck_is_not_run_without_its_secret(finished, tmp_path):
    _, data, lines = finished
    (tmp_path / LEDGER).write_bytes(data[: data.index(b"\n") + 1])
    for text in (None, "00", "no secret"):
        if text is not None:
            (tmp_path / FILE).write_text(text)
        with pytest.raises(ProofError, match=f"is not the secret of deck {lines[0]['hash']}"):
            run_stub(args_of(tmp_path))


def test_only_the_owner_reads_a_secret_and_it_says_nothing_in_the_deck(tmp_path):
    chain = opened(args_of(tmp_path))
    chain.close()
    assert (tmp_path / FILE).stat().st_mode & 0o077 == 0
    assert secret_of(tmp_path, chain.lines[0]).hex() not in canonical(chain.lines[0])


def rescued(finished, tmp_path, diagnose):
    """Go on with a run that was interrupted when trial 1 had been disclosed, and whose unscored diagnosis is gone."""
    out, data, lines = finished
    end = next(k for k, line in enumerate(lines) if line["event"] == "disclosed" and line["trial"] == 1)
    (tmp_path / LEDGER).write_bytes(b"".join(data.splitlines(keepends=True)[: end + 1]))
    (tmp_path / FILE).write_bytes((out / FILE).read_bytes())
    return run_stub(args_of(tmp_path), diagnose)


def test_a_diagnosis_that_was_deleted_is_made_again(finished, tmp_path):
    lines = rescued(finished, tmp_path, stub_diagnose)
    (line,) = [line for line in lines if line["event"] == "scored" and line["trial"] == 1]
    assert line["content"]["scores"]["before"] == 0.03
    assert problems(tmp_path / LEDGER) == []


def test_another_diagnosis_than_the_one_that_was_deleted_is_not_scored(finished, tmp_path):
    def other(files, without=()):
        return stub_diagnose(files)[0], b"model" if case["recorded.csv"] != sha256(files["recorded.csv"]) else b"other"

    case = next(line["files"] for line in finished[2] if line["event"] == "sealed" and line["trial"] == 1)
    with pytest.raises(ProofError, match=r"unscored.1\.json: is not the diagnosis with SHA-256"):
        rescued(finished, tmp_path, other)


def test_a_closed_ledger_is_not_continued(finished, tmp_path):
    _, data, lines = finished
    (tmp_path / LEDGER).write_bytes(data)
    assert run_stub(args_of(tmp_path)) == lines
    assert (tmp_path / LEDGER).read_bytes() == data


def test_other_settings_need_another_folder(finished, tmp_path):
    _, data, _ = finished
    (tmp_path / LEDGER).write_bytes(data)
    announced = tmp_path / "announced.txt"
    with pytest.raises(ProofError, match="trials 8, now 9"):
        opened(replace(args_of(tmp_path, 9), announce=announced))
    assert not announced.exists()


def test_a_chain_that_does_not_begin_with_a_deck_is_not_continued(tmp_path):
    (tmp_path / LEDGER).write_text(canonical(linked("sealed", {"trial": 0}, FIRST)) + "\n")
    with pytest.raises(ProofError, match="event sealed, now deck"):
        opened(args_of(tmp_path))


def test_an_error_of_the_diagnosis_counts_and_the_run_goes_on(tmp_path):
    lines = run_stub(
        args_of(tmp_path, 2), lambda files, without=(): ({"verdict": None, "error": "E: x", "seconds": 0.0}, b"")
    )
    assert [line["error"] for line in lines if line["event"] == "verdict"] == ["E: x"] * 2
    row = next(row for row in lines[-1]["table"]["all families"] if row["metric"] == "diagnosis ended in an error")
    assert (row["value"], row["n"], row["hit"]) == (1.0, 2, False)
    assert problems(tmp_path / LEDGER) == []


def test_a_deck_can_be_published_before_it_is_run(tmp_path, capsys):
    announced = tmp_path / "announced.txt"
    main(Args(tmp_path / "out", trials=3, plan=True, announce=announced))
    head = load(tmp_path / "out" / LEDGER)[0]["hash"]
    assert announced.read_text().split()[:2] == ["deck", head]
    assert head in capsys.readouterr().out


SPY = """
import json, os, sys
seen = {"files": sorted(os.listdir()), "env": dict(os.environ), "arguments": sys.argv[1:], "cwd": os.getcwd()}
seen["group"] = os.getpgid(0) if hasattr(os, "getpgid") else -1
json.dump({"verdict": seen, "error": None, "seconds": 0.0}, open("result.json", "w"))
open("diagnosis.json", "wb").close()
"""


def test_the_diagnosing_process_sees_two_files_and_nothing_else(monkeypatch):
    monkeypatch.setattr(work, "PROGRAM", ("-c", SPY))
    monkeypatch.setenv("SONAR_GYM_SECRET", "the answer")
    files = files_of(case_of(Task("beam", "single", 0, 1, 40)))
    assert set(files) > set(given(files)) == {"simulated.csv", "recorded.csv"}
    seen = diagnosed(files)[0]["verdict"]
    assert seen["files"] == ["recorded.csv", "simulated.csv"]
    assert seen["env"].keys() - {"LC_CTYPE", "PWD", "SHLVL", "_"} == environment().keys()
    assert "the answer" not in str(seen)
    assert seen["arguments"] == []
    assert not Path(seen["cwd"]).exists()
    assert Path(seen["cwd"]) != Path(os.getcwd())
    assert seen["group"] != getattr(os, "getpgid", lambda _: 0)(0)  # Ctrl-C reaches all processes of a group


def test_files_do_not_name_their_trial():
    files = given(files_of(case_of(Task("beam", "single", 7, 123456789, 40))))
    text = b"".join(files.values())
    assert b"123456789" not in text
    assert b"single" not in text
    assert b"beam" not in text


def test_a_process_that_dies_is_an_error_of_the_diagnosis(monkeypatch):
    monkeypatch.setattr(work, "PROGRAM", ("-c", "raise SystemExit('out of memory')"))
    result, model = diagnosed({"recorded.csv": b""})
    assert (result["verdict"], model) == (None, b"")
    assert "out of memory" in result["error"]


def test_an_error_of_scoring_is_returned():
    assert work.scored({}, b"")["error"].startswith("scoring: KeyError")


def test_what_is_scored_is_data_and_runs_no_code(tmp_path):
    class Harm:
        def __reduce__(self):
            return Path.touch, (tmp_path / "harm",)

    task = Task("beam", "same", 0, 1, 40)
    content = work.scored(work.answer_of(task, case_of(task)), pickle.dumps(Harm()))
    assert content["error"].startswith("scoring: ")
    assert not (tmp_path / "harm").exists()


def test_models_of_a_diagnosis_are_those_that_were_packed():
    rng = np.random.default_rng(0)
    batch = Batch.of(case_of(Task("beam", "same", 0, 1, 200)).recorded)
    forest, physical = AnalogueForest.of(batch, rng), EmpiricalModel([CATALOGUE["zero_offset"](offset_m=0.01)], 0.01)
    found = SimpleNamespace(
        verdict=SimpleNamespace(causes=(), where=()), evidence={}, likely={}, recorded=replace(batch, resolution=0.001),
        corrected=forest, causes_only=None, difference=None, emulator=physical,
    )  # fmt: skip
    again = unpacked(packed(found))
    for name, model in (("corrected", forest), ("emulator", physical)):
        loaded = again.models[name]
        assert type(loaded) is type(model)
        own, other = (each.law(batch.ping, batch.past).quantile(0.3) for each in (model, loaded))
        assert np.array_equal(own, other)
    assert again.models["causes_only"] is None
    assert again.recorded(case_of(Task("beam", "same", 0, 1, 200)).recorded).resolution == 0.001


@pytest.mark.slow
def test_a_diagnosis_in_its_own_process_can_be_scored():
    task = Task("beam", "same", 0, 1, 200)
    case = case_of(task)
    result, model = diagnosed(given(files_of(case)))
    assert result["error"] is None
    content = work.scored(work.answer_of(task, case), model)
    assert content["scores"]["process"] > 0
    json.dumps(content)
