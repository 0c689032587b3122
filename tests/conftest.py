"""Shared options and fixtures of the tests: real hardware, real recordings, published networks."""

import contextlib
import gc
import os
from pathlib import Path

import pytest
from hypothesis import settings

from acquisition import DeviceError

os.environ.setdefault("SDL_VIDEODRIVER", "dummy")
os.environ.setdefault("MPLBACKEND", "Agg")
os.environ.setdefault("LOKY_MAX_CPU_COUNT", "1")  # the tests themselves run in parallel
# the machine may be busy; the same tests give the same result, and with SONAR_GYM_FUZZ they draw new examples
settings.register_profile("tests", settings.default, deadline=None, derandomize="SONAR_GYM_FUZZ" not in os.environ)
settings.load_profile("tests")
SHARED = Path(os.environ.get("SONAR_GYM_SHARED", Path(__file__).parents[2] / "shared"))


def pytest_addoption(parser):
    parser.addoption("--hardware", metavar="PORT", help="also test a real sonar at PORT, with a wall 0.3 to 3 m away")
    parser.addoption("--sonar", metavar="NAME", default="srf08", help="driver for `--hardware`")


def pytest_collection_finish():
    """Spare the garbage collector the modules and tests, which stay to the end and are many."""
    gc.freeze()


def shared_folder(name: str, content: str) -> Path:
    """Return a folder of files that are not part of the project; skip the test if it is missing."""
    folder = SHARED / name
    if not folder.is_dir():
        pytest.skip(f"no {content} at {folder}: set SONAR_GYM_SHARED to the folder that contains `{name}`")
    return folder


@pytest.fixture(scope="session")
def real_recordings() -> Path:
    """Folder of real recordings."""
    return shared_folder("recordings", "real recordings")


@pytest.fixture(scope="session")
def thesis_files() -> Path:
    """Folder of the networks that the author of the thesis published."""
    return shared_folder("thesis", "published networks")


@pytest.fixture(scope="session")
def opendlv_vectors() -> Path:
    """Folder of datagrams written by libcluon."""
    return shared_folder("opendlv", "reference datagrams")


@pytest.fixture(scope="session")
def retry():
    """Run a test body that depends on the host's clock up to four times, since a busy machine may be late."""

    def run(attempt):
        for _ in range(3):
            with contextlib.suppress(DeviceError, AssertionError, SystemExit):
                return attempt()
        return attempt()

    return run
