"""Files and folders that are replaced as a whole."""

import errno
import multiprocessing
import os
import signal
import stat
import sys
import time

import pytest

from acquisition.io import files
from acquisition.io.files import whole_folder, write_atomic, write_text

NAMES = ("a", "b", "c")


def write(folder, text):
    with whole_folder(folder) as fresh:
        for name in NAMES:
            (fresh / name).write_text(text)


def content(folder):
    assert sorted(path.name for path in folder.iterdir()) == list(NAMES)
    return {(folder / name).read_text() for name in NAMES}


def keep_writing(folder):
    number = 0
    while True:
        write(folder, str(number))
        number += 1


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs signals: Linux or macOS")
def test_a_complete_folder_stands_at_every_instant_and_after_kills(tmp_path):
    folder = tmp_path / "results" / "model"
    write(folder, "first")
    for _ in range(5):
        process = multiprocessing.get_context("fork").Process(target=keep_writing, args=(folder,))
        process.start()
        end = time.monotonic() + 0.1
        while time.monotonic() < end:
            assert (folder / "a").is_file()
        os.kill(process.pid, signal.SIGKILL)
        process.join()
        assert len(content(folder)) == 1


@pytest.mark.parametrize("can_exchange", [True, False])
def test_a_folder_is_replaced_or_remains(tmp_path, monkeypatch, can_exchange):
    if not can_exchange:
        monkeypatch.setattr(files, "_exchange", lambda *_: False)
    folder = tmp_path / "model"
    for text in ("1", "2"):
        write(folder, text)
        assert content(folder) == {text}
    with pytest.raises(TypeError), whole_folder(folder) as fresh:
        (fresh / "a").write_text(3)
    assert content(folder) == {"2"}
    assert list(tmp_path.iterdir()) == [folder]


@pytest.mark.skipif(sys.platform == "win32", reason="needs links and permissions")
def test_a_link_and_the_permissions_of_a_file_remain(tmp_path):
    target, link = tmp_path / "private" / "a.txt", tmp_path / "b.txt"
    target.parent.mkdir()
    target.write_text("old")
    target.chmod(0o600)
    link.symlink_to(target)
    assert write_text(link, "new") == link
    assert link.is_symlink()
    assert (target.read_text(), stat.S_IMODE(target.stat().st_mode)) == ("new", 0o600)
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["a.txt", "b.txt", "private"]


@pytest.mark.skipif(sys.platform == "win32", reason="needs permissions")
@pytest.mark.parametrize(("mask", "mode"), [(0o077, 0o600), (0o022, 0o644)])
def test_a_new_file_has_the_permissions_that_the_user_gives_to_new_files(tmp_path, mask, mode):
    before = os.umask(mask)
    try:
        write_text(tmp_path / "a.txt", "new")
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "a.txt").stat().st_mode) == mode


def is_full(_):
    raise OSError(errno.ENOSPC, "No space left on device")


def test_a_full_disk_is_named(tmp_path):
    with pytest.raises(OSError, match="No space") as failed:
        write_atomic(tmp_path / "a.txt", is_full)
    assert failed.value.filename == str(tmp_path / "a.txt")
    with pytest.raises(OSError, match="No space") as failed, whole_folder(tmp_path / "b"):
        is_full(None)
    assert failed.value.filename == str(tmp_path / "b")
    assert list(tmp_path.iterdir()) == []


def test_a_failed_write_leaves_no_folder_that_it_made(tmp_path):
    kept = tmp_path / "mine"
    kept.mkdir()
    with pytest.raises(OSError, match="No space left"):
        write_atomic(kept / "new" / "deep" / "figure.png", is_full, binary=True)
    with pytest.raises(OSError, match="No space left"), whole_folder(kept / "other" / "model"):
        is_full(None)
    assert [path.name for path in tmp_path.rglob("*")] == ["mine"]


def test_a_failed_write_keeps_a_folder_that_another_process_uses_meanwhile(tmp_path):
    def shared(file):
        (tmp_path / "new" / "other.txt").write_text("of another process")
        is_full(file)

    with pytest.raises(OSError, match="No space left"):
        write_atomic(tmp_path / "new" / "mine.txt", shared)
    assert [path.name for path in (tmp_path / "new").iterdir()] == ["other.txt"]
