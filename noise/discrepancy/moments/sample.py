"""A recording and a simulation side by side: their shared conditions, and clusters of dependent pings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import f as fisher
from scipy.stats import ks_2samp
from sklearn.linear_model import QuantileRegressor

from acquisition import Ping
from acquisition.arrays import Bits, Floats, Ints
from noise.discrepancy.moments.chains import Chains
from noise.fitting.batch import Batch
from noise.fitting.stack import Stack
from noise.model import ORDER
from noise.statistics import winsorised

MIN_CLUSTERS = 12  # fewer give no bootstrap
GEOMETRY = ("distance", "angle", "incidence", "reflectance")
DISTINCT = 0.5  # Kolmogorov-Smirnov distance of a condition, or of what preceded, from which files are not alike
STILL_M = 1e-3  # change of distance between pings below which a target is stationary
ROUNDING_M = 1e-9  # of logged distances
MIN_MOVED = 0.2  # share of a file among movements so great or so small, which m(x) does not allow for
MIN_OVERLAP = 0.05  # share of a file among comparable pings; with less there is nothing to compare
MIN_POSITIONS = 3  # with an error each, to tell whether they have one of their own
LEAST_VARIANCE = 1e-10  # m^2, of a mean error: visits may agree to a step of the register
FAR = 4.0  # standard errors from a fit of least absolute errors; chosen here
MAX_CLUSTERS = 1500  # more do not improve the variance estimates; neighbours in time are merged


@dataclass(frozen=True, eq=False)
class Sample:
    """Readings of both files; rows of all results are those of the recording followed by those of the simulation.

    Attributes:
        recorded: readings of the recording.
        simulated: readings of the simulation; None where the law of the simulation is known exactly.
        scored: scores that several tests share; see `scores_of_both`.
    """

    recorded: Batch
    simulated: Batch | None
    scored: list[Any] = field(default_factory=list)

    @classmethod
    def comparable(cls, recorded: Batch, simulated: Batch | None) -> Sample:
        """Return two files without pings before which the target moved as it hardly ever does in the other file.

        What a sonar keeps of an earlier reading shows where the target has moved. Of movements that one file alone has,
        nothing follows, unless the law of the simulation is known. Where most pings are such, all are compared.
        """
        if simulated is None:
            return cls(recorded, None)
        size = [np.abs(movement(batch.moved)) for batch in (recorded, simulated)]
        keep = [_overlaps(own, other) for own, other in (size, size[::-1])]
        if min(mask.mean() for mask in keep) < 0.5:
            return cls(recorded, simulated)
        return cls(recorded.select(keep[0]), simulated.select(keep[1]))

    @property
    def batches(self) -> tuple[Batch, ...]:
        """The files that there are, the recording first."""
        return (self.recorded,) if self.simulated is None else (self.recorded, self.simulated)

    @cached_property
    def follows_more(self) -> float:
        """By how much more often a recorded ping follows one of its own visit than a simulated one, -1 to 1.

        Rows of one file may be shuffled, or alternate between positions. What a sonar keeps of an earlier reading then
        shows otherwise, whether it keeps anything or not.
        """
        share = [float(batch.follows.mean()) for batch in self.batches]
        return share[0] - share[-1]

    @cached_property
    def is_recorded(self) -> Bits:
        """Whether each ping is the recording's, (n,)."""
        return np.arange(sum(len(batch) for batch in self.batches)) < len(self.recorded)

    @cached_property
    def conditions(self) -> dict[str, Floats]:
        """Conditions that both files log and that vary, by name, (n,) each."""
        tables = [condition_columns(batch) for batch in self.batches]
        shared = [name for name in tables[0] if all(name in table for table in tables)]
        both = {name: np.concatenate([table[name] for table in tables]) for name in shared}
        both = {name: value for name, value in both.items() if np.isfinite(value).all() and np.ptp(value) > 0}
        if "angle" in both and "incidence" in both and np.array_equal(np.abs(both["angle"]), np.abs(both["incidence"])):
            del both["incidence"]
        return both

    @cached_property
    def of_the_day(self) -> tuple[str, ...]:
        """Logged conditions, other than those of the target, that hardly overlap between the files.

        They are those of two days, such as the temperature of the air. Given them, the files cannot be compared at all.
        """
        logged = [name for name in self.conditions if name not in GEOMETRY]
        files = [(self.conditions[name][self.is_recorded], self.conditions[name][~self.is_recorded]) for name in logged]
        return tuple(
            n for n, each in zip(logged, files, strict=True) if len(each[1]) and ks_2samp(*each).statistic > DISTINCT
        )

    @cached_property
    def cluster(self) -> Ints:
        """Cluster of each ping, (n,).

        A cluster is the k-th visit of a condition in the recording with the k-th visit of the same condition in the
        simulation, so that an error of the nuisance functions at that condition cancels within the cluster. Where
        targets stay in place from visit to visit, all visits of a position are one cluster.
        """
        return self._clusters[0]

    @cached_property
    def chains(self) -> Chains:
        """Pieces of one continuous log, in time, or of what it holds of one position; other clusters by themselves."""
        return self._clusters[1]

    @cached_property
    def _clusters(self) -> tuple[Ints, Chains]:
        keys, chains, held = [], [], stay_in_place(self.batches)
        for k, batch in enumerate(self.batches):
            at, continuous = positions(batch), is_continuous(batch)
            chain = np.zeros(batch.n_visits) if continuous else np.arange(batch.n_visits)
            place = np.zeros_like(at) if moves(batch) else at
            chains.append(np.c_[np.full(batch.n_visits, k), chain, place])
            table = pd.DataFrame(at)
            nth = table.groupby(list(table.columns)).cumcount().to_numpy()
            if held:
                nth = np.zeros_like(nth)
            elif continuous:  # of this file alone
                at, nth = np.full_like(at, float(k)), np.arange(batch.n_visits)
            keys.append(np.c_[at, nth, batch.ping.time[batch.starts]])
        every = pd.DataFrame(np.concatenate(keys))
        by_visit = every.groupby([0, 1, 2, 3, 4], sort=False).ngroup().to_numpy().astype(np.int64)
        merged = _merged(by_visit, every[5].to_numpy())
        first = np.unique(merged, return_index=True)[1]
        label = np.unique(np.concatenate(chains), axis=0, return_inverse=True)[1].ravel()
        parts = zip(self._split(merged), self.batches, strict=True)
        cluster = np.concatenate([part[b.visit] for part, b in parts])
        return cluster, Chains.of(label[first], every[5].to_numpy()[first])

    def _split(self, by_visit: Ints) -> list[Ints]:
        return np.split(by_visit, np.cumsum([batch.n_visits for batch in self.batches])[:-1])

    def left_out(self, law: Stack) -> list[Ints]:
        """Return the part of the simulation's readings that judges each ping, for each file, (n,) each.

        It is the part to which the ping's cluster belongs, so that its law saw neither file there; clusters of the
        recording alone take turns.
        """
        if law.left_out is None or self.simulated is None:
            return [np.full(len(batch), -1) for batch in self.batches]
        own = law.left_out.of(self.simulated)
        by_cluster = np.arange(int(self.cluster.max()) + 1) % len(law.left_out.terms)
        by_cluster[self.cluster[~self.is_recorded]] = own
        return [by_cluster[self.cluster[self.is_recorded]], own]

    @cached_property
    def visit(self) -> Ints:
        """Visit of each ping, numbered through both files, (n,)."""
        start = np.cumsum([0, *(batch.n_visits for batch in self.batches)])
        return np.concatenate([batch.visit + k for batch, k in zip(self.batches, start[:-1], strict=True)])


def movement(change: Floats) -> Floats:
    """Return changes of distance, m, 0 for a stationary target, (n,)."""
    return np.where(np.abs(change) < STILL_M, 0.0, change)


def _overlaps(own: Floats, other: Floats) -> Bits:
    """Return which movements of a file, m, lie where the other has at least `MIN_MOVED` of those beyond, (n,)."""
    moved, others = np.sort(own[own > 0]), np.sort(other[other > 0])
    above = [len(each) - np.searchsorted(each, own - ROUNDING_M) for each in (moved, others)]
    below = [np.searchsorted(each, own + ROUNDING_M) for each in (moved, others)]
    return (own == 0) | np.all([b >= MIN_MOVED * (a + b) for a, b in (above, below)], axis=0)


def is_continuous(batch: Batch) -> bool:
    """Return whether visits are pieces of a log: of a moving robot, or of a target that stays in place.

    They are none in a survey that visits every position once.
    """
    if not np.array_equal(np.unique(batch.condition, return_inverse=True)[1].ravel(), batch.visit):
        return False
    at, ping = positions(batch), batch.ping
    still = all(np.array_equal(value, value[batch.first]) for value in (ping.distance, ping.angle))
    return not (still and len(np.unique(at, axis=0)) == len(at))


def moves(batch: Batch) -> bool:
    """Return whether a continuous log is that of a moving robot, and not of a target that stays in place."""
    return is_continuous(batch) and not bool(batch.stationary.all())


def places(ping: Ping) -> Floats:
    """Return distance, angle, incidence and reflectance of n pings, rounded, (n, 4)."""
    return np.asarray(np.round(np.stack([ping.distance, ping.angle, ping.incidence, ping.reflectance], axis=1), 6))


def positions(batch: Batch) -> Floats:
    """Return distance, angle, incidence and reflectance of each visit, (n_visits, 4)."""
    return places(batch.ping)[batch.starts]


def stay_in_place(batches: Sequence[Batch]) -> bool:
    """Return whether visits of one position share an error, as where a target is placed once for several series.

    What the sonar reads wrong at a position is no such error: both files have it. So the differences between the files
    at shared positions are looked at, or where these are too few, the errors of each file.
    """
    if any(map(moves, batches)):
        return False
    files = [_at_positions(batch) for batch in batches]
    again = sum(len(each) - each.index.nunique() for each in files)  # visits that tell of the scatter at a position
    if not again:
        return False
    by = [each.groupby(level=[*range(each.index.nlevels)]) for each in files]
    scatter = sum(float(((e - g.transform("mean")) ** 2).sum()) for e, g in zip(files, by, strict=True)) / again
    means, counts = [each.mean() for each in by], [each.size() for each in by]
    shared = means[0].index.intersection(means[-1].index)
    if len(batches) == 2 and len(shared) >= MIN_POSITIONS:
        difference = means[0][shared] - means[1][shared]
        return _scatter(difference, scatter * (1.0 / counts[0][shared] + 1.0 / counts[1][shared]), again)
    return any(_scatter(mean, scatter / count, again) for mean, count in zip(means, counts, strict=True))


def _at_positions(batch: Batch) -> pd.Series:
    """Return the mean error of each visit that is heard, m, by its position."""
    echo = batch.is_target(batch.error)
    count = np.bincount(batch.visit, echo)
    heard = count > 0
    mean = np.bincount(batch.visit, winsorised(np.where(echo, batch.error, 0.0)))[heard] / count[heard]
    return pd.Series(mean, index=pd.MultiIndex.from_arrays(list(positions(batch)[heard].T)))


def _scatter(error: pd.Series, variance: pd.Series, again: int) -> bool:
    """Return whether errors at positions, less a linear function of these, scatter more than their variance, at 5 %.

    Some positions may differ by much more: what is far from a fit of least absolute errors is left out, if it is less
    than half of all.

    Args:
        error: at each position, m.
        variance: of each error, m^2.
        again: degrees of freedom of the variance.
    """
    x = np.abs(np.array(error.index.to_list()))
    line = np.stack([np.ones(len(x)), *((c - c.mean()) / c.std() for c in x.T if np.ptp(c) > 0)], axis=1)
    free = len(x) - int(np.linalg.matrix_rank(line))
    if free < MIN_POSITIONS:
        return False
    weight = 1.0 / np.sqrt(np.maximum(variance.to_numpy(), LEAST_VARIANCE))
    line, value = weight[:, None] * line, weight * error.to_numpy()
    left = value - QuantileRegressor(alpha=0.0, fit_intercept=False).fit(line, value).predict(line)
    near = np.abs(left) < FAR
    if 2 * near.sum() < len(x):
        return True
    free -= int((~near).sum())
    return free > 0 and bool(fisher.sf(float((left[near] ** 2).sum()) / free, free, again) < 0.05)


def condition_columns(batch: Batch) -> dict[str, Floats]:
    """Return the logged conditions of a batch by name, SI units and rad, (n,) each; none hides one of the target."""
    ping = batch.ping
    own = {name: getattr(ping, name) for name in GEOMETRY}
    return {**own, **{name: ping.covariates[name] for name in logged_names(ping) if name != "interval_s"}}


def logged_names(ping: Ping) -> list[str]:
    """Return the names of logged columns other than those that follow from the pings, such as "distance"."""
    return [name for name in ping.covariates if name not in (*vars(ping), ORDER)]


def _merged(cluster: Ints, time: Floats) -> Ints:
    """Return clusters numbered by the time of their first visit, neighbours merged beyond `MAX_CLUSTERS`."""
    first = pd.Series(time).groupby(cluster).min().to_numpy()
    rank = np.empty(len(first), dtype=np.int64)
    rank[np.argsort(first, kind="stable")] = np.arange(len(first))
    return rank[cluster] * min(MAX_CLUSTERS, len(first)) // len(first)


def dependence(sample: Sample, scores: Floats, valid: Bits, cluster: Ints, chains: Chains, drifts: bool) -> Ints:
    """Return over how many neighbouring clusters the sums of each score are not independent, (k,).

    Two recordings of one sonar depend on their past alike, and what the recording alone keeps for some time is a
    difference. It is none in logs of a moving robot whose pose drifts, in each in its own way: these depend as the more
    dependent file does.

    Args:
        sample: readings.
        scores: of each ping under the law of its file, (n, k).
        valid: which pings have one, (n, k).
        cluster: of each ping, (n,).
        chains: of all clusters.
        drifts: whether the pose does, where everything moves.
    """
    if sample.simulated is None:
        return np.ones(scores.shape[1], dtype=np.int64)
    drifts = drifts and all(map(moves, sample.batches))
    files = [~sample.is_recorded, sample.is_recorded] if drifts else [~sample.is_recorded]
    each = [_bandwidths(sample, scores[f], valid[f], cluster[f], f, chains) for f in files]
    return np.asarray(np.max(each, axis=0))


def pose_drifts(sample: Sample, bias: Floats, valid: Bits, cluster: Ints, chains: Chains) -> bool:
    """Return whether the errors of range of a recording last longer than a cluster.

    Args:
        sample: readings.
        bias: score of each ping, (n,).
        valid: which pings have one, (n,).
        cluster: of each ping, (n,).
        chains: of all clusters.
    """
    own = sample.is_recorded
    return sample.simulated is not None and bool(
        _bandwidths(sample, bias[own, None], valid[own, None], cluster[own], own, chains)[0] > 1
    )


def _bandwidths(sample: Sample, scores: Floats, valid: Bits, cluster: Ints, file: Bits, chains: Chains) -> Ints:
    """Return the bandwidth of each score of one file, less a cubic of the conditions, (k,)."""
    size = np.maximum(np.bincount(cluster, minlength=chains.n), 1)
    x = [np.ones(chains.n)]
    for value in sample.conditions.values():
        z = np.bincount(cluster, ((value - value.mean()) / value.std())[file], chains.n) / size
        x += [z, z**2, z**3]
    basis, out = np.stack(x, axis=1), []
    for value, known in zip(scores.T, valid.T, strict=True):
        count = np.bincount(cluster, known, chains.n)
        mean, heard = np.bincount(cluster, value * known, chains.n) / np.maximum(count, 1.0), count > 0
        if heard.any():
            mean[heard] -= basis[heard] @ np.linalg.lstsq(basis[heard], mean[heard], rcond=None)[0]
        out.append(chains.bandwidth(mean, heard))
    return np.array(out)
