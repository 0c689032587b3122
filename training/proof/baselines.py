"""Named baselines on the same trials: two-sample tests, independent likelihood ratios, and two other corrections."""

from __future__ import annotations

import warnings
from dataclasses import replace
from typing import Any

import numpy as np
from sklearn.ensemble import HistGradientBoostingClassifier
from sklearn.exceptions import ConvergenceWarning
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel
from sklearn.model_selection import GroupKFold

from acquisition.arrays import Floats, Ints
from noise.beam import fit_beam
from noise.discrepancy.baseline.forest import AnalogueForest
from noise.discrepancy.name.candidates import candidate_names, keys_of, with_sampled_bounds
from noise.fitting.batch import Batch
from noise.fitting.fit import maximise
from noise.fitting.likelihood import likeliest, log_likelihood
from noise.fitting.stack import SPREAD, Stack
from noise.fitting.starts import nuisance_start, starting_points
from noise.law import EchoLaw
from noise.metrics import crps_with_silence
from noise.model import MAX_RANGE, SonarModel
from noise.physical import PhysicalModel
from training.diagnosis.judging.tasks import Case

LEVEL = 0.05  # of the two-sample tests
N_FOLDS, N_PERMUTATIONS, MAX_VISITS = 4, 199, 240  # the last bounds the kernel matrix
AKAIKE = 1.0  # nats per parameter
N_FITTED, GRID_PINGS, FIT_PINGS = 6, 200, 600  # effects with the best starting points are fitted
NEAR_M = 0.3  # an echo this near the target is taken for the target's


def baselines(case: Case, recorded: Batch, emulator: SonarModel | None) -> tuple[dict[str, Any], dict[str, float]]:
    """Return what the baselines say of a trial, and the CRPS of their corrections on its fresh recording, m.

    Args:
        case: the trial.
        recorded: its recording as the diagnosis saw it.
        emulator: law that describes the simulation.
    """
    rng = np.random.default_rng(0)  # so that the same trial gives the same scores
    simulated = Batch.of(case.simulated)
    x, label, group = _features(simulated, recorded)
    said: dict[str, Any] = {"classifier_p": classifier_p(x, label, group, rng), "mmd_p": mmd_p(x, label, group, rng)}
    said["independent"] = independent_name(recorded, emulator, rng)
    return said, corrections(simulated, recorded, Batch.of(case.fresh[0]), rng) if case.fresh else {}


def _features(simulated: Batch, recorded: Batch) -> tuple[Floats, Ints, Ints]:
    """Return conditions and readings of both files, (n, 6), the file, (n,), and the visit, (n,)."""
    columns = []
    for batch in (simulated, recorded):
        ping, echo = batch.ping, batch.reading.echo
        error = np.where(echo, batch.error, -1.0)
        change = np.where(echo & batch.past.echo, batch.reading.range - batch.past.range, 0.0)
        columns.append(np.stack([ping.distance, ping.angle, ping.reflectance, 1.0 * ~echo, error, change], axis=1))
    label = np.repeat([0, 1], [len(simulated), len(recorded)])
    return np.concatenate(columns), label, np.r_[simulated.visit, simulated.n_visits + recorded.visit]


def classifier_p(x: Floats, label: Ints, group: Ints, rng: np.random.Generator) -> float:
    """Return the p-value of a classifier two-sample test (Lopez-Paz and Oquab 2017) on unseen visits.

    The signs of the accuracy above chance of whole visits are permuted, since pings of a visit are not independent.
    """
    right = np.zeros(len(x))
    for train, test in GroupKFold(N_FOLDS).split(x, label, group):
        learner = HistGradientBoostingClassifier(max_iter=40, max_leaf_nodes=12, random_state=0)
        right[test] = learner.fit(x[train], label[train]).predict(x[test]) == label[test]
    by_visit = np.bincount(group, right - max(label.mean(), 1.0 - label.mean()))
    sign = rng.choice([-1.0, 1.0], (N_PERMUTATIONS, len(by_visit)))
    return float((1 + np.sum(sign @ by_visit >= by_visit.sum())) / (N_PERMUTATIONS + 1))


def mmd_p(x: Floats, label: Ints, group: Ints, rng: np.random.Generator) -> float:
    """Return the p-value of the maximum mean discrepancy of visit means (Gretton et al. 2012), by permutation."""
    visits = rng.permutation(group.max() + 1)[:MAX_VISITS]
    mean = np.stack([np.bincount(group, column) for column in x.T], axis=1) / np.bincount(group)[:, None]
    side = label[np.unique(group, return_index=True)[1]][visits]
    mean = (mean - mean.mean(axis=0)) / (mean.std(axis=0) + 1e-9)
    square = np.sum((mean[visits, None] - mean[None, visits]) ** 2, axis=2)
    kernel = np.exp(-square / np.median(square[square > 0]))
    sides = [side, *(rng.permutation(side) for _ in range(N_PERMUTATIONS))]
    values = np.array([_discrepancy(kernel, each) for each in sides])
    return float(np.mean(values >= values[0] * (1.0 - 1e-12)))


def _discrepancy(kernel: Floats, side: Ints) -> float:
    weight = np.where(side == 1, 1.0 / max(side.sum(), 1), -1.0 / max((1 - side).sum(), 1))
    return float(weight @ kernel @ weight)


def independent_name(recorded: Batch, emulator: SonarModel | None, rng: np.random.Generator) -> str:
    """Return the effect with the greatest likelihood ratio if every ping were independent; "" for none.

    The effects, their starting points and the law of the simulation are those of the diagnosis; Akaike's criterion
    decides, without unseen visits and without effects of visits.
    """
    if not isinstance(emulator, PhysicalModel):
        return ""
    base = with_sampled_bounds(Stack.of(emulator), recorded)
    batch, grid = recorded.thin(FIT_PINGS), recorded.thin(GRID_PINGS)
    free = SPREAD[:2]
    null = maximise(nuisance_start(base, batch).without("visits"), free, batch, 20)
    starts = {
        name: likeliest(starting_points(null.stack, name, grid, rng, 2), grid)
        for name in candidate_names(base, recorded, ())
    }
    near = sorted(starts, key=lambda name: -log_likelihood(starts[name], grid).sum())[:N_FITTED]
    gains = {"": 0.0}
    for name in near:
        keys = keys_of(base, name, batch)
        gains[name] = maximise(starts[name], (*keys, *free), batch, 12).nats - null.nats - AKAIKE * len(keys)
    return max(gains, key=lambda name: gains[name])


def corrections(simulated: Batch, recorded: Batch, fresh: Batch, rng: np.random.Generator) -> dict[str, float]:
    """Return the CRPS, m, of a Gaussian-process discrepancy and of a beam model on a fresh recording.

    The process corrects the median of the simulation's readings under similar conditions (Kennedy and O'Hagan 2001);
    the beam model is fitted to the recording alone by expectation maximisation (Thrun et al. 2005).
    """
    forest = AnalogueForest.of(simulated, rng)
    moved = np.maximum(fresh.ping.distance + process_shift(forest, recorded, fresh), 1e-3)
    process = forest.law(replace(fresh.ping, distance=moved))
    beam, _ = fit_beam(recorded.ping, recorded.reading, recorded.resolution, MAX_RANGE)
    return {"process": _crps(process, fresh), "beam": _crps(beam.law(fresh.ping), fresh)}


def _crps(law: EchoLaw, batch: Batch) -> float:
    return float(crps_with_silence(law, batch.reading, MAX_RANGE).mean())


def process_shift(forest: AnalogueForest, recorded: Batch, fresh: Batch) -> Floats:
    """Return the mean difference between recording and simulation by a Gaussian process, m, (n,)."""
    expected = forest.law(recorded.ping).quantile(0.5)
    near = recorded.reading.echo & np.isfinite(expected) & (np.abs(recorded.reading.range - expected) < NEAR_M)
    if near.sum() < 20:
        return np.zeros(len(fresh))
    visit = np.unique(recorded.visit[near], return_inverse=True)[1]

    def mean(value: Floats) -> Floats:
        return np.bincount(visit, value[near]) / np.bincount(visit)

    x = np.stack([mean(recorded.ping.distance), mean(np.abs(recorded.ping.angle))], axis=1)[:MAX_VISITS]
    kernel = ConstantKernel(1e-4, (1e-8, 1.0)) * RBF([1.0, 0.3], (0.05, 20.0)) + WhiteKernel(1e-5, (1e-9, 1e-2))
    process = GaussianProcessRegressor(kernel, random_state=0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)  # a length scale at its bound: no such trend
        process.fit(x, mean(recorded.reading.range - expected)[:MAX_VISITS])
    shift = process.predict(np.stack([fresh.ping.distance, np.abs(fresh.ping.angle)], axis=1))
    return np.asarray(shift, dtype=np.float64)
