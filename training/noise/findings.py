"""Results of the noise report, and the targets that they are checked against."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from acquisition import Recording
from noise import SonarModel, follow
from noise.credence import wilson
from noise.faults import Faulty
from noise.metrics import ClusterMean, credence_reliability, is_correct
from noise.model import steps
from training.noise.compare import OUTLIERS, ModelComparison, sensor_conditions
from training.noise.experiments import CORRELATED, UNCORRELATED, CredenceScore, MemoryGain

BAYES, ALONE, RECENT = "Bayes over the training conditions", "learned, this reading", "learned, last 8 readings"
TEST_SETS = {"conditions": "new conditions, known sensors", "sensors": "new sensors"}
POSITIONS = {"first": (0, 0), "second": (1, 1), "third to sixth": (2, 5), "later": (6, 10_000)}
MIN_GAP_CLOSED, MAX_GAP_GIVEN_CONDITION, MAX_GAP_GIVEN_READINGS = 0.95, 0.02, 0.05
NEGLIGIBLE_GAIN = 0.01  # nats per ping
Z_95 = 1.96


@dataclass(frozen=True)
class ConditionCredence:
    """Predicted credence given the condition, against the recorded fraction of correct readings.

    Attributes:
        gap: mean of |predicted - observed| over bins of the prediction.
        error: mean of |predicted - observed| over conditions.
        coverage: fraction of conditions whose Wilson interval contains the prediction.
    """

    gap: float
    error: float
    coverage: float

    @classmethod
    def of(cls, model: SonarModel, test: Recording) -> ConditionCredence:
        """Compare a model with a recording; a recurrent model conditions on all previous pings."""
        condition, correct = sensor_conditions(test), is_correct(test.ping, test.reading)
        hits, trials = np.bincount(condition, weights=correct), np.bincount(condition)
        low, high = wilson(hits, trials)
        law = follow(model, test.ping, test.reading)
        mean = np.bincount(condition, weights=law.credence()) / trials
        gap, error = credence_reliability(law, test.reading, condition).gap, np.abs(mean - hits / trials).mean()
        return cls(gap, float(error), float(((mean >= low) & (mean <= high)).mean()))


def by_position_in_condition(model: SonarModel, test: Recording) -> dict[str, ClusterMean]:
    """Return the log-likelihood of pings, nats, by their position among the pings of a condition (`POSITIONS`)."""
    condition, position = sensor_conditions(test), np.empty(len(test), dtype=np.int64)
    for k, rows in enumerate(steps(condition)):
        position[rows] = k
    value = follow(Faulty(model, [OUTLIERS]), test.ping, test.reading).log_prob(test.reading)
    masks = {
        name: (position >= first) & (position <= last) & test.reading.answered
        for name, (first, last) in POSITIONS.items()
    }
    return {name: ClusterMean.of(value[mask], condition[mask]) for name, mask in masks.items()}


@dataclass(frozen=True)
class NoiseFindings:
    """Results of the noise report.

    Attributes:
        comparisons: scores of all models, by test set (`TEST_SETS`).
        condition_credence: credence given the condition, by test set and model.
        given: credence given the readings, by test set and method.
        gains: gain of memory, by scenario.
        by_position: log-likelihood by model and position in the condition.
        shipped: names of the models under test.
    """

    comparisons: Mapping[str, ModelComparison]
    condition_credence: Mapping[str, Mapping[str, ConditionCredence]]
    given: Mapping[str, Mapping[str, CredenceScore]]
    gains: Mapping[str, MemoryGain]
    by_position: Mapping[str, Mapping[str, ClusterMean]]
    shipped: tuple[str, ...]


@dataclass(frozen=True)
class Target:
    """Target of the noise models, its result, and whether it is met."""

    target: str
    result: str
    met: bool

    @property
    def row(self) -> tuple[str, str, str]:
        """Row of a table in Markdown."""
        return self.target, self.result, "yes" if self.met else "**no**"


def targets(found: NoiseFindings) -> list[Target]:
    """Return every target with its result."""
    return [
        *(target for name in found.comparisons for target in _likelihood_targets(found, name)),
        *(_condition_target(found, name) for name in found.condition_credence),
        *(_readings_target(found, name) for name in found.given),
        *(_memory_target(found, name) for name in found.gains if name in (*CORRELATED, *UNCORRELATED)),
    ]


def _likelihood_targets(found: NoiseFindings, name: str) -> list[Target]:
    comparison, shipped = found.comparisons[name], found.shipped
    value = {model: score.log_likelihood.mean for model, score in comparison.scores.items()}
    best = max((model for model in value if model not in shipped), key=value.__getitem__)
    below = [model for model in shipped if value[model] <= value[best]]
    result = f"{', '.join(below)} below {best}" if below else f"all above {best} ({value[best]:.2f})"
    closed = {model: comparison.gap_closed(model) for model in shipped}
    return [
        Target(f"{TEST_SETS[name]}: log-likelihood above every baseline", result, not below),
        Target(
            f"{TEST_SETS[name]}: best model closes 95 % of the gap from fitted Gaussian to repeatability",
            _listed(f"{100 * share:.0f} % {model}" for model, share in closed.items()),
            max(closed.values()) >= MIN_GAP_CLOSED,
        ),
    ]


def _condition_target(found: NoiseFindings, name: str) -> Target:
    gaps = {model: score.gap for model, score in found.condition_credence[name].items()}
    text = f"{TEST_SETS[name]}: calibration gap of credence given the condition at most {MAX_GAP_GIVEN_CONDITION:g}"
    return Target(text, _gaps(gaps), max(gaps.values()) <= MAX_GAP_GIVEN_CONDITION)


def _readings_target(found: NoiseFindings, name: str) -> Target:
    gaps = {method: score.reliability.gap for method, score in found.given[name].items()}
    text = f"{TEST_SETS[name]}: calibration gap of credence given the readings at most {MAX_GAP_GIVEN_READINGS:g}"
    return Target(text, _gaps(gaps), max(gaps.values()) <= MAX_GAP_GIVEN_READINGS)


def _gaps(gaps: Mapping[str, float]) -> str:
    return _listed(f"{gap:.3f} {name}" for name, gap in gaps.items())


def _listed(parts: Iterable[str]) -> str:
    return ", ".join(parts)


def _memory_target(found: NoiseFindings, name: str) -> Target:
    gain = found.gains[name].gain
    low, high = gain.mean - Z_95 * gain.error, gain.mean + Z_95 * gain.error
    result = f"{gain.mean:.3f} nats per ping, 95 %: {low:.3f} to {high:.3f}"
    if name in UNCORRELATED:
        return Target(f"no gain of memory: {name}", result, low <= 0.0 <= high or abs(gain.mean) < NEGLIGIBLE_GAIN)
    return Target(f"gain of memory: {name}", result, low > 0.0)
