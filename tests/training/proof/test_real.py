"""Real recordings are made without what is hidden, and scores are those of what was hidden."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from acquisition import Ping, Reading, Recording, SettingError
from noise.effects.medium import ASSUMED_TEMPERATURE_C, CELSIUS
from training.diagnosis.prove_real import Args, main, page
from training.proof.real import CASES, against_air

WEATHER = ("temp", "air", "humid", "rh_", "logger", "interval", "obs", "velocity", "sw_up")


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_what_is_hidden_is_not_in_the_recording(real_recordings, case):
    hidden = case.made(real_recordings / case.name)
    assert len(hidden.recorded) >= 150
    assert not [name for name in hidden.recorded.table.columns if any(word in name for word in WEATHER)]


def test_the_air_over_the_ground_is_recovered_from_readings_alone(real_recordings):
    case = next(case for case in CASES if case.name == "fixed-ranger-copenhagen")
    score = case.made(real_recordings / case.name).score
    assert score is not None
    assert score["segment 2: correlation with the air"] > 0.9
    assert score["segment 2: root mean square error, K"] < 0.6 * score["segment 2: the air's own standard deviation, K"]


def test_a_course_that_is_right_scores_as_right():
    time = np.arange(0.0, 4 * 86400.0, 600.0)
    air = 12.0 + 5.0 * np.sin(2.0 * np.pi * time / 86400.0)
    kelvin = CELSIUS + ASSUMED_TEMPERATURE_C
    read = 2.0 * np.sqrt(kelvin / (kelvin + air - 12.0))
    recording = Recording.of(Ping.of(np.full(len(time), 2.0), time=time), Reading.of(read))
    score = against_air(recording, air)
    assert score["segment 1: correlation with the air"] > 0.999
    assert score["segment 1: root mean square error, K"] < 0.1


def told(verdict: str, *effects: str) -> dict[str, Any]:
    score = {"crps_mm": 2.0}
    each = [{"effect": name, "indistinguishable_from": []} for name in effects]
    held = {"before": score, "after": {"crps_mm": 1.0}}
    return {
        "verdict": {"verdict": verdict, "effects": each, "unknown": {"description": None}, "held_out": held},
        "score": {},
    }


@pytest.mark.parametrize(
    ("verdict", "effects", "fits"),
    [
        ("named", ("truncation",), "| yes |"),
        ("named_with_rest", ("truncation", "spike"), "| in part: also spike |"),
        ("named", ("spike",), "| no |"),
        ("unknown", (), "| no |"),
    ],
)
def test_the_page_says_plainly_what_fits(verdict, effects, fits):
    case = next(case for case in CASES if "truncation" in case.expected)
    assert fits in page([case], {case.name: told(verdict, *effects)})


def test_a_folder_without_recordings_is_told(tmp_path):
    with pytest.raises(SettingError, match="contains none of"):
        main(Args(tmp_path, tmp_path / "out"))
