"""A file or a distribution that shadows a package of this project is an error with a remedy."""

import subprocess
import sys
from pathlib import Path

import pytest

from acquisition.name_check import ForeignNameError, check_names, remedy

ROOT = Path(__file__).parents[2]


def hidden_by(folder, name, code):
    """Run code where a file of the user's has the name of a package, and return what it says."""
    (folder / f"{name}.py").write_text("x = 1\n", encoding="utf-8")
    path = f"import sys; sys.path[:0] = [{str(folder)!r}, {str(ROOT)!r}]; {code}"
    return subprocess.run([sys.executable, "-c", path], capture_output=True, text=True, cwd=folder)


def test_the_packages_of_this_project_pass():
    check_names()


@pytest.mark.parametrize("code", ["import sonar_gym", "from training.cli import main; main(['effects'])"])
def test_another_package_is_an_error(tmp_path, code):
    (tmp_path / "noise").mkdir()
    (tmp_path / "noise" / "__init__.py").write_text("def pnoise2(): ...\n", encoding="utf-8")
    path = f"import sys; sys.path[:0] = [{str(tmp_path)!r}, {str(ROOT)!r}]; "
    done = subprocess.run([sys.executable, "-c", path + code], capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode != 0
    assert f"rename {tmp_path / 'noise'}" in done.stderr


def test_a_file_of_the_users_is_named(tmp_path):
    done = hidden_by(tmp_path, "noise", "import sonar_gym")
    assert f"rename {tmp_path / 'noise.py'}, since Python finds it first" in done.stderr


@pytest.mark.parametrize("name", ["training", "tyro", "pandas", "numpy"])
def test_the_command_names_the_file_that_hides_what_it_needs(tmp_path, name):
    done = hidden_by(tmp_path, name, "from sonar_gym_command import main; sys.argv[1:] = ['plot', 'rec.csv']; main()")
    assert done.stderr.startswith(f"sonar-gym: `import {name}` finds {tmp_path / name}.py, not ")
    assert done.stderr.endswith(f"rename {tmp_path / name}.py, since Python finds it first\n")


def test_a_package_that_is_hidden_is_not_called_missing(tmp_path):
    code = "from acquisition.extras import load_extra; load_extra('training.recordings.figures', 'train')"
    done = hidden_by(tmp_path, "matplotlib", code)
    assert f"rename {tmp_path / 'matplotlib.py'}, since Python finds it first" in done.stderr
    assert "pip install" not in done.stderr


@pytest.mark.parametrize("code", ["import noise", "import sonar_gym", "from sonar_gym_command import main; main()"])
def test_a_file_that_hides_the_base_package_is_named(tmp_path, code):
    done = hidden_by(tmp_path, "acquisition", code)
    assert f"finds {tmp_path / 'acquisition.py'}, not sonar-gym: rename it" in done.stderr
    assert done.returncode == 1


def test_another_distribution_is_uninstalled():
    assert remedy("noise", Path("/env/lib/site-packages/noise/__init__.py")).startswith("run `pip uninstall noise`")


def test_a_package_that_is_missing_is_reinstalled(monkeypatch):
    monkeypatch.setattr("acquisition.name_check.find_spec", lambda name: None)
    with pytest.raises(ForeignNameError, match="finds nothing, not sonar-gym: `pip install --force-reinstall"):
        check_names("noise")
