"""What is scored of a diagnosis, as JSON: a file of the proof may have been changed, and runs no code."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from acquisition import Recording
from noise.discrepancy.result import Diagnosis
from noise.fitting.batch import Batch
from noise.model import SonarModel
from noise.store import load_model, save_model
from training.diagnosis.judging.said import said

MODELS = ("corrected", "causes_only", "difference", "emulator")
FILE = "model.json"


@dataclass(frozen=True, eq=False)
class Parcel:
    """What is scored of a diagnosis.

    Attributes:
        said: what it says besides its verdict.
        models: those of `MODELS`; None where there is none.
        resolution: of the recording's register, m.
    """

    said: Mapping[str, Any]
    models: Mapping[str, SonarModel | None]
    resolution: float

    def recorded(self, recording: Recording) -> Batch:
        """Return the recording as the diagnosis saw it."""
        return replace(Batch.of(recording), resolution=self.resolution)


def packed(found: Diagnosis) -> bytes:
    """Return what is scored of a diagnosis as bytes."""
    models = {name: _described(getattr(found, name)) for name in MODELS}
    content = {"said": said(found), "models": models, "resolution": found.recorded.resolution}
    return json.dumps(content, sort_keys=True).encode()


def unpacked(data: bytes) -> Parcel:
    """Return what `packed` wrote."""
    content = json.loads(data)
    models = {name: _loaded(content["models"][name]) for name in MODELS}
    return Parcel(content["said"], models, float(content["resolution"]))


def _described(model: SonarModel | None) -> Any:
    if model is None:
        return None
    with TemporaryDirectory() as folder:
        return json.loads((save_model(model, Path(folder) / "model") / FILE).read_text(encoding="utf-8"))


def _loaded(description: Any) -> SonarModel | None:
    if description is None:
        return None
    with TemporaryDirectory() as folder:
        (Path(folder) / FILE).write_text(json.dumps(description), encoding="utf-8")
        return load_model(folder)
