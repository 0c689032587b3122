"""Nobody can change a ledger afterwards, and no kill can break it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from training.proof.seal import (
    OPENED,
    SEALED,
    VERDICT,
    Ledger,
    LedgerError,
    check,
    hash_of,
    read,
    salt_of,
    seed_of,
    written,
)

SETTINGS = {"commit": "abc", "seed": 0, "nonce": "word"}


def steps(trial: int, said: str = "none") -> list[tuple[str, dict[str, Any]]]:
    """Return the three steps of a trial."""
    answer, salt, verdict = {"kind": "null", "trial": trial}, salt_of(f"secret {trial}"), {"verdict": said}
    return [
        (SEALED, {"trial": trial, "answer_sha256": hash_of(answer, salt)}),
        (VERDICT, {"trial": trial, "verdict": verdict, "verdict_sha256": hash_of(verdict)}),
        (OPENED, {"trial": trial, "answer": answer, "salt": salt}),
    ]


def kept(path: Path, trials: int = 3) -> str:
    """Write a ledger and return its text."""
    ledger = Ledger.open(path, SETTINGS)
    for trial in range(trials):
        for event, content in steps(trial):
            ledger.append(event, **content)
    ledger.close()
    return path.read_text()


def test_secrets_follow_from_every_part_of_what_they_are_made_of():
    whole = ("commit", 1, "nonce", 7)
    others = [
        ("commitb", 1, "nonce", 7),
        ("commit", 2, "nonce", 7),
        ("commit", 1, "noncf", 7),
        ("commit", 1, "nonce", 8),
    ]
    secrets = [seed_of(*each) for each in (whole, *others)]
    assert len(set(secrets)) == 5
    assert seed_of(*whole) == secrets[0]
    assert salt_of(secrets[0]) not in secrets[0]


def test_a_ledger_that_was_closed_goes_on_where_it_was(tmp_path):
    kept(tmp_path / "ledger", 2)
    ledger = Ledger.open(tmp_path / "ledger", SETTINGS)
    assert sorted(ledger.of(OPENED)) == [0, 1]
    ledger.close()


@given(cut=st.integers(0, 10_000))
def test_whatever_a_kill_leaves_of_a_ledger_can_be_opened(tmp_path_factory, cut):
    folder = tmp_path_factory.mktemp("torn")
    text = kept(folder / "whole", 2)
    (folder / "torn").write_text(text[: cut % (len(text) + 1)])
    ledger = Ledger.open(folder / "torn", SETTINGS)
    whole = text[: cut % (len(text) + 1)].count("\n")
    assert len(ledger.lines) == max(whole, 1)
    ledger.append("more")
    ledger.close()
    read((folder / "torn").read_text(), "torn")


@given(data=st.data())
def test_no_line_can_be_changed_left_out_or_doubled(tmp_path_factory, data):
    folder = tmp_path_factory.mktemp("forged")
    lines = kept(folder / "ledger").splitlines()
    at = data.draw(st.integers(0, len(lines) - 2))
    what = data.draw(st.sampled_from(["change", "drop", "double", "swap"]))
    forged = list(lines)
    if what == "change":
        line = {**json.loads(lines[at]), "event": "something else"}
        forged[at] = written(line)
    elif what == "drop":
        del forged[at]
    elif what == "double":
        forged.insert(at, lines[at])
    else:
        forged[at], forged[at + 1] = forged[at + 1], forged[at]
    with pytest.raises(LedgerError, match="line"):
        read("\n".join(forged) + "\n", "forged")


def test_two_runs_cannot_share_a_ledger(tmp_path):
    ledger = Ledger.open(tmp_path / "ledger", SETTINGS)
    with pytest.raises(LedgerError, match="another process"):
        Ledger.open(tmp_path / "ledger", SETTINGS)
    ledger.close()


def test_a_run_of_other_settings_needs_another_folder(tmp_path):
    kept(tmp_path / "ledger")
    with pytest.raises(LedgerError, match="choose another --out"):
        Ledger.open(tmp_path / "ledger", {**SETTINGS, "nonce": "other"})


def test_a_whole_ledger_passes(tmp_path):
    check(read(kept(tmp_path / "ledger"), "ledger"))


@pytest.mark.parametrize(
    ("order", "told"),
    [
        ([1, 0, 2], "judged before it was sealed"),
        ([0, 2, 1], "opened before it was judged"),
        ([0, 0, 1, 2], "sealed twice"),
        ([0, 1, 1, 2], "judged before it was sealed, or twice"),
    ],
)
def test_steps_out_of_order_are_told(order, told):
    lines = [{"event": steps(4)[k][0], **steps(4)[k][1]} for k in order]
    with pytest.raises(LedgerError, match=told):
        check(lines)


@pytest.mark.parametrize(
    ("step", "key", "told"), [(1, "verdict", "verdict does not match"), (2, "answer", "answer does")]
)
def test_an_answer_or_verdict_that_does_not_match_its_hash_is_told(step, key, told):
    lines = [{"event": event, **content} for event, content in steps(0)]
    lines[step][key] = {**lines[step][key], "changed": True}
    with pytest.raises(LedgerError, match=told):
        check(lines)
