"""Leaves of trees over pings, and which stored readings were made under conditions like those of a ping.

These are the readings that share its leaves in many trees: Meinshausen (2006), Quantile Regression Forests. Every tree
leaves out one fold of the visits, so that the trees without a visit predict it as if it had not been recorded.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy.sparse import csr_array

from acquisition import Ping, Reading
from acquisition.arrays import Bits, Floats, Ints
from noise.discrepancy.baseline.trees import Trees, columns, grow
from noise.fitting.batch import Batch
from noise.fitting.smooth import MEMORY

N_TIMES = 8  # that stand for a part of the record
TIME = "time"
MAX_VALUES = 4_000_000  # computed at once; bounds the memory where all readings share a leaf
INTEGERS, NUMBERS = ("root", "feature", "left", "right"), ("threshold",)


@dataclass(frozen=True, eq=False)
class Leaves:
    """Trees over the inputs of a ping.

    Attributes:
        names: inputs.
        times: first and last recorded time, s. What follows the clock is unknown at others. It may change as much in
            the time since the record as in a part of it as long: such a ping may be at any time of this part, or of
            the record where that is shorter.
        typical: medians of the inputs, which stand for covariates that were not logged, (d,).
        trees: over the inputs.
    """

    names: tuple[str, ...]
    times: tuple[float, float]
    typical: Floats
    trees: Trees

    @property
    def remembers(self) -> bool:
        """Whether the previous reading is an input."""
        return any(name in MEMORY for name in self.names)

    def reached(self, ping: Ping, past: Reading | None) -> Ints:
        """Return the leaves of n pings in each tree, (n, t), or at `N_TIMES` recorded times, (n, `N_TIMES` t)."""
        x = columns(self.names, ping, past, dict(zip(self.names, self.typical.tolist(), strict=True)))
        reached = self.trees.leaves(x)
        other = (ping.time < self.times[0]) | (ping.time > self.times[1])
        if TIME in self.names and other.any():
            reached = np.tile(reached, N_TIMES)
            reached[other] = self._at_recorded_times(x[other], ping.time[other])
        return reached

    def _at_recorded_times(self, x: Floats, time: Floats) -> Ints:
        """Return the leaves of inputs, (n, d), at the recorded times nearest to others, (n,): (n, `N_TIMES` t)."""
        first, last = self.times
        nearest = np.clip(time, first, last)
        farthest = np.clip(2.0 * nearest - time, first, last)
        leaves = []
        for share in np.linspace(0.0, 1.0, N_TIMES):
            x[:, self.names.index(TIME)] = nearest + share * (farthest - nearest)
            leaves.append(self.trees.leaves(x))
        return np.concatenate(leaves, axis=1)

    def to_dict(self) -> dict[str, object]:
        """Return the trees and their inputs as plain data."""
        trees = {name: getattr(self.trees, name).tolist() for name in (*INTEGERS, *NUMBERS)}
        return {
            "names": list(self.names),
            "times": list(self.times),
            "typical": self.typical.tolist(),
            "trees": trees,
        }

    @staticmethod
    def given(data: dict[str, Any]) -> tuple[tuple[str, ...], tuple[float, float], Floats, Trees]:
        """Return the attributes that plain data describe.

        Raises:
            KeyError, TypeError, ValueError: a part is missing or does not fit the others.
        """
        given = data["trees"]
        integers = {name: np.asarray(given[name], dtype=np.int64) for name in INTEGERS}
        trees = Trees(**integers, threshold=np.asarray(given["threshold"], dtype=np.float64))
        first, last = map(float, data["times"])
        return tuple(map(str, data["names"])), (first, last), np.asarray(data["typical"], dtype=np.float64), trees

    def check(self) -> None:
        """Check that the parts fit each other.

        Raises:
            ValueError: they do not.
        """
        trees, n = self.trees, len(self.trees.feature)
        if not (n and {each.shape for each in (trees.feature, trees.threshold, trees.left, trees.right)} == {(n,)}):
            raise ValueError("the nodes of its trees differ in number")
        inner, node = trees.feature >= 0, np.arange(n)
        children = np.stack([trees.left, trees.right])[:, inner]
        if not ((children > node[inner]) & (children < n)).all() or not (trees.feature < len(self.names)).all():
            raise ValueError("a node leads to none below it")
        if trees.root.ndim != 1 or not len(trees.root) or not ((trees.root >= 0) & (trees.root < n)).all():
            raise ValueError("a tree has no root")
        if (
            self.typical.shape != (len(self.names),)
            or not np.isfinite(np.r_[self.times, self.typical, trees.threshold]).all()
        ):
            raise ValueError("a value is missing or not finite")


@dataclass(frozen=True, eq=False)
class Similarity(Leaves):
    """Weights of m stored readings for a ping: how often they share its leaf.

    Attributes:
        leaf: of each stored reading in each tree, -1 where the tree was grown without it, (m, t).
    """

    leaf: Ints

    def ordered(self, order: Ints) -> Similarity:
        """Return the same with the stored readings in another order."""
        return replace(self, leaf=self.leaf[order])

    def weights(self, reached: Ints, used: Bits | None = None) -> Iterator[tuple[slice, csr_array]]:
        """Yield rows of pings and the weights of the stored readings for them, (k, m), sorted, which sum to one.

        Args:
            reached: leaves of n pings, (n, t).
            used: whether a tree is asked for each ping, (n, t); every tree by default.
        """
        used = np.ones(reached.shape, dtype=bool) if used is None else used
        n, n_trees = reached.shape
        of_ping = np.repeat(np.arange(n), n_trees)[used.ravel()]
        each = np.repeat(1.0 / used.sum(axis=1), used.sum(axis=1))
        chosen = csr_array((each, (of_ping, reached[used])), shape=(n, len(self.trees.feature)))
        step = max(1, MAX_VALUES // len(self.leaf))
        for k in range(0, n, step):
            rows = chosen[k : k + step] @ self._members
            rows.sort_indices()
            yield slice(k, k + step), rows

    @cached_property
    def _members(self) -> csr_array:
        """Share of each stored reading in its leaf, (nodes, m)."""
        stored, shape = self.leaf >= 0, (len(self.trees.feature), len(self.leaf))
        size = np.bincount(self.leaf[stored], minlength=shape[0])
        return csr_array((1.0 / size[self.leaf[stored]], (self.leaf[stored], np.nonzero(stored)[0])), shape=shape)

    def to_dict(self) -> dict[str, object]:
        """Return the weights' rule as plain data."""
        return {**super().to_dict(), "leaf": self.leaf.tolist()}

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> Similarity:
        """Return what `to_dict` describes.

        Raises:
            KeyError, TypeError, ValueError: a part is missing or does not fit the others.
        """
        found = cls(*cls.given(data), np.asarray(data["leaf"], dtype=np.int64))
        found.check()
        return found

    def check(self) -> None:
        """Check that the parts fit each other.

        Raises:
            ValueError: they do not.
        """
        super().check()
        if self.leaf.ndim != 2 or not len(self.leaf) or self.leaf.shape[1] != len(self.trees.root):
            raise ValueError("its readings and leaves differ in number")
        inner, n = self.trees.feature >= 0, len(self.trees.feature)
        stored = self.leaf[self.leaf >= 0]
        empty = ~inner & (np.bincount(stored[stored < n], minlength=n) == 0)
        if (stored >= n).any() or inner[stored].any() or empty.any():
            raise ValueError("a reading is in no leaf, or a leaf holds no reading")


def similarity(
    batch: Batch, names: Sequence[str], y: Floats, rng: np.random.Generator
) -> tuple[Similarity, Ints, Bits]:
    """Return trees over the readings of a batch, the leaf of each, (n, t), and whether a tree was grown without it.

    Args:
        batch: readings.
        names: inputs.
        y: what the leaves are to agree in, (n, k).
        rng: grows the trees.
    """
    x = columns(names, batch.ping, batch.past, {})
    trees, drawn = grow(batch, x, y, rng)
    reached = trees.leaves(x)
    times = float(batch.ping.time.min()), float(batch.ping.time.max())
    found = Similarity(tuple(names), times, np.median(x, axis=0), trees, np.where(drawn, reached, -1))
    # where all were grown on one visit, it can only be predicted from itself
    return found, reached, drawn if drawn.all() else ~drawn
