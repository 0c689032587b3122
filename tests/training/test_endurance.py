"""Endurance: commands that are killed at random instants, and hours of recording and driving with flat memory."""

import json
import os
import resource
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from acquisition import Recording
from acquisition.survey.plan import SurveyPlan
from acquisition.survey.session import Session
from sonar_gym import SonarParkingVectorEnv
from training.recordings.record import SOURCES, Args, with_gain

ROOT = Path(__file__).parents[2]
KILLS = {"record": 40, "import": 40, "train-noise": 35, "train-agent": 35, "zoo": 25, "prove": 25}
HOURS, INTERVAL_S, ENVS = 8, 0.25, 16
MAX_GROWTH_KIB = 30 * 1024
pytestmark = [pytest.mark.slow, pytest.mark.timeout(7200)]


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs signals and fork: Linux or macOS")
@pytest.mark.parametrize("name", KILLS)
def test_200_kills_of_six_commands_lose_and_alter_nothing(tmp_path, name):
    command = [sys.executable, str(Path(__file__).with_name("kill_commands.py")), str(tmp_path), name, str(KILLS[name])]
    done = subprocess.run([*command, "1"], capture_output=True, text=True, env={**os.environ, "PYTHONPATH": str(ROOT)})
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    print(f"\n{name}: {result}")
    assert result["kills"] == KILLS[name]
    assert {key: result[key] for key in ("harmed", "failed", "different")} == {
        "harmed": 0, "failed": 0, "different": 0,
    }  # fmt: skip


def memory_kib():
    """Return the memory of this process, KiB."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize() // 1024


class Growth:
    """Memory at the end of a run beyond that after its first tenth, KiB."""

    def __init__(self, total):
        self.total, self.first, self.kib = total, 0, 0

    def __call__(self, done, _=None):
        if not self.first and done >= self.total // 10:
            self.first = memory_kib()
        self.kib = memory_kib() - self.first


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="needs /proc")
def test_eight_hours_of_recording_keep_memory_flat(tmp_path):
    distances = tuple(float(d) for d in range(200, 2600, 50))
    pings = round(HOURS * 3600 / INTERVAL_S / len(distances))
    plan = SurveyPlan((0.0,), distances, (0.9,), pings=pings, interval_s=INTERVAL_S)
    path, growth = tmp_path / "r.csv", Growth(pings * len(distances))
    recording = Recording.load(Session(plan, SOURCES["twin"](with_gain(Args(path, driver="twin"))), path).run(growth))
    print(f"\n{len(recording)} pings, memory grew by {growth.kib} KiB")
    assert len(recording) == pings * len(distances)
    assert np.ptp(recording.ping.time) >= 0.99 * HOURS * 3600
    assert growth.kib < MAX_GROWTH_KIB


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="needs /proc")
def test_eight_hours_of_driving_keep_memory_flat():
    envs, steps = SonarParkingVectorEnv(ENVS, sonar="srf08-mlp", threads=1), HOURS * 36_000
    rng, growth = np.random.default_rng(0), Growth(steps)
    envs.reset(seed=0)
    for step in range(steps):
        observations, rewards, *_ = envs.step(rng.uniform(-1.0, 1.0, (ENVS, 2)))
        if step % 1000 == 0:
            assert envs.observation_space.contains(observations)
            assert np.all(np.isfinite(rewards))
            growth(step)
    print(f"\n{steps} steps of {ENVS} cars, memory grew by {growth.kib} KiB")
    assert growth.kib < MAX_GROWTH_KIB
