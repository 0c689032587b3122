"""What all tests share: where real recordings lie, and quiet libraries."""

import contextlib
import os
from pathlib import Path

import pytest
from hypothesis import settings

from acquisition import DeviceError

os.environ.setdefault("SDL_VIDEODRIVER", "dummy")
os.environ.setdefault("MPLBACKEND", "Agg")
os.environ.setdefault("LOKY_MAX_CPU_COUNT", "1")  # tests themselves run side by side already
# a busy machine is slow now and then, which is no fault of what is tested
settings.register_profile("patient", settings.default, deadline=None)
settings.load_profile("patient")
SHARED = Path(os.environ.get("SONAR_GYM_SHARED", Path(__file__).parents[2] / "shared"))


def pytest_addoption(parser):
    parser.addoption("--hardware", metavar="PORT", help="also test a real sonar at PORT, a wall 0.3 to 3 m before it")
    parser.addoption("--sonar", metavar="NAME", default="srf08", help="which driver `--hardware` is for")


@pytest.fixture(scope="session")
def real_recordings() -> Path:
    """Folder of real recordings, which are not part of the project."""
    folder = SHARED / "recordings"
    if not folder.is_dir():
        pytest.skip(f"no real recordings at {folder}: set SONAR_GYM_SHARED to the folder that holds them")
    return folder


@pytest.fixture(scope="session")
def patiently():
    """Run what goes by the host's own clock up to four times: a busy machine is late now and then, as drivers tell."""

    def run(attempt):
        for _ in range(3):
            with contextlib.suppress(DeviceError, AssertionError, SystemExit):
                return attempt()
        return attempt()

    return run


@pytest.fixture(scope="session")
def thesis_files() -> Path:
    """Folder of the networks that the thesis's author published, which are not part of the project."""
    folder = SHARED / "thesis"
    if not folder.is_dir():
        pytest.skip(f"no published networks at {folder}: set SONAR_GYM_SHARED to the folder that holds `thesis`")
    return folder
