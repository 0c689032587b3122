"""Models by name and path, and what is told where there is none."""

import json

import numpy as np
import pytest

from acquisition import ModelError, Ping, UnknownModelError
from noise import IdealModel, load_model, model_names, save_model
from noise.effects import CATALOGUE
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
    with pytest.raises(AttributeError):
        save_model(IdealModel(), tmp_path / "ideal")
    assert list(tmp_path.iterdir()) == []


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
