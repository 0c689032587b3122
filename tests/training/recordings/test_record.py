"""`sonar-gym record` from end to end."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from acquisition import DeviceError, EchoStatus, NoAnswerError, Ping, Reading, Recording
from acquisition.drivers import Echoes
from acquisition.survey.plan import SurveyPlan
from acquisition.survey.planfile import find_plan
from acquisition.survey.session import Session
from acquisition.survey.sources import DriverSource, VisitData
from training.cli import main
from training.common.progress import TERMINAL
from training.recordings import record
from training.recordings.live import visit_line
from training.recordings.record import measure

FEW = ["--pings", "2", "--interval-s", "1"]


@pytest.mark.parametrize("driver", ["rig", "twin"])
def test_records_the_quick_plan(tmp_path, capsys, driver):
    path = tmp_path / "r.csv"
    main(["record", "--driver", driver, "--out", str(path), "--unit", "5", "--gain", "20", "--sensor", "left", *FEW])
    assert "240 pings on 120 conditions" in capsys.readouterr().out
    recording = Recording.load(path)
    assert set(recording.table["sensor"]) == {"left"}
    assert recording.ping.covariates["gain"] == pytest.approx(np.full(240, 20.0))
    near = (recording.ping.angle == 0) & (recording.ping.distance < 1.0) & recording.reading.echo
    assert near.sum() > 10
    assert np.abs(recording.reading.range - recording.ping.distance)[near].max() < 0.08


def test_the_seed_determines_the_file_and_resuming_a_complete_one_changes_nothing(tmp_path, capsys):
    paths = [tmp_path / "a.csv", tmp_path / "b.csv"]
    for path in paths:
        main(["record", "--out", str(path), "--seed", "1", *FEW])
    first = paths[0].read_bytes()
    assert first == paths[1].read_bytes()
    capsys.readouterr()
    with pytest.raises(SystemExit):
        main(["record", "--out", str(paths[0]), "--seed", "1", *FEW])
    error = capsys.readouterr().err.strip()
    assert error.endswith("a.csv: exists already; continue it with --resume or give another file")
    main(["record", "--out", str(paths[0]), "--seed", "1", "--resume", *FEW])
    assert paths[0].read_bytes() == first


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--gain", "49"], "--gain: expected a whole number from 0 to 31, got 49"),
        (["--driver", "srf08", "--port", "/dev/i2c-987"], "/dev/i2c-987"),
        (
            ["--driver", "srf08", "--port", "/dev/i2c-987", "--address", "224"],
            "--address: expected a whole number from 112 to 127, got 224",
        ),
        (
            ["--driver", "twin", "--resume"],
            "--resume does not work with --driver twin, which does not save its state; delete",
        ),
    ],
)
def test_an_invalid_setting_is_an_error_message_of_one_line(tmp_path, capsys, options, message):
    with pytest.raises(SystemExit) as stop:
        main(["record", "--out", str(tmp_path / "r.csv"), *options])
    assert stop.value.code == 2
    error = capsys.readouterr().err.strip()
    assert message in error
    assert "\n" not in error
    assert not Path(tmp_path / "r.csv").exists()


def test_a_plan_from_a_file_sweeps_a_register(tmp_path, capsys):
    plan = tmp_path / "p.toml"
    plan.write_text("distances_mm = [500, 900]\nangles_deg = [0]\npings = 3\nseed = 7\n[sweep]\ngain = [0, 31]\n")
    for driver in ("rig", "twin"):
        path = tmp_path / f"{driver}.csv"
        main(["record", "--driver", driver, "--plan", str(plan), "--out", str(path)])
        assert "24 pings on 8 conditions" in capsys.readouterr().out
        table = Recording.load(path).table
        assert sorted(set(table["gain"])) == [0, 31]
        assert table["temperature_c"].notna().all()


def test_an_invalid_plan_is_an_error_message_of_one_line(tmp_path, capsys):
    plan = tmp_path / "p.toml"
    plan.write_text("distances_mm = [500]\nangles_deg = [0]\n[sweep]\ngain = [99]\n")
    with pytest.raises(SystemExit) as stop:
        main(["record", "--plan", str(plan), "--out", str(tmp_path / "r.csv")])
    error = capsys.readouterr().err
    assert stop.value.code == 2
    assert "p.toml, sweep.gain: expected a whole number from 0 to 31, got 99" in error
    assert error.count("\n") == 1


@pytest.mark.parametrize("fault", [DeviceError("/dev/ttyACM0: gone"), NoAnswerError("sonar: no acknowledge")])
def test_a_lost_connection_reports_what_is_on_disk_and_how_to_resume(tmp_path, fault):
    class Unplugged:
        pings = 0

        def ping(self):
            self.pings += 1
            if self.pings > 5 + 4 + 1:
                raise fault
            return Echoes((1.0,))

    plan = SurveyPlan((0.0,), (500.0, 700.0, 900.0), (0.9,), pings=2)
    source = DriverSource(Unplugged(), sleep=lambda s: None, patience=1)
    with pytest.raises(type(fault), match=r"; 2 of 3 conditions are on disk; continue with --resume"):
        measure(Session(plan, source, tmp_path / "r.csv"), lambda done, total: None)
    assert len(Recording.load(tmp_path / "r.csv")) == 4


def test_an_interrupted_twin_is_recorded_again(tmp_path, capsys, monkeypatch):
    def interrupt(*_):
        raise KeyboardInterrupt

    command = ["record", "--driver", "twin", "--out", str(tmp_path / "r.csv"), *FEW]
    monkeypatch.setattr(Session, "run", interrupt)
    with pytest.raises(SystemExit):
        main(command)
    assert "0 of 120 conditions are on disk; delete the file or give another" in capsys.readouterr().err
    (tmp_path / "r.csv").write_text("")
    with pytest.raises(SystemExit):
        main(command)
    assert "r.csv: exists already; delete the file or give another" in capsys.readouterr().err


def test_a_survey_with_an_operator(tmp_path, capsys, monkeypatch):
    """A lost and repaired connection, a repeated condition and a postponed one in one session."""

    class Sonar:
        pings, gain, range_register = 0, 14, 140

        def ping(self):
            self.pings += 1
            if 16 <= self.pings < 26:
                raise NoAnswerError("sonar: no acknowledge")
            return Echoes((1.0 + self.pings / 1000.0,))

    def source(args):
        return DriverSource(Sonar(), sleep=lambda s: None)

    given = iter(["", "", "r", "", "", "s", "q"])
    monkeypatch.setattr(TERMINAL, "input", lambda *_, **__: next(given))
    monkeypatch.setitem(record.SOURCES, "srf08", source)
    plan, path = tmp_path / "p.toml", tmp_path / "r.csv"
    plan.write_text("distances_mm=[500, 900, 1300, 1700]\nangles_deg=[0]\nreflectances=[0.9]\npings=5\norder='walk'\n")
    command = ["record", "--driver", "srf08", "--plan", str(plan), "--out", str(path)]
    main(command)
    output = capsys.readouterr()
    assert "10 pings on 2 conditions; 100.0 % with echo" in output.out
    assert "2 of 4 conditions are not measured yet: continue with --resume" in output.out
    table = Recording.load(path).table
    # 5 test pings, 5 for each of two conditions; the second is repeated, fails for 10 pings, then has pings 26 to 30
    assert table["reading_mm"].tolist() == [1000.0 + k for k in (*range(6, 11), *range(26, 31))]
    assert table["distance_mm"].tolist() == [500.0] * 5 + [900.0] * 5
    monkeypatch.setattr(TERMINAL, "input", lambda *_, **__: "")
    main([*command, "--resume"])
    assert "20 pings on 4 conditions" in capsys.readouterr().out
    assert Recording.load(path).table["session"].tolist() == ["0"] * 10 + ["1"] * 10


def test_the_loose_plan_makes_a_valid_recording(tmp_path, capsys):
    path = tmp_path / "r.csv"
    main(["record", "--plan", "loose", "--pings", "30", "--out", str(path)])
    recording = Recording.load(path)
    loose = recording.table["loose_share"]
    lost = ~recording.reading.answered
    assert not lost[loose == 0.0].any()
    assert lost[loose == 0.3].mean() == pytest.approx(0.18, abs=0.08)  # 0.6 of 0.3 are unanswered


def test_live_lines_show_what_was_read(tmp_path, capsys):
    path = tmp_path / "r.csv"
    main(["record", "--out", str(path), "--live", *FEW])
    lines = capsys.readouterr().err.splitlines()
    recording = Recording.load(path)
    echo, error = recording.reading.echo, recording.reading.range - recording.ping.distance
    right = echo & (np.abs(error) <= 0.1 * recording.ping.distance)
    counts = np.array([[int(text) for text in re.findall(r"(?:right|wrong|no echo) (\d+)", line)] for line in lines])
    per_visit = np.stack([right, echo & ~right, ~echo], axis=1).reshape(-1, 2, 3).sum(axis=1)
    assert np.array_equal(counts, per_visit)


def test_a_live_line_is_a_histogram_about_the_true_distance():
    condition = replace(find_plan("quick").condition(0), distance_mm=1000.0)
    measured = VisitData(Ping.of(np.full(5, 1.0)), Reading.of([1.0, 1.0, 0.905, 1.3, 0.0]))
    line = visit_line(condition, measured)
    picture = line.split("|")[1]
    assert (picture[15], picture[0], set(picture[1:15] + picture[16:])) == ("█", "▄", {" "})
    assert line.endswith("+0 mm; right 3, wrong 1, no echo 1 of 5")
    dead = Reading.of([1.0, 0.0, 0.0, 0.0, 0.0], [EchoStatus.ECHO, EchoStatus.NO_ECHO, *[EchoStatus.NO_ANSWER] * 3])
    line = visit_line(condition, VisitData(measured.ping, dead))
    assert line.endswith("right 1, wrong 0, no echo 1, no answer 3 of 5")
