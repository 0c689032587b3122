"""A stranger notices forgeries, also where every hash was computed anew; exit codes say whether all holds."""

import json
import os
import re

import pytest

from tests.training.proof.conftest import forged, stub_diagnose, stub_verdict
from training.cli import main as cli
from training.common.checksum import canonical
from training.diagnosis.judging import rows
from training.proof.chain import load
from training.proof.deck import SCHEMA
from training.proof.ledger import answers_of, context_of
from training.proof.page import PAGE, failures, publish, real_table, table_of
from training.proof.real import CASES
from training.proof.run import LEDGER
from training.proof.sealing import seal
from training.proof.secret import key_of
from training.proof.verify import (
    ANNOUNCED,
    Args,
    announcement_problems,
    content_problems,
    follows,
    order_problems,
    problems_of,
    rediagnosed,
    rediagnosed_without,
    regenerated,
)


def drop_trial(lines):
    return [line for line in lines if line.get("trial") != 3]


def drop_last_trial(lines):
    return [line for line in lines if line.get("trial") != 7]


def drop_scores(lines):
    return [line for line in lines if not (line["event"] == "scored" and line["trial"] == 1)]


def drop_closing(lines):
    return lines[:-1]


def drop_left_out(lines):
    return [line for line in lines if line["event"] != "left_out"]


def second_verdict(lines):
    k = next(k for k, line in enumerate(lines) if line["event"] == "verdict")
    return [*lines[: k + 1], lines[k], *lines[k + 1 :]]


def call_it_lost(lines):
    kept = [line for line in lines if not (line.get("trial") == 2 and line["event"] in ("disclosed", "scored"))]
    return [*kept[:-1], {"event": "resumed", "lost": [2]}, {**kept[-1], "lost": [2], "disclosed": 7}]


def lost_without_interruption(lines):
    return [{**line, "lost": [2], "disclosed": 7} if line["event"] == "closed" else line for line in drop_trial(lines)]


def exchange(name, event, lines):
    at = {line["trial"]: k for k, line in enumerate(lines) if line["event"] == event}
    out = [dict(line) for line in lines]
    first, second = sorted(at, key=lambda t: json.dumps(lines[at[t]][name]))[:: len(at) - 1]
    out[at[first]][name], out[at[second]][name] = lines[at[second]][name], lines[at[first]][name]
    return out


def exchange_keys(lines):
    return exchange("key", "disclosed", lines)


def exchange_seals(lines):
    return exchange("ciphertext", "sealed", lines)


def exchange_files(lines):
    return exchange("files", "sealed", lines)


def better_verdicts(lines):
    """Write a right verdict for every single cause, but not the table that follows."""
    answers = answers_of(lines)
    right = {t: stub_verdict(a["causes"][0]["effect"])["verdict"] for t, a in answers.items() if a["causes"]}
    return [
        {**line, "verdict": right.get(line["trial"], line["verdict"])} if line["event"] == "verdict" else line
        for line in lines
    ]


def easier_answer(lines):
    """Seal another answer with another key after the verdict."""
    key, head = os.urandom(32), lines[0]["hash"]
    answer = {**answers_of(lines)[0], "fault": "another"}
    new = {"sealed": seal(answer, key, f"{head} 0"), "disclosed": {"key": key.hex()}}
    return [{**line, **new.get(line["event"], {})} if line.get("trial") == 0 else line for line in lines]


def no_verdict(lines):
    return [{**line, "verdict": None} if line["event"] == "verdict" else line for line in lines]


def no_number(lines):
    return [{**line, "trials": "8"} if line["event"] == "deck" else line for line in lines]


def better_table(lines):
    table = {"all families": []}
    return [{**line, "table": table} if line["event"] == "closed" else line for line in lines]


def another_secret(lines):
    return [{**line, "secret": "00" * 32} if line["event"] == "closed" else line for line in lines]


def no_secret(lines):
    deck = {name: value for name, value in lines[0].items() if name != "secret_sha256"}
    return [deck, *lines[1:-1], {name: value for name, value in lines[-1].items() if name != "secret"}]


def no_scores(lines):
    return [{**line, "content": None} if line["event"] == "scored" else line for line in lines]


def easier_recording(lines):
    """Accept another answer for a real recording."""
    line = {"event": "real", "name": CASES[0].name, "hidden": "", "accepted": ["stuck"], "files": {}}
    return [*lines[:-1], {**line, **stub_verdict("stuck")}, lines[-1]]


def smaller_deck(lines):
    return [{**line, "trials": 7} if line["event"] == "deck" else line for line in drop_last_trial(lines)]


def added_line(lines):
    return [*lines[:-1], {"event": "remark", "text": "x"}, lines[-1]]


def added_entry(lines):
    return [{**line, "note": 1} if line["event"] == "verdict" else line for line in lines]


FORGERIES = (
    drop_trial,
    drop_last_trial,
    drop_scores,
    drop_closing,
    drop_left_out,
    second_verdict,
    lost_without_interruption,
    exchange_keys,
    exchange_seals,
    exchange_files,
    better_verdicts,
    easier_answer,
    better_table,
    no_verdict,
    no_number,
    another_secret,
    no_secret,
    no_scores,
    easier_recording,
    smaller_deck,
    added_line,
    added_entry,
)


@pytest.mark.parametrize("forgery", FORGERIES, ids=lambda f: f.__name__)
def test_a_forgery_with_hashes_computed_anew_is_noticed(finished, forgery):
    _, _, lines = finished
    assert problems_of(forged(forgery(lines)), Args(None, workers=1, unannounced=True))


def test_what_only_published_hashes_show_is_noticed_by_them(finished, tmp_path):
    _, _, lines = finished
    announced = tmp_path / "announced.txt"
    announced.write_text(f"deck {lines[0]['hash']} 8 trials\nclosed {lines[0]['hash']} {lines[-1]['hash']}\n")
    args = Args(None, workers=1, announced=announced)
    assert problems_of(lines, args) == []
    other = better_verdicts(lines)
    table = table_of(forged(other), answers_of(lines))
    consistent = forged([*other[:-1], {**other[-1], "table": table}])
    assert problems_of(consistent, Args(None, workers=1, unannounced=True)) == []
    assert "closing line" in problems_of(consistent, args)[0]
    rerun = forged([{**lines[0], "salt": "another deck"}, *lines[1:]])
    assert problems_of(rerun, args)
    assert problems_of(lines, Args(None, workers=1, announced=tmp_path / "none.txt"))


def test_the_published_ledger_holds(monkeypatch):
    """Its recordings are compared by `sonar-gym verify-proof`, which takes minutes."""
    monkeypatch.setattr(rows, "N_BOOTSTRAP", 1000)
    args = Args(ANNOUNCED.with_name("ledger.jsonl.xz"))
    lines = load(args.ledger)
    assert [*order_problems(lines), *content_problems(lines), *announcement_problems(lines, args)] == []


def test_rows_of_an_older_ledger_are_compared_where_their_rules_are_the_same():
    strong, lost, near = (
        {"metric": metric, "n": n, "without": 0, "value": 0.5}
        for metric, n in (("strong single: aspect right", 9), ("trial lost by an interruption", 9), ("a new row", 0))
    )
    own = {"all families": [strong, lost, near]}
    old = [{name: value for name, value in row.items() if name != "without"} for row in (strong, lost)]
    assert follows({"all families": old}, own, SCHEMA - 1)
    assert follows({"all families": [old[0] | {"value": 0.6}, old[1]]}, own, SCHEMA - 1)
    for other in ([old[0], old[1] | {"value": 0.6}], old[:1], old[1:]):
        assert not follows({"all families": other}, own, SCHEMA - 1)
    assert not follows({"all families": old}, own, SCHEMA)
    assert follows(own, own, SCHEMA)


@pytest.mark.parametrize("changed", ["key", "seed"])
def test_a_trial_that_does_not_follow_from_the_secret_is_noticed(finished, changed):
    """Its seal and its key agree, as if it had been drawn after the deck was published."""
    _, _, lines = finished
    key, answer = key_of(bytes.fromhex(lines[-1]["secret"]), 0), answers_of(lines)[0]
    key, answer = (os.urandom(32), answer) if changed == "key" else (key, {**answer, "seed": answer["seed"] + 1})
    new = {"sealed": seal(answer, key, context_of(lines, 0)), "disclosed": {"key": key.hex()}}
    other = [{**line, **new.get(line["event"], {})} if line.get("trial") == 0 else line for line in lines]
    assert list(content_problems(lines)) == []
    assert list(content_problems(other)) == [
        "trial 0: family, kind, seed or key does not follow from the secret of the deck"
    ]


def test_two_closing_lines_of_one_deck_are_noticed(finished, tmp_path):
    _, _, lines = finished
    head, last = lines[0]["hash"], lines[-1]["hash"]
    announced = tmp_path / "announced.txt"
    announced.write_text(f"deck {head} 8 trials\nclosed {head} {'0' * 64}\nclosed {head} {last}\n")
    (problem,) = announcement_problems(lines, Args(None, announced=announced))
    assert "has 2 closing lines of this deck" in problem


def test_accepted_answers_of_real_recordings_are_those_of_the_code(finished):
    _, _, lines = finished
    line = {"event": "real", "name": CASES[0].name, "hidden": "", "accepted": list(CASES[0].accepted)}
    assert list(content_problems([*lines[:-1], line, lines[-1]])) == []
    (problem,) = content_problems([*lines[:-1], line | {"accepted": ["stuck"]}, lines[-1]])
    assert problem == f"recording {CASES[0].name}: the accepted answers are not those of this code"


def test_a_verdict_without_the_true_effect_is_repeated(finished):
    _, _, lines = finished
    line = next(line for line in lines if line["event"] == "left_out")
    answer = answers_of(lines)[line["trial"]]
    assert rediagnosed_without(answer, line, stub_diagnose) == ""
    wrong = {**line, "verdict": stub_verdict("time_walk")["verdict"]}
    assert "another verdict" in rediagnosed_without(answer, wrong, stub_diagnose)


def test_a_diagnosis_without_the_true_effect_that_ends_in_an_error_counts(finished):
    _, _, lines = finished
    failed = [{**line, "verdict": None, "error": "E: x"} if line["event"] == "left_out" else line for line in lines]
    table = table_of(failed, answers_of(lines))["all families"]
    row = next(row for row in table if row["metric"].startswith("true effect not in the catalogue"))
    assert (row["value"], row["n"]) == (0.0, 1)


def test_an_unexplained_recording_is_not_answered_rightly():
    line = {"name": "a", "hidden": "b", "accepted": ["zero_offset"], **stub_verdict("zero_offset")}
    unexplained = {**line, "verdict": line["verdict"] | {"verdict": "unexplained"}}
    assert [real_table([each]).endswith("| yes |") for each in (line, unexplained)] == [True, False]


def test_a_trial_that_is_called_lost_needs_an_interruption_and_is_counted(finished):
    _, _, lines = finished
    found = problems_of(forged(call_it_lost(lines)), Args(None, workers=1, unannounced=True))
    assert found  # the table and the closing line count it
    assert "table" in found[0] or "true effect" in found[0] or "expected" in found[0]


def test_an_exchanged_verdict_is_not_repeated(finished):
    _, _, lines = finished
    answers = answers_of(lines)
    verdicts = {line["trial"]: line for line in lines if line["event"] == "verdict"}
    wrong = {**verdicts[0], "verdict": stub_verdict("time_walk")["verdict"]}
    without_model = lambda files: (stub_diagnose(files)[0], b"")  # noqa: E731
    assert rediagnosed(answers[0], verdicts[0], None, without_model) == ""
    assert "another verdict" in rediagnosed(answers[0], wrong, None, without_model)


def test_recordings_and_answers_follow_from_their_seed(finished):
    _, _, lines = finished
    answers = answers_of(lines)
    files = {line["trial"]: line["files"] for line in lines if line["event"] == "sealed"}
    assert regenerated(answers[0], files[0]) == ""
    assert "recordings" in regenerated(answers[0], files[1])
    assert "answer" in regenerated({**answers[0], "fault": "another"}, files[0])


def test_exit_codes(finished, tmp_path, capsys):
    out, data, lines = finished
    options = ["--unannounced", "--workers", "1"]
    cli(["verify-proof", str(out / LEDGER), *options])
    told = capsys.readouterr().out
    assert "FAILED" not in told
    assert "cannot be checked: that no other deck" in told
    for name, content, code in (
        ("changed", data.replace(b"explained", b"exqlained", 1), 2),
        ("forged", "".join(canonical(line) + "\n" for line in forged(better_table(lines))).encode(), 1),
        ("unfinished", b"".join(line + b"\n" for line in data.split(b"\n")[:-2]), 1),
    ):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(SystemExit) as caught:
            cli(["verify-proof", str(tmp_path / name), *options])
        assert caught.value.code == code
    with pytest.raises(SystemExit) as caught:
        cli(["verify-proof", str(out / LEDGER), "--announced", str(tmp_path / "none")])
    assert caught.value.code == 1


def test_the_page_is_short_and_shows_misses_first(finished, tmp_path):
    _, _, lines = finished
    publish(lines, tmp_path, tmp_path)
    text = (tmp_path / PAGE).read_text()
    assert len(re.findall(r"\S*[A-Za-z]\S*", text)) <= 1500
    rows = [line for line in text.splitlines() if line.startswith("| ") and "%" in line][1:]
    assert "**" in rows[0]
    assert lines[-1]["hash"] in text


def test_the_page_says_which_trials_ended_in_an_error_and_in_which():
    ends = {3: "FitError: no echo\nat line 2", 5: None, 7: "the process ended: exit code -15", 9: "FitError: no echo"}
    said = failures([{"trial": trial, "error": error} for trial, error in ends.items()])
    assert said == "3 trials ended in an error (3, 9: FitError: no echo; 7: the process ended: exit code -15)."
    assert failures([{"trial": 0, "error": None}]) == ""
