"""Fit of the decision model: a logistic regression on evidence, checked on families that were left out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from pydantic import TypeAdapter
from sklearn.linear_model import LogisticRegression
from sklearn.metrics import log_loss
from sklearn.model_selection import LeaveOneGroupOut, cross_val_predict
from sklearn.pipeline import Pipeline, make_pipeline
from sklearn.preprocessing import StandardScaler

from acquisition import SettingError
from acquisition.arrays import Bits, Floats, Ints
from noise.discrepancy.evidence import Evidence
from noise.discrepancy.judge.decision import DecisionModel
from noise.discrepancy.thresholds import LISTED
from noise.metrics import reliability
from training.diagnosis.judging.record import Record
from training.diagnosis.judging.scoring import parts_of_fault

PENALTIES = tuple(10.0**k for k in np.arange(-3.0, 2.5, 0.5))  # inverse strengths of the L2 penalty
MIN_FAMILIES = 2
EVIDENCE = TypeAdapter(Evidence)  # records of another version may hold more


@dataclass(frozen=True, eq=False)
class Examples:
    """Selected effects of many trials.

    Attributes:
        feature: (n, k).
        true: whether the effect, or a listed alternative in its place, is a true cause, (n,).
        family, trial: index of the family and of the trial, (n,).
    """

    feature: Floats
    true: Bits
    family: Ints
    trial: Ints


def true_places(record: Record) -> set[str]:
    """Return the selected effects in whose place a true cause is listed; each cause counts in one place."""
    out = set()
    for cause in record["causes"]:
        ids = set(cause["accepted"])
        likely = {e: _listed(record, e, ids) for e in record["evidence"] if e not in out}
        best = max(likely, key=lambda effect: likely[effect], default="")
        if likely.get(best, 0.0) >= LISTED:
            out.add(best)
    return out


def _listed(record: Record, effect: str, ids: set[str]) -> float:
    """Return the probability of a true cause in a place; one that was selected comes first."""
    return float(effect in ids) + sum(p for other, p in record["likely"][effect].items() if other in ids)


def examples_of(records: Sequence[Record]) -> Examples:
    """Return the selected effects of all records with their features, but those that are a part of a fault.

    These are in part right, so that they tell nothing about what is right or wrong.

    Raises:
        SettingError: fewer than two families, or effects that are all true or all wrong.
    """
    families = sorted({record["family"] for record in records})
    rows = [
        (EVIDENCE.validate_python(evidence).features(), effect in true, families.index(record["family"]), k)
        for k, record in enumerate(records)
        for true in [true_places(record)]
        for effect, evidence in record["evidence"].items()
        if effect not in parts_of_fault(record)
    ]
    feature, true, family, trial = (
        (np.array(column) for column in zip(*rows, strict=True)) if rows else [np.empty(0)] * 4
    )
    if len(np.unique(family)) < MIN_FAMILIES or len(np.unique(true)) < 2:
        raise SettingError(
            f"{len(rows)} selected effects of {len(np.unique(family))} families, {int(np.sum(true))} of them true: the "
            f"fit needs both true and wrong ones, and {MIN_FAMILIES} families; run more trials"
        )
    return Examples(feature, true.astype(bool), family.astype(np.int64), trial.astype(np.int64))


def fit(examples: Examples) -> DecisionModel:
    """Return the decision model; the penalty is that with the least log loss on families left out."""
    regression = _regression(_penalty(examples)).fit(examples.feature, examples.true)
    scaler, logistic = regression[0], regression[1]
    return DecisionModel(scaler.mean_, scaler.scale_, logistic.coef_[0], float(logistic.intercept_[0]))


class RisingRegression(LogisticRegression):
    """Logistic regression whose probability never falls where a feature rises: better evidence is no worse.

    Of correlated features one may get a negative weight by chance. The most negative one is left out until there is
    none.
    """

    def fit(self, feature: Floats, true: Bits) -> RisingRegression:
        """Fit the weights, each at least 0.

        Args:
            feature: standardised, (n, k).
            true: outcomes, (n,).
        """
        kept = np.ones(feature.shape[1], dtype=bool)
        while True:
            super().fit(feature * kept, true)
            if (self.coef_[0] >= 0.0).all():
                return self
            kept[np.argmin(self.coef_[0])] = False


def _regression(penalty: float) -> Pipeline:
    return make_pipeline(StandardScaler(), RisingRegression(C=penalty, max_iter=2000))


def _penalty(examples: Examples) -> float:
    if len(np.unique(examples.family)) < MIN_FAMILIES:
        return 1.0
    losses = [log_loss(examples.true, _left_out(examples, each), labels=[False, True]) for each in PENALTIES]
    return PENALTIES[int(np.argmin(losses))]


def _left_out(examples: Examples, penalty: float) -> Floats:
    """Return probabilities of the effects of each family by a model of the other families, (n,)."""
    by_family = LeaveOneGroupOut()
    both = cross_val_predict(
        _regression(penalty),
        examples.feature,
        examples.true,
        groups=examples.family,
        cv=by_family,
        method="predict_proba",
    )
    return np.asarray(both[:, 1])


def left_out_probabilities(examples: Examples) -> Floats:
    """Return probabilities of each family's effects by a model of the others, its penalty included, (n,)."""
    out = np.empty(len(examples.true))
    for each in np.unique(examples.family):
        rest = examples.family != each
        part = Examples(*(getattr(examples, name)[rest] for name in ("feature", "true", "family", "trial")))
        regression = _regression(_penalty(part)).fit(part.feature, part.true)
        out[~rest] = regression.predict_proba(examples.feature[~rest])[:, 1]
    return out


def quality(probability: Floats, examples: Examples) -> dict[str, object]:
    """Return size, Brier score, calibration error and reliability bins of probabilities."""
    bins = reliability(probability, examples.true, examples.trial)
    columns = {"predicted": bins.predicted, "observed": bins.observed, "n": bins.pings}
    table = [{name: value[k].item() for name, value in columns.items()} for k in np.flatnonzero(bins.pings)]
    brier = float(np.mean((probability - examples.true) ** 2))
    return {"n": len(probability), "brier": brier, "ece": bins.gap, "reliability": table}
