"""Real recordings are read from the folder that an environment variable names, with one fact hidden."""

import numpy as np
import pandas as pd

from tests.training.proof.conftest import stub_verdict
from training.proof.real import FOLDER, available, diagnosed_case


def test_without_a_folder_there_are_no_cases(monkeypatch):
    monkeypatch.delenv(FOLDER, raising=False)
    assert available() == []


def test_echo_times_stand_for_the_simulation(monkeypatch, tmp_path):
    folder = tmp_path / "hcsr04-ten-distances"
    folder.mkdir()
    for mark in (10, 20):
        times = np.arange(5) + 2.0 * mark / 0.0343
        pd.DataFrame({"cm": mark, "us": times}).to_csv(folder / f"{mark}cm.csv", index=False)
    monkeypatch.setenv(FOLDER, str(tmp_path))
    seen = {}

    def diagnose(files):
        seen.update(files)
        return stub_verdict("quantisation"), b""

    (case,) = available()
    line = diagnosed_case(case, diagnose)
    assert line["accepted"] == ["quantisation", "truncation"]
    assert set(seen) == set(line["files"]) == {"simulated.csv", "recorded.csv"}
    assert b"truncat" not in b"".join(seen.values())
