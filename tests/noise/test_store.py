"""Models by name and path, and what is told where there is none."""

import json

import numpy as np
import pytest

from acquisition import ModelError, Ping, UnknownModelError
from noise import Faulty, GaussianModel, IdealModel, load_model, model_names, save_model
from noise.effects import CATALOGUE
from noise.faults import Calibration, Short
from noise.physical import PhysicalModel
from noise.store import KINDS


@pytest.fixture
def saved(tmp_path):
    return save_model(PhysicalModel([CATALOGUE["zero_offset"](offset_m=0.02)]), tmp_path / "model")


def test_every_name_loads_and_gives_a_law():
    assert {"ideal", "gaussian", "rig"} <= set(model_names())
    for name in set(model_names()) - {"rig"}:  # which knows no probabilities
        assert load_model(name).law(Ping.of(distance=1.0, reflectance=0.9)).credence()[0] > 0.9


def test_a_saved_model_says_the_same(saved):
    assert load_model(saved).law(Ping.of(distance=1.0)).quantile(0.5)[0] == pytest.approx(1.02)


def test_saving_replaces_the_folder_and_leaves_nothing_beside_it(saved):
    (saved / "old.txt").write_text("of a model that was here before")
    save_model(PhysicalModel(), saved)
    assert sorted(p.name for p in saved.iterdir()) == ["model.json"]
    assert sorted(p.name for p in saved.parent.iterdir()) == ["model"]
    np.testing.assert_array_equal(load_model(saved).law(Ping.of(distance=1.0)).quantile(0.5), [1.0])


def test_an_unknown_name_is_told_with_those_that_are_known():
    with pytest.raises(UnknownModelError, match=r"'srf99': no such name or folder; known names: ideal, gaussian"):
        load_model("srf99")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (None, "holds no model.json"),
        ("{", "not a model file"),
        ("[]", "not a model of format 1"),
        (json.dumps({"format": 2, "kind": "physical"}), "not a model of format 1"),
        (json.dumps({"format": 1, "kind": "pickle"}), f"kind {', '.join(KINDS)}"),
        (json.dumps({"format": 1, "kind": "physical", "effects": {"magic": {}}}), "'magic' is not in the catalogue"),
        (json.dumps({"format": 1, "kind": "physical", "effects": []}), "must map effect ids to parameters"),
        (json.dumps({"format": 1, "kind": "physical"}), "cannot be built from its parameters"),
        (json.dumps({"format": 1, "kind": "physical", "effects": {"spike": {"loud": 1}}}), "no parameter 'loud'"),
    ],
)
def test_a_damaged_model_is_refused_by_name(tmp_path, text, message):
    if text is not None:
        (tmp_path / "model.json").write_text(text)
    with pytest.raises(ModelError, match=message):
        load_model(tmp_path)


def test_a_model_without_plain_data_is_not_half_written(tmp_path):
    class Unkept(IdealModel):
        to_dict = None

    with pytest.raises(TypeError):
        save_model(Unkept(), tmp_path / "unkept")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("model", [IdealModel(0.01), GaussianModel(0.02, 0.01, 0.1)])
@pytest.mark.parametrize("faults", [(), (Short(0.1, span=5.0), Calibration(0.5, drift=1e-3))])
def test_simple_models_and_faults_on_them_come_back_as_they_were(tmp_path, model, faults):
    kept = Faulty(model, faults) if faults else model
    again = load_model(save_model(kept, tmp_path / "model"))
    assert (again.model, again.faults) == (model, faults) if faults else again == model


def test_faults_that_are_none_are_refused(tmp_path):
    save_model(Faulty(IdealModel(), [Short(0.1)]), tmp_path / "model")
    path = tmp_path / "model" / "model.json"
    data = json.loads(path.read_text())
    for broken in ({"faults": [{"fault": "Gremlin"}]}, {"faults": 3}, {"model": {"kind": "pickle"}}, {"model": None}):
        path.write_text(json.dumps({**data, **broken}))
        with pytest.raises(ModelError, match=r"model\.json"):
            load_model(tmp_path / "model")


def test_saving_replaces_an_older_model_and_leaves_nothing_beside_it(tmp_path):
    for resolution in (0.001, 0.01):
        save_model(PhysicalModel((), resolution), tmp_path / "model")
    assert load_model(tmp_path / "model").resolution == 0.01
    assert [path.name for path in tmp_path.iterdir()] == ["model"]


def test_a_folder_of_something_else_is_never_replaced(tmp_path):
    (tmp_path / "recording.csv").write_text("distance_mm\n", encoding="utf-8")
    with pytest.raises(ModelError, match="holds something else than a model"):
        save_model(PhysicalModel(), tmp_path)
    assert (tmp_path / "recording.csv").is_file()
    with pytest.raises(ModelError, match="is a file, expected a folder"):
        save_model(PhysicalModel(), tmp_path / "recording.csv")
