"""The version that pages and records state."""

import subprocess
from importlib.metadata import version

from training.common import commit


def test_the_commit_is_that_of_this_code_and_not_of_a_clone_around_it(tmp_path, monkeypatch):
    def git(*words):
        subprocess.run(["git", "-c", "user.name=a", "-c", "user.email=b", *words], cwd=tmp_path, check=True)

    git("init", "--quiet")
    git("commit", "--quiet", "--allow-empty", "--message", "foreign")
    tmp_path = tmp_path.resolve()
    monkeypatch.setattr(commit, "ROOT", tmp_path)
    assert not commit.commit().startswith("version")
    monkeypatch.setattr(commit, "ROOT", tmp_path / "site-packages")
    (tmp_path / "site-packages").mkdir()
    assert commit.commit() == f"version {version('sonar-gym')}"
