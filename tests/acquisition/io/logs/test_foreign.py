"""Import of logs: names, units, no echo, faults."""

import pytest

from acquisition import EchoStatus, RecordingError, SettingError
from acquisition.io.logs.foreign import ColumnMap, import_table, parse_constants
from acquisition.io.tables import Dialect


def maps(*texts):
    return [ColumnMap.parse(text) for text in texts]


@pytest.fixture
def log(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text(
        "true,got_us,file,humidity\n1.5,8700,a,40\n2.0,0,b,41\n2.0,38000,b,41\n1.0,,b,41\n", encoding="utf-8"
    )
    return path


def test_units_are_converted_and_other_columns_retained(log):
    columns = maps("distance_mm=true:m", "reading_mm=got_us:us", "session=file")
    recording = import_table(log, columns, {"angle_deg": 0.0}, no_echo=38000)
    assert recording.ping.distance.tolist() == [1.5, 2.0, 2.0, 1.0]
    assert recording.reading.range[0] == pytest.approx(1.5)  # 8700 us / 58 us per cm
    status = [EchoStatus.ECHO, EchoStatus.NO_ECHO, EchoStatus.NO_ECHO, EchoStatus.NO_ANSWER]
    assert recording.reading.status.tolist() == status
    assert recording.run.tolist() == [0, 1, 1, 1]
    assert recording.covariates == ("humidity",)


def test_readings_that_have_their_names_already_know_the_value_for_no_echo(log):
    log.write_text("distance_mm,angle_deg,reading_mm,echo_2_mm\n1000,0,400,4000\n1000,0,4000,4000\n")
    recording = import_table(log, maps("distance_mm=distance_mm"), {}, no_echo=4000)
    assert recording.table[["reading_mm", "echo_2_mm"]].to_numpy().tolist() == [[400.0, 0.0], [0.0, 0.0]]


def test_an_error_quotes_the_value_in_the_file(log):
    log.write_text("true,got\n1.0,1.0\n2.0,abc\n", encoding="utf-8")
    with pytest.raises(RecordingError, match=r"log.csv, line 3, column reading_mm: 'abc', expected a number"):
        import_table(log, maps("distance_mm=true:m", "reading_mm=got:m"), {"angle_deg": 0.0})


def test_a_missing_column_is_an_error(log):
    with pytest.raises(RecordingError, match="column 'nope' is missing, found true, got_us"):
        import_table(log, maps("distance_mm=nope"), {})


@pytest.mark.parametrize(
    "text",
    [
        "distance_mm",
        "=x",
        "distance_mm=x:furlong",
        "distance_mm=t:s",
        "angle_deg=x:cm",
        "time_s=t:mm",
        "echo_2_mm=x:pct",
    ],
)
def test_an_invalid_map_is_an_error(text):
    with pytest.raises(SettingError, match="column map"):
        ColumnMap.parse(text)


def test_a_unit_of_another_quantity_is_named_with_those_that_fit():
    with pytest.raises(
        SettingError, match=r"'angle_deg=x:cm': expected a unit of angle_deg \(text, deg, rad\), got 'cm'"
    ):
        ColumnMap.parse("angle_deg=x:cm")


@pytest.mark.parametrize(("unit", "seconds"), [("us", 1e-6), ("ms", 1e-3), ("s", 1.0), ("min", 60.0), ("h", 3600.0)])
def test_times_are_converted_to_seconds(tmp_path, unit, seconds):
    (tmp_path / "log.csv").write_text("t,true\n7,1\n8,1\n10,1\n")
    columns = maps(f"time_s=t:{unit}", f"wait_s=t:{unit}", "distance_mm=true:m", "reading_mm=true:m")
    table = import_table(tmp_path / "log.csv", columns, {"angle_deg": 0.0}).table
    assert table["time_s"].tolist() == pytest.approx([0.0, seconds, 3.0 * seconds])
    assert table["wait_s"].tolist() == pytest.approx([7.0 * seconds, 8.0 * seconds, 10.0 * seconds])


def test_a_column_that_is_given_twice_is_an_error(log):
    for columns in (maps("reading_mm=true:m", "reading_mm=got_us:us"), maps("reading_mm=true:m", "angle_deg=got_us")):
        with pytest.raises(SettingError, match=r"column (reading_mm|angle_deg): is given 2 times; give it once"):
            import_table(log, [*columns, *maps("distance_mm=true:m")], {"angle_deg": 0.0})
    with pytest.raises(SettingError, match="column angle_deg: is given 2 times"):
        parse_constants(["angle_deg=5", "angle_deg=6"])


def test_constants_are_numbers_except_in_text_columns():
    assert parse_constants(["angle_deg=5", "session=lab"]) == {"angle_deg": 5.0, "session": "lab"}
    with pytest.raises(SettingError, match="expected a number"):
        parse_constants(["angle_deg=five"])


TOA5 = """"TOA5","Station","CR1000","12345","CR1000.Std.31","CPU:snow.CR1","40406","Table10"\r
"TIMESTAMP","RECORD","TCDT","Q","AirTC","Pole"\r
"TS","RN","m","","Deg C","m"\r
"","","Smp","Smp","Avg","Smp"\r
"2022-05-21 00:00:00",12,1.946,152,12.3,2\r
"2022-05-21 00:10:00",13,"NAN",0,12.25,2\r
"2022-05-21 00:20:00.5",14,1.95,153,"NAN",2\r
"""  # as the LoggerNet manual of Campbell Scientific describes it


def test_a_logger_file_states_its_units_and_missing_values(tmp_path):
    path = tmp_path / "snow.dat"
    path.write_bytes(TOA5.encode())
    columns = maps("time_s=TIMESTAMP", "reading_mm=TCDT", "distance_mm=Pole", "quality=Q")
    recording = import_table(path, columns, {"angle_deg": 0.0})
    assert recording.ping.time.tolist() == [0.0, 600.0, 1200.5]
    assert recording.reading.range.tolist() == [1.946, 0.0, 1.95]
    assert recording.reading.status.tolist() == [EchoStatus.ECHO, EchoStatus.NO_ANSWER, EchoStatus.ECHO]
    assert recording.ping.distance.tolist() == [2.0, 2.0, 2.0]
    assert set(recording.covariates) >= {"RECORD", "quality"}


def test_a_unit_that_is_given_replaces_that_of_a_logger_file(tmp_path):
    path = tmp_path / "snow.dat"
    path.write_bytes(TOA5.replace('"m"', '"counts"').encode())
    columns = maps("reading_mm=TCDT:cm", "distance_mm=Pole")
    recording = import_table(path, columns, {"angle_deg": 0.0})
    assert recording.reading.range[0] == pytest.approx(0.01946)
    assert recording.ping.distance[0] == pytest.approx(0.002)  # no unit that is known: as it stands


@pytest.mark.parametrize(
    ("damage", "reason"),
    [
        (lambda text: text.splitlines()[0], "TOA5 without its lines of names, units and processing"),
        (lambda text: text.replace('"TS",', ""), "TOA5 without its lines"),
        (lambda text: text.replace(",152,", ",152,1,2,3,"), "more fields than the header"),
        (lambda text: text.replace("1.946", "abc"), r"line 2, column reading_mm: 'abc'"),
        (lambda text: text.replace("2022-05-21 00:20:00.5", "8022-05-21 00:00:0.0+05:00"), r"line 4, .*: '8022-05-21"),
    ],
)
def test_a_damaged_logger_file_is_named(tmp_path, damage, reason):
    path = tmp_path / "snow.dat"
    path.write_text(damage(TOA5))
    with pytest.raises(RecordingError, match=f"snow.dat.*{reason}"):
        import_table(path, maps("time_s=TIMESTAMP", "reading_mm=TCDT", "distance_mm=Pole"), {"angle_deg": 0.0})


def test_dates_and_numbers_of_a_log_keep_their_digits(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text(
        "true,got,when,time_s\n1,1,2024-01-01T00:00:00.25Z,1700000000.1\n1,1,2024-01-01T00:00:00.5Z,1700000000.2\n"
    )
    recording = import_table(
        path, maps("distance_mm=true:m", "reading_mm=got:m", "clock=when:date"), {"angle_deg": 0.0}
    )
    assert recording.table["clock"].diff()[1] == 0.25
    assert recording.table["time_s"].tolist() == [1700000000.1, 1700000000.2]


def test_rows_of_a_log_are_counted_and_measured_as_those_of_a_recording(log):
    log.write_text("true,got,note\n1,1,a\n\n1,1\n1,x,b\n")
    columns, more = maps("distance_mm=true:m", "reading_mm=got:m"), {"angle_deg": 0.0}
    with pytest.raises(
        RecordingError, match=r"line 4, column note: '', expected a field; the row ends before it \(and 1"
    ):
        import_table(log, columns, more)
    assert [fault.line for fault in import_table(log, columns, more, skip_bad_rows=True).rejected] == [4, 5]


def test_a_column_without_a_name_may_be_the_first_of_a_table_with_tabs(tmp_path):
    (tmp_path / "log.tsv").write_text("\tdistance_mm\tangle_deg\treading_mm\n0\t1000\t0\t1010\n")
    recording = import_table(tmp_path / "log.tsv", [], {}, dialect=Dialect("\t"))
    assert recording.table.to_dict("records") == [{"distance_mm": 1000.0, "angle_deg": 0.0, "reading_mm": 1010.0}]
