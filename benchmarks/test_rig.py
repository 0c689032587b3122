"""Run time of the rig: the thesis's survey on disk, and batches of different conditions as in a simulator.

Run by `make benchmarks` with one thread per library; prints Markdown for docs/explanation/rig.md. Batches are processor
time, the best of several repetitions.
"""

from __future__ import annotations

import resource
import subprocess
import sys
import time
import timeit
from pathlib import Path

import numpy as np
import pytest

from acquisition import Ping, Recording
from noise.rig import RigModel

SURVEY_S, SURVEY_KB = 60.0, 2 * 1024**2
LIMITS_MS = {8: 10.0, 1024: 1000.0}  # per batch, by number of pings


def test_survey_of_the_thesis(tmp_path: Path) -> None:
    out = tmp_path / "thesis.csv"
    begin = time.perf_counter()
    command = [sys.executable, "-m", "training.cli", "record", "--plan", "thesis", "--gain", "14", "--out", str(out)]
    subprocess.run(command, check=True, capture_output=True)
    took, used = time.perf_counter() - begin, resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss
    print(f"\nthesis survey of {len(Recording.load(out).ping)} pings: {took:.1f} s, peak memory {used / 1024:.0f} MiB")
    assert took <= SURVEY_S
    assert used <= SURVEY_KB


@pytest.mark.parametrize("n", LIMITS_MS)
def test_batches(n: int) -> None:
    rng, model = np.random.default_rng(0), RigModel()
    angles = np.deg2rad(rng.uniform(-27.5, 27.5, (2, n)))
    ping = Ping.of(rng.uniform(0.1, 3.0, n), *angles, reflectance=rng.choice([0.1, 0.9], n), time=0.0)
    fire = timeit.Timer(lambda: model.law(ping).sample(rng), timer=time.process_time)
    number = max(1, 64 // n)
    best = min(fire.repeat(5, number)) / number
    print(f"\nbatch of {n} pings: {1e3 * best:.1f} ms, {1e6 * best / n:.0f} us per ping")
    assert 1e3 * best <= LIMITS_MS[n]
