"""The diagnosing process cannot see the answers, however it asks."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from training.proof.desk import ROOT, Desk
from training.proof.examine import RECORDED, SIMULATED

# what somebody would try who sits in the diagnosing process and wants the answer
REACHES = {
    "the ledger": "open(run / 'ledger.jsonl').read()",
    "the ledger, by its raw name": "os.open(str(run / 'ledger.jsonl'), os.O_RDONLY)",
    "the ledger, through a way around": "(folder / '..' / '..' / 'ledger.jsonl').read_text()",
    "another trial": "(run / 'trials' / '00001' / 'recorded.csv').read_text()",
    "a file beside the recordings": "(folder / 'answer.json').read_text()",
    "the list of trials": "os.listdir(run / 'trials')",
    "a walk through the run": "list(os.scandir(run))",
    "the parent's environment": "open(f'/proc/{os.getppid()}/environ', 'rb').read()",
    "the parent's command": "open(f'/proc/{os.getppid()}/cmdline', 'rb').read()",
    "another process": "subprocess.run(['cat', str(run / 'ledger.jsonl')], check=True)",
    "a shell": "os.system('true')",
    "a copy of itself": "os.fork()",
    "the network": "socket.create_connection(('127.0.0.1', 9))",
    "the generator": "importlib.import_module('training.proof.generate')",
    "the list of causes": "importlib.import_module('training.proof.trials.causes')",
    "the rig": "importlib.import_module('acquisition.bench')",
    "a library of C": "ctypes.CDLL('libc.so.6')",
}
PROGRAM = """
import ctypes, importlib, json, os, socket, subprocess, sys
from pathlib import Path
from training.proof.examine import SealError, guarded
guard, _ = guarded()
loaded = [name for name in sys.modules if name.startswith(("acquisition.bench", "training.proof.generate"))]
folder = Path(sys.argv[1]).resolve(); run = folder.parent.parent
told = {"loaded": loaded, "own": None}
guard.folder = folder
told["own"] = (folder / "recorded.csv").read_text()
for name, code in json.loads(sys.argv[2]).items():
    try:
        eval(code)
        told[name] = "reached"
    except SealError:
        told[name] = "refused"
    except Exception as error:
        told[name] = repr(error)
print(json.dumps(told))
"""


@pytest.fixture(scope="module")
def told(tmp_path_factory) -> dict[str, object]:
    """Return what became of each reach."""
    run = tmp_path_factory.mktemp("run")
    for trial in ("00000", "00001"):
        (run / "trials" / trial).mkdir(parents=True)
        for name in (SIMULATED, RECORDED, "answer.json"):
            (run / "trials" / trial / name).write_text("secret")
    (run / "ledger.jsonl").write_text("secret")
    argv = [sys.executable, "-c", PROGRAM, str(run / "trials" / "00000"), json.dumps(REACHES)]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(argv, capture_output=True, text=True, check=True, cwd=ROOT, env=environment)
    return dict(json.loads(done.stdout))


@pytest.mark.parametrize("reach", REACHES)
def test_what_would_tell_the_answer_is_refused(told, reach):
    assert told[reach] == "refused"


def test_its_own_recordings_can_be_read(told):
    assert told["own"] == "secret"


def test_the_diagnosis_carries_nothing_of_the_generator(told):
    assert told["loaded"] == []


def test_a_process_gets_nothing_of_the_environment(monkeypatch, tmp_path):
    monkeypatch.setenv("SECRET_OF_THE_TRIAL", "42")
    (tmp_path / "peek.py").write_text(
        "import os\nfrom training.proof.desk import serve\nserve(lambda asked: {'names': sorted(os.environ)})\n"
    )
    monkeypatch.setattr("training.proof.desk.ROOT", tmp_path)
    (tmp_path / "training").symlink_to(Path(ROOT) / "training")
    (tmp_path / "acquisition").symlink_to(Path(ROOT) / "acquisition")
    desk = Desk("peek")
    names = desk.ask({})["names"]
    desk.close()
    assert "PATH" in names
    assert "SECRET_OF_THE_TRIAL" not in names
