"""Speed of the sonar server, and punctuality of the OpenDLV sonars.

Run by `make benchmarks`; prints the figures of docs/how-to/simulators.md. Times are those of the wall clock, so that
other load makes them worse. The sonars run for ten minutes in a network namespace of their own.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from acquisition import Ping
from sonar_gym.bridges.server.client import SonarClient, address_of
from training.common.tables import markdown_table

MODELS = ("ideal", "srf08-mlp", "srf08-lstm", "srf08-hybrid")
BATCH, BATCHES, SINGLES = 64, 400, 400
MIN_RATE = 20_000  # pings/s in batches of 64
DURATION_S, SONARS, RATE_HZ = 600, 8, 20
MAX_JITTER_S, SHARE = 0.005, 0.95
ROOM = "-1,-1,1,-1;\n1,-1,1,1;\n1,1,-1,1;\n-1,1,-1,-1;\n"
ROUTED = 'ip link set lo up && ip route add 225.0.0.0/24 dev lo && exec "$0" "$@"'


def command(*args: object) -> list[str]:
    return [sys.executable, "-m", "training.cli", *map(str, args)]


def seconds(client: SonarClient, ping: Ping, repeats: int) -> np.ndarray:
    """Return the wall-clock times of requests, s, (repeats,)."""
    client.ask(ping)
    found = np.empty(repeats)
    for k in range(repeats):
        begin = time.perf_counter()
        client.ask(ping)
        found[k] = time.perf_counter() - begin
    return found


def processor_time(process: subprocess.Popen[str]) -> float:
    """Return the processor time of a process, s; NaN without /proc."""
    stat = Path(f"/proc/{process.pid}/stat")
    if not stat.exists():
        return np.nan
    user, system = stat.read_text().rpartition(")")[2].split()[11:13]  # see proc(5)
    return (int(user) + int(system)) / os.sysconf("SC_CLK_TCK")


def measured(model: str) -> tuple[float, float, float, float]:
    """Return pings/s in batches, median times of a batch and a single ping, s, and the server's time of a batch, s."""
    rng = np.random.default_rng(0)
    ping = Ping.of(
        rng.uniform(0.1, 5.0, BATCH), rng.uniform(-0.4, 0.4, BATCH), reflectance=rng.uniform(0.1, 0.9, BATCH),
        run=np.arange(BATCH),
    )  # fmt: skip
    with subprocess.Popen(command("serve", model, "--port", 0), stdout=subprocess.PIPE, text=True) as server:
        assert server.stdout is not None
        words = server.stdout.readline().replace(";", "").split()
        address = next(found for found in map(address_of, words) if found)
        with SonarClient(*address) as client:
            client.ask(ping)
            begin = processor_time(server)
            batch = seconds(client, ping, BATCHES)
            used = (processor_time(server) - begin) / (BATCHES + 1)
            single = seconds(client, ping[:1], SINGLES)
        server.terminate()
    return BATCH * BATCHES / float(batch.sum()), float(np.median(batch)), float(np.median(single)), used


def test_the_server_answers_20_000_pings_a_second() -> None:
    found = {model: measured(model) for model in MODELS}
    rows = [
        [
            model, f"{rate:,.0f}", f"{1e3 * batch / BATCH:.3f} ms", f"{1e3 * single:.2f} ms",
            f"{1e3 * used:.2f} ms ({BATCH / used:,.0f} pings/s)",
        ]
        for model, (rate, batch, single, used) in found.items()
    ]  # fmt: skip
    columns = ["model", "pings/s, batches of 64", "a ping", "a single ping", "processor time of a batch"]
    print("\n" + markdown_table(columns, rows))
    assert all(rate >= MIN_RATE for rate, *_ in found.values())


LISTEN = """
import subprocess, sys
from sonar_gym.bridges.opendlv.messages import READING
from sonar_gym.bridges.opendlv.session import Session, seconds_of
session, sonars = Session.join(111), subprocess.Popen(sys.argv[2:], stdout=subprocess.DEVNULL)
with open(sys.argv[1], "w") as out:
    while sonars.poll() is None:
        envelope = session.receive(0.05)
        if envelope is not None and envelope.message == READING:
            times = seconds_of(envelope.sampled), seconds_of(envelope.received)
            print(envelope.sender_stamp, *map(repr, times), file=out)
"""


def jitter(times: np.ndarray) -> np.ndarray:
    """Return the deviations of times from a grid of the period, s."""
    number = np.rint((times - times[0]) * RATE_HZ)
    off = times - number / RATE_HZ
    return np.abs(off - np.median(off))


@pytest.mark.timeout(1200)
def test_readings_of_8_sonars_at_20_hz_are_on_time(tmp_path: Path) -> None:
    if shutil.which("unshare") is None:
        pytest.skip("needs unshare")
    room, log = tmp_path / "room.map", tmp_path / "readings.txt"
    room.write_text(ROOM)
    sonars = command("bridge", "opendlv-sonar", "--map", room, "--mounts", "eight", "--frequency-hz", RATE_HZ,
                     "--latency-s", 0.04, "--duration-s", DURATION_S)  # fmt: skip
    subprocess.run(["unshare", "-rn", "sh", "-c", ROUTED, sys.executable, "-c", LISTEN, log, *sonars], check=True)
    table = np.loadtxt(log)
    share, shares = len(table) / (DURATION_S * SONARS * RATE_HZ), []
    print(f"\n{share:.4f} of the readings; load {os.getloadavg()[1]:.1f}")
    for name, column in (("ping", 1), ("arrival", 2)):
        found = np.concatenate([jitter(table[table[:, 0] == k, column]) for k in range(SONARS)])
        shares.append(np.mean(found <= MAX_JITTER_S))
        print(f"{name}: median {1e3 * np.median(found):.2f} ms, within 5 ms {shares[-1]:.4f}")
    assert min(share, *shares) >= SHARE
