"""Time and memory of a diagnosis of 10,000 pings and of the thesis's 133,100.

Run by `make benchmarks`; prints Markdown. The limits apply to wall time on two idle cores.
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from acquisition import Ping, Recording
from noise.effects import CATALOGUE
from noise.physical import PhysicalModel

TRUTH = {
    "sensitivity": {"loss_db": 36.0},
    "specular_loss": {"strength": 0.6},
    "sound_speed": {"temperature_c": 31.0},
    "travel_time_jitter": {"sigma_m": 0.004},
}
MAX_GIB = 1.0
LIMITS = {"2000": (40, 50, 5.0), "10000": (200, 50, 15.0), "133100": (1331, 100, 40.0)}  # visits, pings of each, s


def recorded(visits: int, each: int, path: Path) -> None:
    """Write a recording with known effects and placement errors of 3 mm."""
    rng = np.random.default_rng(0)
    distance, angle = np.repeat(rng.uniform(0.3, 5.5, visits), each), np.repeat(rng.uniform(0.0, 0.7, visits), each)
    placed = distance + np.repeat(rng.normal(0.0, 0.003, visits), each)
    seconds = np.arange(len(distance)) * 0.065
    law = PhysicalModel([CATALOGUE[name](**values) for name, values in TRUTH.items()])
    reading = law.law(Ping.of(distance=placed, angle=angle, time=seconds)).sample(rng)
    Recording.of(Ping.of(distance=distance, angle=angle, time=seconds), reading).save(path)


@pytest.mark.parametrize(("visits", "each", "max_s"), LIMITS.values(), ids=LIMITS)
def test_a_diagnosis_is_fast_enough(visits: int, each: int, max_s: float, tmp_path: Path) -> None:
    recorded(visits, each, tmp_path / "recorded.csv")
    command = [sys.executable, "-m", "training.cli", "diagnose", str(tmp_path / "recorded.csv")]
    before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    command += ["--out", str(tmp_path / "out")]
    subprocess.run(command, check=True, capture_output=True)
    wall, after = time.perf_counter() - start, resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    gib = after.ru_maxrss / 2**20
    verdict = json.loads((tmp_path / "out" / "verdict.json").read_text())
    named = ", ".join(cause["effect"] for cause in verdict["causes"])
    print(f"\n| {visits * each:,} pings | {wall:.0f} s | {cpu:.0f} s | {gib:.2f} GiB | {named} |")
    assert wall < max_s
    assert gib < MAX_GIB
