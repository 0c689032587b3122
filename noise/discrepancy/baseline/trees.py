"""Randomised regression trees over pings: their inputs, their growth on whole visits, and the search for a leaf."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import ndtri
from scipy.stats import rankdata
from sklearn.tree import ExtraTreeRegressor

from acquisition import Ping, Reading
from acquisition.arrays import Bits, Floats, Ints
from noise.effects import Conditions
from noise.fitting.batch import Batch
from noise.fitting.smooth import MEMORY, MIRRORED, column
from noise.model import order_of

INTERVAL = "interval_s"  # logged with every recording; it describes the past, not the condition
ORDER, SIGNED_ANGLE, SIGNED_INCIDENCE = "order", "signed_angle", "signed_incidence"
CONDITIONS = ("log_distance", "angle", "incidence", MIRRORED, "reflectance", SIGNED_ANGLE, SIGNED_INCIDENCE)
OWN = (*CONDITIONS, ORDER, *MEMORY, "time")  # inputs that every ping has
N_FOLDS, N_DEALS = 5, 6  # each deal of the visits to folds gives one tree without each fold
MIN_LEAF = 4  # pings in a leaf; the average over trees smooths further
MEAN_ABS_NORMAL = float(np.sqrt(2.0 / np.pi))


def _log_order(ping: Ping) -> Floats:
    return np.log1p(order_of(ping))


def columns(names: Sequence[str], ping: Ping, past: Reading | None, typical: Mapping[str, float]) -> Floats:
    """Return inputs of trees, (n, d); a covariate that was not logged has its typical value."""
    c = Conditions.of(ping, past)
    special = {ORDER: _log_order, SIGNED_ANGLE: lambda p: p.angle, SIGNED_INCIDENCE: lambda p: p.incidence}
    out = np.empty((len(ping), len(names)))
    for k, name in enumerate(names):
        if name in special:
            out[:, k] = special[name](ping)
        elif name in OWN or name in ping.covariates:
            out[:, k] = column(name, c).numpy()
        else:
            out[:, k] = typical[name]
    return out.astype(np.float32).astype(np.float64)  # scikit-learn compares single precision


def input_groups(batch: Batch) -> tuple[tuple[str, ...], ...]:
    """Return the inputs to choose from, the fewest first: conditions; with the past; with the past and the time."""
    logged = tuple(name for name in batch.ping.covariates if name != INTERVAL)
    past = (ORDER, *MEMORY, *((INTERVAL,) if INTERVAL in batch.ping.covariates else ()))
    groups = [(*CONDITIONS, *logged), (*CONDITIONS, *logged, *past)]
    if batch.timed:
        groups.append((*groups[1], "time"))
    return tuple(dict.fromkeys(_varying(names, batch) for names in groups))


def _varying(names: Sequence[str], batch: Batch) -> tuple[str, ...]:
    """Return the inputs that vary, without those equal to an earlier one; at least one."""
    x = columns(names, batch.ping, batch.past, {})
    first = [not any(np.array_equal(x[:, k], x[:, j]) for j in range(k)) for k in range(len(names))]
    varied = [name for name, spread, new in zip(names, np.ptp(x, axis=0), first, strict=True) if spread > 0 and new]
    return tuple(varied or names[:1])


def outcomes(batch: Batch) -> Floats:
    """Return what the leaves of a tree are to agree in, standardised, (n, k).

    Whether there is an echo, before and behind the target; the normal score of the target's errors, which no outlier
    dominates; and how far the score is from the middle.
    """
    error, target = batch.error, batch.is_target(batch.error)
    score = np.zeros(len(batch))
    score[target] = ndtri((rankdata(error[target]) - 0.5) / max(int(target.sum()), 1))
    outlier = batch.reading.echo & ~target
    spread = np.where(target, np.abs(score) - MEAN_ABS_NORMAL, 0.0)
    return standardised(batch.reading.echo, outlier & (error < 0), outlier & (error > 0), score, spread)


def standardised(*column: Bits | Floats) -> Floats:
    """Return columns of unit standard deviation, (n, k), without those that are constant; at least one."""
    every = np.stack(column, axis=1).astype(np.float64)
    deviation = every.std(axis=0)
    return every[:, deviation > 0] / deviation[deviation > 0] if (deviation > 0).any() else every[:, :1]


@dataclass(frozen=True, eq=False)
class Trees:
    """Binary trees in one numbering of nodes; a child has a greater number than its parent.

    Attributes:
        root: first node of each tree, (t,).
        feature: input that each node compares, -1 for a leaf, (nodes,).
        threshold: up to which a ping goes left, (nodes,).
        left, right: children, -1 for a leaf, (nodes,).
    """

    root: Ints
    feature: Ints
    threshold: Floats
    left: Ints
    right: Ints

    @classmethod
    def of(cls, grown: Sequence[Any]) -> Trees:
        """Return trees of scikit-learn (their `tree_`) in one numbering."""
        root = np.cumsum([0, *(tree.node_count for tree in grown[:-1])])
        feature = np.concatenate([np.where(tree.children_left < 0, -1, tree.feature) for tree in grown])
        threshold = np.concatenate([np.where(tree.children_left < 0, 0.0, tree.threshold) for tree in grown])
        left, right = (
            np.concatenate([np.where(child < 0, -1, child + r) for child, r in zip(children, root, strict=True)])
            for children in ([tree.children_left for tree in grown], [tree.children_right for tree in grown])
        )
        return cls(root, feature, threshold, left, right)

    def leaves(self, x: Floats) -> Ints:
        """Return the leaf of n pings with inputs x, (n, d), in each tree, (n, t)."""
        node = np.tile(self.root, (len(x), 1))
        row = np.arange(len(x))[:, None]
        while np.any(inner := self.feature[node] >= 0):
            goes_left = x[row, np.maximum(self.feature[node], 0)] <= self.threshold[node]
            child = np.where(goes_left, self.left[node], self.right[node])
            node = np.where(inner, child, node)
        return node


def grow(batch: Batch, x: Floats, y: Floats, rng: np.random.Generator) -> tuple[Trees, Bits]:
    """Return extremely randomised trees (Geurts et al. 2006), each grown without one fold of the visits.

    Args:
        batch: readings; of a robot, runs are dealt to folds.
        x: inputs, (n, d).
        y: what the leaves are to agree in, (n, k).
        rng: deals visits to folds, and draws thresholds.

    Returns:
        The trees, and whether each was grown on each ping, (n, t).
    """
    single, grown, drawn = x.astype(np.float32), [], []
    n_units = int(batch.unit.max()) + 1
    n_folds = min(N_FOLDS, n_units)
    for _ in range(N_DEALS):
        fold = rng.permutation(np.arange(n_units) % n_folds)[batch.unit]
        for k in range(n_folds):
            used = fold != k if n_folds > 1 else fold == k
            seed = int(rng.integers(2**31))
            tree = ExtraTreeRegressor(min_samples_leaf=MIN_LEAF, max_features=1.0, random_state=seed)
            grown.append(tree.fit(single[used], y[used], check_input=False).tree_)
            drawn.append(used)
    return Trees.of(grown), np.stack(drawn, axis=1)
