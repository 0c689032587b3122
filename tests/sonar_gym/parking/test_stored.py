"""Shipped tables of credence: which tasks have one, and when one is out of date."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from noise import GaussianModel, load_model
from noise.learned.networks import MlpModel
from sonar_gym import ENVIRONMENTS
from sonar_gym.parking import prior, stored
from sonar_gym.parking.fleet import MAX_RANGE
from sonar_gym.parking.prior import Task, counted
from sonar_gym.parking.stored import shipped
from sonar_gym.sensing.mounts import LAYOUTS
from sonar_gym.street.street import LEVELS
from sonar_gym.street.vehicle import CarSettings

MODELS = ("gaussian", "srf08-mlp", "srf08-lstm", "srf08-hybrid")


def task(level="normal", layout="eight", driver="agent"):
    return Task(LEVELS[level], CarSettings(), LAYOUTS[layout], MAX_RANGE, driver, True)


@pytest.mark.parametrize("model", MODELS)
def test_registered_environments_have_shipped_tables_of_the_present_weights(model):
    for level in {level for level, _ in ENVIRONMENTS.values()}:
        for layout in ("eight", "eight in turn", "eight without latency", "four"):
            table = shipped(load_model(model), task(level, layout))
            assert table is not None, (level, layout, "run `sonar-gym make-credence`")
            assert np.all((table >= 0.0) & (table <= 1.0))


class Own:
    """A user's model, which has a law and cannot be saved."""

    resolution, remembers = 0.001, False

    def law(self, ping, past=None):
        return GaussianModel().law(ping)


def test_a_model_that_cannot_be_saved_has_no_shipped_table():
    assert shipped(Own(), task()) is None


def test_no_car_is_driven_for_a_shipped_table(monkeypatch):
    monkeypatch.setattr(prior, "count", lambda *_: pytest.fail("cars were driven"))
    model, own = load_model("srf08-mlp"), task("hard")
    args = model, own.streets, own.car, own.mounts, own.max_range, own.driver, own.crosstalk
    assert prior.street_credence(*args) is not None


def test_another_street_layout_or_agent_has_no_shipped_table(monkeypatch):
    model, own = load_model("srf08-mlp"), task()
    moved = replace(own.mounts[0], x=own.mounts[0].x + 0.01), *own.mounts[1:]
    for other in (
        replace(own, streets=replace(own.streets, kerb_reflectance=0.5)),
        replace(own, mounts=moved),
        replace(own, mounts=(replace(own.mounts[0], height_m=0.1), *own.mounts[1:])),
        replace(own, crosstalk=False),
    ):
        assert shipped(model, other) is None
    monkeypatch.setattr(stored, "_agent", lambda: "other weights")
    assert shipped(model, own) is None


COUNTS = """
import sys
import sonar_gym.agent, sonar_gym.control.driver, sonar_gym.parking.vector
from noise import load_model
load_model("srf08-lstm")
for name, module in list(sys.modules.items()):
    if name.split(".")[0] in ("noise", "sonar_gym"):
        print(module.__file__)
"""


def test_the_key_of_the_cache_holds_every_module_that_counts_and_the_weights_of_the_agent():
    done = subprocess.run([sys.executable, "-c", COUNTS], capture_output=True, text=True, check=True)
    used = {Path(line) for line in done.stdout.split()}
    assert len(used) > 50
    assert used | {stored.AGENT} <= set(stored.source_files())


def test_a_changed_source_changes_the_key_of_the_cache(tmp_path, monkeypatch):
    file = tmp_path / "law.py"
    monkeypatch.setattr(stored, "source_files", lambda: [file])
    digests = set()
    for text in ("a = 1", "a = 2"):
        file.write_text(text)
        digests.add(stored._sources.__wrapped__())
    assert len(digests) == 2


def test_other_weights_have_no_shipped_table():
    shipped_model = load_model("srf08-mlp")
    layers = [(weight * 1.001, bias) for weight, bias in shipped_model.layers]
    assert shipped(MlpModel(shipped_model.inputs, shipped_model.head, layers), task()) is None


@pytest.mark.slow
def test_shipped_tables_are_counted_again_by_the_present_sources():
    own = task()
    table, again = shipped(load_model("srf08-mlp"), own), counted(load_model("srf08-mlp"), own)[0]
    assert np.mean(np.abs(table - again)) < 0.01
