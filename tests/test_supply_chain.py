"""Pins, hashes, and the report of known vulnerabilities."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PINS = dict(line.split("==") for line in (ROOT / "constraints.txt").read_text().split())
HARM = {"id": "PYSEC-2026-1", "fix_versions": ["9.9"]}


UNSAFE = r"pickle\.loads?\(|torch\.load\((?!.*weights_only=True)|allow_pickle=True|joblib\.load|yaml\.(unsafe_)?load\("


def test_no_pickle_is_loaded():
    files = [path for name in ("acquisition", "noise", "sonar_gym", "training") for path in (ROOT / name).rglob("*.py")]
    assert len(files) > 100
    assert not [path for path in files if re.search(UNSAFE, path.read_text())]


def normal(name):
    return re.sub(r"[-_.]+", "-", name).lower()


def test_every_pin_is_locked_with_hashes():
    entries = re.split(r"\n(?=\S)", (ROOT / "requirements.lock").read_text().strip())
    locked = {normal(entry.split("==")[0]): entry for entry in entries}
    for name, version in PINS.items():
        entry = locked[normal(name)]
        assert entry.split("==")[1].split()[0] == version, name
        assert "--hash=sha256:" in entry, name


@pytest.mark.parametrize(
    ("answer", "code", "line"),
    [
        ({"name": "a", "version": "1", "vulns": [HARM]}, 1, "a 1: PYSEC-2026-1, mended in 9.9"),
        ({"name": "a", "version": "1", "vulns": []}, 0, f"audit: 0 known vulnerabilities in 1 of {len(PINS)} packages"),
        ({"name": "a", "skip_reason": "not found"}, 0, "audit: skipped, the package index gives no vulnerabilities of"),
        (None, 0, "audit: skipped, the package index gives no vulnerabilities of"),
    ],
)
def test_what_was_not_audited_is_not_reported_as_free_of_vulnerabilities(tmp_path, answer, code, line):
    text = "raise ConnectionError" if answer is None else f"print({json.dumps({'dependencies': [answer]})!r})"
    (tmp_path / "pip_audit.py").write_text(text)
    done = subprocess.run(
        [sys.executable, str(ROOT / ".ci" / "audit")],
        capture_output=True, text=True, env={**os.environ, "PYTHONPATH": str(tmp_path)},
    )  # fmt: skip
    assert done.returncode == code, done.stderr
    assert done.stdout.startswith(line)
    assert not done.stderr
