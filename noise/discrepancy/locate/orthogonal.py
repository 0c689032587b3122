"""The orthogonal test: does a recording differ from its law in a way that the simulation does not?

For ping i of the simulation (D = 0) or the recording (D = 1), with scores s that have mean zero under the law,

    s_i = g(x_i) + D_i delta(x_i, t_i, past_i) + noise,

where g, the error of the law that both files share, is a nuisance. With m(x) = P(D = 1 | x), the statistic of a
regressor phi is sum_i w_i (s_i - g(x_i)), where w = phi (D - m) - E[phi (D - m) | x] if both files have phi, and
w = phi D - E[phi D | x] if only the recording has it. It is Neyman-orthogonal: errors of g and of m enter as a product
(Chernozhukov et al. 2018, double/debiased machine learning). Statistics are divided by the root of the sum of squares
over clusters, or over sums of neighbours that depend on each other (see `chains`), and the maximum over regressors and
aspects is compared with its distribution under random signs of clusters (wild cluster bootstrap; Cameron, Gelbach and
Miller 2008; of dependent clusters, Shao 2010).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from acquisition.arrays import Bits, Floats, Ints, Singles
from noise.discrepancy.moments.bootstrap import exceeded, p_of_greatest, signs_of, studentised
from noise.discrepancy.moments.chains import Chains
from noise.discrepancy.moments.moments import Group, bin_sums, unbiased_moments
from noise.discrepancy.moments.nuisance import Basis, CrossFit, basis_of, folds_of, units_of
from noise.discrepancy.moments.regressors import Column, Form, Regressor, columns_of
from noise.discrepancy.moments.sample import MIN_OVERLAP, Sample, dependence, pose_drifts
from noise.discrepancy.moments.scores import ASPECTS, BIAS, Scores, scores_of_both
from noise.discrepancy.result import Aspect, PValue
from noise.effects.state import DETECTION_WIDTH_DB
from noise.fitting.stack import Stack

OVERLAP = (MIN_OVERLAP, 1.0 - MIN_OVERLAP)  # of m(x)
MIN_CLUSTERS = 8  # of a statistic: 2^7 distinct sign patterns allow p < 0.01
MIN_VARIANCE = 0.02  # of an indicator, whose score is divided by its standard deviation
RATES = (Aspect.DETECTION, Aspect.EARLY, Aspect.LATE)
INDICATORS = (*RATES, Aspect.REPEAT, Aspect.COINCIDENCE)

Only = Callable[[Regressor, Aspect], bool]


@dataclass(frozen=True, eq=False)
class Tested:
    """Result of the test; K regressors, A aspects, C clusters.

    Attributes:
        p_value: of the greatest |z|.
        z: studentised statistics, nan where too few clusters contribute, (A, K).
        best: aspect and index of the regressor with the greatest |z|; None where nothing can be tested.
        regressors: descriptions, K.
        overlap: share of the recording's pings with m(x) in `OVERLAP`.
        greatest: |z| of the most extreme statistic in each draw of the bootstrap, (draws,).
        scale: root of the sum of squares over clusters that each statistic is divided by, (A, K).
        length: number of neighbouring clusters that are not independent, (A,).
        groups, columns, units, cluster, chains: intermediate results for `locate` and `could_have_seen`.
    """

    p_value: PValue
    z: Floats
    best: tuple[Aspect, int] | None
    regressors: tuple[Regressor, ...]
    overlap: float
    greatest: Floats
    scale: Floats
    length: Ints
    groups: tuple[Group, ...]
    columns: tuple[Column, ...]
    units: Ints
    cluster: Ints
    chains: Chains

    def is_below(self, level: float) -> bool:
        """Return whether the p-value is below a level: the test finds a difference."""
        return self.p_value.value < level

    def p_of(self, z: float) -> PValue:
        """Return the p-value of a statistic, adjusted for the choice of regressor and aspect."""
        return PValue(
            exceeded(abs(z), self.greatest),
            len(self.greatest),
            len(self.regressors),
            int(np.sum(np.isfinite(self.z).any(axis=1))),
        )


def orthogonal_test(
    law_recorded: Stack,
    law_simulated: Stack,
    sample: Sample,
    rng: np.random.Generator,
    *,
    signs: Singles | None = None,
    only: Only | None = None,
) -> Tested:
    """Test whether the recording differs from its law in a way that the simulation does not.

    Args:
        law_recorded: law of the recording: the emulator or, to ask what is left, the corrected law.
        law_simulated: law that describes the simulation.
        sample: readings.
        rng: divides clusters into folds and draws signs.
        signs: of clusters in each draw of the bootstrap, if they are shared with another test, (draws, clusters).
        only: which (regressor, aspect) pairs are tested; all by default.
    """
    return compared(scores_of_both(law_recorded, law_simulated, sample), sample, rng, signs=signs, only=only)


def compared(
    scored: Scores,
    sample: Sample,
    rng: np.random.Generator,
    *,
    signs: Singles | None = None,
    only: Only | None = None,
) -> Tested:
    """Test whether the scores of the recording have another mean than those of the simulation.

    Args:
        scored: scores of both files, in the order of the sample.
        sample: readings.
        rng: divides clusters into folds and draws signs.
        signs: of clusters in each draw of the bootstrap, if they are shared with another test, (draws, clusters).
        only: which (regressor, aspect) pairs are tested; all by default.
    """
    contrast = contrast_of(scored, sample, rng)
    signs = signs_of(sample.cluster, rng) if signs is None else signs
    return _tested(contrast, signs, only)


@dataclass(frozen=True, eq=False)
class _Frame:
    """What all groups share: the scores of both files, columns, the unit of each ping, the first ping of each unit."""

    sample: Sample
    scored: Scores
    columns: list[Column]
    units: Ints
    first: Ints

    def sums(self, value: Floats) -> Floats:
        """Return sums over units, (units, ...)."""
        return np.asarray(np.add.reduceat(value, self.first, axis=0))


@dataclass(frozen=True, eq=False)
class Contrast:
    """The scores of both files less their nuisance functions.

    Attributes:
        frame: what all groups share.
        groups: aspects that exist for the same pings.
        overlap: share of the recording's pings with m(x) in `OVERLAP`.
    """

    frame: _Frame
    groups: list[Group]
    overlap: float

    @property
    def units(self) -> Ints:
        """Unit of each ping, (n,)."""
        return self.frame.units


def contrast_of(scored: Scores, sample: Sample, rng: np.random.Generator) -> Contrast:
    """Return the scores of both files less their nuisance functions.

    Args:
        scored: scores of both files, in the order of the sample.
        sample: readings.
        rng: divides clusters into folds.
    """
    columns = columns_of(sample)
    x = np.stack(list(sample.conditions.values()) or [np.zeros(len(sample.visit))], axis=1)
    level = np.clip(scored.level_db, -20.0, 20.0)  # beyond, detection is certain or impossible
    own = np.stack([level, np.exp(-0.5 * (level / DETECTION_WIDTH_DB) ** 2)], axis=1)
    units = units_of(sample.visit, np.concatenate([x, np.round(own, 3)], axis=1))
    first = np.unique(units, return_index=True)[1]
    frame = _Frame(sample, scored, columns, units, first)
    if sample.simulated is None:
        return Contrast(frame, [_known(frame, rows) for rows in _same_rows(scored.valid)], 1.0)
    compared = [k for k, name in enumerate(sample.conditions) if name not in sample.of_the_day]
    shared = x[first][:, compared] if compared else np.zeros((len(first), 1))
    basis = basis_of(shared, own[first], sample.cluster[first], rng)
    folds = folds_of(sample.cluster[first], rng)
    fitted = [_fitted(frame, rows, basis, folds) for rows in _same_rows(scored.valid)]
    overlap = max(fitted, key=lambda each: int(each[0].valid.sum()))[1]
    return Contrast(frame, [group for group, _ in fitted], overlap)


def _same_rows(valid: Bits) -> list[Ints]:
    """Return the indices of aspects that are valid for the same pings, and for any."""
    which = np.unique(valid, axis=1, return_inverse=True)[1].ravel()
    return [np.flatnonzero((which == k) & valid.any(axis=0)) for k in np.unique(which[valid.any(axis=0)])]


def _known(frame: _Frame, aspects: Ints) -> Group:
    """Return the group of aspects where the law is known: g = 0 and every ping is the recording's."""
    ones = np.ones(len(frame.first))
    valid = frame.scored.valid[:, aspects[0]]
    weight = _weights(frame, aspects, np.zeros((len(frame.first), len(aspects))))
    residual = frame.scored.value[:, aspects] * weight
    expected = (None,) * len(frame.columns)
    return Group(
        aspects,
        valid,
        ones,
        ones,
        expected,
        residual,
        frame.scored.natural[:, aspects],
        weight,
        _unexpected(frame, aspects),
    )


def _unexpected(frame: _Frame, aspects: Ints) -> Bits:
    """Return where an indicator took its less likely value; True for valid scores of other aspects, (n, aspects)."""
    indicator = np.array([ASPECTS[a] in INDICATORS for a in aspects])
    return frame.scored.valid[:, aspects] & (~indicator | (np.abs(frame.scored.value[:, aspects]) > 0.5))


def _fitted(frame: _Frame, aspects: Ints, basis: Basis, folds: list[Ints]) -> tuple[Group, float]:
    """Return the group of aspects, with nuisance functions estimated on both files, and the overlap."""
    valid = frame.scored.valid[:, aspects[0]]
    count = frame.sums(valid.astype(np.float64))
    recorded = frame.sample.is_recorded[frame.first].astype(np.float64)
    on_conditions = CrossFit(basis.features[:, : basis.n_condition], count, folds, near=False)
    m = np.clip(on_conditions.predict((count * recorded)[:, None])[:, 0], 0.0, 1.0)
    inside = (m >= OVERLAP[0]) & (m <= OVERLAP[1])
    contrast = (recorded - m) * inside
    values = np.concatenate([frame.scored.value[:, aspects], frame.scored.natural[:, aspects]], axis=1)
    g = CrossFit(basis.features, count, folds, near=True).predict(frame.sums(values * valid[:, None]))
    k = len(aspects)
    weight = _weights(frame, aspects, g[:, :k])
    residual = (values - g[frame.units]) * valid[:, None]
    expected = _expected_weights(frame, valid, contrast, recorded * inside, on_conditions)
    own = count * recorded
    overlap = float((own * inside).sum() / max(own.sum(), 1.0))
    unexpected = _unexpected(frame, aspects)
    own_residual, natural = residual[:, :k] * weight, residual[:, k:]
    group = Group(aspects, valid, contrast, recorded, expected, own_residual, natural, weight, unexpected)
    return group, overlap


def _weights(frame: _Frame, aspects: Ints, g: Floats) -> Floats:
    """Return the inverse standard deviation of rates given the conditions, 1 for other scores, (n, aspects).

    Pings then have one variance in all regions, as `locate` expects, and as normal scores have.
    """
    out = np.ones((len(frame.units), len(aspects)))
    for j, a in enumerate(aspects):
        if ASPECTS[a] in RATES:
            rate = frame.scored.probability[frame.first, RATES.index(ASPECTS[a])] + g[:, j]
            out[:, j] = (np.maximum(rate * (1.0 - rate), MIN_VARIANCE) ** -0.5)[frame.units]
    return out


def _expected_weights(
    frame: _Frame, valid: Bits, contrast: Floats, recorded: Floats, fit: CrossFit
) -> tuple[Floats | None, ...]:
    """Return the cross-fitted conditional mean of the weight of each bin, None for functions of the conditions."""
    out: list[Floats | None] = []
    sums = []
    for column in frame.columns:
        if column.form is not Form.CONDITION:
            own = contrast if column.form is Form.SHARED else recorded
            sums.append(bin_sums(column, frame.units, valid * own[frame.units], len(frame.first)))
    predicted = fit.predict(np.concatenate(sums, axis=1)) if sums else np.empty((len(frame.first), 0))
    at = 0
    for column in frame.columns:
        if column.form is Form.CONDITION:
            out.append(None)
        else:
            out.append(predicted[:, at : at + column.n_bins])
            at += column.n_bins
    return tuple(out)


def _tested(contrast: Contrast, signs: Singles, only: Only | None) -> Tested:
    groups, frame, overlap = contrast.groups, contrast.frame, contrast.overlap
    columns, cluster, chains = tuple(frame.columns), frame.sample.cluster, frame.sample.chains
    value, valid = frame.scored.value, frame.scored.valid
    drifts = pose_drifts(frame.sample, value[:, BIAS], valid[:, BIAS], cluster, chains)
    length = dependence(frame.sample, value, valid, cluster, chains, drifts)
    regressors = tuple(r for column in columns for r in column.regressors)
    z, scale = np.full((2, len(ASPECTS), len(regressors)), np.nan)
    greatest = np.zeros((len(ASPECTS), len(signs)))
    # g and m do not depend on the conditions of the day, so that regions of these are not compared
    comparable = np.array([not set(r.columns) & set(frame.sample.of_the_day) for r in regressors])
    for group in groups:
        psi, own = unbiased_moments(group, columns, frame.units, cluster, group.residual)
        for j, a in enumerate(group.aspects):
            allowed = np.array([only is None or only(r, ASPECTS[a]) for r in regressors])
            allowed &= comparable
            allowed &= _clusters_with(columns, cluster, group.unexpected[:, j]) >= MIN_CLUSTERS
            z[a], scale[a], scaled = studentised(psi[:, :, j], allowed, chains, int(length[a]), own[:, :, j])
            if scaled.shape[1]:
                greatest[a] = np.abs(signs @ scaled).max(axis=1)
    return _result(z, scale, length, greatest, groups, frame, overlap)


def _clusters_with(columns: tuple[Column, ...], cluster: Ints, event: Bits) -> Floats:
    """Return the number of clusters with an event in the region of each regressor, (regressors,).

    Without events the residuals of an indicator are the errors of g alone, which are no evidence.
    """
    n, counts = int(cluster.max()) + 1, []
    for column in columns:
        counts.append(
            (bin_sums(column, cluster, event.astype(np.float64), n, absolute=True) @ column.combine > 0).sum(axis=0)
        )
    return np.concatenate(counts)


def _result(
    z: Floats, scale: Floats, length: Ints, greatest: Floats, groups: list[Group], frame: _Frame, overlap: float
) -> Tested:
    regressors = tuple(r for column in frame.columns for r in column.regressors)
    most = greatest.max(axis=0)
    best = None
    if np.isfinite(z).any():
        a, k = np.unravel_index(np.nanargmax(np.abs(z)), z.shape)
        best = (ASPECTS[a], int(k))
    count = int(np.isfinite(z).any(axis=1).sum())
    p_value = replace(p_of_greatest(z, most, len(regressors)), n_aspects=count)
    groups_, columns = tuple(groups), tuple(frame.columns)
    units, cluster, chains = frame.units, frame.sample.cluster, frame.sample.chains
    return Tested(p_value, z, best, regressors, overlap, most, scale, length, groups_, columns, units, cluster, chains)
