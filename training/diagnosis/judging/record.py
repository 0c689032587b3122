"""What is written down of one diagnosed task: the answer, the verdict, its evidence, and scores on fresh recordings."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np
from sklearn.ensemble import HistGradientBoostingClassifier
from sklearn.model_selection import GroupKFold, cross_val_predict
from threadpoolctl import threadpool_limits

from acquisition import Recording
from acquisition.arrays import Bits, Floats
from noise import discrepancy
from noise.discrepancy.baseline.nearest import NearestVisits
from noise.discrepancy.result import Diagnosis, Location
from noise.fitting.batch import Batch
from noise.metrics import ClusterMean, crps_with_silence
from noise.model import MAX_RANGE, IdealModel, SonarModel
from training.common.commit import commit
from training.diagnosis.judging.tasks import Case, Task, case_of

Record = dict[str, Any]
N_FOLDS = 5
MAX_ITERATIONS = 60  # of boosting: separates strong from weak differences, and takes about a second


def record_of(task: Task) -> Record:
    """Make, diagnose and score one task; an error is recorded, not raised."""
    head: Record = {**asdict(task), "id": task.id, "commit": commit()}
    with threadpool_limits(1):
        case = case_of(task)
        answer = {"causes": [asdict(cause) for cause in case.causes], "fault": case.fault, "n": len(case.recorded)}
        begin = time.perf_counter()
        try:
            found = discrepancy.diagnose(IdealModel(), case.recorded, simulated=case.simulated, seed=task.seed)
        except Exception as error:  # every failure of the diagnosis counts against it
            return {**head, **answer, "error": f"{type(error).__name__}: {error}"}
        seconds = time.perf_counter() - begin
        return {**head, **answer, "error": None, "seconds": seconds, **_content(case, found)}


def _content(case: Case, found: Diagnosis) -> Record:
    verdict, batch = found.verdict, found.recorded
    region = case.causes[0].region if len(case.causes) == 1 else {}
    simulated = found.simulated if found.simulated is not None else Batch.of(case.simulated)
    return {
        "separation_nats": separation_nats(simulated, batch),
        "verdict": verdict.to_dict(),
        "intervals": {
            cause.effect: {name: (v.value, v.low, v.high) for name, v in cause.parameters.items()}
            for cause in verdict.causes
        },
        "overlap": [overlap(batch, location, region) for location in verdict.where],
        "evidence": {name: asdict(each) for name, each in found.evidence.items()},
        "posteriors": {name: dict(each) for name, each in found.posteriors.items()},
        "scores": scores(found, case.fresh) if case.fresh else None,
    }


def overlap(batch: Batch, location: Location, region: Mapping[str, tuple[float, float]]) -> float | None:
    """Return the intersection over union of two regions, in pings; None for a region of history or phase."""
    here, true = _inside(batch, location.region), _inside(batch, region)
    if here is None or true is None or not (here | true).any():
        return None
    return float((here & true).sum() / (here | true).sum())


def _inside(batch: Batch, region: Mapping[str, tuple[float, float]]) -> Bits | None:
    ping = batch.ping
    columns = {name: getattr(ping, name) for name in ("distance", "angle", "incidence", "reflectance", "time")}
    columns |= {"abs_angle": np.abs(ping.angle), **ping.covariates}
    if not region.keys() <= columns.keys():
        return None
    inside = np.ones(len(batch), dtype=bool)
    for name, (low, high) in region.items():
        inside &= (columns[name] >= low - 1e-9) & (columns[name] <= high + 1e-9)
    return inside


def scores(found: Diagnosis, fresh: tuple[Recording, ...]) -> Record:
    """Return CRPS with silence counted, m, on a fresh recording.

    The user's simulation and the oracle, a second recording, are the readings of their nearest visits under the same
    conditions. Where no model is offered, its score is that of the simulation.

    Args:
        found: the diagnosis.
        fresh: recording, simulation, and second recording under the same conditions.
    """
    batch, simulated, again = (Batch.of(each) for each in fresh)
    models: dict[str, SonarModel | None] = {
        "before": NearestVisits.of(simulated),
        "again": NearestVisits.of(again),
        "corrected": found.corrected,
        "causes_only": found.causes_only,
    }
    each = {name: _crps(model, batch) for name, model in models.items() if model is not None}
    means: Record = {name: float(each.get(name, each["before"]).mean()) for name in models}
    gap = ClusterMean.of(each["before"] - each["again"], batch.visit).error
    change = ClusterMean.of(each.get("corrected", each["before"]) - each["before"], batch.visit).error
    return {**means, "gap_error": gap, "change_error": change, "offered": found.corrected is not None}


def _crps(model: SonarModel, batch: Batch) -> Floats:
    return crps_with_silence(model.law(batch.ping, batch.past), batch.reading, MAX_RANGE)


def separation_nats(simulated: Batch, recorded: Batch) -> float:
    """Return how far apart two recordings are, in nats, without any law of a sonar.

    A classifier of the files sees conditions and readings, another sees conditions alone; the difference of their log
    losses on unseen visits estimates, from below, the information of the readings about the file, times their number.
    """
    file = np.r_[np.zeros(len(simulated)), np.ones(len(recorded))]
    group = np.r_[simulated.visit, simulated.n_visits + recorded.visit]
    if len(np.unique(group)) < 2 * N_FOLDS:
        return 0.0
    common = sorted(simulated.ping.covariates.keys() & recorded.ping.covariates.keys())
    conditions, readings = map(
        np.concatenate, zip(_columns(simulated, common), _columns(recorded, common), strict=True)
    )
    gain = _log_probability(np.c_[conditions, readings], file, group) - _log_probability(conditions, file, group)
    return float(gain.sum())


def _columns(batch: Batch, common: list[str]) -> tuple[Floats, Floats]:
    ping, reading = batch.ping, batch.reading
    logged = [ping.covariates[name] for name in common]
    error = np.where(reading.echo, reading.range - ping.distance, np.nan)
    before = np.where(reading.echo & batch.past.echo, reading.range - batch.past.range, np.nan)
    conditions = np.stack([ping.distance, ping.angle, ping.incidence, ping.reflectance, *logged], axis=1)
    return conditions, np.stack([error, before, reading.echo.astype(np.float64)], axis=1)


def _log_probability(column: Floats, file: Floats, group: Floats) -> Floats:
    learner = HistGradientBoostingClassifier(max_iter=MAX_ITERATIONS, early_stopping=False, random_state=0)
    folds = GroupKFold(N_FOLDS)
    both = cross_val_predict(learner, column, file, groups=group, cv=folds, method="predict_proba")
    return np.log(np.clip(both[np.arange(len(file)), file.astype(int)], 1e-3, 1.0))
