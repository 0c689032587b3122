"""What is written down of one diagnosed task: the answer, the verdict, its evidence, and scores on fresh recordings."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from functools import partial
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from acquisition import EchoStatus, Reading, Recording, previous
from acquisition.arrays import Bits, Floats, Ints
from acquisition.ping import CREDENCE_TOLERANCE
from noise import discrepancy
from noise.discrepancy.judge.held_out import fair_crps
from noise.discrepancy.result import Diagnosis
from noise.fitting.batch import Batch
from noise.fitting.visits import visits_of
from noise.metrics import ClusterMean, crps_with_silence
from noise.model import MAX_RANGE, IdealModel, SonarModel, with_order
from noise.replay import with_simulated
from training.common.commit import commit
from training.diagnosis.judging.said import said
from training.diagnosis.judging.tasks import Case, Task, case_of

Record = dict[str, Any]
Region = Mapping[str, Sequence[float]]  # column -> (low, high)
Models = Mapping[str, SonarModel | None]
NEAR = "near"  # entry of the scores within the tolerance of credence
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
    models = {"corrected": found.corrected, "causes_only": found.causes_only, "difference": found.difference}
    return {"verdict": found.verdict.to_dict(), **judged(case, said(found), found.recorded, models)}


def judged(case: Case, told: Mapping[str, Any], batch: Batch, models: Models) -> Record:
    """Return what a diagnosis says, the overlap of its regions with the true one, and scores on fresh recordings.

    Args:
        case: the task with its answer.
        told: what `said` returned.
        batch: the recording as the diagnosis saw it.
        models: "corrected", "causes_only" and "difference" of the diagnosis.
    """
    region = case.causes[0].region if len(case.causes) == 1 else {}
    return {
        **{name: told[name] for name in ("intervals", "evidence", "likely")},
        "overlap": [overlap(batch, each, region) for each in told["regions"]],
        "scores": scores(models, case.fresh) if case.fresh else None,
    }


def overlap(batch: Batch, found: Region, region: Region) -> float | None:
    """Return the intersection over union of two regions, in pings; None for a region of history or phase."""
    here, true = _inside(batch, found), _inside(batch, region)
    if here is None or true is None or not (here | true).any():
        return None
    return float((here & true).sum() / (here | true).sum())


def _inside(batch: Batch, region: Region) -> Bits | None:
    ping = batch.ping
    columns = {name: getattr(ping, name) for name in ("distance", "angle", "incidence", "reflectance", "time")}
    columns |= {"abs_angle": np.abs(ping.angle), **ping.covariates}
    if not region.keys() <= columns.keys():
        return None
    inside = np.ones(len(batch), dtype=bool)
    for name, (low, high) in region.items():
        inside &= (columns[name] >= low - 1e-9) & (columns[name] <= high + 1e-9)
    return inside


def scores(offered: Models, fresh: tuple[Recording, ...]) -> Record:
    """Return CRPS with silence counted, m, on a fresh recording, and the same within the tolerance of credence.

    A silent ping counts as a reading at the end of the register, so that chance in the number of these hides errors of
    range; within the tolerance it counts no more than any other reading that is no use.

    The user's simulation and the oracle, a second recording, are their own readings in the same visits; "own" is the
    simulation's own readings with what differs applied to them. Where no model is offered, its score is that of the
    simulation.

    Args:
        offered: models of the diagnosis; see `judged`.
        fresh: recording, simulation, and second recording under the same conditions, ping by ping.
    """
    near = _scores(offered, fresh, CREDENCE_TOLERANCE)
    return {**_scores(offered, fresh, None), "offered": offered["corrected"] is not None, NEAR: near}


def _scores(offered: Models, fresh: tuple[Recording, ...], tolerance: float | None) -> dict[str, float]:
    recording, simulated, again = fresh
    batch, crps = Batch.of(recording), partial(ensemble_crps, recording, tolerance=tolerance)
    each = {"before": crps(simulated), "again": crps(again)}
    models = {name: offered[name] for name in ("corrected", "causes_only")}
    each |= {name: each["before"] if m is None else _crps(m, batch, tolerance) for name, m in models.items()}
    acting = offered["difference"]
    each["own"] = each["before"] if acting is None else crps(simulated, acting)
    gap = ClusterMean.of(each["before"] - each["again"], batch.visit).error
    changes = {
        f"{name}_error": ClusterMean.of(each[name] - each["before"], batch.visit).error for name in ("corrected", "own")
    }
    means = {name: float(value.mean()) for name, value in each.items()}
    return {**means, **changes, "gap_error": gap}


def _crps(model: SonarModel, batch: Batch, tolerance: float | None) -> Floats:
    return crps_with_silence(model.law(batch.ping, batch.past), batch.reading, MAX_RANGE, tolerance=tolerance)


def ensemble_crps(
    recording: Recording, other: Recording, model: SonarModel | None = None, tolerance: float | None = None
) -> Floats:
    """Return the CRPS of answered pings, m, in the order of a `Batch`; the ensemble is the same visit of another file.

    Readings of the ensemble are moved to the distance of the ping.

    Args:
        recording: what is predicted.
        other: readings of the ensemble.
        model: changes each reading of the ensemble, at the ping's condition and past.
        tolerance: share of the distance to which readings are clipped; see `crps_with_silence`.
    """
    batch, pairs = Batch.of(recording), list(_ensembles(recording, other))
    row = np.concatenate([np.repeat(rows, len(members)) for rows, members in pairs])
    member = np.concatenate([np.tile(members, len(rows)) for rows, members in pairs])
    shift = batch.ping.distance[row] - other.ping.distance[member]
    drawn = _moved(other.reading[member], shift, other.resolution)
    if model is not None:
        before = _moved(previous(other.reading, other.ping.run)[member], shift, other.resolution)
        law = model.law(with_simulated(with_order(batch.ping)[row], drawn, before), batch.past[row])
        drawn = law.sample(np.random.default_rng(0))
    distance, out = batch.ping.distance, np.empty(len(batch))
    end, drawn_end = _ends(batch.reading, distance, tolerance), _ends(drawn, distance[row], tolerance)
    ensembles = np.split(drawn_end, np.cumsum([len(rows) * len(members) for rows, members in pairs])[:-1])
    for (rows, members), values in zip(pairs, ensembles, strict=True):
        out[rows] = fair_crps(end[rows], values.reshape(len(rows), len(members)))
    return out


def _moved(reading: Reading, shift: Floats, step: float) -> Reading:
    """Return readings whose echoes are moved by a shift, m, (n,), to no less than a step, m."""
    echo = reading.status == EchoStatus.ECHO
    return Reading.of(np.where(echo, np.maximum(reading.range + shift, step), 0.0), reading.status)


def _ensembles(recording: Recording, other: Recording) -> Iterator[tuple[Ints, Ints]]:
    """Yield the rows of each visit in a `Batch`, and the answered pings of that visit in another file."""
    visit = visits_of(recording)[1]
    answered = np.flatnonzero(other.reading.answered)
    named = np.unique(visit[recording.reading.answered])
    for name, rows in zip(named, Batch.of(recording).visit_rows, strict=True):
        same = answered[visit[answered] == name]
        yield rows, (same if len(same) > 1 else answered)[:MAX_MEMBERS]


def _ends(reading: Reading, distance: Floats, tolerance: float | None) -> Floats:
    """Return ranges, m, with the end of the register for no echo, clipped as in `crps_with_silence`."""
    reach = np.inf if tolerance is None else tolerance * distance
    return np.clip(np.where(reading.echo, reading.range, MAX_RANGE), distance - reach, distance + reach)
