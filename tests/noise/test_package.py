"""The names of the package `noise`: all listed, imported on first use."""

import subprocess
import sys

import pytest

import noise

NAMES = """CATALOGUE ComposedModel ConditionPrior CredenceTable EchoLaw Faulty GaussianModel IdealModel LstmModel
MlpModel PhysicalModel SonarModel compose diagnose follow listener load_model load_thesis_network model_names save_model
simulate with_simulated"""
MODULES = "law model store credence physical metrics faults effects learned fitting discrepancy"


@pytest.mark.parametrize("name", [*NAMES.split(), *MODULES.split()])
def test_public_names_are_listed_and_importable(name):
    assert name in dir(noise)
    assert getattr(noise, name) is not None


def test_an_unknown_name_raises():
    with pytest.raises(AttributeError, match="colour"):
        _ = noise.colour


def test_torch_is_not_imported_before_it_is_needed():
    script = (
        "import sys, noise; noise.GaussianModel(); noise.load_model('srf08-mlp'); assert 'torch' not in sys.modules;"
        "noise.PhysicalModel(); assert 'torch' in sys.modules"
    )
    subprocess.run([sys.executable, "-c", script], check=True, timeout=120)
