"""Compiled kernels follow all their sources, and are otherwise read from the cache."""

import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from numba import config
from numba.core import caching
from numba.core.dispatcher import Dispatcher

import sonar_gym
from sonar_gym import compiled
from sonar_gym.compiled import drop_stale
from sonar_gym.sensing.mounts import Mount
from sonar_gym.street.vehicle import CarSettings

INNER = "from numba import njit\n@njit(cache=True)\ndef inner():\n    return {}\n"
OUTER = "from numba import njit\nfrom inner import inner\n@njit(cache=True)\ndef outer():\n    return inner()\n"
RUN = """
from pathlib import Path
from sonar_gym.compiled import drop_stale
drop_stale(Path("."))
from outer import outer
print(outer(), outer.stats.cache_hits.get((), 0))
"""


def run_outer(folder):
    """Return the value of the outer kernel in a new process, and whether it was cached."""
    package = str(Path(sonar_gym.__file__).parents[1])
    env = {**os.environ, "PYTHONPATH": os.pathsep.join([str(folder), package])}
    env.pop("NUMBA_CACHE_DIR", None)
    done = subprocess.run([sys.executable, "-c", RUN], cwd=folder, env=env, capture_output=True, text=True, check=True)
    value, cached = done.stdout.split()
    return int(value), cached == "1"


def write(path, text, seconds_ago):
    path.write_text(text)
    time_s = time.time() - seconds_ago
    os.utime(path, (time_s, time_s))


def test_a_kernel_is_recompiled_when_one_that_it_calls_has_changed(tmp_path):
    write(tmp_path / "outer.py", OUTER, 100)
    write(tmp_path / "inner.py", INNER.format(1), 100)
    assert run_outer(tmp_path) == (1, False)
    assert run_outer(tmp_path) == (1, True)
    write(tmp_path / "inner.py", INNER.format(2), 0)
    assert run_outer(tmp_path) == (2, False)


def test_only_indices_older_than_a_source_are_removed(tmp_path):
    cache = tmp_path / "__pycache__"
    cache.mkdir()
    write(tmp_path / "a.py", "", 50)
    write(tmp_path / "b.py", "", 20)
    write(tmp_path / "no_kernels.py", "", 0)
    write(cache / "a.f-1.py311.nbi", "", 10)
    write(cache / "b.g-1.py311.nbi", "", 5)
    assert drop_stale(tmp_path) == []
    write(tmp_path / "b.py", "", 7)
    assert [path.name for path in drop_stale(tmp_path)] == ["a.f-1.py311.nbi"]
    assert (cache / "b.g-1.py311.nbi").is_file()


def test_a_source_from_the_future_removes_nothing(tmp_path):
    (tmp_path / "__pycache__").mkdir()
    write(tmp_path / "a.py", "", -1000)
    write(tmp_path / "__pycache__" / "a.f-1.py311.nbi", "", 10)
    assert drop_stale(tmp_path) == []
    assert drop_stale(tmp_path / "nowhere") == []


def test_where_no_cache_can_be_written_a_private_temporary_folder_is_used(monkeypatch):
    monkeypatch.setattr(caching.CompileResultCacheImpl, "_locator_classes", [caching.UserProvidedCacheLocator])
    monkeypatch.setattr(config, "CACHE_DIR", "")
    monkeypatch.setenv("NUMBA_CACHE_DIR", "")  # so that it is restored
    with pytest.warns(RuntimeWarning, match="set NUMBA_CACHE_DIR to a folder of your own"):
        folder = compiled.use_temporary_cache()
    assert folder.name == config.CACHE_DIR == os.environ["NUMBA_CACHE_DIR"]
    assert Path(folder.name).stat().st_mode & 0o077 == 0
    folder.cleanup()


def test_a_cache_that_can_be_written_is_kept():
    assert compiled.use_temporary_cache() is None


def compiled_types():
    """Return the types of arguments for which each kernel of the package is compiled or loaded."""
    modules = [module for name, module in list(sys.modules.items()) if name.startswith("sonar_gym.")]
    kernels = [each for module in modules for each in vars(module).values() if isinstance(each, Dispatcher)]
    assert len(kernels) > 20
    return {id(kernel): list(kernel.signatures) for kernel in kernels}


def drive(number):
    """Drive with settings that are numbers of a type, each a whole number."""
    mounts = [Mount(str(k), *map(number, (k, 0, 90)), cone_deg=number(30), height_m=number(1)) for k in range(8)]
    env = sonar_gym.SonarParkingEnv(
        sonar_layout=mounts,
        reward=dict.fromkeys(("potential", "discount", "time", "parked", "crashed", "crash_distance"), number(1)),
        car=CarSettings(rear_overhang=number(1), wheelbase=number(3), length=number(5), width=number(2)),
        street={"reflectance": (number(1), number(1)), "gap": (number(10), number(10))},
    )
    env = sonar_gym.SonarObservation(env, max_range=number(3), reflectance=number(1), period_s=number(1))
    env.reset(seed=0)
    env.step(np.array([0, 1]))


def test_kernels_are_compiled_once_whatever_the_type_of_a_setting():
    drive(float)
    before = compiled_types()
    drive(int)
    drive(np.float32)
    assert compiled_types() == before
