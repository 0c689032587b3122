"""Which program made a page, a table or a ledger."""

from __future__ import annotations

import subprocess
from importlib.metadata import version
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def commit() -> str:
    """Return the commit that this code is of, "+" where files differ from it; the version where there is no clone.

    Ask before anything is written: a page inside the clone would itself be such a difference.
    """
    words = ["git", "describe", "--always", "--dirty=+", "--abbrev=12", "--exclude=*"]
    try:
        told = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return f"version {version('sonar-gym')}"
    return told.stdout.strip()
