"""Processor time and memory of long recordings; run by `make benchmarks` with one thread per library."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from acquisition import Ping, Reading, Recording
from acquisition.io.chunks import write_chunks
from acquisition.io.columns import convert
from acquisition.io.tables import parse_table

ROWS, LOAD_S = 2_000_000, 5.0
MANY, MANY_MIB = 10_000_000, 700.0
PASS = """
import sys
import acquisition.io.chunks as chunks
def peak(): return int(open("/proc/self/status").read().split("VmHWM:")[1].split()[0])
before = peak()
rows = sum(len(part) for part in chunks.read_chunks(sys.argv[1]))
print(rows, (peak() - before) / 1024)
"""


def part(k: int, rows: int = 100_000) -> Recording:
    """Return visits of 100 pings with a session, a covariate, echoes, misses and missing answers."""
    rng = np.random.default_rng(k)
    visit = np.repeat(rng.uniform(0.2, 4.0, rows // 100), 100)
    ping = Ping.of(visit, rng.uniform(-0.6, 0.6, rows), run=k, temperature_c=20.0 + rng.random(rows))
    echo = Reading.of(np.where(rng.random(rows) < 0.05, 0.0, np.round(visit + 0.005 * rng.normal(size=rows), 3)))
    recording = Recording.of(ping, echo)
    recording.table.loc[::1000, "reading_mm"] = np.nan
    return recording


@pytest.mark.slow
def test_two_million_rows_of_csv_are_loaded_in_five_seconds(tmp_path: Path) -> None:
    path = tmp_path / "r.csv"
    write_chunks(path, map(part, range(ROWS // 100_000)))
    begin = time.process_time()
    recording = Recording.load(path)
    load = time.process_time() - begin
    begin = time.process_time()
    table, faults = convert(str(path), parse_table(path.read_bytes(), str(path)))
    text = time.process_time() - begin
    assert not faults
    assert table.equals(recording.table)
    print(f"{ROWS:,} rows of CSV: {load:.1f} s of processor time, {text / load:.1f} times as fast as by text")
    assert load <= LOAD_S


@pytest.mark.slow
@pytest.mark.parametrize("name", ["r.csv", "r.parquet"])
def test_ten_million_rows_are_read_in_bounded_memory(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    write_chunks(path, map(part, range(MANY // 100_000)))
    begin = time.perf_counter()
    done = subprocess.run([sys.executable, "-c", PASS, str(path)], check=True, capture_output=True, text=True)
    rows, mib = done.stdout.split()
    print(
        f"{name}: {int(rows):,} rows, {path.stat().st_size / 2**20:.0f} MiB, read with {float(mib):.0f} MiB more memory"
    )
    print(f"in {time.perf_counter() - begin:.0f} s")
    assert (int(rows), float(mib) <= MANY_MIB) == (MANY, True)
