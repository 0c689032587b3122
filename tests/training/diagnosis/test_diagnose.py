"""The command `sonar-gym diagnose`: output files, printed summary, error messages."""

import json
import subprocess
import sys
from pathlib import Path

import gymnasium
import numpy as np
import pytest

import sonar_gym  # noqa: F401  (registers the environment)
from acquisition import Ping, Recording, SettingError
from noise import load_model
from noise.discrepancy.result import SCHEMA
from training.cli import main
from training.diagnosis.diagnose import simulator_of


@pytest.fixture
def finished(situations, tmp_path, monkeypatch, capsys):
    """The command's output folder and text for a diagnosis that is made beforehand."""

    def run(name):
        asked = {}

        def diagnose(model, recording, **options):
            asked.update(model=model, recording=recording, **options)
            options["progress"]("fitting", 0.5)
            return situations[name]

        monkeypatch.setattr("training.diagnosis.diagnose.diagnose", diagnose)
        recording = Recording.of(Ping.of(distance=[1.0, 2.0]), situations[name].recorded.reading[:2])
        recording.save(tmp_path / "recorded.csv")
        main(["diagnose", str(tmp_path / "recorded.csv"), "--out", str(tmp_path / "out"), "--seed", "1"])
        return tmp_path / "out", capsys.readouterr().out, asked

    return run


@pytest.mark.parametrize("name", ["partly", "too_little", "silent"])
def test_the_summary_is_short_and_without_jargon(finished, name):
    lines = finished(name)[1].strip().splitlines()
    assert 2 <= len(lines) <= 12
    assert not any(word in line for line in lines for word in ("nats", "p =", "CRPS", "nan"))
    assert lines[-1].startswith("report: ")


def test_settings_reach_the_diagnosis(finished):
    _, _, asked = finished("silent")
    assert asked["seed"] == 1
    assert asked["simulated"] is None
    assert len(asked["recording"]) == 2


def test_the_verdict_is_of_schema_2(finished):
    verdict = json.loads((finished("scale")[0] / "verdict.json").read_text())
    assert verdict["schema"] == SCHEMA == 2
    assert verdict["summary"].startswith("Readings run long by 1.5 % (15 mm at 1 m)")
    assert verdict["causes"][0]["alternatives"][0]["effect"] == "clock_scale"


def test_the_corrected_model_loads_and_runs_in_the_environment(finished):
    out, text, _ = finished("scale")
    assert str(out / "corrected") in text
    middle = load_model(out / "corrected").law(Ping.of(distance=[1.0, 2.0])).quantile(0.5)
    assert np.allclose(middle, [1.0152, 2.0304], atol=0.002)
    environment = gymnasium.make("SonarParking-v0", sonar=str(out / "corrected"), credence_driver=None)
    environment.reset(seed=0)
    environment.step(environment.action_space.sample())
    environment.close()


def test_no_model_is_written_if_no_correction_is_offered(finished):
    out, text, _ = finished("unexplained")
    assert "no correction is offered" in text
    assert not (out / "corrected").exists()
    assert (out / "report.html").is_file()


HEAD = "distance_mm,angle_deg,reading_mm\n"
BROKEN = {
    "missing file": (None, "no such file"),
    "empty file": ("", "empty"),
    "no rows": (HEAD, "no rows"),
    "missing column": ("distance_mm,reading_mm\n1000,1000\n", "angle_deg is missing"),
    "text in a number": (HEAD + "1000,0,1000\n1000,0,soon\n", "line 3, column reading_mm: 'soon'"),
    "not a number": (HEAD + "nan,0,1000\n", "column distance_mm: 'nan'"),
    "negative distance": (HEAD + "-5,0,1000\n", "column distance_mm: '-5'"),
    "no answer at all": (HEAD + "1000,0,\n1000,0,\n", "no ping was answered"),
}


@pytest.mark.parametrize(("content", "message"), BROKEN.values(), ids=BROKEN)
def test_an_invalid_recording_is_an_error_message_of_one_line(tmp_path, capsys, content, message):
    path = tmp_path / "recorded.csv"
    if content is not None:
        path.write_text(content)
    with pytest.raises(SystemExit) as stop:
        main(["diagnose", str(path), "--out", str(tmp_path / "out")])
    error = capsys.readouterr().err.strip()
    assert stop.value.code == 2
    assert len(error.splitlines()) == 1
    assert message in error
    assert not (tmp_path / "out").exists()


def test_the_exit_code_of_an_error_is_2_without_a_traceback(tmp_path):
    path = tmp_path / "recorded.csv"
    path.write_text(BROKEN["text in a number"][0])
    command = [sys.executable, "-m", "training.cli", "diagnose", str(path), "--out", str(tmp_path / "out")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert done.returncode == 2
    assert len(done.stderr.strip().splitlines()) == 1
    assert "Traceback" not in done.stderr


def test_a_function_of_the_user_is_a_simulator(tmp_path, monkeypatch):
    (tmp_path / "mine.py").write_text(
        "def sonar(pings, rng):\n    return pings.distance + rng.normal(0, 0.003, len(pings))\n"
    )
    monkeypatch.chdir(tmp_path)
    assert simulator_of(Path("mine:sonar"))(Ping.of(distance=[1.0]), np.random.default_rng(0)).shape == (1,)
    assert simulator_of(Path("mine.csv")) is None
    (tmp_path / "faulty.py").write_text("def sonar(:\n")
    for wrong in ("mine:nothing", "nowhere:sonar", "faulty:sonar", ":sonar", "a:b:c", "tcp://localhost", "tcp://x:y"):
        with pytest.raises(SettingError, match="module:function"):
            simulator_of(Path(wrong))
