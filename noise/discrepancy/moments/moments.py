"""Weights of regressors and their sums over clusters, given the nuisance functions of a group of aspects."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from acquisition.arrays import Bits, Floats, Ints
from noise.discrepancy.moments.regressors import Column, Form


@dataclass(frozen=True, eq=False)
class Group:
    """Aspects whose scores exist for the same pings, with what their statistics are made of.

    Attributes:
        aspects: indices into `ASPECTS`.
        valid: whether a ping has these scores, (n,).
        contrast: D - m(x), 0 where the files do not overlap, of each unit, (units,).
        recorded: D of each unit, (units,).
        expected: conditional mean of the weight of each bin, of each column; None where it is zero, (units, bins).
        residual: weighted score minus g(x), 0 where not valid, (n, aspects).
        natural: the same of the natural values, without weights, (n, aspects).
        weight: factor of the score in `residual`, (n, aspects).
        unexpected: where an indicator took its less likely value; everywhere for other scores, (n, aspects).
    """

    aspects: Ints
    valid: Bits
    contrast: Floats
    recorded: Floats
    expected: tuple[Floats | None, ...]
    residual: Floats
    natural: Floats
    weight: Floats
    unexpected: Bits

    def plain_weight(self, form: Form) -> Floats:
        """Return the factor of a regressor of a form before its conditional mean is subtracted, (units,)."""
        return self.recorded * (self.contrast != 0) if form is Form.RECORDED else self.contrast


def bin_sums(column: Column, label: Ints, value: Floats, n: int, absolute: bool = False) -> Floats:
    """Return sums of values over (label, bin), (n, bins); `absolute` ignores the sign of the column's factor."""
    known = column.base >= 0
    factor = value if column.factor is None else value * (np.abs(column.factor) if absolute else column.factor)
    flat = label[known] * column.n_bins + column.base[known]
    sums = np.bincount(flat, factor[known], n * column.n_bins)
    return np.asarray(sums.reshape(n, column.n_bins), dtype=np.float64)


def moments(group: Group, columns: Sequence[Column], units: Ints, cluster: Ints, value: Floats) -> Floats:
    """Return sums over clusters of the weight of each regressor times values.

    Args:
        group: aspects and their nuisance functions.
        columns: all columns.
        units: unit of each ping, (n,).
        cluster: cluster of each ping, (n,).
        value: values, 0 where not valid, (n, k).

    Returns:
        sums, (clusters, regressors, k).
    """
    n, first = int(cluster.max()) + 1, np.unique(units, return_index=True)[1]
    by_unit, at = np.add.reduceat(value, first, axis=0), cluster[first]
    out = []
    for column, expected in zip(columns, group.expected, strict=True):
        weight = group.plain_weight(column.form)[units]
        parts = [bin_sums(column, cluster, weight * part, n) for part in centred(column, group, value).T]
        if expected is not None:
            for j, part in enumerate(parts):
                product = expected * by_unit[:, j : j + 1]
                part -= np.stack([np.bincount(at, each, n) for each in product.T], axis=1)
        out.append(np.stack([part @ column.combine for part in parts], axis=2))
    return np.concatenate(out, axis=1)


def centred(column: Column, group: Group, value: Floats) -> Floats:
    """Return values less their mean in each bin of what both files have beside the conditions, (n, k).

    After a reading of another object, say, readings of both files may have another mean than g(x). Such readings may be
    more frequent in one file without a difference in what follows them.
    """
    if column.form is not Form.SHARED or column.factor is not None:
        return value
    rows = np.flatnonzero(group.valid & (column.base >= 0))
    at = column.base[rows]
    count = np.maximum(np.bincount(at, minlength=column.n_bins), 1)
    mean = np.stack([np.bincount(at, part[rows], column.n_bins) / count for part in value.T], axis=1)
    out = value.copy()
    out[rows] -= mean[at]
    return out


def one_weight(group: Group, columns: Sequence[Column], units: Ints, k: int) -> tuple[Floats, Floats]:
    """Return the weight and the value of regressor k at each ping, (n,) each."""
    for column, expected in zip(columns, group.expected, strict=True):  # noqa: B007
        if k < len(column.regressors):
            break
        k -= len(column.regressors)
    part = column.combine[:, k]
    phi = np.where(column.base >= 0, part[np.maximum(column.base, 0)], 0.0)
    phi = phi if column.factor is None else phi * column.factor
    weight = phi * group.plain_weight(column.form)[units]
    if expected is not None:
        weight = weight - (expected @ part)[units]
    return weight * group.valid, phi * group.valid
