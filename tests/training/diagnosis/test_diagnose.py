"""The command `sonar-gym diagnose`: output files, printed summary, error messages."""

import json
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import gymnasium
import numpy as np
import pytest

import sonar_gym  # noqa: F401  (registers the environment)
from acquisition import Ping, Reading, Recording, SettingError
from noise import load_model
from noise.discrepancy.name.explanation import Interval
from noise.effects import CATALOGUE
from noise.physical import PhysicalModel
from training.cli import main
from training.diagnosis.diagnose import simulator_of
from training.diagnosis.report import by_chance, certainty, interval, parameter


def diagnose(*arguments):
    return subprocess.run(
        [sys.executable, "-m", "training.cli", "diagnose", *map(str, arguments)],
        capture_output=True,
        text=True,
        timeout=280,
    )


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A diagnosis of an ideal sonar against readings that are 25 mm long and scatter."""
    folder = tmp_path_factory.mktemp("diagnosis")
    rng = np.random.default_rng(0)
    distance = np.repeat(rng.uniform(0.3, 3.0, 32), 4)
    truth = PhysicalModel([CATALOGUE["zero_offset"](offset_m=0.025), CATALOGUE["travel_time_jitter"](sigma_m=0.003)])
    ping = Ping.of(distance=distance, angle=np.repeat(rng.uniform(0, 0.3, 32), 4))
    Recording.of(ping, truth.law(ping).sample(rng)).save(folder / "recorded.csv")
    return folder / "out", diagnose(folder / "recorded.csv", "--out", folder / "out", "--seed", 1)


def test_the_summary_names_the_cause_in_a_few_lines(finished):
    _, done = finished
    assert done.returncode == 0, done.stderr
    lines = done.stdout.strip().splitlines()
    assert 4 <= len(lines) <= 12
    assert "offset of +2" in lines[1]
    assert any("nats" in line for line in lines)


def test_the_verdict_contains_the_offset(finished):
    verdict = json.loads((finished[0] / "verdict.json").read_text())
    offset = verdict["effects"][0]["parameters"]["offset_m"]
    assert offset["value"] == pytest.approx(0.025, abs=0.002)
    assert offset["low"] < offset["value"] < offset["high"]


def test_the_page_is_self_contained(finished):
    page = (finished[0] / "report.html").read_text()
    assert len(page) < 1_500_000
    assert page.count("<svg") == 8
    links = [part.split('"')[0] for part in page.split('href="')[1:] + page.split('src="')[1:]]
    assert all(link.startswith(("#", "data:")) for link in links)
    assert "<script" not in page


def test_the_corrected_model_loads_and_runs_in_the_environment(finished):
    model = load_model(finished[0] / "corrected")
    middle = model.law(Ping.of(distance=[1.0, 2.0])).quantile(0.5)
    assert np.allclose(middle, [1.025, 2.025], atol=0.003)
    environment = gymnasium.make("SonarParking-v0", sonar=str(finished[0] / "corrected"))
    observation, _ = environment.reset(seed=0)
    environment.step(environment.action_space.sample())
    assert observation is not None
    environment.close()


def test_a_recording_without_echoes_has_no_empty_figures(tmp_path, capsys):
    rng = np.random.default_rng(2)
    distance = np.repeat(rng.uniform(0.3, 3.0, 24), 4)
    Recording.of(Ping.of(distance=distance), Reading.of(np.zeros(len(distance)))).save(tmp_path / "silent.csv")
    main(["diagnose", str(tmp_path / "silent.csv"), "--out", str(tmp_path / "out")])
    assert "None of 96 pings had an echo" in capsys.readouterr().out
    page = (tmp_path / "out" / "report.html").read_text()
    assert page.count("<svg") == 5  # two maps, readings, detection and credence; there are no errors to draw
    assert "PIT histogram" not in page


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
    assert not (tmp_path / "out" / "verdict.json").exists()


def test_the_exit_code_of_an_error_is_2_without_a_traceback(tmp_path):
    path = tmp_path / "recorded.csv"
    path.write_text(BROKEN["text in a number"][0])
    done = diagnose(path, "--out", tmp_path / "out")
    assert done.returncode == 2
    assert len(done.stderr.strip().splitlines()) == 1
    assert "Traceback" not in done.stderr


def test_numbers_have_their_unit():
    assert interval(Interval(0.0123, 0.01, 0.02, "m")) == "12.3 mm (10 to 20)"
    assert interval(Interval(24.1, 23.6, 24.6, "degC")) == "24.1 °C (23.6 to 24.6)"
    assert "one recording in 1,000" in certainty(0.001)
    assert "not significant" in certainty(0.5)


def test_unexplained_structure_is_significant():
    present = SimpleNamespace(present=True, p_value=4e-10)
    assert "not significant" not in certainty(by_chance(SimpleNamespace(p_value=0.27, unknown=present)))
    none = SimpleNamespace(present=False, p_value=0.4)
    assert "not significant" in certainty(by_chance(SimpleNamespace(p_value=0.27, unknown=none)))


def test_a_unit_is_not_repeated_in_the_name_of_a_parameter():
    labels = {parameter(p.name, p.unit) for effect in CATALOGUE.values() for p in effect.parameters}
    assert {"offset", "temperature", "rate", "sigma at 6m", "behind", "per metre"} <= labels
    assert not [label for label in labels if label.split()[-1] in ("m", "s", "k", "db", "deg", "c", "h")]


def test_a_function_of_the_user_is_a_simulator(tmp_path, monkeypatch):
    (tmp_path / "mine.py").write_text(
        "def sonar(pings, rng):\n    return pings.distance + rng.normal(0, 0.003, len(pings))\n"
    )
    monkeypatch.chdir(tmp_path)
    assert simulator_of(Path("mine:sonar"))(Ping.of(distance=[1.0]), np.random.default_rng(0)).shape == (1,)
    assert simulator_of(Path("mine.csv")) is None
    for wrong in ("mine:nothing", "nowhere:sonar"):
        with pytest.raises(SettingError, match="module:function"):
            simulator_of(Path(wrong))
