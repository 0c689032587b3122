"""Import of logs: names, units, no echo, faults."""

import pytest

from acquisition import EchoStatus, RecordingError, SettingError
from acquisition.io.foreign import ColumnMap, import_table, parse_constants


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


def test_an_error_quotes_the_value_in_the_file(log):
    log.write_text("true,got\n1.0,1.0\n2.0,abc\n", encoding="utf-8")
    with pytest.raises(RecordingError, match=r"log.csv, line 3, column reading_mm: 'abc', expected a number"):
        import_table(log, maps("distance_mm=true:m", "reading_mm=got:m"), {"angle_deg": 0.0})


def test_a_missing_column_is_an_error(log):
    with pytest.raises(RecordingError, match="column 'nope' is missing, found true, got_us"):
        import_table(log, maps("distance_mm=nope"), {})


@pytest.mark.parametrize("text", ["distance_mm", "=x", "distance_mm=x:furlong"])
def test_an_invalid_map_is_an_error(text):
    with pytest.raises(SettingError, match="column map"):
        ColumnMap.parse(text)


def test_constants_are_numbers_except_in_text_columns():
    assert parse_constants(["angle_deg=5", "session=lab"]) == {"angle_deg": 5.0, "session": "lab"}
    with pytest.raises(SettingError, match="expected a number"):
        parse_constants(["angle_deg=five"])
