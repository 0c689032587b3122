"""What others would do with two recordings: named baselines that stand in the same table."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from sklearn.ensemble import HistGradientBoostingClassifier
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel
from sklearn.model_selection import GroupKFold

from acquisition import Recording
from acquisition.arrays import Floats, Ints
from noise.beam import fit_beam
from noise.discrepancy.common.splits import Split
from noise.discrepancy.name.search import Search
from noise.fitting.batch import Batch
from noise.fitting.fit import log_likelihood, maximise
from noise.fitting.stack import SPREAD, VISITS, Stack
from noise.fitting.visit_effects import FLOOR
from noise.fitting.visits import visits_of
from noise.model import MAX_RANGE

FOLDS, SHUFFLES, MOST = 4, 200, 240
AKAIKE = 1.0  # nats a parameter
NEAREST = 8  # effects that likelihood ratios fit
NEAR_M = 0.3  # an echo this near the target is taken for its own


def features(recording: Recording) -> Floats:
    """Return what a two-sample test may look at, (n, 8): conditions, reading, its error, its change, time of run."""
    ping, reading = recording.ping, recording.reading
    error = np.where(reading.echo, reading.range - ping.distance, -1.0)
    change = np.diff(error, prepend=error[:1])
    silent = (~reading.echo).astype(np.float64)
    columns = [ping.distance, ping.angle, ping.incidence, ping.reflectance, silent, error, change, ping.time]
    return np.stack(columns, axis=1)


def two_samples(simulated: Recording, recorded: Recording, rng: np.random.Generator) -> dict[str, float]:
    """Return what a classifier and a kernel two-sample test say of two recordings, conditions among their features.

    Folds and shuffles keep cells whole: pings of one cell are no independent witnesses.
    """
    x = np.concatenate([features(r) for r in (simulated, recorded)])
    label = np.repeat([0, 1], [len(simulated), len(recorded)])
    group = np.concatenate([simulated.condition, recorded.condition + simulated.condition.max() + 1])
    return {**_classifier(x, label, group), "kernel_p": _kernel_p(x, label, group, rng)}


def _classifier(x: Floats, label: Ints, group: Ints) -> dict[str, float]:
    """Return by how many nats a classifier tells unseen cells apart, and how many standard errors that is."""
    gain = np.zeros(len(x))
    for train, test in GroupKFold(FOLDS).split(x, label, group):
        model = HistGradientBoostingClassifier(max_iter=40, max_leaf_nodes=12, random_state=0).fit(
            x[train], label[train]
        )
        chance = np.bincount(label[train])[label[test]] / len(train)
        told = np.clip(model.predict_proba(x[test])[np.arange(len(test)), label[test]], 1e-3, 1.0)
        gain[test] = np.log(told) - np.log(chance)
    by_cell = np.bincount(group, gain)
    error = float(np.sqrt(len(by_cell)) * by_cell.std()) + 1e-9
    return {"classifier_nats": float(gain.sum()), "classifier_z": float(gain.sum()) / error}


def _kernel_p(x: Floats, label: Ints, group: Ints, rng: np.random.Generator) -> float:
    """Return the p-value of the maximum mean discrepancy under shuffles of whole cells, one mean row a cell."""
    first = np.unique(group, return_index=True)[1]
    mean = np.stack([np.bincount(group, column) for column in x[:, :7].T], axis=1) / np.bincount(group)[:, None]
    side = label[first][:MOST]
    mean = (mean - mean.mean(axis=0)) / (mean.std(axis=0) + 1e-9)
    square = ((mean[:MOST, None] - mean[None, :MOST]) ** 2).sum(axis=2)
    kernel = np.exp(-square / np.median(square[square > 0]))
    found = _discrepancy(kernel, side)
    shuffled = [_discrepancy(kernel, rng.permutation(side)) for _ in range(SHUFFLES)]
    return float((1 + np.sum(np.array(shuffled) >= found)) / (SHUFFLES + 1))


def _discrepancy(kernel: Floats, side: Ints) -> float:
    weight = np.where(side == 1, 1.0 / max(side.sum(), 1), -1.0 / max((1 - side).sum(), 1))
    return float(weight @ kernel @ weight)


def independent_name(search: Search) -> tuple[str, float]:
    """Return the effect that likelihood ratios name which take every ping for independent, "" for none, and its nats.

    The same laws and starts; no offset or repetition is shared by a cell, and Akaike's criterion decides.
    """
    base = search.base.put(
        [(VISITS, name) for name in ("placement_m", "urn_weight", "ping_correlation", "simulation_correlation")],
        [0.0] * 4,
    )
    free = SPREAD[:2]
    start = maximise(base, free, search.screen, 25)
    here = float(log_likelihood(start.stack, search.grid).sum()) + AKAIKE
    grids = {name: search.points(start.stack, name)[0] for name in search.candidates()}
    near = sorted((name for name in grids if grids[name][0] > here), key=lambda name: -grids[name][0])[:NEAREST]
    best, gain = "", 0.0
    for name in near:
        keys = search.keys([name])
        nats = maximise(grids[name][1], (*keys, *free), search.screen, 12).nats - start.nats - AKAIKE * len(keys)
        if nats > gain:
            best, gain = name, nats
    return best, float(gain)


def process_nats(stack: Stack, seen: Batch, vault: Batch) -> float:
    """Return the vault's log likelihood a ping when a Gaussian process over distance and angle corrects the mean."""
    error, near = seen.error, seen.reading.echo & (np.abs(seen.error) < NEAR_M)
    if near.sum() < 20:
        return float(log_likelihood(stack, vault).mean())
    cell = np.unique(seen.condition[near], return_inverse=True)[1]
    count = np.bincount(cell)

    def mean(value: Floats) -> Floats:
        return np.bincount(cell, value[near]) / count

    x = np.stack([mean(seen.ping.distance), mean(np.abs(seen.ping.angle))], axis=1)
    kernel = ConstantKernel(1e-4, (1e-8, 1.0)) * RBF([1.0, 0.3], (0.05, 20.0)) + WhiteKernel(1e-5, (1e-9, 1e-2))
    process = GaussianProcessRegressor(kernel, random_state=0).fit(x, mean(error))
    there = np.stack([vault.ping.distance, np.abs(vault.ping.angle)], axis=1)
    moved = np.maximum(vault.ping.distance + process.predict(there), 1e-3)
    return float(log_likelihood(stack, replace(vault, ping=replace(vault.ping, distance=moved))).mean())


def beam_nats(recorded: Recording, split: Split) -> float:
    """Return the vault's log likelihood a ping under the four-part beam model, fitted to the open cells by EM."""
    open_rows = np.isin(visits_of(recorded)[0], np.unique(split.both.condition)) & recorded.reading.answered
    seen = recorded.select(open_rows)
    model, _ = fit_beam(seen.ping, seen.reading, recorded.resolution, MAX_RANGE)
    vault = split.vault
    law = model.law(vault.ping)
    arbitrary = FLOOR * np.where(vault.reading.echo, 1.0 / law.last_step, 1.0)
    return float(np.log((1.0 - 2.0 * FLOOR) * np.exp(law.log_prob(vault.reading)) + arbitrary).mean())
