"""Metres in a column of millimetres are valid numbers; each command that reads them says so."""

import numpy as np
import pytest

from acquisition import Ping, Reading, Recording
from training.cli import main

COMMANDS = {
    "plot": ["plot", "{}", "--out", "figures"],
    "import": ["import", "{}", "--out", "o.csv", "--columns", "distance_mm=distance_mm", "reading_mm=reading_mm",
               "angle_deg=angle_deg"],
    "convert": ["import", "{}", "--out", "o.csv"],
}  # fmt: skip


@pytest.fixture
def survey():
    distance = np.repeat(np.arange(0.3, 3.0, 0.3), 4)
    return Recording.of(Ping.of(distance), Reading.of(distance))


def told(capsys, command, recording):
    """Return the warnings that a command prints about a recording."""
    main([word.format(recording.save("rec.csv")) for word in COMMANDS[command]])
    return [line for line in capsys.readouterr().out.splitlines() if line.startswith("warning: ")]


@pytest.mark.parametrize("command", COMMANDS)
def test_a_command_warns_of_metres(tmp_path, monkeypatch, capsys, survey, command):
    monkeypatch.chdir(tmp_path)
    assert told(capsys, command, survey) == []
    metres = Recording(survey.table.assign(reading_mm=survey.table.reading_mm / 1000))
    small, ratio = told(capsys, command, metres)
    assert "no value of reading_mm exceeds 20 mm" in small
    assert "reading_mm=...:m" in small
    assert "0.001 times distance_mm" in ratio


def test_a_long_recording_is_in_metres_if_all_of_it_is(tmp_path, monkeypatch, capsys, survey):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("training.recordings.import_log.read_chunks", lambda *_: iter([near, survey]))
    near = Recording(survey.table.assign(distance_mm=15.0, reading_mm=15.0))
    assert told(capsys, "convert", survey) == []
