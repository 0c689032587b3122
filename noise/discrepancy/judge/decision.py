"""The decision model: the probability that a selected effect is a cause, fitted on an ensemble of generators.

A logistic regression on a few features of the evidence. Its weights lie beside it in decision.json, with the record of
how they were made and how well they did on generators that were left out (`sonar-gym fit-decision` makes them).
"""

from __future__ import annotations

import json
from dataclasses import dataclass, fields
from functools import cache
from pathlib import Path

import numpy as np

from acquisition.arrays import Floats

WEIGHTS = Path(__file__).with_name("decision.json")


@dataclass(frozen=True)
class Evidence:
    """What is known of a selected effect when it is judged.

    Attributes:
        gain: log-likelihood on unseen visits that is lost without it, nats.
        gain_error: standard error of `gain` over visits, nats.
        n_pings: number of pings of the folds.
        n_visits: number of visits of the folds.
        share: its share of the misfit, 0 to 1.
        rest: share of the misfit that nothing explains, 0 to 1.
        lead: log posterior relative to the best alternative in its place, nats.
        prior: log prior of its size, nats, at most 0.
        p_before: p-value of the test of the simulation's law.
        p_after: p-value of the test of the corrected law.
        n_effects: number of selected effects.
        catch_all: whether it is an effect that many others resemble.
    """

    gain: float
    gain_error: float
    n_pings: int
    n_visits: int
    share: float
    rest: float
    lead: float
    prior: float
    p_before: float
    p_after: float
    n_effects: int
    catch_all: bool

    def features(self) -> Floats:
        """Return the features of the decision model, on scales on which a unit matters."""
        return np.array(
            [
                np.log1p(max(self.gain, 0.0)),
                np.clip(self.gain / max(self.gain_error, 1e-9), -3.0, 12.0),
                np.log10(max(self.gain, 1e-3) / self.n_pings),
                self.share,
                self.rest,
                np.tanh(self.lead / 10.0),
                self.prior,
                np.log10(max(self.p_before, 1e-4)),
                np.log10(max(self.p_after, 1e-4)),
                float(self.n_effects - 1),
                float(self.catch_all),
                np.log10(self.n_visits),
            ]
        )


FEATURES = (
    "log_gain",
    "gain_in_errors",
    "log10_gain_per_ping",
    "share",
    "rest",
    "lead",
    "prior",
    "log10_p_before",
    "log10_p_after",
    "other_effects",
    "catch_all",
    "log10_visits",
)


@dataclass(frozen=True, eq=False)
class DecisionModel:
    """Logistic regression with weights for standardised features.

    Attributes:
        mean, scale: of the features, (k,).
        weight: (k,).
        intercept: log-odds at the mean.
        temperature: factor by which log posteriors of alternatives overstate evidence.
    """

    mean: Floats
    scale: Floats
    weight: Floats
    intercept: float
    temperature: float

    def probability(self, evidence: Evidence) -> float:
        """Return the probability that the effect, or one of its alternatives, is a cause."""
        log_odds = float((evidence.features() - self.mean) / self.scale @ self.weight + self.intercept)
        return float(1.0 / (1.0 + np.exp(-np.clip(log_odds, -30.0, 30.0))))

    def to_dict(self) -> dict[str, object]:
        """Return the weights as plain data."""
        arrays = {
            name: dict(zip(FEATURES, getattr(self, name).tolist(), strict=True)) for name in ("mean", "scale", "weight")
        }
        return {**arrays, "intercept": self.intercept, "temperature": self.temperature}

    @classmethod
    def from_dict(cls, data: dict[str, object]) -> DecisionModel:
        """Return the model of `to_dict`."""
        arrays = {name: np.array([dict(data[name])[key] for key in FEATURES]) for name in ("mean", "scale", "weight")}  # type: ignore[call-overload]
        return cls(**arrays, intercept=float(str(data["intercept"])), temperature=float(str(data["temperature"])))


@cache
def decision_model() -> DecisionModel:
    """Return the shipped decision model."""
    return DecisionModel.from_dict(json.loads(WEIGHTS.read_text())["model"])


assert len(FEATURES) == len(Evidence(1, 1, 1, 1, 0, 0, 0, 0, 1, 1, 1, False).features())
assert len(fields(Evidence)) == len(FEATURES)
