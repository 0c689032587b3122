"""Compiled kernels follow their sources, those of other files too; and nothing is compiled twice."""

import os
import subprocess
import sys
import time
from pathlib import Path

import sonar_gym
from sonar_gym.compiled import drop_stale

INNER = "from numba import njit\n@njit(cache=True)\ndef inner():\n    return {}\n"
OUTER = "from numba import njit\nfrom inner import inner\n@njit(cache=True)\ndef outer():\n    return inner()\n"
RUN = """
from pathlib import Path
from sonar_gym.compiled import drop_stale
drop_stale(Path("."))
from outer import outer
print(outer(), outer.stats.cache_hits.get((), 0))
"""


def say(folder):
    """Return what the outer kernel says in a process of its own, and whether it was there already."""
    package = str(Path(sonar_gym.__file__).parents[1])
    env = {**os.environ, "PYTHONPATH": os.pathsep.join([str(folder), package])}
    env.pop("NUMBA_CACHE_DIR", None)
    done = subprocess.run([sys.executable, "-c", RUN], cwd=folder, env=env, capture_output=True, text=True, check=True)
    value, there = done.stdout.split()
    return int(value), there == "1"


def write(path, text, seconds_ago):
    path.write_text(text)
    then = time.time() - seconds_ago
    os.utime(path, (then, then))


def test_a_kernel_is_compiled_anew_when_one_that_it_calls_has_changed(tmp_path):
    write(tmp_path / "outer.py", OUTER, 100)
    write(tmp_path / "inner.py", INNER.format(1), 100)
    assert say(tmp_path) == (1, False)
    assert say(tmp_path) == (1, True)
    write(tmp_path / "inner.py", INNER.format(2), 0)
    assert say(tmp_path) == (2, False)


def test_only_what_is_older_than_its_sources_is_dropped(tmp_path):
    kept = tmp_path / "__pycache__"
    kept.mkdir()
    write(tmp_path / "a.py", "", 50)
    write(tmp_path / "b.py", "", 20)
    write(tmp_path / "no_kernels.py", "", 0)
    write(kept / "a.f-1.py311.nbi", "", 10)
    write(kept / "b.g-1.py311.nbi", "", 5)
    assert drop_stale(tmp_path) == []
    write(tmp_path / "b.py", "", 7)
    assert [path.name for path in drop_stale(tmp_path)] == ["a.f-1.py311.nbi"]
    assert (kept / "b.g-1.py311.nbi").is_file()


def test_a_source_from_the_future_drops_nothing(tmp_path):
    (tmp_path / "__pycache__").mkdir()
    write(tmp_path / "a.py", "", -1000)
    write(tmp_path / "__pycache__" / "a.f-1.py311.nbi", "", 10)
    assert drop_stale(tmp_path) == []
    assert drop_stale(tmp_path / "nowhere") == []
