"""Wheel and sdist: built, and installed beside nothing else in fresh environments."""

import os
import shutil
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


@pytest.fixture(params=["python3.11", "python3.12", "python3.13"])
def python(request):
    """Path of an interpreter that runs: a name of pyenv on PATH does not where another version is chosen."""
    installed = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv")).glob(f"versions/*/bin/{request.param}")
    for path in filter(None, (shutil.which(request.param), *sorted(installed))):
        if subprocess.run([path, "-c", ""], capture_output=True).returncode == 0:
            return path
    pytest.skip(f"no {request.param} runs, neither from PATH nor of pyenv: install it to test the wheel with it")


CORE = (
    "import sys; from training.cli import main; "
    "main(['record', '--driver', 'rig', '--pings', '1', '--out', 'rec.csv']); "
    "assert not {'torch', 'gymnasium', 'serial'} & set(sys.modules)"
)
BARE = (
    "import importlib, acquisition\n"
    "for name, extra in (('noise', 'noise'), ('sonar_gym', 'gym')):\n"
    "    try:\n        importlib.import_module(name)\n"
    "    except acquisition.MissingExtraError as error:\n        assert f'sonar-gym[{extra}]' in str(error)\n"
    "    else:\n        raise AssertionError(name)\n"
)
DRIVE = (
    "import gymnasium, sonar_gym; "
    "env = gymnasium.make('SonarParking-v0', sonar='srf08-mlp', credence_driver='random'); "
    "env.reset(seed=0); env.step([0.0, 0.5]); print(sonar_gym.__version__)"
)
COMMANDS = {  # of each extra, run in the order given
    "record": ["record --driver twin --pings 1 --out rec.csv"],
    "parquet": ["record --driver rig --pings 1 --out rec.csv", "import rec.csv --out rec.parquet"],
    "opendlv": ["record --driver rig --pings 1 --out rec.csv", "bridge opendlv-rec rec.csv --out rec.rec"],
    "fmi": ["export fmi ideal --out sonar.fmu"],
    "offline": ["dataset --out datasets --episodes 1 --drivers scripted --sonars ideal"],
    "train": [
        "record --driver rig --pings 1 --out rec.csv",
        "plot rec.csv --out figures",
        "train-agent --out agent --lessons 1 --steps 2000 --num-envs 8 --hidden 8 --sonars ideal --repeat 1",
    ],
    "all": [
        "record --driver twin --pings 1 --out rec.csv",
        "import rec.csv --out rec.parquet",
        "bridge ros-bag rec.csv --out bag",
        "bridge opendlv-rec rec.csv --out rec.rec",
        "export fmi ideal --out sonar.fmu",
        "diagnose rec.csv --out diagnosis",
    ],
}
pytestmark = [pytest.mark.slow, pytest.mark.timeout(1800)]


@pytest.fixture(autouse=True)
def alone(monkeypatch):
    """A path of the caller would hide what a fresh environment lacks."""
    monkeypatch.delenv("PYTHONPATH", raising=False)


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    out = tmp_path_factory.mktemp("dist")
    subprocess.run([sys.executable, "-m", "build", "--outdir", str(out), str(ROOT)], check=True, capture_output=True)
    return out


def test_the_archives_hold_weights_types_and_templates(built):
    (wheel,), (sdist,) = built.glob("*.whl"), built.glob("*.tar.gz")
    names = set(zipfile.ZipFile(wheel).namelist())
    for member in (
        "noise/weights/srf08-mlp/weights.safetensors",
        "noise/py.typed",
        "sonar_gym/__init__.pyi",
        "training/pages/templates/view.html",
    ):
        assert member in names
    own = {"acquisition", "noise", "sonar_gym", "training", "sonar_gym_command.py"}
    assert {name.split("/")[0] for name in names} - own == {
        next(name.split("/")[0] for name in names if ".dist-info" in name)
    }
    with tarfile.open(sdist) as archive:
        assert any(name.endswith("/pyproject.toml") for name in archive.getnames())


def run_fresh(python, tmp_path, what, code):
    subprocess.run([python, "-m", "venv", str(tmp_path / "venv")], check=True)
    own = str(tmp_path / "venv" / "bin" / "python")
    subprocess.run([own, "-m", "pip", "install", "-q", what], check=True)
    return subprocess.run([own, "-c", code], check=True, cwd=tmp_path, capture_output=True, text=True).stdout


def test_the_wheel_runs_the_environment(built, tmp_path, python):
    (wheel,) = built.glob("*.whl")
    assert run_fresh(python, tmp_path, f"{wheel}[noise,gym]", DRIVE).strip()


@pytest.mark.parametrize("extra", COMMANDS)
def test_the_wheel_runs_the_commands_of_an_extra(built, tmp_path, python, extra):
    (wheel,) = built.glob("*.whl")
    run_fresh(python, tmp_path, f"{wheel}[{extra}]", "")
    for line in COMMANDS[extra]:
        subprocess.run([str(tmp_path / "venv" / "bin" / "sonar-gym"), *line.split()], check=True, cwd=tmp_path)
    has_torch = any(tmp_path.glob("venv/lib/python3.*/site-packages/torch"))
    assert has_torch == (extra not in ("record", "parquet"))


def test_the_core_records_without_torch(built, tmp_path):
    (sdist,) = built.glob("*.tar.gz")
    run_fresh(sys.executable, tmp_path, str(sdist), CORE)
    subprocess.run([str(tmp_path / "venv" / "bin" / "python"), "-c", BARE], check=True, cwd=tmp_path)
    assert (tmp_path / "rec.csv").stat().st_size > 1000
