"""Public names of the package, and what importing it costs."""

import subprocess
import sys

import pytest

import sonar_gym

NAMES = [
    "ENV_ID",
    "ParkingDriver",
    "SonarObservation",
    "SonarParkingEnv",
    "SonarParkingVectorEnv",
    "SonarVecEnv",
    "SonarVectorObservation",
    "load_agent",
    "run_episode",
]
HEAVY = {"torch", "stable_baselines3", "pygame", "numba", "scipy", "matplotlib", "highway_env"}


@pytest.mark.parametrize("name", NAMES)
def test_public_names_are_listed_and_importable(name):
    assert name in dir(sonar_gym)
    assert name in sonar_gym.__all__
    assert getattr(sonar_gym, name) is not None


def test_unknown_name_raises():
    with pytest.raises(AttributeError, match="SonarParkingEnvironment"):
        _ = sonar_gym.SonarParkingEnvironment


def test_import_registers_the_environment_and_loads_no_heavy_module():
    code = "import sys, gymnasium, sonar_gym; print(sonar_gym.ENV_ID in gymnasium.registry, *sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    registered, *modules = done.stdout.split()
    assert registered == "True"
    assert not HEAVY & set(modules)
