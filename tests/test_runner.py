"""The runner of the tests: a crash of a worker process is a failure, and never a wait."""

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
CRASH = "import os, signal, time\ndef test_one(): time.sleep(2)\ndef test_two(): os.kill(os.getpid(), signal.SIGKILL)\n"


def test_a_worker_that_crashes_ends_the_run_as_failed(tmp_path):
    for name, text in (("a", "def test(): pass"), ("b", CRASH), ("c", "def test(): pass")):
        (tmp_path / f"test_{name}.py").write_text(text)
    options = ["-c", ROOT / "pyproject.toml", "--rootdir", tmp_path, "-n", "2", "--dist", "loadfile", "-q"]
    done = subprocess.run(
        [sys.executable, "-m", "pytest", *options, tmp_path], cwd=tmp_path, capture_output=True, text=True, timeout=100
    )
    assert done.returncode == 1, done.stdout
    assert "1 failed" in done.stdout
    assert "crashed while running" in done.stdout
