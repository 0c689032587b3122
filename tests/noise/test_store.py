"""Loading and saving of models, and error messages for missing or damaged ones."""

import json
import sys

import numpy as np
import pytest

from acquisition import ModelError, Ping, UnknownModelError
from noise import Faulty, GaussianModel, IdealModel, load_model, model_names, save_model
from noise.effects import CATALOGUE
from noise.faults import Calibration, Short
from noise.learned.tensors import write_tensors
from noise.physical import PhysicalModel

PHYSICAL = {"format": 1, "kind": "physical", "resolution": 0.01, "max_range": 3.0}


@pytest.fixture
def saved(tmp_path):
    return save_model(PhysicalModel([CATALOGUE["zero_offset"](offset_m=0.02)]), tmp_path / "model")


def test_every_name_loads_and_gives_a_law():
    assert {"ideal", "gaussian", "rig"} <= set(model_names())
    for name in set(model_names()) - {"rig"}:  # which has no probabilities
        assert load_model(name).law(Ping.of(distance=1.0, reflectance=0.9)).credence()[0] > 0.9


def test_a_saved_model_has_the_same_law(saved):
    assert load_model(saved).law(Ping.of(distance=1.0)).quantile(0.5)[0] == pytest.approx(1.02)


def test_saving_replaces_the_folder_and_leaves_no_other_files(saved):
    (saved / "old.txt").write_text("of an older model")
    save_model(PhysicalModel(), saved)
    assert sorted(p.name for p in saved.iterdir()) == ["model.json"]
    assert sorted(p.name for p in saved.parent.iterdir()) == ["model"]
    np.testing.assert_array_equal(load_model(saved).law(Ping.of(distance=1.0)).quantile(0.5), [1.0])


def test_the_error_for_an_unknown_name_lists_the_known_names():
    with pytest.raises(UnknownModelError, match=r"'srf99': no such name or folder"):
        load_model("srf99")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (None, "contains no model.json"),
        ("{", "not JSON"),
        ("[]", "should be an object"),
        (json.dumps({"format": 2, "kind": "physical"}), "physical.format: input should be 1, got 2"),
        (json.dumps({"format": 1, "kind": "pickle"}), "input tag 'pickle'"),
        (
            json.dumps({**PHYSICAL, "effects": {"magic": {}}}),
            "'magic' is not in the catalogue",
        ),
        (
            json.dumps({**PHYSICAL, "effects": []}),
            "physical.effects: input should be an object",
        ),
        (json.dumps({"format": 1, "kind": "physical"}), "physical.resolution: field required"),
        (
            json.dumps({"format": 1, **GaussianModel().to_dict(), "miss": 2.0}),
            "miss: expected a number from 0 to 1, got 2",
        ),
        (
            json.dumps({**PHYSICAL, "effects": {"spike": {"loud": 1}}}),
            "no parameter 'loud'",
        ),
        ('{"format": 1, "about": [' + "{}," * 2_000_000, "holds more than 1,000,000 lists, objects and texts"),
    ],
)
def test_a_damaged_model_raises_with_its_path(tmp_path, text, message):
    if text is not None:
        (tmp_path / "model.json").write_text(text)
    with pytest.raises(ModelError, match=message):
        load_model(tmp_path)


def test_a_model_that_cannot_be_saved_leaves_no_files(tmp_path):
    class Unsavable(IdealModel):
        to_dict = None

    with pytest.raises(TypeError):
        save_model(Unsavable(), tmp_path / "unsavable")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("model", [IdealModel(0.01), GaussianModel(0.02, 0.01, 0.1)])
@pytest.mark.parametrize("faults", [(), (Short(0.1, span=5.0), Calibration(0.5, drift=1e-3))])
def test_simple_models_and_faults_on_them_load_unchanged(tmp_path, model, faults):
    saved = Faulty(model, faults) if faults else model
    again = load_model(save_model(saved, tmp_path / "model"))
    assert (again.model, again.faults) == (model, faults) if faults else again == model


def test_invalid_faults_raise(tmp_path):
    save_model(Faulty(IdealModel(), [Short(0.1)]), tmp_path / "model")
    path = tmp_path / "model" / "model.json"
    data = json.loads(path.read_text())
    for broken in ({"faults": [{"fault": "Gremlin"}]}, {"faults": 3}, {"model": {"kind": "pickle"}}, {"model": None}):
        path.write_text(json.dumps({**data, **broken}))
        with pytest.raises(ModelError, match=r"model\.json"):
            load_model(tmp_path / "model")


def test_saving_replaces_an_older_model_and_leaves_no_other_folder(tmp_path):
    for resolution in (0.001, 0.01):
        save_model(PhysicalModel((), resolution), tmp_path / "model")
    assert load_model(tmp_path / "model").resolution == 0.01
    assert [path.name for path in tmp_path.iterdir()] == ["model"]


def test_a_folder_with_other_contents_is_never_replaced(tmp_path):
    (tmp_path / "recording.csv").write_text("distance_mm\n", encoding="utf-8")
    with pytest.raises(ModelError, match="contains something other than a model"):
        save_model(PhysicalModel(), tmp_path)
    assert (tmp_path / "recording.csv").is_file()
    with pytest.raises(ModelError, match="is a file, expected a folder"):
        save_model(PhysicalModel(), tmp_path / "recording.csv")


@pytest.mark.skipif(sys.platform == "win32", reason="needs a limit of file sizes")
def test_weights_that_do_not_fit_on_the_disk_are_an_error_of_the_disk(tmp_path):
    import resource

    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, limits[1]))
    try:
        with pytest.raises(OSError, match="large"):
            write_tensors(tmp_path, {"w": np.zeros(1000)}, "")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
