"""`sonar-gym import` of published logs and of a bag."""

import numpy as np
import pytest

from acquisition import EchoStatus, Ping, Reading, Recording
from training.cli import main

# file, columns, constants, pings
WALL = ["distance_mm=range:m", "time_s=time:s", "velocity=velocity_command"]
LOGS = {
    "snow": (
        "fixed-ranger-copenhagen/segments-1-and-3.csv",
        ["reading_mm=range_raw_m:m", "time_s=TIMESTAMP:date", "session=segment"],
        ["distance_mm=2000", "angle_deg=0"],
        8012,
    ),
    "angle": (
        "hcsr04-angle/Misure_prove.csv",
        ["angle_deg=angolo:deg", "reading_mm=verticale 2cm:cm"],
        ["distance_mm=20", "sensor=hcsr04", "session=2cm"],
        None,
    ),
    "calibration": (
        "hcsr04-calibration/readings.csv",
        ["distance_mm=true_cm:cm", "reading_mm=measured_cm:cm", "session=source_file", "temperature_c=temp1_c"],
        ["angle_deg=0"],
        3150,
    ),
    "wall HC-SR04": ("hcsr04-maxbotix-wall/calibration.csv", [*WALL, "reading_mm=sonar1:m"], ["angle_deg=0"], 3023),
    "wall MaxBotix": ("hcsr04-maxbotix-wall/training2.csv", [*WALL, "reading_mm=sonar2:m"], ["angle_deg=0"], 1350),
    "ten distances": (
        "hcsr04-ten-distances/100cm.csv",
        ["reading_mm=Time (µs):us", "temperature_c=Temperature (°C)"],
        ["distance_mm=1000", "angle_deg=0"],
        15,
    ),
    "apple": (
        "mb1213-apple/Apple_150mm_No_Backdrop.csv",
        ["reading_mm=ultra:cm", "x_mm=x", "y_mm=y"],
        ["distance_mm=150", "angle_deg=0"],
        8405,
    ),
    "seven": (
        "seven-hcsr04-objects/20210102_alldata.csv",
        ["reading_mm=HCSR04_001:cm", "time_s=Time:s", "session=ObjectClass"],
        ["distance_mm=550", "angle_deg=0", "sensor=HCSR04_001"],
        None,
    ),
}


def imported(source, out, columns, constants, *more):
    main(["import", str(source), "--out", str(out), "--columns", *columns, "--constants", *constants, *more])
    return Recording.load(out)


@pytest.mark.parametrize("name", LOGS)
def test_real_logs_are_imported_and_drawn(real_recordings, tmp_path, capsys, name):
    file, columns, constants, pings = LOGS[name]
    recording = imported(real_recordings / file, tmp_path / "r.csv", columns, constants, "--skip-bad-rows")
    lines = len((real_recordings / file).read_text(encoding="utf-8-sig").splitlines()) - 1
    rejected = capsys.readouterr().out.count("omitted: ")
    assert len(recording) == pings if pings else 0 < len(recording) <= lines
    assert rejected >= lines - len(recording)
    if recording.has("time_s"):
        assert recording.ping.time[0] == 0.0
        assert recording.ping.time.max() > 1.0
    main(["plot", str(tmp_path / "r.csv"), "--out", str(tmp_path)])


def test_units_are_converted(real_recordings, tmp_path):
    file, columns, constants, _ = LOGS["ten distances"]
    recording = imported(real_recordings / file, tmp_path / "r.csv", columns, constants)
    assert recording.reading.range[0] == pytest.approx(5722e-6 / 58e-6 / 100.0)  # 58 us a cm
    file, columns, constants, _ = LOGS["snow"]
    snow = imported(real_recordings / file, tmp_path / "s.csv", columns, constants)
    assert np.median(np.diff(snow.ping.time)) == pytest.approx(600.0)  # one row per ten minutes, according to its notes
    assert snow.run.max() == 1


def test_an_empty_field_is_no_answer_and_a_zero_no_echo(tmp_path):
    log = tmp_path / "log.csv"
    log.write_text("when,true,got\n2024-05-01T10:00:00Z,1,1.01\n2024-05-01T10:00:01.5Z,1,0\n2024-05-01T10:01:00Z,1,\n")
    columns = ["distance_mm=true:m", "reading_mm=got:m", "time_s=when:date"]
    recording = imported(log, tmp_path / "r.csv", columns, ["angle_deg=0"])
    assert recording.reading.status.tolist() == [EchoStatus.ECHO, EchoStatus.NO_ECHO, EchoStatus.NO_ANSWER]
    assert recording.ping.time.tolist() == [0.0, 1.5, 60.0]


@pytest.mark.parametrize(
    ("file", "options", "message"),
    [
        ("log.csv", [], "not UTF-8 text"),
        ("log.bag", [], "a bag has no true distance"),
        ("log.bag", ["--constants", "distance_mm=1000"], "not a readable bag"),
        ("log.mcap", ["--constants", "distance_mm=1000"], "not a readable bag"),
        ("log.db3", ["--constants", "distance_mm=1000"], "not a readable bag"),
        ("log.bag", ["--truth-topic", "/a", "--truth-csv", "b.csv"], "expected a topic or a table, got both"),
    ],
)
def test_an_invalid_import_is_an_error_message_of_one_line(tmp_path, capsys, file, options, message):
    (tmp_path / file).write_bytes(b"\x00\x01 no such thing \xff")
    with pytest.raises(SystemExit) as stop:
        main(["import", str(tmp_path / file), "--out", str(tmp_path / "r.csv"), *options])
    assert stop.value.code == 2
    error = capsys.readouterr().err.strip()
    assert message in error
    assert "\n" not in error
    assert not (tmp_path / "r.csv").exists()


def test_a_bag_is_imported_by_the_command(tmp_path, capsys):
    rosbag1 = pytest.importorskip("rosbags.rosbag1", reason="needs the extra sonar-gym[ros]")
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    kinds = store.types
    with rosbag1.Writer(tmp_path / "log.bag") as writer:
        connection = writer.add_connection("/sonar", "sensor_msgs/msg/Range", typestore=store)
        for k, value in enumerate([1.0, float("inf"), float("-inf")]):
            header = kinds["std_msgs/msg/Header"](k, kinds["builtin_interfaces/msg/Time"](100 + k, 0), "front")
            message = kinds["sensor_msgs/msg/Range"](header, 0, 0.5, 0.02, 4.0, value)
            raw = store.serialize_ros1(message, "sensor_msgs/msg/Range")
            writer.write(connection, (100 + k) * 10**9, raw)
    (tmp_path / "truth.csv").write_text("time_s,distance_m\n0,1\n2,1\n")
    out, truth = tmp_path / "r.csv", ["--truth-csv", str(tmp_path / "truth.csv"), "--longest-gap-s", "3"]
    main(["import", str(tmp_path / "log.bag"), "--out", str(out), *truth])
    output = capsys.readouterr().out
    assert "3 pings in 1 conditions and 1 runs; 1 without echo, 1 without answer" in output
    assert "too close to measure (REP 117), recorded as no answer: 1" in output
    assert Recording.load(out).table["sensor"].tolist() == ["front"] * 3


SERIAL = "Ready\n10:00:00.5 -> Distance: 57.3 cm\n10:00:01 -> Distance: 57.1 cm\n10:00:01.5 -> Out of range\n"


def test_guessed_columns_are_shown_and_used_only_if_accepted(tmp_path, capsys):
    (tmp_path / "log.txt").write_text(SERIAL)
    words = ["import", str(tmp_path / "log.txt"), "--out", str(tmp_path / "r.csv"), "--constants", "angle_deg=0"]
    with pytest.raises(SystemExit):
        main(words)
    shown, error = capsys.readouterr()
    assert "reading_mm = Distance_cm, in cm: 57.3, 57.1, 0, ..." in shown
    assert "no column seems to be distance_mm" in error
    with pytest.raises(SystemExit):
        main([*words, "distance_mm=573"])
    assert "repeat with --accept-guess, or with what is right of --columns" in capsys.readouterr().err
    assert not (tmp_path / "r.csv").exists()
    main([*words, "distance_mm=573", "--accept-guess"])
    recording = Recording.load(tmp_path / "r.csv")
    assert recording.table["reading_mm"].tolist() == [573.0, 571.0, 0.0]
    assert recording.ping.time.tolist() == [0.0, 0.5, 1.0]


def test_options_hold_for_a_source_that_has_the_columns_of_a_recording(tmp_path, capsys):
    path, out = tmp_path / "a.csv", tmp_path / "b.csv"
    path.write_text("distance_mm,angle_deg,reading_mm\n1000,0,1010\n1000,0,4000\nx,0,1\n", encoding="utf-8-sig")
    words = ["import", str(path), "--out", str(out), "--skip-bad-rows"]
    main(words)
    assert "is a recording already" in (shown := capsys.readouterr().out)
    assert shown.count("omitted: ") == 1
    assert "line 4, column distance_mm: 'x', expected a number" in shown
    main([*words, "--no-echo", "4000", "--constants", "reflectance=0.9", "--accept-guess"])
    table = Recording.load(out).table
    assert table[["reading_mm", "reflectance"]].to_numpy().tolist() == [[1010.0, 0.9], [0.0, 0.9]]
    with pytest.raises(SystemExit):
        main([*words, "--delimiter", ";"])


def test_a_recording_is_converted_to_parquet_and_back(tmp_path, capsys):
    pytest.importorskip("pyarrow", reason="needs the extra sonar-gym[parquet]")
    ping = Ping.of(np.repeat([1.0, 2.0], 3), temperature_c=20.0)
    path = Recording.of(ping, Reading.of(np.repeat([1.01, 0.0], 3))).save(tmp_path / "a.csv")
    main(["import", str(path), "--out", str(tmp_path / "b.parquet")])
    main(["import", str(tmp_path / "b.parquet"), "--out", str(tmp_path / "c.csv")])
    assert (tmp_path / "c.csv").read_bytes() == path.read_bytes()
    with pytest.raises(SystemExit):
        main(["import", str(tmp_path / "b.parquet"), "--out", str(tmp_path / "d.csv"), "--constants", "light=1"])
    assert "b.parquet: is Parquet, expected a CSV file in UTF-8" in capsys.readouterr().err
