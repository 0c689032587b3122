"""Weights of regressors and their sums over clusters, given the nuisance functions of a group of aspects."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from acquisition.arrays import Bits, Floats, Ints
from noise.discrepancy.moments.bootstrap import leverage_factor
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
    every = zip(columns, _in_bins(group, columns, units, cluster, value), strict=True)
    return np.concatenate([_of_regressors(column, sums, means) for column, (sums, means) in every], axis=1)


def unbiased_moments(
    group: Group, columns: Sequence[Column], units: Ints, cluster: Ints, value: Floats
) -> tuple[Floats, Floats]:
    """Return the sums of `moments`, and those of which the squares add up to the variance of the total.

    Where values are centred in bins, the residuals of a cluster are too small, by its share of the bin.
    """
    plain, unbiased = [], []
    for column, (sums, means) in zip(columns, _in_bins(group, columns, units, cluster, value), strict=True):
        plain.append(_of_regressors(column, sums, means))
        if is_centred(column):
            factor = _leverage_factor(column, group, cluster)
            unbiased.append(_of_regressors(column, [part * factor for part in sums], means))
        else:
            unbiased.append(plain[-1])
    return np.concatenate(plain, axis=1), np.concatenate(unbiased, axis=1)


def _in_bins(
    group: Group, columns: Sequence[Column], units: Ints, cluster: Ints, value: Floats
) -> Iterator[tuple[list[Floats], list[Floats]]]:
    """Yield the sums of each column over (cluster, bin), and what is expected of them, one array for each value."""
    n, first = int(cluster.max()) + 1, np.unique(units, return_index=True)[1]
    by_unit, at = np.add.reduceat(value, first, axis=0), cluster[first]
    for column, expected in zip(columns, group.expected, strict=True):
        weight = centred(column, group, group.plain_weight(column.form)[units][:, None])[:, 0]
        sums = [bin_sums(column, cluster, weight * part, n) for part in centred(column, group, value).T]
        yield sums, [] if expected is None else [_expected_sums(expected, part, at, n) for part in by_unit.T]


def _of_regressors(column: Column, sums: Sequence[Floats], means: Sequence[Floats]) -> Floats:
    """Return sums over bins, less their means if there are any, for each regressor, (clusters, regressors, k)."""
    left = [part - mean for part, mean in zip(sums, means, strict=True)] if means else sums
    return np.stack([part @ column.combine for part in left], axis=2)


def _expected_sums(expected: Floats, by_unit: Floats, cluster: Ints, n: int) -> Floats:
    """Return sums over clusters of the conditional mean of the weight of each bin times a value, (clusters, bins)."""
    return np.stack([np.bincount(cluster, each, n) for each in (expected * by_unit[:, None]).T], axis=1)


def centred(column: Column, group: Group, value: Floats) -> Floats:
    """Return values less their mean in each bin of what both files have beside the conditions, (n, k).

    After a reading of another object, say, readings of both files may have another mean than g(x). Such readings may be
    more frequent in one file without a difference in what follows them.
    """
    if not is_centred(column):
        return value
    rows = np.flatnonzero(group.valid & (column.base >= 0))
    at = column.base[rows]
    count = np.maximum(np.bincount(at, minlength=column.n_bins), 1)
    mean = np.stack([np.bincount(at, part[rows], column.n_bins) / count for part in value.T], axis=1)
    out = value.copy()
    out[rows] -= mean[at]
    return out


def is_centred(column: Column) -> bool:
    """Return whether values are compared within the bins of a column: of what both files have beside the conditions."""
    return column.form is Form.SHARED and column.factor is None


def _leverage_factor(column: Column, group: Group, cluster: Ints) -> Floats:
    """Return the factor of each cluster's residuals in each bin, (clusters, bins)."""
    count = bin_sums(column, cluster, group.valid.astype(np.float64), int(cluster.max()) + 1)
    return leverage_factor(count / np.maximum(count.sum(axis=0), 1.0))


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
