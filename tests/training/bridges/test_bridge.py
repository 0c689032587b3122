"""The commands `bridge`, `serve` and `export`."""

import shutil
import signal
import subprocess
import sys

import numpy as np
import pytest

from acquisition import Ping, Reading, Recording
from noise import load_model
from sonar_gym.bridges.server.client import SonarClient, address_of
from training.cli import main

TOGETHER = """
ip link set lo up && ip route add 225.0.0.0/24 dev lo
"$0" -m training.cli bridge opendlv-agent --duration-s 300 & agent=$!
"$0" -m training.cli bridge opendlv-car --lock-step --seed 0
kill $agent
"""


def command(*args):
    return [sys.executable, "-m", "training.cli", *map(str, args)]


@pytest.fixture
def recording(tmp_path):
    distance = np.linspace(0.5, 2.0, 16)
    ping = Ping.of(distance, 0.0, reflectance=0.9, time=0.1 * np.arange(16))
    reading = Reading.of(np.where(np.arange(16) == 5, 0.0, np.round(distance, 2)))
    return Recording.of(ping, reading, sensor="2").save(tmp_path / "recording.csv")


def enable_interrupts():
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # a shell starts background jobs with SIGINT ignored


def test_a_server_answers_until_it_is_interrupted():
    words = command("serve", "ideal", "--port", 0)
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True, preexec_fn=enable_interrupts) as server:
        try:
            line = server.stdout.readline()
            address = address_of(next(word.rstrip(";") for word in line.split() if word.startswith("tcp://")))
            with SonarClient(*address) as client:
                assert client.ask(Ping.of([1.25]))[0].range[0] == pytest.approx(1.25)
            server.send_signal(signal.SIGINT)
            assert server.wait(20) == 130
        finally:
            server.kill()


@pytest.mark.parametrize("simulator", ["webots", "gazebo"])
def test_the_nearest_sonar_is_written_with_the_error_that_it_leaves(simulator, tmp_path, capsys):
    out = tmp_path / "sonar.txt"
    main(["export", simulator, "srf08-mlp", "--out", str(out), "--max-range", "3"])
    assert "left by the simulator: " in capsys.readouterr().out
    assert ("DistanceSensor {" if simulator == "webots" else "<sensor ") in out.read_text()


def test_a_recording_becomes_a_rec_file_and_a_recording_again(recording, tmp_path, capsys):
    rec, back = tmp_path / "drive.rec", tmp_path / "back.csv"
    main(["bridge", "opendlv-rec", str(recording), "--out", str(rec), "--start-s", "1650000000"])
    main(["bridge", "opendlv-rec", str(rec), "--out", str(back), "--truth-csv", str(recording), "--period-s", "0.1"])
    assert "16 pings, 1 without echo" in capsys.readouterr().out
    np.testing.assert_allclose(Recording.load(back).reading.range, Recording.load(recording).reading.range, atol=1e-6)


def test_constants_of_a_rec_file_are_numbers_or_text(recording, tmp_path, capsys):
    rec, back = tmp_path / "drive.rec", tmp_path / "back.csv"
    main(["bridge", "opendlv-rec", str(recording), "--out", str(rec)])
    words = ["bridge", "opendlv-rec", str(rec), "--out", str(back), "--constants", "session=morning", "distance_mm=900"]
    main(words)
    assert Recording.load(back).table[["session", "distance_mm"]].drop_duplicates().to_numpy().tolist() == [
        ["morning", 900.0]
    ]
    with pytest.raises(SystemExit):
        main([*words, "--truth-csv", str(recording)])
    assert "column distance_mm: is given 2 times; give it once" in capsys.readouterr().err


def test_tables_of_webots_become_models(tmp_path, capsys):
    world = tmp_path / "world.wbt"
    world.write_text('DistanceSensor { name "front left" lookupTable [0 0 0.1, 5 5 0.1] }')
    main(["bridge", "webots", str(world), "--out", str(tmp_path / "models"), "--metres-per-unit", "1"])
    assert "2 rows, up to 5 m" in capsys.readouterr().out
    assert load_model(tmp_path / "models" / "front-left").law(Ping.of(2.0)).sigma[0] == pytest.approx(0.2)


def test_a_recording_becomes_a_bag(recording, tmp_path, capsys):
    pytest.importorskip("rosbags")
    main(["bridge", "ros-bag", str(recording), "--out", str(tmp_path / "bag"), "--model", "ideal"])
    assert "16 messages of sensor_msgs/Range" in capsys.readouterr().out
    assert sorted(p.suffix for p in (tmp_path / "bag").iterdir()) == [".mcap", ".yaml"]


@pytest.mark.parametrize(
    ("args", "text"),
    [
        (("bridge", "opendlv-sonar", "--map", "no.map"), "no.map: no such map"),
        (("bridge", "opendlv-agent", "--cid", "300"), "--cid: expected a whole number from 1 to 254, got 300"),
        (("bridge", "webots", "no.wbt", "--out", "x"), "no.wbt: no such file"),
        (("serve", "ideal", "--port", "70000"), "--port: expected a whole number from 0 to 65535, got 70000"),
        (("export", "webots", "rig", "--out", "x"), "can only be sampled"),
    ],
)
def test_a_mistake_is_one_line_and_exit_code_2(args, text, capsys):
    with pytest.raises(SystemExit) as stopped:
        main(list(args))
    error = capsys.readouterr().err
    assert (stopped.value.code, error.count("\n")) == (2, 1), error
    assert text in error


@pytest.mark.timeout(400)
def test_the_agent_parks_the_car_in_a_multicast_session():
    if shutil.which("unshare") is None or subprocess.run(["unshare", "-rn", "true"], capture_output=True).returncode:
        pytest.skip("this machine allows no network namespaces")
    shell = ["unshare", "-rn", "sh", "-c", TOGETHER, sys.executable]
    done = subprocess.run(shell, capture_output=True, text=True, timeout=380)
    assert "parked after" in done.stdout, done.stdout + done.stderr
