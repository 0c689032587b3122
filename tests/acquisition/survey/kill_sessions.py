"""Kill recording sessions at random instants and check the file after each kill. Run by test_durability.py.

usage: kill_sessions.py FOLDER KILLS SEED; prints the result as JSON.
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
from acquisition.survey.plan import SurveyPlan
from acquisition.survey.session import Session
from acquisition.survey.sources import RigSource

PLAN = SurveyPlan(
    (0.0, 5.0), tuple(float(d) for d in range(200, 2200, 200)), (0.1, 0.9), pings=60, interval_s=0.2, seed=4
)
SOURCE = RigSource(Rig(Unit.draw(4), Setup(gain=20, output="us", bus=Bus(nack=0.1))), seed=3)


def begin(path):
    """Start a session in a child process; return its id and the pipe with the number of recorded pings."""
    reader, writer = os.pipe()
    child = os.fork()
    if not child:
        os.close(reader)
        Session(PLAN, SOURCE, path, resume=True).run(lambda done, of: os.write(writer, done.to_bytes(4, "big")))
        os._exit(0)
    os.close(writer)
    return child, reader


def kill(path, after_s):
    """Kill a session after some time; return the number of pings it reported, and whether it was still running."""
    child, reader = begin(path)
    time.sleep(after_s)
    os.kill(child, signal.SIGKILL)
    status = os.waitpid(child, 0)[1]
    with os.fdopen(reader, "rb") as pipe:
        report = pipe.read()
    return int.from_bytes(report[-4:], "big") if report else 0, os.WIFSIGNALED(status)


def main(folder, kills, seed):
    """Kill sessions `kills` times, on as many recordings as needed."""
    rng = np.random.default_rng(seed)
    whole = Session(PLAN, SOURCE, folder / "whole.csv").run().read_bytes()
    result = {"kills": 0, "corrupt": 0, "lost_visits": 0, "torn": 0, "unreadable": 0, "recordings": 0}
    reported, path = 0, folder / "0.csv"
    while result["kills"] < kills:
        pings, killed = kill(path, rng.uniform(0.0, 0.25))
        reported = max(reported, pings)
        result["kills"] += killed
        data = path.read_bytes() if path.exists() else b""
        lines = data[: data.rfind(b"\n") + 1]
        result["corrupt"] += not whole.startswith(data)
        rows = max(lines.count(b"\n") - 1, 0)
        result["torn"] += len(lines) != len(data) or rows % PLAN.pings != 0
        result["lost_visits"] += max(reported - rows, 0) // PLAN.pings
        if rows:
            result["unreadable"] += len(Recording.load(path)) != rows
        if not killed:
            result["corrupt"] += data != whole
            result["recordings"] += 1
            reported, path = 0, folder / f"{result['recordings']}.csv"
    print(json.dumps(result))


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]))
