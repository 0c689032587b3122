"""Compare noise models on recordings they have not seen, such as those of other sensors, between two known ends.

The lower end is a normal scatter fitted as simulators have it; the upper is what the sensor repeats of itself: each
ping predicted from all others of its condition, which know where the target truly stood, as no model can.
Every model is given 3 arbitrary readings in 10,000, so that no single reading decides.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import pandas as pd
import tyro
from numpy.typing import NDArray

from acquisition import Recording, SettingError
from noise import IdealModel, SonarModel, load_model
from noise.beam import fit_beam
from noise.faults import Faulty, Short
from noise.law import Floats
from noise.metrics import Evaluation, Score, evaluate
from noise.model import MAX_RANGE
from training.common.progress import bar
from training.noise.baselines import PRIOR_PINGS, CellModel, fit_gaussian, fit_physics

ARBITRARY = Short(3e-4)  # in every model, so that no single reading decides; as in `noise.fitting.visit_effects`
GAUSSIAN, BEAM = "Gaussian, fitted", "beam model, by EM"
HEADINGS = ("model", "log-likelihood, nats a ping", "of the way", "CRPS, mm", "credence gap")


@dataclass(frozen=True)
class Args:
    """Settings of `sonar-gym compare-noise`."""

    learn: Annotated[Path, tyro.conf.Positional]
    """Recording to fit the baselines to."""
    test: Annotated[tuple[Path, ...], tyro.conf.Positional]
    """Recordings to score all models on: other sensors, other conditions. Each condition needs two pings or more."""
    models: tuple[str, ...] = ("srf08-mlp", "srf08-lstm", "srf08-hybrid")
    """Models to compare with the baselines, by name or folder."""


@dataclass(frozen=True)
class Compared:
    """Scores of models on fresh pings, and what the sensor's own pings are worth as a law of each other.

    Attributes:
        scores: by model.
        repeatability: log-likelihood of the same pings, nats, each condition's law taken from its other pings.
    """

    scores: dict[str, Evaluation]
    repeatability: Score

    def way(self, name: str) -> float:
        """Return how much of the way from the Gaussian to the repeatability a model goes: 1 is all of it."""
        low, high = self.scores[GAUSSIAN].log_likelihood.mean, self.repeatability.mean
        return (self.scores[name].log_likelihood.mean - low) / (high - low)


def halves(cell: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return every second ping of each cell, beginning with its second, (n,) bool.

    >>> halves(np.array([0, 1, 0, 0, 1])).tolist()
    [False, False, True, False, True]
    """
    order = np.argsort(cell, kind="stable")
    first = np.r_[True, np.diff(cell[order]) != 0]
    start = np.maximum.accumulate(np.where(first, np.arange(len(cell)), 0))
    fresh = np.empty(len(cell), dtype=bool)
    fresh[order] = (np.arange(len(cell)) - start) % 2 == 1
    return fresh


def repeatability(recording: Recording, fresh: NDArray[np.bool_], base: SonarModel) -> Floats:
    """Return the log probability of fresh pings, each under all of its condition's other pings, (fresh,).

    It is the predictive probability of a Dirichlet process about `base`, worth `PRIOR_PINGS` pings: shares of what else
    was read, and a remainder for what never was.
    """
    reading, cell = recording.reading, place(recording)
    said = np.rint(reading.range / recording.resolution).astype(np.int64)
    _, name = np.unique(np.stack([cell, reading.status, said]), axis=1, return_inverse=True)
    alike, known = np.bincount(name)[name[fresh]] - 1, np.bincount(cell)[cell[fresh]] - 1
    prior = np.exp(base.law(recording.ping[fresh]).log_prob(reading[fresh]))
    return np.log((alike + PRIOR_PINGS * prior) / (known + PRIOR_PINGS))


def baselines(learn: Recording) -> dict[str, SonarModel]:
    """Return what simulators have, fitted to a recording."""
    step, seen = learn.resolution, learn.reading.answered
    reach = max(MAX_RANGE, learn.reading.range.max() + step)
    ping, reading = learn.ping[seen], learn.reading[seen]
    beam, _ = fit_beam(ping, reading, step, reach)
    return {
        "ideal": IdealModel(step, reach),
        GAUSSIAN: fit_gaussian(ping, reading, step, reach),
        BEAM: beam,
        "each condition as recorded": CellModel.of(learn, beam),
        "physics, fitted": fit_physics(learn.select(seen), reach),
    }


def compare(test: Recording, models: dict[str, SonarModel]) -> Compared:
    """Score models on the fresh pings of a recording; those that remember have heard all pings before.

    Raises:
        SettingError: a register differs, or no condition was met twice.
    """
    for name, model in models.items():
        if abs(model.resolution - test.resolution) > 1e-9:
            own, wanted = (f"{1e3 * one.resolution:g} mm" for one in (model, test))
            raise SettingError(f"{name}: counts in steps of {own}, {test.name} in {wanted}: choose alike ones")
    cell = place(test)
    fresh = halves(cell) & test.reading.answered
    if not fresh.any():
        raise SettingError(f"{test.name}: no condition was met twice: record two pings or more of each")
    every = {name: Faulty(model, [ARBITRARY]) for name, model in models.items()}
    scores = {name: evaluate(model, test.ping, test.reading, cell, fresh) for name, model in every.items()}
    return Compared(scores, Score.of(repeatability(test, fresh, models[BEAM]), cell[fresh]))


def place(recording: Recording) -> NDArray[np.int64]:
    """Return the number of the condition, as met by one sensor, of each ping, (n,)."""
    sensor = recording.table["sensor"] if recording.has("sensor") else pd.Series(0, recording.table.index)
    both = np.stack([recording.condition, pd.factorize(sensor)[0]])
    return np.unique(both, axis=1, return_inverse=True)[1].ravel()


def rows(compared: Compared) -> list[tuple[str, ...]]:
    """Return a row of text for each model and one for the sensor's repeatability."""
    out = [
        (name, str(s.log_likelihood), _percent(compared.way(name)), str(s.crps_mm), f"{s.credence_gap:.3f}")
        for name, s in compared.scores.items()
    ]
    return [*out, ("own repeatability", str(compared.repeatability), "100 %", "", "")]


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %" if np.isfinite(share) else "-"


def main(args: Args) -> None:
    """Print a table in Markdown for each recording tested on."""
    models = {**baselines(Recording.load(args.learn)), **{name: load_model(name) for name in args.models}}
    pages = []
    with bar("scoring", len(args.test)) as progress:
        for done, path in enumerate(args.test, start=1):
            pages.append(_table(path, compare(Recording.load(path), models)))
            progress(done, len(args.test))
    print("\n\n".join(pages))


def _table(path: Path, compared: Compared) -> str:
    score = compared.repeatability
    head = f"{path.name}: {score.pings} fresh pings in {score.clusters} conditions, standard errors over these."
    lines = [f"| {' | '.join(row)} |" for row in (HEADINGS, ("---",) * len(HEADINGS), *rows(compared))]
    return "\n".join([head, "", *lines])
