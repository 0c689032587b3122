"""What is written down of one diagnosed task: the answer, the verdict, its evidence, and scores on fresh recordings."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from acquisition import Recording
from acquisition.arrays import Bits, Floats
from noise import discrepancy
from noise.discrepancy.judge.held_out import fair_crps
from noise.discrepancy.result import Diagnosis, Location
from noise.fitting.batch import Batch
from noise.fitting.visits import visits_of
from noise.metrics import ClusterMean, crps_with_silence
from noise.model import MAX_RANGE, IdealModel, SonarModel
from training.common.commit import commit
from training.diagnosis.judging.tasks import Case, Task, case_of

Record = dict[str, Any]
MAX_MEMBERS = 25  # readings of an ensemble; more hardly add information, and take memory


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
    return {
        "verdict": verdict.to_dict(),
        "intervals": {
            cause.effect: {name: (v.value, v.low, v.high) for name, v in cause.parameters.items()}
            for cause in verdict.causes
        },
        "overlap": [overlap(batch, location, region) for location in verdict.where],
        "evidence": {name: asdict(each) for name, each in found.evidence.items()},
        "likely": {name: dict(each) for name, each in found.likely.items()},
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

    The user's simulation and the oracle, a second recording, are their own readings in the same visits. Where no model
    is offered, its score is that of the simulation.

    Args:
        found: the diagnosis.
        fresh: recording, simulation, and second recording under the same conditions, ping by ping.
    """
    recording, simulated, again = fresh
    batch = Batch.of(recording)
    each = {"before": ensemble_crps(recording, simulated), "again": ensemble_crps(recording, again)}
    models = {"corrected": found.corrected, "causes_only": found.causes_only}
    each |= {name: each["before"] if model is None else _crps(model, batch) for name, model in models.items()}
    gap = ClusterMean.of(each["before"] - each["again"], batch.visit).error
    change = ClusterMean.of(each["corrected"] - each["before"], batch.visit).error
    means = {name: float(value.mean()) for name, value in each.items()}
    return {**means, "gap_error": gap, "change_error": change, "offered": found.corrected is not None}


def _crps(model: SonarModel, batch: Batch) -> Floats:
    return crps_with_silence(model.law(batch.ping, batch.past), batch.reading, MAX_RANGE)


def ensemble_crps(recording: Recording, other: Recording) -> Floats:
    """Return the CRPS of answered pings, m, in the order of a `Batch`; the ensemble is the same visit of another file.

    Readings of the ensemble are moved to the distance of the ping.
    """
    visit = visits_of(recording)[1]
    order = np.lexsort((np.arange(len(visit)), visit))
    order = order[recording.reading.answered[order]]
    distance, reading, answered = recording.ping.distance, recording.reading, np.flatnonzero(other.reading.answered)
    error = np.where(other.reading.echo, other.reading.range - other.ping.distance, np.inf)
    out = np.empty(len(visit))
    for rows in np.split(order, np.flatnonzero(np.diff(visit[order])) + 1):
        same = answered[visit[answered] == visit[rows[0]]]
        members = error[same if len(same) > 1 else answered][:MAX_MEMBERS]
        drawn = np.where(np.isfinite(members), distance[rows, None] + members, MAX_RANGE)
        y = np.where(reading.echo[rows], reading.range[rows], MAX_RANGE)
        out[rows] = fair_crps(y, drawn)
    return out[order]
