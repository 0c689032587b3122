"""Score noise models on other recordings, for example of other sensors, on a scale between two references.

The lower reference is a fitted Gaussian. The upper one is the sensor's repeatability: each ping predicted from all
other pings of its condition. These share the target's actual position, which a model of single pings lacks. Every
model is mixed with 3e-4 of uniform outliers, so that no single reading dominates the score.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import pandas as pd
import tyro
from annotated_types import MinLen
from numpy.typing import NDArray

from acquisition import Recording, SettingError
from acquisition.arrays import Floats
from acquisition.io.files import write_text
from acquisition.io.places import OutputFile
from noise import IdealModel, SonarModel, load_model
from noise.beam import fit_beam
from noise.faults import Faulty, Short
from noise.metrics import ClusterMean, Evaluation, evaluate
from noise.model import MAX_RANGE
from noise.store import ModelName
from training.common.progress import bar
from training.common.tables import markdown_table
from training.noise.baselines import PRIOR_PINGS, NearestConditionModel, fit_gaussian, fit_physics

OUTLIERS = Short(3e-4)  # mixed into every model; as in `noise.fitting.visit_effects`
GAUSSIAN, BEAM = "Gaussian, fitted", "beam model, by EM"
HEADINGS = ("model", "log-likelihood, nats per ping", "gap closed", "CRPS, mm", "credence gap")


@dataclass(frozen=True)
class Args:
    """Settings of `sonar-gym compare-noise`."""

    learn: Annotated[Path, tyro.conf.Positional]
    """Recording to fit the baselines to."""
    test: Annotated[tuple[Path, ...], tyro.conf.Positional, MinLen(1)]
    """Recordings to score all models on: other sensors, other conditions. Each condition needs at least two pings."""
    models: Annotated[tuple[ModelName, ...], MinLen(1)] = ("srf08-mlp", "srf08-lstm", "srf08-hybrid")
    """Models to compare with the baselines, by name or folder."""
    out: OutputFile | None = None
    """Markdown file for the tables, which are also printed."""


@dataclass(frozen=True)
class ModelComparison:
    """Scores of models on the scored pings, and the sensor's repeatability on the same pings.

    Attributes:
        scores: by model.
        repeatability: log-likelihood, nats, of each ping under the law of its condition's other pings.
    """

    scores: dict[str, Evaluation]
    repeatability: ClusterMean

    def gap_closed(self, name: str) -> float:
        """Return the position of a model's log-likelihood between the Gaussian, 0, and the repeatability, 1."""
        low, high = self.scores[GAUSSIAN].log_likelihood.mean, self.repeatability.mean
        return (self.scores[name].log_likelihood.mean - low) / (high - low)


def alternate_pings(condition: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return every second ping of each condition, beginning with its second, (n,) bool.

    >>> alternate_pings(np.array([0, 1, 0, 0, 1])).tolist()
    [False, False, True, False, True]
    """
    order = np.argsort(condition, kind="stable")
    first = np.r_[True, np.diff(condition[order]) != 0]
    start = np.maximum.accumulate(np.where(first, np.arange(len(condition)), 0))
    scored = np.empty(len(condition), dtype=bool)
    scored[order] = (np.arange(len(condition)) - start) % 2 == 1
    return scored


def repeatability(recording: Recording, scored: NDArray[np.bool_], base: SonarModel) -> Floats:
    """Return the log probability of the scored pings, each given all other answered pings of its condition, (scored,).

    This is the predictive probability of a Dirichlet process with base law `base` and concentration `PRIOR_PINGS`.
    """
    reading, condition = recording.reading, sensor_conditions(recording)
    step = np.rint(reading.range / recording.resolution).astype(np.int64)
    _, outcome = np.unique(np.stack([condition, reading.status, step]), axis=1, return_inverse=True)
    equal = np.bincount(outcome)[outcome[scored]] - 1
    others = np.bincount(condition, reading.answered)[condition[scored]] - 1
    prior = np.exp(base.law(recording.ping[scored]).log_prob(reading[scored]))
    return np.log((equal + PRIOR_PINGS * prior) / (others + PRIOR_PINGS))


def baselines(learn: Recording) -> dict[str, SonarModel]:
    """Return the baselines fitted to a recording."""
    step, answered = learn.resolution, learn.reading.answered
    reach = max(MAX_RANGE, learn.reading.range.max() + step)
    ping, reading = learn.ping[answered], learn.reading[answered]
    beam, _ = fit_beam(ping, reading, step, reach)
    return {
        "ideal": IdealModel(step, reach),
        GAUSSIAN: fit_gaussian(ping, reading, step, reach),
        BEAM: beam,
        "each condition as recorded": NearestConditionModel.of(learn, beam),
        "physics, fitted": fit_physics(learn.select(answered), reach),
    }


def compare(test: Recording, models: dict[str, SonarModel]) -> ModelComparison:
    """Score models on alternate pings of a recording; recurrent models condition on all previous pings.

    Raises:
        SettingError: a register differs, or no condition has two pings.
    """
    for name, model in models.items():
        if abs(model.resolution - test.resolution) > 1e-9:
            own, wanted = (f"{1e3 * one.resolution:g} mm" for one in (model, test))
            raise SettingError(f"{name}: counts in steps of {own}, {test.name} in {wanted}: choose equal ones")
    condition = sensor_conditions(test)
    scored = alternate_pings(condition) & test.reading.answered
    if not scored.any():
        raise SettingError(f"{test.name}: no condition has two pings: record at least two of each")
    every = {name: Faulty(model, [OUTLIERS]) for name, model in models.items()}
    scores = {name: evaluate(model, test.ping, test.reading, condition, scored, True) for name, model in every.items()}
    return ModelComparison(scores, ClusterMean.of(repeatability(test, scored, models[BEAM]), condition[scored]))


def sensor_conditions(recording: Recording) -> NDArray[np.int64]:
    """Return the index of each ping's combination of condition and sensor, (n,)."""
    sensor = recording.table["sensor"] if recording.has("sensor") else pd.Series(0, recording.table.index)
    both = np.stack([recording.condition, pd.factorize(sensor)[0]])
    return np.unique(both, axis=1, return_inverse=True)[1].ravel()


def comparison_text(comparison: ModelComparison) -> str:
    """Return the scores as a table in Markdown below a line on the test data."""
    score = comparison.repeatability
    rows = [
        (name, str(s.log_likelihood), _percent(comparison.gap_closed(name)), str(s.crps_mm), f"{s.credence_gap:.3f}")
        for name, s in comparison.scores.items()
    ]
    table = markdown_table(HEADINGS, [*rows, ("repeatability", str(score), "100 %", "", "")])
    return f"{score.pings} scored pings in {score.clusters} conditions, standard errors over these.\n\n{table}"


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %" if np.isfinite(share) else "-"


def main(args: Args) -> None:
    """Print a table in Markdown for each test recording."""
    models = {**baselines(Recording.load(args.learn)), **{name: load_model(name) for name in args.models}}
    pages = []
    with bar("scoring", len(args.test)) as progress:
        for done, path in enumerate(args.test, start=1):
            pages.append(f"{path.name}: {comparison_text(compare(Recording.load(path), models))}")
            progress(done, len(args.test))
    print("\n\n".join(pages))
    if args.out is not None:
        write_text(args.out, "\n\n".join(pages) + "\n")
