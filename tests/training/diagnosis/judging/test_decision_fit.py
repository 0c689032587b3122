"""The fit recovers the decision model that made the trials, and states how well it does elsewhere."""

import json
from dataclasses import asdict, fields

import numpy as np
import pytest
from sklearn.linear_model import LogisticRegression

from acquisition import SettingError
from noise.discrepancy.evidence import Evidence
from noise.discrepancy.judge.decision import DecisionModel
from training.diagnosis.judging.decision_fit import RisingRegression, examples_of, true_places
from training.diagnosis.judging.fit_command import Args, fitted, main
from training.diagnosis.judging.run import append

from .conftest import EVIDENCE, OFFSET, SCALE, cause


@pytest.fixture
def records(record):
    """Trials in which a true cause has odds exp(4 log(1 + t) - 8), with t its gain in standard errors."""
    rng = np.random.default_rng(0)
    made = []
    for k in range(900):
        log_t = float(rng.uniform(1.0, 3.0))
        true = rng.random() < 1.0 / (1.0 + np.exp(8.0 - 4.0 * log_t))
        swapped = true and rng.random() < 0.3
        selected = "spike" if swapped or not true else "zero_offset"
        other = "zero_offset" if swapped else "quantisation"
        made.append(
            record(
                ("beam", "rig", "ruler")[k % 3],
                number=k,
                causes=(OFFSET,) if true else (),
                named=[cause(selected)],
                evidence={selected: EVIDENCE | {"gain": EVIDENCE["gain_error"] * np.expm1(log_t)}},
                likely={selected: {selected: 0.7, other: 0.3}},
            )
        )
    return made


def test_probabilities_of_families_left_out_are_calibrated(records):
    model, card = fitted(records)
    sizes = (1.5, 2.0, 2.5)
    gains = [EVIDENCE["gain_error"] * np.expm1(size) for size in sizes]
    stated = [model.probability(Evidence(**(EVIDENCE | {"gain": gain}))) for gain in gains]
    assert stated == pytest.approx([0.12, 0.5, 0.88], abs=0.12)
    assert card["ece"] < 0.05
    assert card["brier"] < 0.14  # of the true probabilities 0.12
    assert card["families used"] == ["beam", "rig", "ruler"]
    assert card["families left out"] == ["fixed", "driving"]


def test_better_evidence_is_never_worse_however_features_are_correlated():
    rng = np.random.default_rng(3)
    first = rng.normal(size=400)
    feature = np.stack([first, first + 0.3 * rng.normal(size=400), rng.normal(size=400)], axis=1)
    true = rng.random(400) < 1.0 / (1.0 + np.exp(-3.0 * feature[:, 0] + 1.0 * feature[:, 1] - feature[:, 2]))
    free, rising = (kind(C=10.0).fit(feature, true) for kind in (LogisticRegression, RisingRegression))
    assert free.coef_[0][1] < 0.0
    assert (rising.coef_[0] >= 0.0).all()
    alone = LogisticRegression(C=10.0).fit(feature[:, [0, 2]], true)
    assert rising.coef_[0][[0, 2]] == pytest.approx(alone.coef_[0], abs=1e-3)


def test_records_that_hold_more_than_is_needed_are_used(records):
    more = [{**r, "evidence": {k: {**e, "of_another_version": 1.0} for k, e in r["evidence"].items()}} for r in records]
    assert np.array_equal(examples_of(more).feature, examples_of(records).feature)


def test_a_part_of_a_fault_is_neither_right_nor_wrong(records, record):
    named = [cause("stale_repeat"), cause("spike")]
    fault = record(kind="unmodelled", causes=(), named=named, fault="hold of the reading before where it is warm")
    before, after = examples_of(records), examples_of([*records, fault])
    assert len(after.true) == len(before.true) + 1  # the spike, which is wrong
    assert not after.true[-1]


def test_each_cause_counts_in_one_place(record):
    both = record(causes=(SCALE,), named=[cause("sound_speed"), cause("spike", 0.6)])
    both["likely"] = {"sound_speed": {"sound_speed": 1.0}, "spike": {"spike": 0.6, "clock_scale": 0.4}}
    assert true_places(both) == {"sound_speed"}
    unlikely = {"spike": {"spike": 0.99, "zero_offset": 0.01}}
    beside = record(causes=(OFFSET,), named=[cause("spike")], likely=unlikely)
    assert true_places(beside) == set()


def test_too_few_trials_are_an_error(record):
    with pytest.raises(SettingError, match="run more trials"):
        examples_of([record()])
    with pytest.raises(SettingError, match="no finished trials"):
        fitted([])


def test_the_command_writes_weights_a_card_and_a_picture(records, tmp_path, capsys):
    for each in records[:200]:
        append(tmp_path / "records.jsonl", each)
    main(Args(out=tmp_path, n=0, weights=tmp_path / "weights.json", picture=tmp_path / "picture.png"))
    written = json.loads((tmp_path / "weights.json").read_text())
    assert DecisionModel.from_dict(written["model"]).intercept
    assert {"n", "brier", "ece", "reliability", "command", "commit"} <= written["card"].keys()
    assert (tmp_path / "picture.png").read_bytes().startswith(b"\x89PNG")
    assert asdict(Evidence(**EVIDENCE)).keys() == {each.name for each in fields(Evidence)}
    assert "ece" in capsys.readouterr().out
