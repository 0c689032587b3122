"""Laws of what a sonar reads: physical, learned, corrected. Torch is imported only when a model needs it."""

from __future__ import annotations

import importlib
from typing import Any

from noise.credence import ConditionPrior, CredenceTable
from noise.law import EchoLaw
from noise.model import GaussianModel, IdealModel, SonarModel, follow, listener, simulate
from noise.store import load_model, model_names, save_model

_LAZY = {
    "PhysicalModel": "noise.physical",
    "CATALOGUE": "noise.effects",
    "LstmModel": "noise.learned.recurrent",
    "MlpModel": "noise.learned.networks",
    "Faulty": "noise.faults",
    "diagnose": "noise.discrepancy",
    "load_thesis_network": "noise.learned.thesis",
}

__all__ = [
    "CATALOGUE",
    "ConditionPrior",
    "CredenceTable",
    "EchoLaw",
    "Faulty",
    "GaussianModel",
    "IdealModel",
    "LstmModel",
    "MlpModel",
    "PhysicalModel",
    "SonarModel",
    "diagnose",
    "follow",
    "listener",
    "load_model",
    "load_thesis_network",
    "model_names",
    "save_model",
    "simulate",
]


def __getattr__(name: str) -> Any:
    """Import what needs torch or h5py on first use."""
    if name in _LAZY:
        return getattr(importlib.import_module(_LAZY[name]), name)
    raise AttributeError(f"module 'noise' has no attribute {name!r}")
