"""Regressors of the test: indicators of intervals and boxes of conditions, time and history.

A column is divided into bins; its regressors are all unions of adjacent bins, so that the sums of all regressors follow
from the sums of the bins.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from itertools import combinations

import numpy as np

from acquisition.arrays import Bits, Floats, Ints
from noise.discrepancy.moments.sample import Sample, condition_columns, is_continuous, movement
from noise.fitting.batch import Batch

N_BINS = 8  # of a condition: at quantiles of the recording
N_TIME_BINS = 16
N_PAIR_BINS = 4  # of each side of a box
MAX_RUNS = 12  # runs that are tested one by one
N_PERIODS = 12  # longest resolvable periods, T/2, T/3, ... of a record of length T
MIN_CYCLES = 2  # a period is resolvable if the record holds so many of it, and it at least two readings


class Form(StrEnum):
    """How a regressor enters: by what it depends on, and in which files it exists."""

    CONDITION = "condition"  # a function of the shared conditions
    SHARED = "shared"  # exists in both files but is no function of the conditions
    RECORDED = "recorded"  # exists in the recording only


@dataclass(frozen=True)
class Regressor:
    """A function of a ping: the indicator of a region, or a harmonic of time.

    Attributes:
        columns: names of its columns; () is everywhere.
        region: column -> (low, high), SI units and rad, infinite where open.
        phase_of_s: period of a harmonic, s; 0 for an indicator.
    """

    columns: tuple[str, ...]
    region: tuple[tuple[str, float, float], ...] = ()
    phase_of_s: float = 0.0

    @property
    def n_edges(self) -> int:
        """Number of finite edges: the complexity of a region."""
        return sum(int(np.isfinite(low)) + int(np.isfinite(high)) for _, low, high in self.region)


@dataclass(frozen=True, eq=False)
class Column:
    """Bins of one column, or of a pair, and the regressors that are made of them.

    Attributes:
        form: how it enters.
        base: weight of each bin at each ping as bin index, (n,); -1 for none.
        n_bins: number of bins.
        combine: regressors as sums of bins, (bins, regressors).
        regressors: their descriptions.
        factor: multiplies the indicator, (n,); None for 1.
        span: smallest and greatest value of each column in the recording.
    """

    form: Form
    base: Ints
    n_bins: int
    combine: Floats
    regressors: tuple[Regressor, ...]
    factor: Floats | None = None
    span: Mapping[str, tuple[float, float]] = field(default_factory=dict)


def columns_of(sample: Sample) -> list[Column]:
    """Return all columns of a sample."""
    recorded = sample.is_recorded
    found = [_everywhere(len(recorded))]
    conditions = dict(sample.conditions)
    if "angle" in conditions and conditions["angle"].min() < 0 < conditions["angle"].max():
        conditions["abs_angle"] = np.abs(conditions["angle"])
    for name, value in conditions.items():
        found += _binned(name, value, recorded, N_BINS, Form.CONDITION)
    angle = "abs_angle" if "abs_angle" in conditions else "angle"
    for pair in (("distance", angle), ("distance", "reflectance"), (angle, "reflectance")):
        if all(name in conditions for name in pair):
            found += _boxes(pair, conditions, recorded)
    return found + _histories(sample) + _runs(sample) + _recorded_only(sample)


def _everywhere(n: int) -> Column:
    return Column(Form.CONDITION, np.zeros(n, dtype=np.int64), 1, np.ones((1, 1)), (Regressor(()),))


def _edges(value: Floats, n_bins: int) -> Floats:
    """Return inner edges of bins at quantiles, halfway between neighbouring values where these are few."""
    unique = np.unique(value)
    if len(unique) <= n_bins:
        return (unique[1:] + unique[:-1]) / 2.0
    edges = np.unique(np.quantile(value, np.arange(1, n_bins) / n_bins))
    return edges[(edges > unique[0]) & (edges <= unique[-1])]


def _intervals(edges: Floats) -> list[tuple[int, int]]:
    """Return first and one past the last bin of each union of adjacent bins, except the whole."""
    return [pair for pair in combinations(range(len(edges) + 2), 2) if pair != (0, len(edges) + 1)]


def _bounds(edges: Floats) -> Floats:
    return np.r_[-np.inf, edges, np.inf]


def _indicator(pairs: list[tuple[int, int]], n_bins: int) -> Floats:
    number = np.arange(n_bins)[:, None]
    low, high = np.array(pairs).T
    return ((number >= low) & (number < high)).astype(np.float64)


def _binned(name: str, value: Floats, rows: Bits, n_bins: int, form: Form) -> list[Column]:
    """Return the column of a quantity with bins at quantiles of the given rows; none where it is constant."""
    known = rows & np.isfinite(value)
    edges = _edges(value[known], n_bins) if known.any() else np.empty(0)
    if not len(edges):
        return []
    pairs, bound = _intervals(edges), _bounds(edges)
    regressors = tuple(Regressor((name,), ((name, bound[i], bound[j]),)) for i, j in pairs)
    base = np.where(np.isfinite(value), np.searchsorted(edges, value, side="right"), -1)
    return [
        Column(
            form, base, len(edges) + 1, _indicator(pairs, len(edges) + 1), regressors, span={name: _span(value[known])}
        )
    ]


def _boxes(pair: tuple[str, str], conditions: dict[str, Floats], rows: Bits) -> list[Column]:
    """Return the column of boxes in two conditions."""
    values = [conditions[name] for name in pair]
    edges = [_edges(value[rows], N_PAIR_BINS) for value in values]
    if not all(len(e) for e in edges):
        return []
    sides = [_intervals(e) for e in edges]
    bins = [np.searchsorted(e, value, side="right") for e, value in zip(edges, values, strict=True)]
    n_bins = [len(e) + 1 for e in edges]
    combine = np.asarray(np.kron(_indicator(sides[0], n_bins[0]), _indicator(sides[1], n_bins[1])), dtype=np.float64)
    bounds = [_bounds(e) for e in edges]
    regressors = tuple(
        Regressor(pair, ((pair[0], bounds[0][a], bounds[0][b]), (pair[1], bounds[1][c], bounds[1][d])))
        for a, b in sides[0]
        for c, d in sides[1]
    )
    base, span = bins[0] * n_bins[1] + bins[1], {name: _span(conditions[name][rows]) for name in pair}
    return [Column(Form.CONDITION, base, n_bins[0] * n_bins[1], combine, regressors, span=span)]


def _span(value: Floats) -> tuple[float, float]:
    return float(value.min()), float(value.max())


def _histories(sample: Sample) -> list[Column]:
    """Return columns of time, order in the visit, the previous reading and movement, which both files have.

    They are compared between the files, since two files of one sensor may follow the same temperature.
    """
    rows, found = sample.is_recorded, []
    if all(batch.timed for batch in sample.batches):
        time = np.concatenate([batch.ping.time for batch in sample.batches])
        found += _binned("time", time, rows, N_TIME_BINS, Form.SHARED)
        interval = np.concatenate([_interval_s(batch) for batch in sample.batches])
        found += _binned("interval_s", np.round(interval, 6), rows, N_PAIR_BINS, Form.SHARED)
        found += _phases(sample)
    if not any(is_continuous(batch) for batch in sample.batches):  # the pieces of a continuous log begin anywhere
        order = np.concatenate([octave(batch.count) for batch in sample.batches])
        found += _binned("order", order, rows, N_BINS, Form.SHARED)
    past = np.concatenate([previous_place(batch) for batch in sample.batches])
    found += _binned("previous_reading", past, rows, N_PAIR_BINS, Form.SHARED)
    move = np.concatenate([since_echo(batch) for batch in sample.batches])
    return found + _binned("movement", move, rows, N_PAIR_BINS, Form.SHARED)


def _interval_s(batch: Batch) -> Floats:
    """Return the time since the previous ping of the visit, s, (n,); nan for the first."""
    return np.where(batch.count > 0, np.diff(batch.ping.time, prepend=np.nan), np.nan)


def octave(count: Floats | Ints) -> Floats:
    """Return the least number of earlier pings with which each ping is tested: 0, 1, 3, 7, ..., (n,)."""
    return np.asarray(2.0 ** np.floor(np.log2(1.0 + count)) - 1.0)


def previous_place(batch: Batch) -> Floats:
    """Return what the previous reading of the run was, (n,); nan at the start of a run.

    -2: no echo; -1: before the present target; 0: at it; 1: behind it. Finer bins would select pings by their own
    error, since errors within a visit agree.
    """
    excess = batch.past.range - batch.ping.distance
    place = np.sign(excess) * (np.abs(excess) > batch.reach)
    return np.where(batch.past.echo, place, np.where(batch.past.answered, -2.0, np.nan))


def since_echo(batch: Batch) -> Floats:
    """Return the change of distance since the last echo of the run, m, (n,), 0 for a stationary target."""
    return movement(batch.ping.distance - batch.last[:, 1])


def _recorded_only(sample: Sample) -> list[Column]:
    """Return columns of logged quantities that only the recording has."""
    own, rows = sample.recorded, sample.is_recorded
    found = []
    for name, value in condition_columns(own).items():
        if name in own.ping.covariates and name not in condition_columns(sample.batches[-1]):
            found += _binned(name, _padded(value, rows), rows, N_BINS, Form.RECORDED)
    return found


def _padded(value: Floats, rows: Bits) -> Floats:
    """Return a column of the recording for all rows, nan in the simulation."""
    out = np.full(len(rows), np.nan)
    out[rows] = value
    return out


def _runs(sample: Sample) -> list[Column]:
    """Return the indicators of single runs, by their order in each file; none for one run or for many."""
    runs = [np.unique(batch.ping.run, return_inverse=True)[1] for batch in sample.batches]
    n = int(runs[0].max()) + 1
    if not 1 < n <= MAX_RUNS:
        return []
    run = np.concatenate(runs)
    regressors = tuple(Regressor(("run",), (("run", k, k),)) for k in range(n))
    return [Column(Form.SHARED, np.where(run < n, run, -1), n, np.eye(n), regressors)]


def _phases(sample: Sample) -> list[Column]:
    """Return harmonics of time, none shorter than two sampling intervals or longer than half the record."""
    own = sample.recorded.ping.time
    time = np.concatenate([batch.ping.time for batch in sample.batches])
    length, step = float(np.ptp(own)), np.diff(np.sort(own))
    shortest = 2.0 * float(np.median(step[step > 0])) if (step > 0).any() else np.inf
    periods = [length / k for k in range(MIN_CYCLES, MIN_CYCLES + N_PERIODS) if length / k >= shortest]
    base, one = np.zeros(len(time), dtype=np.int64), np.ones((1, 1))
    return [
        Column(Form.SHARED, base, 1, one, (Regressor(("time",), phase_of_s=period),), wave(2.0 * np.pi * time / period))
        for period in periods
        for wave in (np.sin, np.cos)
    ]
