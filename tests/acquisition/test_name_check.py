"""Another distribution's package `noise` is an error with a remedy."""

import subprocess
import sys
from pathlib import Path

import pytest

from acquisition.name_check import check_noise

ROOT = Path(__file__).parents[2]


def test_the_package_of_this_project_passes():
    check_noise()


@pytest.mark.parametrize("code", ["import sonar_gym", "from training.cli import main; main(['effects'])"])
def test_another_package_noise_is_an_error(tmp_path, code):
    (tmp_path / "noise").mkdir()
    (tmp_path / "noise" / "__init__.py").write_text("def pnoise2(): ...\n", encoding="utf-8")
    path = f"import sys; sys.path[:0] = [{str(tmp_path)!r}, {str(ROOT)!r}]; "
    done = subprocess.run([sys.executable, "-c", path + code], capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode != 0
    assert str(tmp_path / "noise" / "__init__.py") in done.stderr
    assert "pip uninstall noise" in done.stderr
