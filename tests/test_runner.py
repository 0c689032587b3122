"""The runner of the tests: a crash of a worker process is a failure, and never a wait. The checks of a release."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

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


def released(folder, version, stubs):
    """Return the exit status of the release script in a repository, and what it calls missing."""
    done = subprocess.run(
        [folder / ".ci" / "release", version],
        env={**os.environ, "PATH": f"{stubs}{os.pathsep}{os.environ['PATH']}", "PYTHON": str(stubs / "python")},
        capture_output=True,
        text=True,
    )
    return done.returncode, re.findall("^MISSING (.*)", done.stdout, re.MULTILINE)


@pytest.fixture
def stubs(tmp_path):
    """Folder of a `make` that passes and a `python` that finds no vulnerability; either can be made to fail."""
    folder = tmp_path / "bin"
    folder.mkdir()
    for name, text in (("make", "exit 0"), ("python", "echo audit: 0 known")):
        (folder / name).write_text(f"#!/bin/sh\n{text}\n")
        (folder / name).chmod(0o755)
    return folder


@pytest.fixture
def repository(tmp_path):
    """A repository that is ready for release 1.2.3."""
    folder = tmp_path / "repository"
    (folder / ".ci").mkdir(parents=True)
    shutil.copy(ROOT / ".ci" / "release", folder / ".ci")
    (folder / "CHANGELOG.md").write_text("# Changelog\n\n## 1.2.3\n")
    (folder / "CITATION.cff").write_text("version: 1.2.3\n")
    git = ["git", "-C", str(folder), "-c", "user.name=a", "-c", "user.email=a@b"]
    for line in ("init -q", "add -A", "commit -qm one"):
        subprocess.run([*git, *line.split()], check=True)
    return folder


def test_a_release_that_is_ready_passes(repository, stubs):
    assert released(repository, "1.2.3", stubs) == (0, [])


def test_a_release_names_all_that_is_missing(repository, stubs):
    (repository / "CITATION.cff").write_text("version: 1.2.2\n")
    (stubs / "make").write_text("#!/bin/sh\nexit 1\n")
    (stubs / "python").write_text("#!/bin/sh\necho audit: skipped\n")
    subprocess.run(["git", "-C", repository, "tag", "v1.3"], check=True)
    assert released(repository, "1.3", stubs) == (
        1,
        [
            "version is a number of three parts",
            "nothing is uncommitted",
            "CHANGELOG.md has a section of the version",
            "CITATION.cff states the version",
            "the tag v1.3 is new",
            "tests",
            "site without warnings",
            "no known vulnerability",
        ],
    )
