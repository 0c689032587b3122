"""Workers and the start of the command: an interruption ends all of it, at once and without a traceback."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from training.common.workers import worker_processes

POOL = """
import signal, time
from pathlib import Path
from acquisition.io.files import write_atomic
from training.common.workers import worker_processes
def write(name):
    write_atomic(Path(name), lambda file: time.sleep(3600))
if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell starts background jobs with SIGINT ignored
    with worker_processes(2) as pool:
        jobs = [pool.submit(write, f"{k}.txt") for k in range(5)]
        while len(list(Path(".").glob("*.part"))) < 2:
            time.sleep(0.01)
        print("begun", flush=True)
        try:
            jobs[0].result()
        except KeyboardInterrupt:
            raise SystemExit(130)
"""


@pytest.mark.skipif(not hasattr(os, "killpg"), reason="needs groups of processes: Linux or macOS")
@pytest.mark.parametrize("to", [os.kill, os.killpg])
def test_an_interruption_ends_the_workers_at_once(tmp_path, to):
    path = tmp_path / "pool.py"
    path.write_text(POOL)
    command = [sys.executable, str(path)]
    process = subprocess.Popen(
        command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
    )  # fmt: skip
    assert process.stdout.readline() == "begun\n"
    time.sleep(1.0)
    to(process.pid, signal.SIGINT)
    _, error = process.communicate()  # pytest's own limit of time is shorter than the jobs
    assert (process.returncode, error) == (130, "")
    assert list(tmp_path.iterdir()) == [path]


KILLED = """
import os, time
from training.common.workers import worker_processes
if __name__ == "__main__":
    with worker_processes(2) as pool:
        print(*{pool.submit(os.getpid).result() for _ in range(20)}, flush=True)
        time.sleep(3600)
"""


def is_alive(pid):
    try:
        status = Path(f"/proc/{pid}/stat").read_text()
    except (FileNotFoundError, ProcessLookupError):
        return False
    return status.rsplit(")", 1)[1].split()[0] != "Z"


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="needs Linux, which tells what a process does")
def test_workers_end_with_a_command_that_is_killed(tmp_path):
    path = tmp_path / "pool.py"
    path.write_text(KILLED)
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    streams = {"stdout": subprocess.PIPE, "stderr": subprocess.DEVNULL, "text": True}
    with subprocess.Popen([sys.executable, str(path)], env=environment, **streams) as process:
        workers = [int(pid) for pid in process.stdout.readline().split()]
        process.kill()
    assert workers
    end = time.monotonic() + 30.0
    while any(map(is_alive, workers)):
        assert time.monotonic() < end, "workers outlive the command"
        time.sleep(0.05)


def test_the_results_of_the_workers_are_those_of_their_jobs():
    with worker_processes(2) as pool:
        assert list(pool.map(abs, range(-9, 0))) == list(range(9, 0, -1))


def fail(pool):
    pool.submit(time.sleep, 3600)
    raise ZeroDivisionError


def test_an_error_waits_for_no_worker():
    with pytest.raises(ZeroDivisionError), worker_processes(1) as pool:
        fail(pool)


START = """
import os, signal, sys, threading
import sonar_gym_command
signal.signal(signal.SIGINT, signal.default_int_handler)
threading.Timer(0.05, os.kill, (os.getpid(), signal.SIGINT)).start()
sys.argv[1:] = ["effects"]
sonar_gym_command.main()
"""


@pytest.mark.skipif(sys.platform == "win32", reason="needs signals")
def test_an_interruption_of_the_start_shows_no_traceback():
    done = subprocess.run([sys.executable, "-c", START], capture_output=True, text=True)
    assert done.returncode in (-signal.SIGINT, 130)  # while packages are imported, or in the command
    assert "Traceback" not in done.stderr
