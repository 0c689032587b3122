"""Readings of a simulation, or of a recording, as a law: a quantile regression forest between its own conditions.

Meinshausen (2006), Quantile Regression Forests: a ping has the errors of the pings that share its leaves. Every tree
leaves out one fold of the visits, so that the trees without a visit predict it as if it had not been recorded.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy.sparse import csr_matrix

from acquisition import ModelError, Ping, Reading
from acquisition.arrays import Bits, Floats, Ints
from acquisition.brief import brief
from noise.discrepancy.baseline.forest_law import N_LEVELS, QuantileLaw, quantiles
from noise.discrepancy.baseline.trees import Trees, columns, grow, input_groups
from noise.fitting.batch import Batch
from noise.fitting.smooth import MEMORY
from noise.fitting.visit_effects import FLOOR
from noise.law import EchoLaw
from noise.metrics import crps_with_silence
from noise.model import MAX_RANGE

MAX_PINGS = 4000  # of the forest, thinned by visit; bounds time and the size of the file
N_TIMES = 8  # that stand for all recorded times
TIME = "time"
MAX_VALUES = 4_000_000  # computed at once; bounds the memory
INTEGERS, NUMBERS = ("root", "feature", "left", "right"), ("threshold",)


@dataclass(frozen=True, eq=False)
class AnalogueForest:
    """A sonar that reads what it read under similar conditions and after a similar past, at the same errors.

    Attributes:
        names: inputs.
        times: first and last recorded time, s. What follows the clock is unknown at others: such a ping may be at any
            recorded time.
        typical: medians of the inputs, which stand for covariates that were not logged, (d,).
        trees: over the inputs.
        leaf: of each stored reading in each tree, -1 where the tree was grown without it, (m, t).
        error: of each stored reading, m, ascending, infinite for no echo, (m,).
        resolution, max_range: of the register, m.
    """

    __repr__ = brief

    names: tuple[str, ...]
    times: tuple[float, float]
    typical: Floats
    trees: Trees
    leaf: Ints
    error: Floats
    resolution: float
    max_range: float

    @classmethod
    def of(cls, batch: Batch, rng: np.random.Generator, max_range: float = MAX_RANGE) -> AnalogueForest:
        """Return the law of readings, with the inputs that predict visits which trees have not seen.

        Args:
            batch: readings.
            rng: grows the trees.
            max_range: of the register's last step, m.
        """
        return grown(batch, rng, max_range).model

    @property
    def remembers(self) -> bool:
        """Whether the previous reading is an input."""
        return any(name in MEMORY for name in self.names)

    def law(self, ping: Ping, past: Reading | None = None) -> QuantileLaw:
        """Return the law of n pings, given the previous reading of each; a ping alone is the first of its visit."""
        x = columns(self.names, ping, past, dict(zip(self.names, self.typical.tolist(), strict=True)))
        reached = self.trees.leaves(x)
        other = (ping.time < self.times[0]) | (ping.time > self.times[1])
        if TIME in self.names and other.any():
            reached = np.tile(reached, N_TIMES)
            reached[other] = self._at_any_time(x[other])
        return self.mixture(ping, reached, np.ones(reached.shape, dtype=bool))

    def _at_any_time(self, x: Floats) -> Ints:
        """Return the leaves of inputs, (n, d), at times all over the record, (n, `N_TIMES` t)."""
        leaves = []
        for time in np.linspace(*self.times, N_TIMES):
            x[:, self.names.index(TIME)] = time
            leaves.append(self.trees.leaves(x))
        return np.concatenate(leaves, axis=1)

    def mixture(self, ping: Ping, reached: Ints, used: Bits) -> QuantileLaw:
        """Return the law of n pings with given leaves, (n, t), and trees, (n, t)."""
        n, m, n_trees = len(ping), len(self.leaf), reached.shape[1]
        stored = self.leaf >= 0
        size = np.bincount(self.leaf[stored], minlength=len(self.trees.feature))
        shape = len(size)
        row, at = np.nonzero(stored)[0], self.leaf[stored]
        members = csr_matrix((1.0 / size[at], (at, row)), shape=(shape, m))
        of_ping = np.repeat(np.arange(n), n_trees)[used.ravel()]
        each = np.repeat(1.0 / used.sum(axis=1), used.sum(axis=1))
        chosen = csr_matrix((each, (of_ping, reached[used])), shape=(n, shape))
        p_echo, centre, n_echo = np.empty(n), np.empty((n, N_LEVELS)), int(np.isfinite(self.error).sum())
        rows = max(1, MAX_VALUES // m)
        for k in range(0, n, rows):
            weight = (chosen[k : k + rows] @ members).toarray()[:, :n_echo]
            p_echo[k : k + rows] = weight.sum(axis=1)
            centre[k : k + rows] = quantiles(weight, self.error[:n_echo])
        knots = np.maximum(ping.distance[:, None] + centre, self.resolution)
        return QuantileLaw(ping, np.minimum(p_echo, 1.0), knots, self.resolution, self.max_range)

    def to_dict(self) -> dict[str, object]:
        """Return the model as plain data; errors of readings without an echo are null."""
        error = [x if np.isfinite(x) else None for x in self.error.tolist()]
        trees = {name: getattr(self.trees, name).tolist() for name in (*INTEGERS, *NUMBERS)}
        base = {"kind": "forest", "resolution": self.resolution, "max_range": self.max_range}
        own = {
            "names": list(self.names),
            "times": list(self.times),
            "typical": self.typical.tolist(),
            "leaf": self.leaf.tolist(),
            "error": error,
        }
        return {**base, **own, "trees": trees}

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> AnalogueForest:
        """Return the model that `to_dict` describes.

        Raises:
            ModelError: a part is missing or does not fit the others.
        """
        try:
            given = data["trees"]
            integers = {name: np.asarray(given[name], dtype=np.int64) for name in INTEGERS}
            trees = Trees(**integers, threshold=np.asarray(given["threshold"], dtype=np.float64))
            error = np.array([np.inf if x is None else float(x) for x in data["error"]])
            names, typical = tuple(map(str, data["names"])), np.asarray(data["typical"], dtype=np.float64)
            first, last = map(float, data["times"])
            leaf, limits = np.asarray(data["leaf"], dtype=np.int64), (data["resolution"], data["max_range"])
            model = cls(names, (first, last), typical, trees, leaf, error, *map(float, limits))
            _check(model)
        except (KeyError, TypeError, ValueError) as problem:
            raise ModelError(f"model: cannot be built from its parts ({problem}); it may be damaged") from None
        return model


def _check(model: AnalogueForest) -> None:
    """Check that the parts of a forest fit each other.

    Raises:
        ValueError: they do not.
    """
    trees, n = model.trees, len(model.trees.feature)
    if not (n and {each.shape for each in (trees.feature, trees.threshold, trees.left, trees.right)} == {(n,)}):
        raise ValueError("the nodes of its trees differ in number")
    inner, node = trees.feature >= 0, np.arange(n)
    children = np.stack([trees.left, trees.right])[:, inner]
    if not ((children > node[inner]) & (children < n)).all() or not (trees.feature < len(model.names)).all():
        raise ValueError("a node leads to none below it")
    if trees.root.ndim != 1 or not len(trees.root) or not ((trees.root >= 0) & (trees.root < n)).all():
        raise ValueError("a tree has no root")
    if model.leaf.shape != (len(model.error), len(trees.root)) or not len(model.error):
        raise ValueError("its readings and leaves differ in number")
    stored = model.leaf[model.leaf >= 0]
    empty = ~inner & (np.bincount(stored[stored < n], minlength=n) == 0)
    if (stored >= n).any() or inner[stored].any() or empty.any():
        raise ValueError("a reading is in no leaf, or a leaf holds no reading")
    numbers = np.r_[model.times, model.typical, trees.threshold, model.resolution, model.max_range]
    if model.typical.shape != (len(model.names),) or not np.isfinite(numbers).all() or np.isnan(model.error).any():
        raise ValueError("a value is missing or not finite")
    if min(model.resolution, model.max_range) <= 0.0 or (np.diff(model.error[np.isfinite(model.error)]) < 0).any():
        raise ValueError("its register or its errors are not valid")


@dataclass(frozen=True, eq=False)
class Grown:
    """A forest, its readings, and their law by the trees that were grown without their visits."""

    model: AnalogueForest
    batch: Batch
    crossed: EchoLaw

    @cached_property
    def crps(self) -> Floats:
        """CRPS of each reading, silence counted, by trees that saw no ping of its visit, m, (n,)."""
        return np.asarray(crps_with_silence(self.crossed, self.batch.reading, MAX_RANGE))

    @cached_property
    def nats(self) -> Floats:
        """Log probability of each reading by trees that saw no ping of its visit, nats, (n,), with a floor."""
        return floored_log_prob(self.crossed, self.batch)


def _grown(batch: Batch, names: tuple[str, ...], rng: np.random.Generator, max_range: float) -> Grown:
    x = columns(names, batch.ping, batch.past, {})
    trees, drawn = grow(batch, x, rng)
    reached = trees.leaves(x)
    error = np.where(batch.reading.echo, batch.error, np.inf)
    order = np.argsort(error, kind="stable")
    leaf = np.where(drawn, reached, -1)[order]
    typical = np.median(x, axis=0)
    times = float(batch.ping.time.min()), float(batch.ping.time.max())
    model = AnalogueForest(names, times, typical, trees, leaf, error[order], batch.resolution, max_range)
    # with a single visit every tree was grown on it, and it can only be predicted from itself
    return Grown(model, batch, model.mixture(batch.ping, reached, ~drawn if batch.n_visits > 1 else drawn))


def grown(batch: Batch, rng: np.random.Generator, max_range: float = MAX_RANGE) -> Grown:
    """Return the forest of at most `MAX_PINGS` readings with the inputs that predict visits best which trees lack."""
    few = batch.thin(MAX_PINGS)
    return min((_grown(few, names, rng, max_range) for names in input_groups(few)), key=lambda each: each.crps.mean())


def floored_log_prob(law: EchoLaw, batch: Batch) -> Floats:
    """Return the log probability of each reading, nats, (n,), with a floor for what a law calls impossible."""
    steps = max(law.last_step, 1)
    coarser = np.log(steps * batch.resolution / law.max_range) if batch.reading.echo.any() else 0.0
    nats = law.log_prob(batch.reading) + np.where(batch.reading.echo, min(coarser, 0.0), 0.0)
    floor = np.where(batch.reading.echo, FLOOR / steps, FLOOR)
    return np.log((1.0 - 2.0 * FLOOR) * np.exp(nats) + floor)
