"""The empirical term: in what a recording differs from a simulation without a name, as functions of the ping.

For ping i of the simulation (D = 0) or the recording (D = 1), with what a law says of both and the error g(x) of that
law estimated and subtracted, as in the orthogonal test, the residual of a shift, a spread or a share of echoes is

    r_i = (D_i - m(x_i)) delta(x_i, t_i, past_i) + noise,  m(x) = P(D = 1 | x).

The function delta is found by gradient boosting of trees with squared loss on all these pings (the R-learner of Nie and
Wager 2021), so that what a law gets wrong of both files is no part of it. The number of trees is that of the least loss
on clusters that they lack, and a part that does not gain there beyond chance is left out.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import pandas as pd
from sklearn.ensemble import GradientBoostingRegressor

from acquisition import Ping, Reading
from acquisition.arrays import Floats, Ints
from noise.discrepancy.baseline.adjusted import (
    EARLY,
    GAINED,
    LATE,
    LOST,
    SHIFT,
    SPREAD,
    Adjusted,
    AdjustedLaw,
    Amounts,
    Boosted,
    Outliers,
)
from noise.discrepancy.baseline.trees import Trees, columns, input_groups
from noise.discrepancy.judge.held_out import beyond_chance
from noise.discrepancy.locate.orthogonal import MIN_VARIANCE, RATES, contrast_of
from noise.discrepancy.moments.sample import Sample
from noise.discrepancy.moments.scores import ASPECTS, LIMIT, scores_of_both
from noise.discrepancy.result import Aspect
from noise.fitting.batch import Batch
from noise.fitting.stack import Stack
from noise.model import SonarModel

MAX_PINGS = 4000  # of each file, thinned by visit; bounds the time
N_FOLDS = 5
N_TREES, RATE, DEPTH, MIN_LEAF = 30, 0.2, 2, 20  # most trees; step, depth and least pings of a leaf; chosen here
MIN_CONTRAST = 0.02  # smallest divisor
MIN_RATE = 0.01  # of echoes or of silence


@dataclass(frozen=True, eq=False)
class Learned:
    """A part of the term.

    Attributes:
        function: of a ping.
        cross_fitted: its value at each ping by trees that lack the ping's cluster, (n,).
        gain: in loss on such clusters, (clusters,).
    """

    function: Boosted
    cross_fitted: Floats
    gain: Floats


@dataclass(frozen=True, eq=False)
class CrossFittedModel:
    """A model with the term, for readings that it was learned from: as it is without their clusters.

    Attributes:
        model: the model.
        amount: of the term at each reading.
        outliers: of the term.
    """

    model: SonarModel
    amount: Amounts
    outliers: Mapping[str, Outliers]

    @property
    def resolution(self) -> float:
        """Step of the register, m."""
        return self.model.resolution

    @property
    def remembers(self) -> bool:
        """Whether the law depends on the previous reading, apart from the term."""
        return self.model.remembers

    def law(self, ping: Ping, past: Reading | None = None) -> AdjustedLaw:
        """Return the law of the pings of these readings, (n,)."""
        return AdjustedLaw(self.model.law(ping, past), self.amount, self.outliers)


@dataclass(frozen=True, eq=False)
class Term:
    """The empirical term.

    Attributes:
        parts: functions of a ping, by name.
        outliers: where echoes before and behind the target are, if they are parts.
        recorded, simulated: their values by trees that lack the cluster of a ping, by its row in each file.
    """

    parts: Mapping[str, Boosted]
    outliers: Mapping[str, Outliers]
    recorded: Mapping[str, pd.Series]
    simulated: Mapping[str, pd.Series]

    def on(self, model: SonarModel) -> Adjusted:
        """Return a model with the term."""
        return Adjusted(model, self.parts, self.outliers)

    def cross_fitted(self, model: SonarModel, batch: Batch, simulated: bool = False) -> CrossFittedModel:
        """Return a model with the term for readings of one of the files, as it is without their clusters."""
        amount, values = {}, self.simulated if simulated else self.recorded
        for name, part in self.parts.items():
            known = values[name].reindex(batch.row).to_numpy()
            amount[name] = np.where(np.isnan(known), part(batch.ping, batch.past), known)
        return CrossFittedModel(model, amount, self.outliers)


def term_of(recorded: Stack, simulated: Stack, sample: Sample, rng: np.random.Generator) -> Term | None:
    """Return the empirical term beside a law of the recording; None where nothing gains beyond chance.

    Args:
        recorded: law of the recording.
        simulated: law of the simulation.
        sample: readings of both files.
        rng: divides clusters into folds, and grows trees.
    """
    few = replace(sample, recorded=sample.recorded.thin(MAX_PINGS), scored=[])
    if few.simulated is not None:
        few = replace(few, simulated=few.simulated.thin(MAX_PINGS))
    found = Residuals(recorded, simulated, few, rng).parts()
    if not found:
        return None
    every = {name: _outliers(few.recorded, name) for name in (EARLY, LATE) if name in found}
    outliers = {name: each for name, each in every.items() if each is not None}
    found = {name: each for name, each in found.items() if name not in every or name in outliers}
    files = [
        {name: pd.Series(each.cross_fitted[rows], batch.row) for name, each in found.items()}
        for rows, batch in zip((few.is_recorded, ~few.is_recorded), few.batches, strict=False)
    ]
    return Term({name: each.function for name, each in found.items()}, outliers, files[0], files[-1])


class Residuals:
    """What is left of the scores of both files, and functions of a ping that explain it.

    Args:
        recorded: law of the recording.
        simulated: law of the simulation.
        sample: readings of both files.
        rng: divides clusters into folds, and grows trees.
    """

    def __init__(self, recorded: Stack, simulated: Stack, sample: Sample, rng: np.random.Generator) -> None:
        self.sample, self.rng = sample, rng
        self.scored = scores_of_both(recorded, simulated, sample)
        self.contrast = contrast_of(self.scored, sample, rng)
        self.label = _units(sample)
        n_units = int(self.label.max()) + 1
        self.n_folds = min(N_FOLDS, n_units)
        self.fold = rng.permutation(np.arange(n_units) % self.n_folds)[self.label]

    def parts(self) -> dict[str, Learned]:
        """Return the parts that gain beyond chance, by name."""
        shift = self._shift()
        shifts = shift is not None and beyond_chance(shift.gain)
        found = {SHIFT: shift, SPREAD: self._spread(shift if shifts else None)}
        found |= {EARLY: self._rate(Aspect.EARLY), LATE: self._rate(Aspect.LATE)}
        found |= self._echoes()
        return {name: each for name, each in found.items() if each is not None and beyond_chance(each.gain)}

    def _shift(self) -> Learned | None:
        known = self._residual(Aspect.BIAS)
        return None if known is None else self._learned(*known)

    def _spread(self, shift: Learned | None) -> Learned | None:
        """Return the spread about the shifted middle: a shift alone adds half its square to the score of the spread."""
        known = self._residual(Aspect.SPREAD)
        if known is None:
            return None
        residual, contrast, valid = known
        if shift is not None:
            residual = residual - contrast * 0.5 * np.clip(shift.cross_fitted / self.scored.sigma, -LIMIT, LIMIT) ** 2
        return self._learned(residual, contrast, valid)

    def _echoes(self) -> dict[str, Learned | None]:
        """Return the share of echoes that are lost where these are fewer, or else of silence that becomes an echo."""
        known = self._residual(Aspect.DETECTION)
        fewer = known is not None and float(known[0] @ (known[1] * known[2])) < 0.0
        return {LOST if fewer else GAINED: self._rate(Aspect.DETECTION, lost=fewer)}

    def _rate(self, aspect: Aspect, lost: bool = False) -> Learned | None:
        """Return the share of other pings that are so too, or of those that are which no longer are."""
        known = self._residual(aspect)
        if known is None or min(np.sum(self._is(aspect) == each) for each in (0.0, 1.0)) < MIN_LEAF:
            return None
        residual, contrast, valid = known
        rate = np.clip(self._is(aspect) - residual, MIN_RATE, 1.0 - MIN_RATE)
        weight = valid / np.maximum(rate * (1.0 - rate), MIN_VARIANCE)
        return self._learned(residual, contrast, weight, -rate if lost else 1.0 - rate)

    def _is(self, aspect: Aspect) -> Floats:
        """Return whether each ping has an echo, or one before or behind the target, (n,)."""
        a = ASPECTS.index(aspect)
        rate = self.scored.probability[:, RATES.index(aspect)]
        return np.where(self.scored.valid[:, a], np.rint(self.scored.value[:, a] + rate), 0.0)

    def _residual(self, aspect: Aspect) -> tuple[Floats, Floats, Floats] | None:
        """Return an aspect's residual in natural units, D - m(x), and where both exist, (n,) each."""
        a = ASPECTS.index(aspect)
        group = next((each for each in self.contrast.groups if a in each.aspects), None)
        if group is None:
            return None
        residual = group.natural[:, int(np.flatnonzero(group.aspects == a)[0])]
        return residual, group.contrast[self.contrast.units], group.valid.astype(np.float64)

    def _learned(
        self, residual: Floats, contrast: Floats, weight: Floats, factor: Floats | float = 1.0
    ) -> Learned | None:
        """Return the function of a ping, of some inputs, that has the least squared loss on clusters that trees lack.

        Args:
            residual: contrast x factor x function + noise, (n,).
            contrast: D - m(x), (n,).
            weight: inverse variance of the noise, up to a factor, (n,).
            factor: of the function, (n,).
        """
        both = np.where(np.abs(contrast) < MIN_CONTRAST, 0.0, contrast * factor)
        strength = weight * both**2
        target = np.divide(residual, both, out=np.zeros_like(residual), where=strength > 0.0)
        groups = input_groups(self.sample.recorded)
        shared = dict.fromkeys(tuple(name for name in names if name not in self.recorded_only) for names in groups)
        every = [self._boosted(names, target, strength) for names in shared if names]
        best = max((each for each in every if each), key=lambda each: each.gain.sum(), default=None)
        if not self.recorded_only:
            return best
        # of what the recording alone has, a condition tells its mean alone: r = k (delta - m E[delta | x]) where D = 1
        mean = np.zeros_like(residual) if best is None else best.cross_fitted
        strength = strength / np.maximum(contrast**2, MIN_CONTRAST**2) * self.sample.is_recorded
        target = np.divide(residual, factor) + (1.0 - contrast) * mean
        finer = self._boosted(groups[-1], target, strength)
        before = np.sum(strength * (target**2 - (target - mean) ** 2))
        return finer if finer is not None and finer.gain.sum() > before else best

    @cached_property
    def recorded_only(self) -> set[str]:
        """Columns that the recording alone logs."""
        return set(self.sample.recorded.ping.covariates) - set(self.sample.batches[-1].ping.covariates)

    def _boosted(self, names: tuple[str, ...], target: Floats, strength: Floats) -> Learned | None:
        """Return a function of inputs; None where no tree predicts clusters better that it lacks."""
        used = strength > 0.0
        if any((used & (self.fold != k)).sum() < 2 * MIN_LEAF for k in range(self.n_folds)):
            return None
        recorded, *simulated = self.sample.batches
        own = columns(names, recorded.ping, recorded.past, {})
        typical = dict(zip(names, np.median(own, axis=0).tolist(), strict=True))  # of what the recording alone has
        x = np.concatenate([own, *(columns(names, each.ping, each.past, typical) for each in simulated)])
        steps = np.zeros((N_TREES + 1, len(x)))
        for k in range(self.n_folds):
            grown, other = used & (self.fold != k), self.fold == k
            model = _boosting(N_TREES, self.rng).fit(x[grown], target[grown], sample_weight=strength[grown])
            steps[1:, other] = list(model.staged_predict(x[other]))
        loss = strength * (target - steps) ** 2
        best = int(loss.sum(axis=1).argmin())
        if best == 0:
            return None
        whole = _boosting(best, self.rng).fit(x[used], target[used], sample_weight=strength[used])
        gain = np.asarray(np.bincount(self.label, loss[0] - loss[best]), dtype=np.float64)
        return Learned(_function(whole, typical, recorded), steps[best], gain)


def _boosting(n_trees: int, rng: np.random.Generator) -> GradientBoostingRegressor:
    return GradientBoostingRegressor(
        init="zero",
        n_estimators=n_trees,
        learning_rate=RATE,
        max_depth=DEPTH,
        min_samples_leaf=MIN_LEAF,
        random_state=int(rng.integers(2**31)),
    )


def _function(grown: GradientBoostingRegressor, typical: Mapping[str, float], recorded: Batch) -> Boosted:
    """Return a sum of trees of scikit-learn, given the medians of its inputs, as a function of a ping."""
    trees = [each.tree_ for each in grown.estimators_[:, 0]]
    value = np.concatenate([np.where(each.children_left < 0, RATE * each.value[:, 0, 0], 0.0) for each in trees])
    times = float(recorded.ping.time.min()), float(recorded.ping.time.max())
    return Boosted(tuple(typical), times, np.array([*typical.values()]), Trees.of(trees), value)


def _outliers(recorded: Batch, name: str) -> Outliers | None:
    """Return where the echoes before or behind the target are; None where there is none."""
    error = recorded.error
    rows = recorded.is_outlier(error) & ((error < 0.0) if name == EARLY else (error > 0.0))
    return Outliers.of(recorded.reading.range[rows], recorded.ping.distance[rows]) if rows.any() else None


def _units(sample: Sample) -> Ints:
    """Return the independent unit of each ping, (n,): its cluster, or its run where pings of a run depend."""
    if not any(batch.by_run for batch in sample.batches):
        return sample.cluster
    start = np.cumsum([0, *(int(batch.unit.max()) + 1 for batch in sample.batches)])
    return np.concatenate([batch.unit + k for batch, k in zip(sample.batches, start[:-1], strict=True)])
