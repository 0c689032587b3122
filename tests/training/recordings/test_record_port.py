"""`sonar-gym record` with every real driver and a simulated device on a pseudo-terminal."""

import numpy as np
import pytest

from acquisition import Ping, Recording
from acquisition.bench import Rig, Setup, Unit
from acquisition.twins.devantech import Srf02Twin, Srf08Twin, Srf10Twin
from tests.acquisition.drivers.serial_devices import ArduinoTwin, HcSr04Twin, HostClock, MaxBotixTwin, PseudoTerminal
from training.cli import main

PLAN = "distances_mm = [1000]\nangles_deg = [0]\nreflectances = [0.9]\npings = 3\ninterval_s = 0.2\n"
QUIET = Setup(placement_m=0.0, placement_deg=0.0, tilt_deg=0.0, drift_c=0.0, post=None)


def before_a_wall(kind):
    twin = kind(Rig(Unit.nominal(), QUIET), np.random.default_rng(0), clock=HostClock())
    twin.place(Ping.of(distance=1.0, reflectance=0.9))
    return twin


DEVICES = {
    "srf08": lambda: ArduinoTwin(before_a_wall(Srf08Twin)),
    "srf10": lambda: ArduinoTwin(before_a_wall(Srf10Twin)),
    "srf02": lambda: ArduinoTwin(before_a_wall(Srf02Twin)),
    "hcsr04": lambda: ArduinoTwin(None, before_a_wall(HcSr04Twin)),
    "maxbotix": lambda: before_a_wall(MaxBotixTwin),
    "maxbotix-pwm": lambda: ArduinoTwin(pwm=before_a_wall(MaxBotixTwin)),
}


@pytest.mark.parametrize("driver", DEVICES)
def test_records_from_a_port(tmp_path, driver, retry):
    plan, path = tmp_path / "p.toml", tmp_path / "r.csv"
    plan.write_text(PLAN, encoding="utf-8")
    gain = ["--gain", "16"] if driver == "srf10" else []

    def attempt():
        path.unlink(missing_ok=True)
        with PseudoTerminal(DEVICES[driver]()) as far:
            options = ["--driver", driver, "--port", far.path, "--plan", str(plan), "--operator", "none", *gain]
            main(["record", "--out", str(path), *options])
        recording = Recording.load(path)
        assert recording.reading.range == pytest.approx(np.full(3, 1.0), abs=0.04)
        assert ("gain" in recording.ping.covariates) == (driver in ("srf08", "srf10"))
        assert not {"temperature_c", "humidity_pct"} & set(recording.table), "nobody measured them"

    retry(attempt)


def test_the_air_beside_a_real_sensor_is_logged_where_it_was_measured(tmp_path, retry):
    (tmp_path / "p.toml").write_text(PLAN, encoding="utf-8")
    (tmp_path / "w1").write_text("21250\n")

    def attempt():
        with PseudoTerminal(DEVICES["hcsr04"]()) as far:
            options = [
                "--driver",
                "hcsr04",
                "--port",
                far.path,
                "--plan",
                str(tmp_path / "p.toml"),
                "--operator",
                "none",
            ]
            air = ["--humidity-pct", "40", "--thermometer", str(tmp_path / "w1")]
            main(["record", "--out", str(tmp_path / "r.csv"), *options, *air])

    retry(attempt)
    table = Recording.load(tmp_path / "r.csv").table
    assert table[["temperature_c", "humidity_pct"]].drop_duplicates().to_numpy().tolist() == [[21.25, 40.0]]


def test_a_survey_beyond_the_registers_of_the_sensor_does_not_begin(tmp_path, capsys):
    with PseudoTerminal(DEVICES["srf10"]()) as far:
        options = ["--driver", "srf10", "--port", far.path, "--plan", "gain-sweep", "--operator", "none"]
        with pytest.raises(SystemExit):
            main(["record", "--out", str(tmp_path / "r.csv"), *options])
    assert "SRF10 gain must be a whole number from 0 to 16" in capsys.readouterr().err
    assert not (tmp_path / "r.csv").exists()


def test_no_answer_is_not_recorded_as_no_echo(tmp_path, capsys):
    plan, path = tmp_path / "p.toml", tmp_path / "r.csv"
    plan.write_text(PLAN, encoding="utf-8")
    with PseudoTerminal(ArduinoTwin()) as far:
        options = ["--driver", "hcsr04", "--port", far.path, "--plan", str(plan), "--operator", "none"]
        with pytest.raises(SystemExit) as stop:
            main(["record", "--out", str(path), *options])
    assert stop.value.code == 2
    assert "echo line did not rise" in capsys.readouterr().err
