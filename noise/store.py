"""Loading and saving of models: `load_model("srf08-mlp")`, `load_model("run/corrected")`, `save_model(model, folder)`.

A saved model is a folder with `model.json` (kind and parameters) and, for networks, `weights.safetensors`.
Pickle is never used.
"""

from __future__ import annotations

import importlib
import json
import os
from pathlib import Path
from typing import Annotated, Any

from acquisition import ModelError, SettingError, SonarError, UnknownModelError
from acquisition.arguments import checked
from acquisition.io.files import check_path, is_folder, whole_folder
from acquisition.io.schema import read_json
from acquisition.limits import Loadable, near, shown
from noise.model import SonarModel
from noise.schema import Model

FORMAT = 1
WEIGHTS = Path(__file__).parent / "weights"
# module and class by name, and by the kind in model.json; imported on demand, since some need torch, and since the rig
# must not be imported together with the laws that are tested against it
BUILT_IN = {
    "ideal": ("noise.model", "IdealModel"),
    "gaussian": ("noise.model", "GaussianModel"),
    "rig": ("noise.rig", "RigModel"),
}
KINDS = {
    "physical": ("noise.physical", "PhysicalModel"),
    "empirical": ("noise.fitting.empirical", "EmpiricalModel"),
    "forest": ("noise.discrepancy.baseline.forest", "AnalogueForest"),
    "adjusted": ("noise.discrepancy.baseline.adjusted", "Adjusted"),
    "beam": ("noise.beam", "BeamModel"),
    "table": ("noise.table", "TableModel"),
    "mlp": ("noise.learned.networks", "MlpModel"),
    "ideal": ("noise.model", "IdealModel"),
    "gaussian": ("noise.model", "GaussianModel"),
    "faulty": ("noise.faults", "Faulty"),
    "composed": ("noise.composed", "ComposedModel"),
    "replay": ("noise.replay", "Replay"),
    "transport": ("noise.discrepancy.baseline.transport", "Transport"),
    "lstm": ("noise.learned.recurrent", "LstmModel"),
}


def model_names() -> list[str]:
    """Return the names that `load_model` accepts."""
    shipped = sorted(path.parent.name for path in WEIGHTS.glob("*/model.json"))
    return [*BUILT_IN, *shipped]


def load_model(name: str | os.PathLike[str]) -> SonarModel:
    """Return a model by name ("ideal", "gaussian", "srf08-mlp", ...) or by the path of its folder.

    Raises:
        UnknownModelError: neither a known name nor a folder.
        ModelError: the folder does not contain a model that this version can read.
    """
    if not isinstance(name, str | os.PathLike):
        raise UnknownModelError(f"model: expected a name or the path of a folder, got {shown(name)}")
    if str(name) in BUILT_IN:
        module, attribute = BUILT_IN[str(name)]
        return getattr(importlib.import_module(module), attribute)()
    folder = WEIGHTS / str(name) if str(name) in model_names() else Path(name)
    if not is_folder(folder):
        known = ", ".join(model_names())
        raise UnknownModelError(
            f"model {str(name)!r}: no such name or folder{near(name, model_names())}; known names: {known}"
        )
    data = _read(folder)
    try:
        return _of_kind(folder, data)
    except (SonarError, ArithmeticError, LookupError, RuntimeError, TypeError, ValueError) as error:
        # the schema fits, but the parts do not fit each other
        where = "" if str(folder) in str(error) else f"{folder / 'model.json'}: "
        raise ModelError(f"{where}{error}") from None


ModelName = Annotated[str, Loadable(load_model)]  # of settings: a name or a folder


def _of_kind(folder: Path, data: Any) -> SonarModel:
    """Return the model described by (a part of) a folder's model.json."""
    kind = data.get("kind") if isinstance(data, dict) else None
    if kind not in KINDS:
        raise ModelError(f"{folder / 'model.json'}: the model is of kind {kind!r}, expected {', '.join(KINDS)}")
    module, attribute = KINDS[kind]
    cls = getattr(importlib.import_module(module), attribute)
    if kind in ("faulty", "composed", "replay", "transport", "adjusted"):
        return cls.load(folder, data, _of_kind)
    return cls.load(folder, data) if hasattr(cls, "load") else cls.from_dict(data)


def _read(folder: Path) -> dict[str, Any]:
    path = folder / "model.json"
    data = read_json(path, Model)
    if "format" not in data:
        raise ModelError(f"{path}: has no format, expected {FORMAT}; it is of another version")
    return data


@checked
def save_model(model: object, folder: str | os.PathLike[str]) -> Path:
    """Write a model's folder atomically, replacing an older model, and return the folder.

    Args:
        model: any object with `to_dict()`; `write_weights(folder)` is called if it exists.
        folder: folder to write.
    """
    if isinstance(model, type) or not hasattr(model, "to_dict"):
        raise SettingError(f"save_model.model: expected a model with to_dict(), got {shown(model)}")
    folder = Path(folder)
    check_path(folder)
    check_model_folder(folder)
    text = _described(model)
    with whole_folder(folder) as fresh:
        if hasattr(model, "write_weights"):
            model.write_weights(fresh)
        (fresh / "model.json").write_text(text + "\n", encoding="utf-8")
    return folder


def _described(model: Any) -> str:
    described = model.to_dict()
    if not isinstance(described, dict) or "kind" not in described:  # such as a table
        raise SettingError(f"save_model.model: its to_dict() gives no kind of model: {shown(model)}")
    try:
        return json.dumps({"format": FORMAT, **described}, indent=2, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise SettingError(f"save_model.model: its to_dict() gives what is no JSON: {error}") from None


def check_model_folder(folder: Path) -> None:
    """Check that writing a model to a folder replaces nothing but an older model.

    Raises:
        ModelError: the path is a file, or a folder with other contents.
    """
    if folder.exists() and not folder.is_dir():
        raise ModelError(f"{folder}: is a file, expected a folder for the model; give another name")
    if folder.exists() and any(folder.iterdir()) and not (folder / "model.json").is_file():
        raise ModelError(f"{folder}: contains something other than a model; give the name of a new folder")
