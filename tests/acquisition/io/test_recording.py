"""The CSV format: columns, faults, runs, resolution, saving."""

import os
import stat
from decimal import Decimal

import numpy as np
import pandas as pd
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from acquisition import EchoStatus, Ping, Reading, Recording, RecordingError, RecordingNotFoundError
from acquisition.io.chunks import write_chunks

HEADER = "distance_mm,angle_deg,reading_mm"


def write(path, text):
    path.write_text(text, encoding="utf-8")
    return path


def test_zero_is_no_echo_and_empty_is_no_answer(tmp_path):
    recording = Recording.load(write(tmp_path / "r.csv", f"{HEADER}\n1000,0,1003\n1000,0,0\n1000,0,\n"))
    assert recording.reading.status.tolist() == [EchoStatus.ECHO, EchoStatus.NO_ECHO, EchoStatus.NO_ANSWER]
    assert recording.reading.range.tolist() == pytest.approx([1.003, 0.0, 0.0])


def test_a_name_of_a_column_that_holds_a_line_end_is_named(tmp_path):
    with pytest.raises(RecordingError, match=r"line 1: has 2 names of columns where the table has 4; remove"):
        Recording.load(write(tmp_path / "r.csv", 'distance_mm,"no\nte",angle_deg,reading_mm\n1000,a,0,1003\n'))


def test_units_become_si(tmp_path):
    ping = Recording.load(write(tmp_path / "r.csv", f"{HEADER},incidence_deg\n1500,30,1503,10\n")).ping
    assert ping.distance[0] == pytest.approx(1.5)
    assert ping.angle[0] == pytest.approx(np.pi / 6)
    assert ping.incidence[0] == pytest.approx(np.pi / 18)


def test_other_columns_are_retained_and_complete_numbers_are_covariates(tmp_path):
    text = f"{HEADER},light,note,pressure_hpa\n1000,0,1003,12,door open,1010\n1000,0,1003,13,,\n"
    recording = Recording.load(write(tmp_path / "r.csv", text))
    assert recording.covariates == ("light",)  # pressure is not logged in every row: retained, but no covariate
    assert recording.table["note"].tolist() == ["door open", ""]
    assert recording.table["pressure_hpa"][0] == 1010
    again = Recording.load(recording.save(tmp_path / "again.csv"))
    assert list(again.table.columns) == list(recording.table.columns)


def test_numbers_whose_squares_are_beyond_single_precision_are_text(tmp_path):
    recording = Recording.load(write(tmp_path / "r.csv", f"{HEADER},serial,stamp\n1000,0,1003,1e99,1e15\n"))
    assert recording.covariates == ("stamp",)
    assert recording.table["serial"].tolist() == ["1e99"]


@pytest.mark.parametrize(
    ("row", "message"),
    [
        ("abc,0,1003", "line 3, column distance_mm: 'abc', expected a number from 0 to 100000"),
        ("-5,0,1003", "line 3, column distance_mm: '-5', expected a number from 0 to 100000"),
        ("nan,0,1003", "line 3, column distance_mm: 'nan', expected a number from 0 to 100000"),
        (",0,1003", "line 3, column distance_mm: '', expected a number from 0 to 100000"),
        ("1000,inf,1003", "line 3, column angle_deg: 'inf', expected a number from -180 to 180"),
        (
            "1000,0,-1",
            "line 3, column reading_mm: '-1', expected a number from 0 to 1700000, 0 for no echo, or nothing",
        ),
        (
            "1000,0,NaN",
            "line 3, column reading_mm: 'NaN', expected a number from 0 to 1700000, 0 for no echo, or nothing",
        ),
    ],
)
def test_a_faulty_row_is_an_error_with_its_place_or_skipped(tmp_path, row, message):
    path = write(tmp_path / "bad.csv", f"{HEADER}\n1000,0,1003\n{row}\n1000,0,1004\n")
    with pytest.raises(RecordingError) as caught:
        Recording.load(path)
    assert str(caught.value).startswith(f"{path}, {message}")
    rest = Recording.load(path, skip_bad_rows=True)
    assert rest.table["reading_mm"].tolist() == [1003.0, 1004.0]
    assert [fault.line for fault in rest.rejected] == [3]


def test_a_file_that_is_no_recording_is_an_error(tmp_path):
    with pytest.raises(RecordingNotFoundError, match="no such file"):
        Recording.load(tmp_path / "nothing.csv")
    with pytest.raises(RecordingError, match="is a folder"):
        Recording.load(tmp_path)
    with pytest.raises(RecordingError, match="the file is empty"):
        Recording.load(write(tmp_path / "empty.csv", ""))
    with pytest.raises(RecordingError, match="has no rows"):
        Recording.load(write(tmp_path / "header.csv", HEADER + "\n"))
    with pytest.raises(RecordingError, match="column angle_deg is missing"):
        Recording.load(write(tmp_path / "short.csv", "distance_mm,reading_mm\n1,2\n"))
    (tmp_path / "bytes.csv").write_bytes(b"\xff\xfe\x00\x81" * 10)
    with pytest.raises(RecordingError):
        Recording.load(tmp_path / "bytes.csv")


def test_runs_follow_sessions_and_conditions_follow_positions(tmp_path):
    text = f"{HEADER},session,sensor\n1000,0,1003,a,left\n1000,0,1003,a,right\n2000,0,2003,a,left\n1000,0,1003,b,left\n"
    recording = Recording.load(write(tmp_path / "r.csv", text))
    assert recording.run.tolist() == [0, 1, 0, 2]
    assert recording.condition.tolist() == [0, 0, 1, 0]


@pytest.mark.parametrize(
    ("step", "expected"), [(10.0, 0.01), (25.4, 0.0254), (1.0, 0.001), (0.17, 0.001), (24.287, 0.024287), (3.3, 0.0033)]
)
def test_the_grid_of_the_readings_is_found(step, expected):
    rng = np.random.default_rng(0)
    reading = np.rint(rng.uniform(300, 5000, 200) / step) * step
    recording = Recording.of(Ping.of(np.full(200, 1.0)), Reading.of(reading / 1000))
    assert recording.resolution == pytest.approx(expected)


@pytest.mark.parametrize("step", [2.6, 3.43, 4.3, 6.86, 12.7, 17.24, 24.287, 43.0])
def test_another_grid_is_found_although_the_log_rounds_to_millimetres(step):
    rng = np.random.default_rng(1)
    reading = np.rint(np.rint(rng.uniform(300, 5000, 300) / step) * step)
    recording = Recording.of(Ping.of(np.full(300, 1.0)), Reading.of(reading / 1000))
    assert recording.resolution == pytest.approx(step / 1000, rel=2e-3)


@settings(max_examples=60, deadline=None)
@given(st.sampled_from([4.3, 6.86, 12.7, 17.24, 25.4]), st.floats(-0.45, 0.45), st.integers(0, 2**31))
def test_a_grid_that_a_constant_moves_is_found_although_the_log_rounds_to_millimetres(step, share, seed):
    rng = np.random.default_rng(seed)
    reading = np.rint(np.rint(rng.uniform(300, 5000, 300) / step) * step + share * step)
    recording = Recording.of(Ping.of(rng.uniform(0.3, 5.0, 300)), Reading.of(reading / 1000))
    assert recording.resolution == pytest.approx(step / 1000, rel=2e-3)


def test_four_values_on_a_grid_are_enough_unless_the_target_is_on_it():
    step = 5.517242
    reading = np.resize(np.arange(180, 184) * step, 60) / 1000
    at_one_place = Recording.of(Ping.of(np.full(60, 1.0)), Reading.of(reading))
    assert at_one_place.resolution == pytest.approx(step / 1000)
    two = Recording.of(Ping.of(np.full(60, 1.0)), Reading.of(np.resize(np.arange(180, 182) * step, 60) / 1000))
    assert two.resolution == 0.001
    exact = Recording.of(Ping.of(reading), Reading.of(reading))
    assert exact.resolution == 0.001


@pytest.mark.parametrize("step", [20.0, 50.0, 100.0, 50.8])
def test_a_multiple_of_a_common_grid_is_found(step):
    rng = np.random.default_rng(2)
    reading = np.rint(rng.uniform(300, 5000, 200) / step) * step
    recording = Recording.of(Ping.of(np.full(200, 1.003)), Reading.of(reading / 1000))
    assert recording.resolution == pytest.approx(step / 1000)
    there = Recording.of(Ping.of(reading / 1000), Reading.of(reading / 1000))
    assert there.resolution in (0.01, 0.0254), "the target itself is on the coarser grid"


@settings(max_examples=60, deadline=None)
@given(st.integers(2, 60), st.integers(0, 59), st.integers(0, 2**31))
def test_whole_millimetres_of_any_step_are_found(step, offset, seed):
    rng = np.random.default_rng(seed)
    reading = np.rint(rng.uniform(300, 5000, 200) / step) * step + offset % step
    recording = Recording.of(Ping.of(rng.uniform(0.3, 5.0, 200)), Reading.of(reading / 1000))
    assert recording.grid == pytest.approx((step / 1000, -(-offset % step) / 1000))


@pytest.mark.parametrize("values", [2, 3, 5, 11, 40, 200])
def test_no_grid_is_found_where_there_is_none(values):
    rng = np.random.default_rng(values)
    for _ in range(50):
        reading = np.rint(rng.choice(rng.uniform(300, 5000, values), 300))
        recording = Recording.of(Ping.of(np.full(300, 1.0)), Reading.of(reading / 1000))
        assert recording.resolution in (0.001, 0.01, 0.0254)


@settings(max_examples=60, deadline=None)
@example(10.0, 0.33, 0)  # all readings are multiples of a third of the step, too
@example(10.0, 0.25, 0)
@given(st.sampled_from([10.0, 25.4, 20.0, 12.7]), st.floats(-0.45, 0.45), st.integers(0, 2**31))
def test_a_constant_added_after_rounding_moves_the_grid_and_not_its_step(step, share, seed):
    rng = np.random.default_rng(seed)
    offset = np.round(share * step, 1)
    reading = np.rint(rng.uniform(300, 5000, 200) / step) * step + offset
    recording = Recording.of(Ping.of(rng.uniform(0.3, 5.0, 200)), Reading.of(reading / 1000))
    found, origin = recording.grid
    assert found == pytest.approx(step / 1000)
    assert -found < origin <= 0.0
    off = (recording.reading.range - origin) / found
    assert np.abs(off - np.rint(off)).max() < 0.01


def test_targets_on_whole_centimetres_are_no_grid_of_the_sensor():
    distance = np.repeat(np.arange(0.2, 2.0, 0.01), 3)
    exact = Recording.of(Ping.of(distance), Reading.of(np.round(distance + 0.012, 3)))
    assert exact.grid == (0.001, 0.0)
    steps = 0.01 * np.random.default_rng(0).integers(-2, 3, len(distance))
    coarse = Recording.of(Ping.of(distance), Reading.of(np.round(distance + 0.012 + steps, 3)))
    assert coarse.grid == pytest.approx((0.01, -0.008))


@given(st.floats(-1e10, 1e10), st.lists(st.floats(0.0, 1e4), min_size=1, max_size=9))
def test_the_origin_of_the_clock_does_not_matter(origin, elapsed):
    table = pd.DataFrame({"distance_mm": 1000.0, "angle_deg": 0.0, "reading_mm": 1003.0, "time_s": elapsed})
    moved = Recording(table.assign(time_s=table.time_s + origin))
    here = Recording(table).ping.time
    assert here.min() == 0.0
    np.testing.assert_allclose(moved.ping.time, here, atol=1e-5)
    assert moved.table.time_s.tolist() == (table.time_s + origin).tolist(), "the log itself is not altered"


@settings(max_examples=40)
@given(
    st.lists(
        st.tuples(st.floats(0.03, 6), st.floats(-0.7, 0.7), st.sampled_from([0.0, 0.5, 3.25]), st.integers(0, 2)),
        min_size=1,
        max_size=20,
    )
)
def test_saving_and_loading_changes_nothing(tmp_path_factory, rows):
    distance, angle, reading, run = (np.array(column) for column in zip(*rows, strict=True))
    recording = Recording.of(Ping.of(distance, angle, run=run, temperature_c=20.0), Reading.of(reading))
    again = Recording.load(recording.save(tmp_path_factory.mktemp("r") / "r.csv"))
    np.testing.assert_allclose(again.ping.distance, distance, atol=1e-9)
    np.testing.assert_allclose(again.ping.angle, angle, atol=1e-7)
    np.testing.assert_array_equal(again.reading.status, recording.reading.status)
    assert again.covariates == ("temperature_c",)


@settings(max_examples=40)
@example("time_s", 1_700_000_000_100, 3)
@example("unix_ms", 1_700_000_000_100, 0)
@given(st.sampled_from(["time_s", "unix_ms", "light"]), st.integers(-(10**14), 10**14), st.just(3))
def test_numbers_of_up_to_15_digits_are_written_as_they_were_read(tmp_path_factory, name, count, places):
    folder = tmp_path_factory.mktemp("r")
    numbers = [f"{Decimal(count + k).scaleb(-places)}" for k in range(3)]
    text = "".join(f"{number},1000,0,1003\n" for number in numbers)
    recording = Recording.load(write(folder / "r.csv", f"{name},{HEADER}\n{text}"))
    write_chunks(folder / "parts.csv", [recording])
    for path in (recording.save(folder / "again.csv"), folder / "parts.csv"):
        found = [line.partition(",")[0] for line in path.read_text().splitlines()[1:]]
        assert list(map(Decimal, found)) == list(map(Decimal, numbers))


def test_long_numbers_of_sessions_stay_apart():
    table = pd.DataFrame(
        {"distance_mm": 1000.0, "angle_deg": 0.0, "reading_mm": 1003.0, "session": [20240101123456, 20240101123457]}
    )
    recording = Recording.from_text(table, "r")
    assert recording.table["session"].tolist() == ["20240101123456", "20240101123457"]


def test_a_failed_save_leaves_the_old_file_unchanged(tmp_path, monkeypatch):
    recording = Recording.of(Ping.of([1.0]), Reading.of([1.0]))
    path = recording.save(tmp_path / "r.csv")
    before = path.read_bytes()

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space left"):
        recording.save(path)
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["r.csv"]
    assert stat.S_IMODE(path.stat().st_mode) == 0o644
