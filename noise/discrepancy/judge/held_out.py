"""Scores on visits that no estimate used: the user's simulation, the emulator, the corrected model."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from acquisition.arrays import Floats
from noise.discrepancy.baseline.forest import MAX_PINGS, AnalogueForest, crossed_crps, floored_log_prob
from noise.discrepancy.name.estimates import Z
from noise.discrepancy.name.search import standard_error
from noise.discrepancy.result import HeldOut, Interval, Score
from noise.fitting.batch import Batch
from noise.metrics import crps_with_silence
from noise.model import SonarModel


def crps(model: SonarModel, batch: Batch) -> float:
    """Return the mean CRPS of a model's readings with silence counted, m."""
    return float(np.mean(crps_of_each(model, batch)))


def crps_of_each(model: SonarModel, batch: Batch) -> Floats:
    """Return the CRPS of each reading with silence counted, m, (n,)."""
    return np.asarray(crps_with_silence(model.law(batch.ping, batch.past), batch.reading))


def gains(model: SonarModel, other: SonarModel, batch: Batch) -> bool:
    """Return whether a model's CRPS is less than another's beyond chance: the interval over visits excludes zero."""
    return _beyond_chance(batch.visit_sums(crps_of_each(other, batch) - crps_of_each(model, batch)))


def forest_gains(other: SonarModel, batch: Batch, rng: np.random.Generator) -> bool:
    """Return whether a forest's CRPS on visits that its trees have not seen is less than a model's beyond chance."""
    few = batch.thin(MAX_PINGS)
    return _beyond_chance(few.visit_sums(crps_of_each(other, few) - crossed_crps(few, rng)))


def _beyond_chance(gain: Floats) -> bool:
    return bool(gain.sum() > Z * standard_error(gain))


def best_of(models: Sequence[SonarModel], fallback: SonarModel, batch: Batch) -> SonarModel:
    """Return the model with the least CRPS; the fallback only where it gains beyond chance.

    Laws with causes hold under other conditions too, and a forest of readings under their own alone.

    Args:
        models: laws.
        fallback: a model that knows no law.
        batch: visits that no model was fitted to.
    """
    best = min(models, key=lambda model: crps(model, batch), default=fallback)
    return fallback if gains(fallback, best, batch) else best


def log_score(model: SonarModel, batch: Batch) -> Floats:
    """Return the log probability of each reading, nats, (n,), with a floor for what a law calls impossible."""
    return floored_log_prob(model.law(batch.ping, batch.past), batch)


def held_out(
    before: SonarModel,
    emulator: SonarModel,
    after: SonarModel,
    seen: Batch,
    unseen: Batch,
    rng: np.random.Generator,
) -> HeldOut:
    """Return the scores on unseen visits.

    Args:
        before: the user's own simulation.
        emulator: law that describes it.
        after: the corrected model.
        seen: the recording's other visits, whose readings show how well it repeats itself.
        unseen: readings to score.
        rng: grows the forest of the other visits.
    """
    nats = [log_score(model, unseen) for model in (before, emulator, after)]
    scores = [
        Score(float(n.mean()), crps(model, unseen)) for n, model in zip(nats, (before, emulator, after), strict=True)
    ]
    gain = unseen.visit_sums(nats[2] - nats[0])
    mean, error = float(gain.sum()) / len(unseen), Z * standard_error(gain) / len(unseen)
    gained = Interval(mean, mean - error, mean + error, "nats")
    itself = crps(AnalogueForest.of(seen, rng), unseen)
    return HeldOut(len(unseen), unseen.n_visits, scores[0], scores[1], scores[2], itself, gained)
