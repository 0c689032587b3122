"""Kill commands that write at random instants, go on, and compare with an undisturbed run. Run by test_endurance.py.

usage: kill_commands.py FOLDER COMMAND KILLS SEED; prints the result as JSON.
"""

import json
import os
import random
import shutil
import signal
import sys
import time
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import torch
from safetensors.numpy import load_file
from stable_baselines3 import PPO

import training.agents.train
import training.agents.zoo.command as zoo
import training.noise.train
import training.proof.run
import training.recordings.import_log
import training.recordings.record  # noqa: F401 - imported once, before the processes are forked
from acquisition import Ping, Reading, Recording
from sonar_gym.agent import load_policy
from training.cli import main as run_command
from training.common import canvas  # noqa: F401
from training.proof.chain import load as load_ledger
from training.proof.verify import Args as Verify
from training.proof.verify import problems_of

PLAN = """angles_deg = [0, 10]
distances_mm = {from = 200, to = 1400, step = 200}
reflectances = [0.1, 0.9]
pings = 20
interval_s = 0.2
"""
MAPS = [f"{name}={name}" for name in ("time_s", "distance_mm", "angle_deg", "reading_mm")]
SHORT = {"n_steps": 16, "batch_size": 256}


def words_of(name, folder, out):
    """Return the words of a command that takes a few seconds."""
    return {
        "record": ["record", "--plan", folder / "plan.toml", "--seed", 3, "--resume", "--out", out / "r.csv"],
        "import": ["import", folder / "log.csv", "--out", out / "r.csv", "--columns", *MAPS],
        "train-noise": ["train-noise", folder / "small.csv", "--out", out / "m", "--epochs", 20, "--hidden", 8],
        "train-agent": ["train-agent", "--out", out / "a", "--lessons", 2, "--steps", 8000, "--num-envs", 8,
                        "--hidden", 8, "--sonars", "ideal", "--repeat", 1],
        "zoo": ["zoo", "ppo", "--out", out / "z", "--steps", 15_000, "--episodes", 2],
        "prove": ["prove", "--out", out / "p", "--trials", 2, "--pings", 40, "--left-out", 0, "--workers", 1],
    }[name]  # fmt: skip


RESULTS = {
    "record": "r.csv", "import": "r.csv", "train-noise": "m/weights.safetensors",
    "train-agent": "a/agent/weights.safetensors", "zoo": "z/model.zip", "prove": "p/ledger.jsonl",
}  # fmt: skip


def content(path):
    """Return what must be equal after kills: bytes, or the weights in a file that also holds times."""
    if path.suffix == ".zip":
        return {name: value.numpy() for name, value in PPO.load(path, device="cpu").policy.state_dict().items()}
    return load_file(path) if path.suffix == ".safetensors" else path.read_bytes()


def equal(name, path, whole):
    """Return whether a result is that of an undisturbed run; trials are drawn anew, so one is diagnosed again."""
    if name == "prove":
        return not problems_of(load_ledger(path), Verify(path, rediagnose=1, workers=1, unannounced=True))
    one, other = content(path), whole
    if isinstance(one, bytes):
        return one == other
    return one.keys() == other.keys() and all(np.array_equal(one[name], other[name]) for name in one)


def run(words, log, kill_after_s=np.inf, group=False):
    """Run a command in a process of its own; return whether it was killed, and its exit code."""
    child = os.fork()
    if not child:
        os.setpgid(0, 0)
        handle = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
        os.dup2(handle, 1), os.dup2(handle, 2)
        code = 70
        with suppress(BaseException):
            try:
                run_command(list(map(str, words)))
                code = 0
            except SystemExit as left:
                code = left.code or 0
        os._exit(code)
    end, status = time.monotonic() + kill_after_s, None
    while status is None and time.monotonic() < end:
        done, found = os.waitpid(child, os.WNOHANG)
        status = found if done else None
        time.sleep(0.002)
    if status is None:
        (os.killpg if group else os.kill)(child, signal.SIGKILL)
        status = os.waitpid(child, 0)[1]
    with suppress(ProcessLookupError):  # workers of a process that was killed alone
        os.killpg(child, signal.SIGKILL)
    return os.WIFSIGNALED(status), os.waitstatus_to_exitcode(status)


def unharmed(name, path, whole, before):
    """Return whether what stands at the path after a kill is nothing, or right; a growing file only grows."""
    data = path.read_bytes() if path.is_file() else b""
    if name == "record":
        return whole.startswith(data) and len(data) >= len(before)
    if name == "prove":  # an incomplete last line is cut off when the command goes on
        complete = data[: data.rfind(b"\n") + 1]
        return complete.startswith(before[: before.rfind(b"\n") + 1])
    if name == "train-agent" and path.parent.exists():
        load_policy(path.parent)
    return not data or name == "train-agent" or equal(name, path, whole)


def prepare(folder):
    (folder / "plan.toml").write_text(PLAN)
    rng, distance = np.random.default_rng(0), np.repeat(np.linspace(0.3, 2.5, 12), 20)
    reading = Reading.of(np.round(distance + 0.005 * rng.standard_normal(240), 2))
    recording = Recording.of(Ping.of(distance, np.tile([0.0, 0.1], 120), time=0.1 * np.arange(240)), reading)
    recording.save(folder / "small.csv")
    table = pd.concat([recording.table] * 100, ignore_index=True)
    Recording(table.assign(time_s=0.1 * np.arange(len(table)))).save(folder / "log.csv")
    tuned = zoo.tuned
    zoo.tuned = lambda *args: replace(
        tuned(*args), n_timesteps=20_000, keywords={**tuned(*args).keywords, **SHORT}
    )  # legs of 1,000 steps, so that some are complete at a kill


def main(folder, name, kills, seed):
    """Kill a command `kills` times, on as many outputs as needed, each run until it ends."""
    torch.set_num_threads(1)
    prepare(folder)
    rng, log, out = random.Random(seed), folder / "log.txt", folder / "whole"
    for _ in range(2):  # the first run may compile
        shutil.rmtree(out, ignore_errors=True)
        out.mkdir()
        begin = time.monotonic()
        assert run(words_of(name, folder, out), log) == (False, 0), log.read_text()
    seconds, whole = time.monotonic() - begin, content(out / RESULTS[name])
    result, killed = {"kills": 0, "harmed": 0, "failed": 0, "different": 0, "finished": 0}, False
    while killed or result["kills"] < kills:
        out = folder / str(result["finished"])
        out.mkdir(exist_ok=True)
        path = out / RESULTS[name]
        before = path.read_bytes() if path.is_file() else b""
        end_it = (
            result["kills"] == kills or rng.random() < 0.1
        )  # without progress between kills, a command would never end
        after_s = np.inf if end_it else rng.uniform(0.0, seconds)
        killed, code = run(words_of(name, folder, out), log, after_s, rng.random() < 0.5)
        if not end_it:  # a machine that becomes slower would kill too early to go on, a faster one too late to kill
            seconds *= 1.1 if killed else 0.8
        result["kills"] += killed
        result["harmed"] += not unharmed(name, path, whole, before)
        if not killed:
            result["failed"] += code != 0
            if code:
                print(f"{name}: exit code {code}: {log.read_text()[-2000:]}", file=sys.stderr)
            result["different"] += not (code == 0 and equal(name, path, whole))
            result["finished"] += 1
    print(json.dumps(result))


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2], int(sys.argv[3]), int(sys.argv[4]))
