"""Columns that are guessed, and the lines of a serial monitor."""

import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from acquisition import EchoStatus, RecordingError
from acquisition.io.logs.foreign import ColumnMap, import_table, read_log
from acquisition.io.logs.guess import guess_columns, guess_dialect
from acquisition.io.logs.serial_log import is_serial_log, read_serial_log
from acquisition.io.tables import MAX_COLUMNS


def guess(header, row):
    table = pd.DataFrame([row.split(",")], columns=header.split(","))
    return " ".join(f"{m.name}={m.source}:{m.unit}" for m in guess_columns(table))


@pytest.mark.parametrize(
    ("header", "row", "expected"),
    [  # headers as logs of makers have them
        ("true_cm,measured_cm,file", "1,2,a", "distance_mm=true_cm:cm reading_mm=measured_cm:cm session=file:text"),
        ("Actual Distance (m),Sonar (m)", "1,1", "distance_mm=Actual Distance (m):m reading_mm=Sonar (m):m"),
        ("timestamp,distance", "2024-01-01T10:00,12", "reading_mm=distance: time_s=timestamp:date"),
        ("millis,duration,laserMm", "1,5,9", "distance_mm=laserMm:mm reading_mm=duration:us time_s=millis:ms"),
        ("distance_mm,angle_deg", "1,2", "distance_mm=distance_mm:mm angle_deg=angle_deg:deg"),
        ("Reference [inches],Echo time [us]", "3,5", "distance_mm=Reference [inches]:in reading_mm=Echo time [us]:us"),
        ("time_us,true_mm", "1,2", "distance_mm=true_mm:mm time_s=time_us:us"),
        ("foo,bar", "1,2", ""),
    ],
)
def test_columns_are_guessed_by_words_and_units(header, row, expected):
    assert guess(header, row) == expected


@given(st.lists(st.text(max_size=12), min_size=1, max_size=8, unique=True))
def test_a_column_is_used_once_and_every_guess_can_be_written_as_an_option(names):
    maps = guess_columns(pd.DataFrame([["1"] * len(names)], columns=names))
    assert len({m.source for m in maps}) == len(maps)
    assert {m.source for m in maps} <= set(names)


@pytest.mark.parametrize(
    ("text", "delimiter", "decimal"),
    [
        ("a,b\n1,2.5\n", ",", "."),
        ("a;b\n1,5;2\n3,5;4\n", ";", ","),
        ("a\tb\n1.5\t2\n", "\t", "."),
        ("one\n1\n", ",", "."),
    ],
)
def test_the_dialect_is_guessed(text, delimiter, decimal):
    dialect = guess_dialect(text)
    assert (dialect.delimiter, dialect.decimal) == (delimiter, decimal)


@pytest.mark.parametrize(
    ("text", "columns", "rows"),
    [  # the sketches "Ping" of the Arduino IDE, NewPing's example, common HC-SR04 tutorials, the serial plotter
        ("12in, 30cm\n13in, 33cm\n", ["value_1_in", "value_2_cm"], [["12", "30"], ["13", "33"]]),
        ("Ping: 12cm\nPing: 0cm\n", ["Ping_cm"], [["12"], ["0"]]),
        ("Ready\nDistance: 45.6 cm\nOut of range\n", ["Distance_cm"], [["45.6"], ["0"]]),
        ("D: 45 cm\nOut of range: 400 cm\nOut of range\n", ["D_cm"], [["45"], ["0"], ["0"]]),
        ("d: 45, timeout: 30\nd: 46, timeout: 30\n", ["d", "timeout"], [["45", "30"], ["46", "30"]]),
        ("10:00:00.5 -> D: 7 cm\n10:00:01 -> timeout\n", ["time", "D_cm"], [["36000.5", "7"], ["36001", "0"]]),
        ("left:120,right:98\nleft:121,right:\n", ["left", "right"], [["120", "98"]]),
        ("23:59:59.9 -> 5 cm\n0:00:00.1 -> 6 cm\n", ["time", "value_cm"], [["86399.9", "5"], ["86400.1", "6"]]),
    ],
)  # fmt: skip
def test_lines_of_known_sketches_are_read(text, columns, rows):
    assert is_serial_log(text)
    log = read_serial_log(text)
    assert list(log.table.columns) == columns
    assert log.table.to_numpy().tolist() == rows
    assert log.omitted == len(text.splitlines()) - len(rows)


def test_a_log_in_which_each_line_has_a_name_of_its_own_is_no_table(tmp_path):
    (tmp_path / "log.txt").write_text("".join(f"a{k}: 1\n" for k in range(MAX_COLUMNS + 1)))
    with pytest.raises(RecordingError, match=r"log\.txt: its lines name 1001 numbers, expected at most 1000"):
        read_log(tmp_path / "log.txt")


@pytest.mark.parametrize("text", ["a,b\n1,2\n3,4\n", "time;d\n10:00:00;5\n", "1,2,3\n4,5,6\n", "", '"TOA5","x"\n'])
def test_tables_are_no_serial_logs(text):
    assert not is_serial_log(text)


@given(st.lists(st.one_of(st.none(), st.integers(1, 400)), min_size=1, max_size=20))
def test_a_serial_log_becomes_a_recording_with_the_numbers_of_its_lines(tmp_path_factory, values):
    lines = ["boot", "Distance: 1 cm", *("Out of range" if v is None else f"Distance: {v} cm" for v in values)]
    path = tmp_path_factory.mktemp("log") / "serial.txt"
    path.write_text("\r\n".join(lines) + "\r\n")
    recording = import_table(
        path, [ColumnMap.parse("reading_mm=Distance_cm:cm")], {"distance_mm": 1000.0, "angle_deg": 0.0}
    )
    expected = [EchoStatus.ECHO, *(EchoStatus.NO_ECHO if v is None else EchoStatus.ECHO for v in values)]
    assert recording.reading.status.tolist() == expected
    assert recording.table["reading_mm"].tolist() == [10.0, *(10.0 * (v or 0) for v in values)]
