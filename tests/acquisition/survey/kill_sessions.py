"""Kill recording sessions at random instants, and see after each kill what is on disk. Run by test_durability.py.

usage: kill_sessions.py FOLDER KILLS SEED; prints what came of it as JSON.
"""

import json
import os
import signal
import sys
import time
from pathlib import Path

import numpy as np

from acquisition import Recording
from acquisition.bench import Bus, Rig, Setup, Unit
from acquisition.survey.plan import Plan
from acquisition.survey.session import Session
from acquisition.survey.sources import RigSource

PLAN = Plan((0.0, 5.0), tuple(float(d) for d in range(200, 2200, 200)), (0.1, 0.9), pings=60, interval_s=0.2, seed=4)
SOURCE = RigSource(Rig(Unit.draw(4), Setup(gain=20, output="us", bus=Bus(nack=0.1))), seed=3)


def begin(path):
    """Start a session in a process of its own; return its id and where it tells the cells that are done."""
    reader, writer = os.pipe()
    child = os.fork()
    if not child:
        os.close(reader)
        Session(PLAN, SOURCE, path, resume=True).run(lambda done, of: os.write(writer, done.to_bytes(4, "big")))
        os._exit(0)
    os.close(writer)
    return child, reader


def kill(path, after_s):
    """Let a session run for some time and kill it; return the pings that it had told, and whether it was killed."""
    child, reader = begin(path)
    time.sleep(after_s)
    os.kill(child, signal.SIGKILL)
    status = os.waitpid(child, 0)[1]
    with os.fdopen(reader, "rb") as pipe:
        told = pipe.read()
    return int.from_bytes(told[-4:], "big") if told else 0, os.WIFSIGNALED(status)


def main(folder, kills, seed):
    """Kill as often as asked, over as many recordings as it takes."""
    rng = np.random.default_rng(seed)
    whole = Session(PLAN, SOURCE, folder / "whole.csv").run().read_bytes()
    result = {"kills": 0, "corrupt": 0, "lost_cells": 0, "torn": 0, "unreadable": 0, "recordings": 0}
    told, path = 0, folder / "0.csv"
    while result["kills"] < kills:
        heard, killed = kill(path, rng.uniform(0.0, 0.25))
        told = max(told, heard)
        result["kills"] += killed
        data = path.read_bytes() if path.exists() else b""
        lines = data[: data.rfind(b"\n") + 1]
        result["corrupt"] += not whole.startswith(data)
        rows = max(lines.count(b"\n") - 1, 0)
        result["torn"] += len(lines) != len(data) or rows % PLAN.pings != 0
        result["lost_cells"] += max(told - rows, 0) // PLAN.pings
        if rows:
            result["unreadable"] += len(Recording.load(path)) != rows
        if not killed:
            result["corrupt"] += data != whole
            result["recordings"] += 1
            told, path = 0, folder / f"{result['recordings']}.csv"
    print(json.dumps(result))


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]))
