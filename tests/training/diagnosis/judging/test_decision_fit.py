"""The fit recovers a decision model and a temperature that made the trials, and states how well it does elsewhere."""

import json
from dataclasses import asdict, fields

import numpy as np
import pytest

from acquisition import SettingError
from noise.discrepancy.evidence import Evidence
from noise.discrepancy.judge.decision import DecisionModel
from training.diagnosis.judging.decision_fit import examples_of, temperature_of, true_places
from training.diagnosis.judging.fit_command import Args, fitted, main
from training.diagnosis.judging.run import append

from .conftest import EVIDENCE, OFFSET, SCALE, cause

TEMPERATURE = 3.0


@pytest.fixture
def records(record):
    """Trials in which a true cause has odds exp(8 sqrt(p_after) - 4), and posteriors overstate evidence three times."""
    rng = np.random.default_rng(0)
    made = []
    for k in range(900):
        root = float(rng.uniform())
        true = rng.random() < 1.0 / (1.0 + np.exp(4.0 - 8.0 * root))
        lead = float(rng.normal(0.0, 8.0))
        swapped = true and rng.random() < 1.0 / (1.0 + np.exp(lead / TEMPERATURE))
        selected = "spike" if swapped or not true else "zero_offset"
        other = "zero_offset" if swapped else "quantisation"
        made.append(
            record(
                ("beam", "rig", "ruler")[k % 3],
                number=k,
                causes=(OFFSET,) if true else (),
                named=[cause(selected)],
                evidence={selected: EVIDENCE | {"p_after": root**2, "lead": lead}},
                posteriors={selected: {other: -lead}},
            )
        )
    return made


def test_the_temperature_is_recovered(records):
    assert temperature_of(records) == pytest.approx(TEMPERATURE, rel=0.25)


def test_probabilities_of_families_left_out_are_calibrated(records):
    model, card, _ = fitted(records)
    roots = (0.25, 0.5, 0.75)
    stated = [model.probability(Evidence(**(EVIDENCE | {"p_after": root**2, "lead": 0.0}))) for root in roots]
    assert stated == pytest.approx([0.12, 0.5, 0.88], abs=0.12)
    assert card["ece"] < 0.05
    assert card["brier"] < 0.14  # of the true probabilities 0.12
    assert card["families used"] == ["beam", "rig", "ruler"]
    assert card["families left out"] == ["fixed", "driving"]


def test_each_cause_counts_in_one_place(record):
    both = record(causes=(SCALE,), named=[cause("sound_speed"), cause("spike", 0.6)])
    both["posteriors"] = {"sound_speed": {"spike": -50.0}, "spike": {"clock_scale": -0.1}}
    assert true_places(both, 1.0) == {"sound_speed"}
    beside = record(causes=(OFFSET,), named=[cause("spike")], posteriors={"spike": {"zero_offset": -400.0}})
    assert true_places(beside, 1.0) == set()


def test_too_few_trials_are_an_error(record):
    with pytest.raises(SettingError, match="run more trials"):
        examples_of([record()], 1.0)
    with pytest.raises(SettingError, match="no finished trials"):
        fitted([])


def test_the_command_writes_weights_a_card_and_a_picture(records, tmp_path, capsys):
    for each in records[:200]:
        append(tmp_path / "records.jsonl", each)
    main(Args(out=tmp_path, n=0, weights=tmp_path / "weights.json", picture=tmp_path / "picture.png"))
    written = json.loads((tmp_path / "weights.json").read_text())
    assert DecisionModel.from_dict(written["model"]).temperature > 0
    assert {"n", "brier", "ece", "reliability", "command", "commit"} <= written["card"].keys()
    assert (tmp_path / "picture.png").read_bytes().startswith(b"\x89PNG")
    assert asdict(Evidence(**EVIDENCE)).keys() == {each.name for each in fields(Evidence)}
    assert "ece" in capsys.readouterr().out
