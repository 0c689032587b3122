"""Long recordings: parsed at once as text would be, read in parts, as Parquet, and sampled by visits."""

import gzip
import itertools

import numpy as np
import pandas as pd
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from acquisition import EchoStatus, Ping, Reading, Recording, RecordingError, RecordingNotFoundError, SettingError
from acquisition.io import chunks, columns, parquet, tables
from acquisition.io.chunks import read_chunks, sample_visits, write_chunks
from acquisition.io.columns import convert, read_columns
from acquisition.io.tables import parse_table, read_blocks
from tests.fuzz.tables import csv_bytes

QUIRKS = (
    "",
    "nan",
    "NaN",
    "inf",
    "True",
    "1",
    "1.50",
    " 2",
    "2 ",
    "1e5",
    "1e101",
    "0x10",
    "1_0",
    "+3",
    "007",
    "-0",
    "a",
)
STRANGE = st.lists(st.sampled_from(QUIRKS), min_size=1, max_size=4)
UNKNOWN_ENDINGS = settings(suppress_health_check=[HealthCheck.too_slow], max_examples=25, deadline=None)


def outcome(read):
    """Return the table and faults, or the message of the error."""
    try:
        table, faults = read()
    except RecordingError as error:
        return str(error)
    return table, faults


def assert_same(one, other):
    if isinstance(one, str) or isinstance(other, str):
        assert one == other
    else:
        pd.testing.assert_frame_equal(one[0], other[0])
        assert one[1] == other[1]


@UNKNOWN_ENDINGS
@given(data=csv_bytes())
@example(b"distance_mm,angle_deg,reading_mm\n200,0,195,\n1280,9")
@example(b"distance_mm,angle_deg,reading_mm\n200,0,195,7\n1280,9")
def test_parsing_numbers_at_once_gives_what_their_text_gives(data):
    assert_same(outcome(lambda: read_columns(data, "x")), outcome(lambda: convert("x", parse_table(data, "x"))))


@UNKNOWN_ENDINGS
@given(reading=STRANGE, session=STRANGE, other=STRANGE)
def test_fields_that_parsers_take_differently_are_read_as_text(reading, session, other):
    n = max(map(len, (reading, session, other)))
    rows = (f"1000,0,{reading[k % len(reading)]},{session[k % len(session)]},{other[k % len(other)]}" for k in range(n))
    data = "\n".join(["distance_mm,angle_deg,reading_mm,session,note", *rows, ""]).encode()
    assert_same(outcome(lambda: read_columns(data, "x")), outcome(lambda: convert("x", parse_table(data, "x"))))


@given(
    rows=st.lists(
        st.lists(st.sampled_from(["1", '"a\nb"', '"x""\n"', "long" * 9, ""]), min_size=2, max_size=2), max_size=9
    ),
    size=st.integers(1, 40),
    end=st.sampled_from(["\n", "\r\n", ""]),
)
def test_blocks_are_whole_rows_and_nothing_is_lost(tmp_path_factory, rows, size, end):
    text = "\n".join(",".join(row) for row in [["a", "b"], *rows]) + end
    path = tmp_path_factory.mktemp("blocks") / "x.csv"
    path.write_bytes(text.encode())
    header = path.read_bytes().partition(b"\n")
    found = list(read_blocks(path, size))
    assert b"".join(block.removeprefix(header[0] + header[1]) for block, _ in found) == header[2]
    for block, line in found:
        assert block.count(b'"') % 2 == 0
        before = path.read_bytes().find(block.removeprefix(header[0] + header[1]))
        assert line >= 2
        assert before >= 0


def test_a_quotation_mark_within_a_field_opens_no_quotes(tmp_path):
    rows = ['1000,0,1010,5" post', *["1000,0,1011,a"] * 9, '1000,0,1012,"a\nb"', "1000,0,1013,c"]
    (tmp_path / "x.csv").write_text("\n".join(["distance_mm,angle_deg,reading_mm,note", *rows, ""]))
    blocks = [block.partition(b"\n")[2].decode() for block, _ in read_blocks(tmp_path / "x.csv", 30)]
    assert len(blocks) > 5
    assert "".join(blocks) == "\n".join([*rows, ""])
    assert not [block for block in blocks if not block.startswith("1000")]


PIECES = (
    "1000,0,1010,a\n",
    "\n",
    "  \n",
    '1000,0,1010,"a\nb,c"\n',
    '1000,0,1010, "a""\n\n"\n',
    '1000,0,1010,5" x\n',
    "1000,0,,\n",
)


@settings(max_examples=60)
@given(
    pieces=st.lists(st.sampled_from(PIECES), max_size=9),
    more=st.lists(st.sampled_from(PIECES), max_size=9),
    bad=st.sampled_from(["oops,0,1010,a", "1000,0,1010", "1000,0", "1000", '1000,0,"1\n"']),
    end=st.sampled_from(["\n", "\r\n", "\r"]),
)
@example(pieces=["\n", "\n"], more=[], bad="oops,0,1010,a", end="\n")
@example(pieces=[], more=[], bad="1000,0,1010", end="\n")
def test_a_fault_is_named_by_its_line_whatever_stands_before_it(tmp_path_factory, pieces, more, bad, end):
    before = "".join(["distance_mm,angle_deg,reading_mm,note\n", *pieces])
    path = tmp_path_factory.mktemp("lines") / "x.csv"
    path.write_text(f"{before}{bad}\n{''.join(more)}", newline=end)
    line = before.count("\n") + 1
    with pytest.raises(RecordingError, match=rf"x.csv, line {line}, column"):
        Recording.load(path)
    path.write_text(f"{before}{bad}\n{''.join(more)}1000,0,1010,z\n", newline=end)
    recording = Recording.load(path, skip_bad_rows=True)
    assert [fault.line for fault in recording.rejected] == [line]
    assert len(recording) == 1 + sum(bool(piece.strip()) for piece in [*pieces, *more])


def test_a_row_that_ends_early_is_no_missing_answer(tmp_path):
    path = tmp_path / "r.csv"
    path.write_text("distance_mm,angle_deg,reading_mm,light\n1000,0,1010,5\n1000,0\n1000,0,,6\n")
    with pytest.raises(
        RecordingError, match=r"line 3, column reading_mm: '', expected a field; the row ends before it$"
    ):
        Recording.load(path)
    for recording in (Recording.load(path, skip_bad_rows=True), *read_chunks(path, skip_bad_rows=True)):
        assert recording.reading.status.tolist() == [EchoStatus.ECHO, EchoStatus.NO_ANSWER]
        assert recording.covariates == ("light",)
    path.write_text("distance_mm,angle_deg,reading_mm,\n1000,0,1010\n")
    assert len(Recording.load(path)) == 1, "a column without a name needs no field"


def survey(n_visits=30, pings=7):
    """Return a recording of visits of equal length, with text, gaps and a covariate that is missing at first."""
    rng = np.random.default_rng(0)
    visit = np.repeat(np.arange(n_visits), pings)
    ping = Ping.of(500.0 / 1000 + 0.1 * visit, run=visit // 10, temperature_c=20.0 + visit)
    reading = Reading.of(np.where(rng.random(len(visit)) < 0.1, 0.0, ping.distance))
    late = np.where(visit < n_visits // 2, np.nan, visit)
    recording = Recording.of(ping, reading, note=np.where(visit == 3, "door, open", ""), late_c=late)
    recording.table.loc[5, "reading_mm"] = np.nan
    return recording


@pytest.fixture(params=["csv", "csv.gz", "parquet"])
def path(request, tmp_path):
    path = tmp_path / f"r.{request.param}"
    if request.param == "csv.gz":
        path.write_bytes(gzip.compress(survey().save(tmp_path / "plain.csv").read_bytes()))
        return path
    return survey().save(path)


@pytest.fixture
def small(monkeypatch):
    """Let parts be a few rows."""
    monkeypatch.setattr(chunks, "read_blocks", lambda path: read_blocks(path, 500))
    whole = chunks.read_batches
    monkeypatch.setattr(chunks, "read_batches", lambda path: whole(path, 11))


@pytest.mark.usefixtures("small")
def test_parts_are_the_recording_cut_between_visits(path):
    parts, whole = list(read_chunks(path)), Recording.load(path)
    assert len(parts) > 5
    pd.testing.assert_frame_equal(pd.concat([part.table for part in parts], ignore_index=True), whole.table)
    assert all(len(part) % 7 == 0 for part in parts)
    for before, after in itertools.pairwise(parts):
        assert before.ping.distance[-1] != after.ping.distance[0]


@pytest.mark.usefixtures("small")
@pytest.mark.parametrize("name", ["again.csv", "again.parquet"])
def test_parts_are_written_as_one_file(path, tmp_path, name):
    assert write_chunks(tmp_path / name, read_chunks(path)) == len(survey())
    pd.testing.assert_frame_equal(Recording.load(tmp_path / name).table, Recording.load(path).table)


def visits_of(sample):
    """Return the numbers of the visits of a sample, after checking that each is whole."""
    visits = np.rint((sample.ping.distance - 0.5) / 0.1).astype(int)
    found = np.unique(visits)
    assert np.bincount(visits)[found].tolist() == [7] * len(found)
    assert (np.diff(visits) >= 0).all()
    return found


def test_each_visit_is_as_likely_to_be_sampled_as_any_other(tmp_path):
    path, counts = survey().save(tmp_path / "r.parquet"), np.zeros(30)
    for seed in range(50):
        found = visits_of(sample_visits(path, 6, np.random.default_rng(seed)))
        assert len(found) == 6
        counts[found] += 1
    chi2 = ((counts - 10) ** 2 / (10 * 0.8)).sum()  # each visit is drawn with probability 1/5 in 50 samples
    assert chi2 < 58.3  # 0.1 % of the chi-squared distribution with 29 degrees of freedom


@pytest.mark.usefixtures("small")
def test_a_sample_of_parts_consists_of_whole_visits(path):
    assert len(visits_of(sample_visits(path, 6, np.random.default_rng(0)))) == 6
    assert len(sample_visits(path, 100, np.random.default_rng(0))) == len(survey())
    with pytest.raises(SettingError, match="expected at least 1 visit"):
        sample_visits(path, 0, np.random.default_rng(0))


@pytest.mark.usefixtures("small")
def test_a_fault_is_named_by_its_line_in_the_file_or_skipped(tmp_path):
    path = survey().save(tmp_path / "r.csv")
    lines = path.read_text().splitlines()
    lines[100] = lines[100].replace(lines[100].split(",")[3], "x1", 1)  # distance_mm
    path.write_text("\n".join(lines) + "\n")
    with pytest.raises(RecordingError, match=r"line 101, column distance_mm: 'x1', expected a number") as in_parts:
        list(read_chunks(path))
    with pytest.raises(RecordingError) as at_once:
        Recording.load(path)
    assert str(in_parts.value) == str(at_once.value)
    parts = list(read_chunks(path, skip_bad_rows=True))
    assert [fault.line for part in parts for fault in part.rejected] == [101]
    assert sum(map(len, parts)) == len(survey()) - 1


@pytest.mark.usefixtures("small")
def test_an_unfinished_session_is_read_up_to_its_last_complete_line(tmp_path):
    path = survey().save(tmp_path / "r.csv")
    path.write_bytes(path.read_bytes()[:-20])
    (tmp_path / "r.csv.unfinished").write_text("{}")
    assert sum(map(len, read_chunks(path))) == len(survey()) - 1 == len(Recording.load(path))


def test_what_cannot_be_read_is_named(tmp_path, monkeypatch):
    with pytest.raises(RecordingNotFoundError):
        list(read_chunks(tmp_path / "none.csv"))
    (tmp_path / "empty.csv").write_text("distance_mm,angle_deg,reading_mm\n")
    with pytest.raises(RecordingError, match="has no rows"):
        list(read_chunks(tmp_path / "empty.csv"))
    whole = survey().save(tmp_path / "r.parquet").read_bytes()
    for cut in (4, 100, len(whole) - 3):
        (tmp_path / "cut.parquet").write_bytes(whole[:cut])
        with pytest.raises(RecordingError, match=r"cut.parquet: not a readable Parquet file"):
            Recording.load(tmp_path / "cut.parquet")
    survey().table.drop(columns="angle_deg").to_parquet(tmp_path / "short.parquet")
    with pytest.raises(RecordingError, match="column angle_deg is missing"):
        Recording.load(tmp_path / "short.parquet")
    (tmp_path / "row.csv").write_text('a,b\n"' + "x" * 200)
    monkeypatch.setattr(tables, "MAX_ROW", 50)
    with pytest.raises(RecordingError, match="line 2: a row of more than"):
        list(read_blocks(tmp_path / "row.csv", 20))


def test_a_parquet_file_has_the_columns_that_it_holds_whatever_pandas_notes_beside_them(tmp_path):
    table = survey().table.iloc[::2]
    table.to_parquet(tmp_path / "part.parquet")
    assert "__index_level_0__" not in Recording.load(tmp_path / "part.parquet").table
    for k, names in enumerate((range(3), pd.MultiIndex.from_product([["a"], ["x", "y", "z"]]))):
        pd.DataFrame(np.ones((2, 3)), columns=names).to_parquet(tmp_path / f"{k}.parquet")
        with pytest.raises(RecordingError, match=r"column distance_mm is missing.*found"):
            Recording.load(tmp_path / f"{k}.parquet")


def test_what_is_made_to_fill_memory_is_rejected(tmp_path, monkeypatch):
    header, path = b"distance_mm,angle_deg,reading_mm\n", tmp_path / "bomb.csv"
    monkeypatch.setattr(tables, "SMALL", 10_000)
    path.write_bytes(gzip.compress(header + b"500,0,501\n" * 10**5))
    for read in (Recording.load, lambda path: list(read_chunks(path))):
        with pytest.raises(RecordingError, match=r"bomb\.csv: expands to more than 100 times its size"):
            read(path)
    path.write_bytes(header + b"500,0,501\n" + b"," * 2 * tables.MAX_ROW)
    with pytest.raises(RecordingError, match=r"bomb\.csv, line 3: a row of more than 10 MiB"):
        Recording.load(path)
    monkeypatch.setattr(parquet, "MAX_VALUES", 100)
    with pytest.raises(RecordingError, match="million values; read it in parts"):
        Recording.load(survey().save(tmp_path / "r.parquet"))
    monkeypatch.setattr(parquet, "MAX_COLUMNS", 3)
    with pytest.raises(RecordingError, match="has more than 3 columns"):
        list(read_chunks(tmp_path / "r.parquet"))


def test_a_file_of_faults_is_no_recording_with_bad_rows(tmp_path, monkeypatch):
    monkeypatch.setattr(columns, "MAX_FAULTS", 5)
    (tmp_path / "r.csv").write_text("distance_mm,angle_deg,reading_mm\n" + "500,0,x\n" * 6)
    with pytest.raises(RecordingError, match=r"line 2, column reading_mm: 'x', .* \(and 5 more, too many to omit\)"):
        Recording.load(tmp_path / "r.csv", skip_bad_rows=True)
