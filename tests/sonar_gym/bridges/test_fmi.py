"""A unit of FMI 3.0, checked and run by FMPy."""

import numpy as np
import pytest

from acquisition import Ping
from noise import load_model
from sonar_gym.bridges.fmi.build import build_unit
from sonar_gym.bridges.server.sensors import Sensors
from training.cli import main

fmpy = pytest.importorskip("fmpy", reason="needs FMPy")
validate = pytest.importorskip("fmpy.validation").validate_fmu
pytest.importorskip("pythonfmu3", reason="needs the extra sonar-gym[fmi]")
STEPS, STEP_S, N, SEED = 20, 0.1, 3, 5


class Unit:
    """An instance of a unit, as an importer holds it."""

    def __init__(self, path, folder, seed=SEED):
        self.description, self.messages = fmpy.read_model_description(path), []
        self.reference = {v.name: v.valueReference for v in self.description.modelVariables}
        unzipped = fmpy.extract(path, folder)
        self.fmu = fmpy.simulation.instantiate_fmu(
            unzipped, self.description, "CoSimulation", logger=lambda *parts: self.messages.append(parts[-1].decode())
        )
        self.fmu.setInt64([self.reference["seed"]], [seed])
        self.fmu.enterInitializationMode()
        self.fmu.exitInitializationMode()

    def set(self, name, values):
        self.fmu.setFloat64([self.reference[f"{name}[{k + 1}]"] for k in range(N)], values)

    def get(self, name):
        return self.fmu.getFloat64([self.reference[f"{name}[{k + 1}]"] for k in range(N)])


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return build_unit("srf08-lstm", tmp_path_factory.mktemp("unit") / "sonar.fmu", N)


@pytest.fixture
def start(path, tmp_path):
    units = []

    def begin(seed=SEED):
        units.append(Unit(path, tmp_path / str(len(units)), seed))
        return units[-1]

    yield begin
    for unit in units:
        unit.fmu.terminate()
        unit.fmu.freeInstance()


def drive(unit, steps=STEPS):
    """Approach a wall; return what the sonars read in each step, and the credence."""
    found = []
    for k in range(steps):
        unit.set("distance", [2.0 - 0.05 * k, 1.0, 1000.0])
        unit.set("reflectance", [0.9, 0.5, 0.5])
        unit.fmu.doStep(k * STEP_S, STEP_S)
        found.append([unit.get(name) for name in ("range", "status", "credence")])
    return np.array(found)


def test_fmpy_finds_no_fault_in_the_unit(path):
    assert validate(str(path)) == []


def test_the_unit_reads_what_the_model_reads_with_its_memory(start):
    found, sensors = drive(start()), Sensors(load_model("srf08-lstm"), 6.0, SEED)
    for k, (range_, status, credence) in enumerate(found):
        distance = [2.0 - 0.05 * k, 1.0, 1000.0]
        ping = Ping.of(distance, 0.0, reflectance=[0.9, 0.5, 0.5], time=k * STEP_S, run=np.arange(N))
        reading, given = sensors.answer(ping)
        np.testing.assert_array_equal(range_, reading.range)
        np.testing.assert_array_equal(status, reading.status)
        np.testing.assert_array_equal(credence, given)


def test_a_seed_repeats_the_readings_and_instances_do_not_disturb_each_other(start):
    one, two, other = start(), start(), start(SEED + 1)
    drive(two, 3)
    first = drive(one)
    assert not np.array_equal(first, drive(other))
    for unit in (one, two):
        unit.fmu.reset()
        unit.fmu.setInt64([unit.reference["seed"]], [SEED])
        unit.fmu.enterInitializationMode()
        unit.fmu.exitInitializationMode()
        np.testing.assert_array_equal(first, drive(unit))


def test_a_wrong_value_ends_the_step_with_its_reason(start):
    unit = start()
    unit.set("distance", [1.0, -1.0, 1.0])
    with pytest.raises(fmpy.fmi1.FMICallException):
        unit.fmu.doStep(0.0, STEP_S)
    assert "distance must lie in [0, 1000] m, got -1 m" in unit.messages[-1]
    unit.set("distance", [1.0, 1.0, 1.0])
    unit.fmu.doStep(0.0, STEP_S)


def test_the_command_writes_a_unit(tmp_path, capsys):
    main(["export", "fmi", "ideal", "--out", str(tmp_path / "sonar.fmu"), "--sensors", "8"])
    assert "8 sonars with ideal" in capsys.readouterr().out
    assert validate(str(tmp_path / "sonar.fmu")) == []
