"""Recordings after SIGKILL, a full disk, Ctrl-C and a second writer."""

import errno
import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pandas as pd
import pytest

from acquisition import Recording, RecordingError
from acquisition.bench import Rig
from acquisition.io.files import lock
from acquisition.io.journal import Journal
from acquisition.io.recording import unfinished_path
from acquisition.survey.plan import SurveyPlan
from acquisition.survey.session import Session
from acquisition.survey.sources import RigSource

PLAN = SurveyPlan(angles_deg=(0.0, 5.0), distances_mm=(300.0, 700.0), reflectances=(0.9,), pings=6, seed=2)
SOURCE = RigSource(Rig(), seed=5)
ROWS = pd.DataFrame({"time_s": [0.0, 1.0], "session": "0", "sensor": "0", "distance_mm": 1.0})
posix = pytest.mark.skipif(sys.platform == "win32", reason="needs signals and fork: Linux or macOS")


def killed(folder, kills, seed):
    script = Path(__file__).with_name("kill_sessions.py")
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[3])}
    done = subprocess.run(
        [sys.executable, str(script), str(folder), str(kills), str(seed)],
        capture_output=True,
        text=True,
        env=environment,
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def check(result, kills):
    assert result["kills"] == kills
    assert {name: result[name] for name in ("corrupt", "lost_visits", "unreadable")} == {
        "corrupt": 0,
        "lost_visits": 0,
        "unreadable": 0,
    }


@posix
def test_ten_kills_lose_and_corrupt_nothing(tmp_path):
    check(killed(tmp_path, 10, 0), 10)


@posix
@pytest.mark.slow
def test_two_hundred_kills_lose_and_corrupt_nothing(tmp_path):
    result = killed(tmp_path, 200, 1)
    print(f"\n{result}")
    check(result, 200)


def test_every_incomplete_visit_is_repaired_to_the_byte(tmp_path):
    """A power cut can truncate anywhere: cut at many bytes of the last condition and resume."""
    whole = Session(PLAN, SOURCE, tmp_path / "whole.csv").run().read_bytes()
    lines = whole.splitlines(keepends=True)
    path = tmp_path / "r.csv"
    for keep in range(len(whole) - sum(map(len, lines[-6:])), len(whole), 41):
        path.write_bytes(whole[:keep])
        Session(PLAN, SOURCE, path, resume=True).run()
        assert path.read_bytes() == whole


@pytest.mark.parametrize("text", ["my notes", "a,b\n1,2\n", "distance_mm,angle_deg,reading_mm\n1,2,3\n" * 20])
def test_resuming_never_changes_a_file_of_another_program(tmp_path, text):
    path = tmp_path / "notes.csv"
    path.write_text(text)
    with pytest.raises(RecordingError, match="was not created by a session; give another file"):
        Session(PLAN, SOURCE, path, resume=True).run()
    assert path.read_text() == text


def test_an_edited_file_is_an_error_and_unchanged(tmp_path):
    path = Session(PLAN, SOURCE, tmp_path / "r.csv").run()
    lines = path.read_text().splitlines(keepends=True)
    text = "".join([*lines[:4], "1,2,3,4,5,6,7,8,9,10,11,12,13,14,15,16,17,18,19,20\n", *lines[4:]])
    path.write_text(text)
    with pytest.raises(RecordingError, match=r"was edited by another program: .* line 5"):
        Session(PLAN, SOURCE, path, resume=True).run()
    assert path.read_text() == text


def full_after(monkeypatch, good, code):
    """Simulate a disk that accepts some bytes and then fails, like a full one: with a short write first."""
    left, write = [good], os.write

    def some(handle, data):
        if left[0] <= 0:
            raise OSError(code, os.strerror(code))
        count = min(len(data), left[0])
        left[0] -= count
        return write(handle, data[:count])

    monkeypatch.setattr(os, "write", some)


@pytest.mark.parametrize("good", [0, 10, 500, 900])
@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EIO])
def test_a_full_or_broken_disk_leaves_complete_visits_and_an_error_with_advice(tmp_path, monkeypatch, good, code):
    whole = Session(PLAN, SOURCE, tmp_path / "whole.csv").run().read_bytes()
    path = tmp_path / "r.csv"
    with monkeypatch.context() as patched:
        full_after(patched, good, code)
        with pytest.raises(RecordingError, match=r"cannot be written: .* \d conditions are complete on disk") as caught:
            Session(PLAN, SOURCE, path).run()
    assert ("free disk space" if code == errno.ENOSPC else "check the disk") in str(caught.value)
    assert "continue with --resume" in str(caught.value)
    left = path.read_bytes()
    assert whole.startswith(left)
    assert max(left.count(b"\n") - 1, 0) % PLAN.pings == 0
    Session(PLAN, SOURCE, path, resume=True).run()
    assert path.read_bytes() == whole


@posix
def test_the_limit_of_the_operating_system_on_file_size(tmp_path):
    code = (
        "import resource, sys; from pathlib import Path; resource.setrlimit(resource.RLIMIT_FSIZE, (1200, 1200));"
        "from acquisition.survey.plan import SurveyPlan; from acquisition.survey.session import Session;"
        "from acquisition.survey.sources import RigSource; from acquisition.bench import Rig;"
        "plan = SurveyPlan(angles_deg=(0.0, 5.0), distances_mm=(300.0, 700.0), reflectances=(0.9,), pings=6, seed=2);"
        "Session(plan, RigSource(Rig(), 5), Path(sys.argv[1])).run()"
    )
    path = tmp_path / "r.csv"
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[3])}
    done = subprocess.run([sys.executable, "-c", code, str(path)], capture_output=True, text=True, env=environment)
    assert "cannot be written: File too large" in done.stderr
    assert 0 < path.stat().st_size <= 1200
    assert len(Recording.load(path)) % PLAN.pings == 0


def test_a_second_writer_is_rejected(tmp_path):
    path = tmp_path / "r.csv"
    with Journal.open(path, 2, resume=False) as journal:
        journal.begin({})
        journal.append(ROWS)
        before = path.read_bytes()
        with pytest.raises(RecordingError, match=r"another session is writing to it; wait for it, stop it, or give"):
            Session(PLAN, SOURCE, path, resume=True).run()
        assert path.read_bytes() == before
    with open(path, "rb+") as file:
        assert lock(file.fileno())  # unlocked


def test_an_interrupt_between_write_and_sync_removes_the_visit(tmp_path, monkeypatch):
    path = tmp_path / "r.csv"
    with Journal.open(path, 2, resume=False) as journal:
        journal.begin({})
        journal.append(ROWS)
        before = path.read_bytes()
        fsync = os.fsync

        def interrupted(handle):
            monkeypatch.setattr(os, "fsync", fsync)
            raise KeyboardInterrupt

        monkeypatch.setattr(os, "fsync", interrupted)
        with pytest.raises(KeyboardInterrupt):
            journal.append(ROWS)
        assert path.read_bytes() == before
        assert journal.n_visits == 1


def test_dropping_the_last_visit(tmp_path):
    path = tmp_path / "r.csv"
    with Journal.open(path, 2, resume=False) as journal:
        journal.begin({})
        journal.append(ROWS)
        before = path.read_bytes()
        journal.append(ROWS)
        journal.drop_last()
        assert path.read_bytes() == before
        journal.drop_last()
        assert (path.read_bytes(), journal.n_visits) == (b"", 0)
        journal.append(ROWS)
        assert path.read_bytes() == before


def test_an_invalid_path_is_an_error(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(RecordingError, match=r"cannot be written: .*; give another path"):
        Session(PLAN, SOURCE, tmp_path / "file" / "r.csv").run()


def enable_interrupts():
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # a shell starts background jobs with SIGINT ignored


@posix
@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGKILL, -9)])
def test_the_command_itself_can_be_stopped_and_resumed(tmp_path, retry, number, code):
    path, whole = tmp_path / "r.csv", tmp_path / "whole.csv"
    command = [sys.executable, "-m", "training.cli", "record", "--pings", "20", "--interval-s", "1", "--out"]
    root = Path(__file__).parents[3]

    def stopped() -> str:  # a recording may be complete before a busy machine sends the signal
        for file in tmp_path.iterdir():
            file.unlink()
        process = subprocess.Popen(
            [*command, str(path)], stderr=subprocess.PIPE, text=True, cwd=root, preexec_fn=enable_interrupts
        )
        while not (path.exists() and path.stat().st_size > 10_000):
            assert process.poll() is None
            time.sleep(0.01)
        process.send_signal(number)
        error = process.communicate()[1]
        assert process.returncode == code
        return error

    error = retry(stopped)
    if number == signal.SIGINT:
        assert re.fullmatch(r"sonar-gym: interrupted; .* of 120 conditions are on disk; .* --resume\n", error)
    assert unfinished_path(path).exists()
    for arguments in ([str(path), "--resume"], [str(whole)]):
        subprocess.run([*command, *arguments], check=True, capture_output=True, cwd=root)
    assert path.read_bytes() == whole.read_bytes()


def test_a_session_that_is_no_number_is_named_and_nothing_is_changed(tmp_path):
    path = tmp_path / "r.csv"
    Session(PLAN, SOURCE, path).run()
    lines = path.read_text().splitlines(keepends=True)
    cells = lines[-1].split(",")
    cells[lines[0].strip().split(",").index("session")] = "x"
    path.write_text("".join([*lines[:-1], ",".join(cells)]))
    before = path.read_bytes()
    with pytest.raises(RecordingError, match="session 'x' of the last row"):
        Session(PLAN, SOURCE, path, resume=True).run()
    assert path.read_bytes() == before
