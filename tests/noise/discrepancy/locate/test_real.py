"""Two halves of one real recording, in alternating blocks, do not differ."""

import numpy as np
import pandas as pd
import pytest

from acquisition import Recording
from noise.discrepancy.locate.orthogonal import orthogonal_test
from noise.discrepancy.moments.sample import Sample
from noise.effects import CATALOGUE
from noise.fitting.batch import Batch
from noise.fitting.fit import maximise
from noise.fitting.stack import NUISANCES, Stack
from noise.fitting.starts import nuisance_start
from noise.physical import PhysicalModel

pytestmark = pytest.mark.slow
FREE = (("clock_scale", "error"), ("zero_offset", "offset_m"), ("spike", "probability"))
BLOCK = 25


def calibration(folder):
    log = pd.read_csv(folder / "hcsr04-calibration" / "readings.csv")
    columns = {"session": log.source_file, "distance_mm": 10.0 * log.true_cm, "angle_deg": 0.0}
    return pd.DataFrame({**columns, "interval_ms": log.interval_ms * 1.0, "reading_mm": 10.0 * log.measured_cm})


def wall(folder, name):
    log = pd.read_csv(folder / "hcsr04-maxbotix-wall" / "training2.csv")
    columns = {"distance_mm": 1e3 * log["range"], "angle_deg": 0.0, "time_s": log.time - log.time[0]}
    return pd.DataFrame({**columns, "reading_mm": 1e3 * log[name]})


def fixed(folder):
    log = pd.read_csv(folder / "fixed-ranger-copenhagen" / "segments-1-and-3.csv")
    stamp = pd.to_datetime(log.TIMESTAMP)
    distance = log.groupby("segment").range_raw_m.transform("median")
    columns = {"session": log.segment.astype(str), "distance_mm": 1e3 * distance, "angle_deg": 0.0}
    columns |= {"time_s": (stamp - stamp[0]).dt.total_seconds(), "reading_mm": 1e3 * log.range_raw_m}
    return pd.DataFrame(columns).dropna()


TABLES = {
    "calibration": calibration,
    "HC-SR04 and a wall": lambda folder: wall(folder, "sonar1"),
    "MaxBotix and a wall": lambda folder: wall(folder, "sonar2"),
    "fixed target for weeks": fixed,
}


def fitted(batch):
    few = batch.thin(1000)
    names = ["travel_time_jitter", "clock_scale", "zero_offset", "spike"]
    stack = Stack.of(PhysicalModel([CATALOGUE[name]() for name in names], batch.resolution))
    return maximise(nuisance_start(stack, few), [*FREE, *NUISANCES], few, 60).stack


@pytest.mark.parametrize("name", TABLES)
def test_halves_of_a_recording_do_not_differ(real_recordings, name):
    table = TABLES[name](real_recordings)
    block = np.arange(len(table)) // BLOCK
    side = np.random.default_rng(1).permutation(block.max() + 1)[block] % 2
    halves = [Batch.of(Recording(table[side == k].reset_index(drop=True), name)) for k in (0, 1)]
    law = fitted(halves[1])
    tested = orthogonal_test(law, law, Sample(halves[0], halves[1]), np.random.default_rng(0))
    assert tested.p_value.value > 0.01
