"""The decision model: the probability that a selected effect is a cause, fitted on an ensemble of generators.

A logistic regression on a few features of the evidence. Its weights lie beside it in decision.json, with the record of
how they were made and how well they did on generators that were left out (`sonar-gym fit-decision` makes them).
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from acquisition.arrays import Floats
from noise.discrepancy.evidence import FEATURES, Evidence

WEIGHTS = Path(__file__).with_name("decision.json")


@dataclass(frozen=True, eq=False)
class DecisionModel:
    """Logistic regression with weights for standardised features.

    Attributes:
        mean, scale: of the features, (k,).
        weight: (k,).
        intercept: log-odds at the mean.
    """

    mean: Floats
    scale: Floats
    weight: Floats
    intercept: float

    def probability(self, evidence: Evidence) -> float:
        """Return the probability that the effect, or one of its alternatives, is a cause."""
        log_odds = float((evidence.features() - self.mean) / self.scale @ self.weight + self.intercept)
        return float(1.0 / (1.0 + np.exp(-np.clip(log_odds, -30.0, 30.0))))

    def to_dict(self) -> dict[str, object]:
        """Return the weights as plain data."""
        arrays = {
            name: dict(zip(FEATURES, getattr(self, name).tolist(), strict=True)) for name in ("mean", "scale", "weight")
        }
        return {**arrays, "intercept": self.intercept}

    @classmethod
    def from_dict(cls, data: dict[str, object]) -> DecisionModel:
        """Return the model of `to_dict`."""
        arrays = {name: np.array([dict(data[name])[key] for key in FEATURES]) for name in ("mean", "scale", "weight")}  # type: ignore[call-overload]
        return cls(**arrays, intercept=float(str(data["intercept"])))


@cache
def decision_model() -> DecisionModel:
    """Return the shipped decision model."""
    return DecisionModel.from_dict(json.loads(WEIGHTS.read_text())["model"])
