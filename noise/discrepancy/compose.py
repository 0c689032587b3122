"""A model for training with the causes that a diagnosis found."""

from __future__ import annotations

import os
import warnings

from acquisition import SettingError
from acquisition.limits import shown
from noise.composed import ComposedModel, with_differences
from noise.discrepancy.result import Diagnosis
from noise.effects import CATALOGUE, Effect
from noise.model import SonarModel
from noise.store import load_model


def compose(model: SonarModel | str | os.PathLike[str], diagnosis: Diagnosis) -> ComposedModel:
    """Return a model with the causes that a diagnosis found, for training; causes that cannot be added are warned of.

    Args:
        model: model whose laws have probabilities, its name or its folder.
        diagnosis: diagnosis whose causes are added, as differences between its simulation and its recording.

    Raises:
        SettingError: the law of the model can only be sampled.
    """
    base = load_model(model) if isinstance(model, str | os.PathLike) else model
    if not all(hasattr(diagnosis, name) for name in ("emulator", "causes_only", "verdict")):
        raise SettingError(f"compose.diagnosis: expected a Diagnosis, got {shown(diagnosis)}")
    known, found = (_values(each) for each in (diagnosis.emulator, diagnosis.causes_only))
    causes = {cause.effect: cause.parameters for cause in diagnosis.verdict.causes if cause.believed}
    stated = {name: {key: each.value for key, each in values.items()} for name, values in causes.items()}
    # stated values of an offset are differences
    values = {name: {**known.get(name, {}), **each, **found.get(name, {})} for name, each in stated.items()}
    composed, left_out = with_differences(base, known, values)
    if left_out or not causes:
        reasons = "; ".join(f"{name} ({reason})" for name, reason in left_out.items()) or "the diagnosis names no cause"
        warnings.warn(f"compose: not added to the model: {reasons}", stacklevel=2)
    return composed


def _values(model: SonarModel | None) -> dict[str, dict[str, float]]:
    effects: tuple[Effect, ...] = getattr(model, "effects", ())
    return {effect.name: effect.values for effect in effects if effect.name in CATALOGUE}
