"""Version of the code that made a page, a table or a ledger."""

from __future__ import annotations

import subprocess
from importlib.metadata import version
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def commit() -> str:
    """Return the commit of this code, with "+" if files differ from it; outside a clone, the package version.

    Call it before writing any file into the clone, which would count as a difference.
    """
    try:
        if Path(_git("rev-parse", "--show-toplevel")).resolve() == ROOT:  # not a clone around an installed package
            return _git("describe", "--always", "--dirty=+", "--abbrev=12", "--exclude=*")
    except (OSError, subprocess.CalledProcessError):
        pass
    return f"version {version('sonar-gym')}"


def _git(*words: str) -> str:
    return subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=True).stdout.strip()
