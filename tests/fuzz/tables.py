"""Bad and strange tables, made from a valid one."""

import gzip

from hypothesis import strategies as st

CELLS = (
    "",
    "nan",
    "inf",
    "-inf",
    "1e999",
    "-1",
    "1,5",
    "x",
    "0",
    "1e-320",
    "1e308",
    "٣",
    "0x10",
    "1_0",
    "--",
    "NULL",
    "=1+1",
    "½",
    '"',
    "\x1b[2J",
)
WORDS = """distance angle incidence reflectance run time range interval_s status reading self cls covariates name
time_s session
sensor echo_2_mm echo_18_mm incidence_deg condition temperature_c humidity_pct gain index visit level_0"""
NAMES = (*WORDS.split(), "Unnamed: 0", "", " ", "a,b", "💥", "x" * 300, "\u202e")
BASE = ("time_s", "distance_mm", "angle_deg", "reflectance", "reading_mm")


def rows_of(n, distances=12):
    """Return the rows of a valid table: n pings at a few distances and two reflectances."""
    where = [200.0 + 180.0 * (k * distances // n) for k in range(n)]
    return [
        [f"{0.1 * k:g}", f"{d:g}", f"{9 * (k % 2)}", ("0.1", "0.9")[k % 4 // 2], f"{d + 7 * k % 11 - 5:g}"]
        for k, d in enumerate(where)
    ]


@st.composite
def tables(draw):
    """Header and rows: columns added, removed, renamed or repeated, cells replaced, few rows or many."""
    n = draw(st.sampled_from((0, 1, 2, 3, 5, 24, 120)))
    header, rows = list(BASE), rows_of(max(n, 1))[:n]
    for name in draw(st.lists(st.sampled_from(NAMES), max_size=3)):
        values = draw(st.sampled_from((("1",), ("1", "2"), ("a", "b", ""), CELLS, ("",), ("5", "nan"), ("1e18", "0"))))
        header.append(name)
        for k, row in enumerate(rows):
            row.append(values[k % len(values)])
    if draw(st.booleans()):
        column, value = draw(st.integers(0, len(header) - 1)), draw(st.sampled_from(CELLS))
        for row in rows if draw(st.booleans()) else rows[-1:]:
            row[column] = value
    if draw(st.integers(0, 3)) == 0:
        del header[draw(st.integers(0, len(header) - 1))]
    if draw(st.integers(0, 3)) == 0:
        column, factor = draw(st.integers(0, 4)), draw(st.sampled_from((0.0, 1e-3, -1.0, 1e3, 1e6)))
        for row in rows:
            row[column] = f"{factor * float(row[column]):g}" if row[column].replace(".", "").isdigit() else row[column]
    return header, rows


@st.composite
def csv_bytes(draw):
    """A table as a file: other delimiters, line ends, encodings, compression, and damage."""
    header, rows = draw(tables())
    delimiter = draw(st.sampled_from((",", ",", ",", ",", ";", "\t", " ")))
    end = draw(st.sampled_from(("\n", "\n", "\r\n", "\r", "\n\n")))
    text = end.join(delimiter.join(row) for row in (header, *rows)) + draw(
        st.sampled_from((end, "", end * 3, "\x00", '"'))
    )
    data = text.encode(draw(st.sampled_from(("utf-8", "utf-8", "utf-8-sig", "utf-16", "cp1252"))), "replace")
    data = gzip.compress(data) if draw(st.integers(0, 7)) == 0 else data
    if draw(st.integers(0, 3)) == 0:
        data = data[: draw(st.integers(0, len(data)))]
    if data and draw(st.integers(0, 5)) == 0:
        place = draw(st.integers(0, len(data) - 1))
        data = data[:place] + draw(st.binary(min_size=1, max_size=4)) + data[place + 1 :]
    return data
