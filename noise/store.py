"""Loading and saving of models: `load_model("srf08-mlp")`, `load_model("run/corrected")`, `save_model(model, folder)`.

A saved model is a folder with `model.json` (kind and parameters) and, for networks, `weights.safetensors`.
Pickle is never used.
"""

from __future__ import annotations

import importlib
import json
import os
from pathlib import Path
from typing import Any

from acquisition import ModelError, UnknownModelError
from acquisition.io.files import whole_folder
from noise.model import SonarModel

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
    "nearest": ("noise.discrepancy.baseline.nearest", "NearestVisits"),
    "beam": ("noise.beam", "BeamModel"),
    "mlp": ("noise.learned.networks", "MlpModel"),
    "ideal": ("noise.model", "IdealModel"),
    "gaussian": ("noise.model", "GaussianModel"),
    "faulty": ("noise.faults", "Faulty"),
    "composed": ("noise.composed", "ComposedModel"),
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
    if str(name) in BUILT_IN:
        module, attribute = BUILT_IN[str(name)]
        return getattr(importlib.import_module(module), attribute)()
    shipped = WEIGHTS / str(name)
    folder = shipped if (shipped / "model.json").is_file() else Path(name)
    if not folder.is_dir():
        known = ", ".join(model_names())
        raise UnknownModelError(f"model {str(name)!r}: no such name or folder; known names: {known}")
    return _of_kind(folder, _read(folder))


def _of_kind(folder: Path, data: Any) -> SonarModel:
    """Return the model described by (a part of) a folder's model.json."""
    kind = data.get("kind") if isinstance(data, dict) else None
    if kind not in KINDS:
        raise ModelError(f"{folder / 'model.json'}: the model is of kind {kind!r}, expected {', '.join(KINDS)}")
    module, attribute = KINDS[kind]
    cls = getattr(importlib.import_module(module), attribute)
    if kind in ("faulty", "composed"):
        return cls.load(folder, data, _of_kind)
    return cls.load(folder, data) if hasattr(cls, "load") else cls.from_dict(data)


def _read(folder: Path) -> dict[str, Any]:
    path = folder / "model.json"
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise ModelError(f"{folder}: contains no model.json; give the folder of a saved model") from None
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise ModelError(f"{path}: not a model file ({error}); it may be damaged") from None
    if not isinstance(data, dict) or data.get("format") != FORMAT or data.get("kind") not in KINDS:
        raise ModelError(f"{path}: not a model of format {FORMAT} and kind {', '.join(KINDS)}")
    return data


def save_model(model: Any, folder: str | os.PathLike[str]) -> Path:
    """Write a model's folder atomically, replacing an older model, and return the folder.

    Args:
        model: any object with `to_dict()`; `write_weights(folder)` is called if it exists.
        folder: folder to write.
    """
    folder = Path(folder)
    check_model_folder(folder)
    text = json.dumps({"format": FORMAT, **model.to_dict()}, indent=2, allow_nan=False)
    with whole_folder(folder) as fresh:
        if hasattr(model, "write_weights"):
            model.write_weights(fresh)
        (fresh / "model.json").write_text(text + "\n", encoding="utf-8")
    return folder


def check_model_folder(folder: Path) -> None:
    """Check that writing a model to a folder replaces nothing but an older model.

    Raises:
        ModelError: the path is a file, or a folder with other contents.
    """
    if folder.exists() and not folder.is_dir():
        raise ModelError(f"{folder}: is a file, expected a folder for the model; give another name")
    if folder.exists() and any(folder.iterdir()) and not (folder / "model.json").is_file():
        raise ModelError(f"{folder}: contains something other than a model; give the name of a new folder")
