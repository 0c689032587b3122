"""Located mismatches: the most probable region of each aspect, with its size.

With z a significant statistic, studentised by a variance that all of them share, z^2 / 2 is the gain in log-likelihood
of a difference in a region. Each finite edge of a region is one more estimated number, so that the region with the
greatest z^2 - edges log(clusters) is the most probable one (Schwarz 1978, BIC). Further mismatches of the same aspect
count if they remain significant after the first is projected out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from acquisition.arrays import Floats, Ints
from noise.discrepancy.locate.orthogonal import Tested
from noise.discrepancy.moments.bootstrap import studentised
from noise.discrepancy.moments.moments import Group, bin_sums, one_weight, unbiased_moments
from noise.discrepancy.moments.regressors import Column, Regressor
from noise.discrepancy.moments.scores import ASPECTS
from noise.discrepancy.result import Aspect, Interval, Location, PValue, Range
from noise.discrepancy.thresholds import BIAS_TOLERANCE_M, FALSE_ALARM

TWO_SIDED = 1.645  # standard errors on either side of a 90 % interval
ORDER = {Aspect.SPREAD: 1, Aspect.REPEAT: 1, Aspect.MEMORY: 1, Aspect.SKEW: 2}  # of moments; 0 for all others
ROUNDING = 1e-9  # relative error of a sum over clusters
MAX_PER_ASPECT = 3  # located mismatches of one aspect; more are hardly distinct


@dataclass(frozen=True)
class _Found:
    """A significant regressor of an aspect: index, centred statistic, and adjusted p-value."""

    regressor: int
    strength: float
    p_value: PValue


def locate(tested: Tested) -> tuple[Location, ...]:
    """Return the located mismatches, the strongest first; empty where the test does not reject at `FALSE_ALARM`.

    Of those that no draw of the bootstrap reaches, a difference of lower order comes first, and with a bias that is
    certain and matters, spread and skew are left out: echoes that read long also look wider and lopsided.
    """
    out = []
    for group in tested.groups:
        for j, a in enumerate(group.aspects):
            for found in _steps(tested, group, j):
                place = location_of(tested, int(a), found.regressor, found.p_value)
                trifle = ASPECTS[a] is Aspect.BIAS and abs(place.size.value) < BIAS_TOLERANCE_M
                certain = found.p_value.at_end and not trifle
                order = -ORDER.get(ASPECTS[a], 0) if certain else -max(ORDER.values()) - 1
                out.append(((order, found.strength), place))
    places = tuple(location for _, location in sorted(out, key=lambda pair: pair[0], reverse=True))
    shifted = any(_shifts(each) for each in places)
    return tuple(each for each in places if not (shifted and each.aspect in (Aspect.SPREAD, Aspect.SKEW)))


def _shifts(place: Location) -> bool:
    """Return whether a mismatch is a bias that no draw of the bootstrap reaches and that matters."""
    certain = place.aspect is Aspect.BIAS and place.p_value.at_end
    return certain and abs(place.size.value) >= BIAS_TOLERANCE_M


def _steps(tested: Tested, group: Group, j: int) -> list[_Found]:
    """Return the significant regressors of the j-th aspect of a group, each after projecting out those before."""
    allowed = np.isfinite(tested.z[group.aspects[j]])
    found: list[_Found] = []
    residual = group.residual[:, j]
    while len(found) < MAX_PER_ASPECT and allowed.any():
        every = unbiased_moments(group, tested.columns, tested.units, tested.cluster, residual[:, None])
        psi, own = (each[:, :, 0] for each in every)
        z = studentised(psi, allowed, tested.chains, int(tested.length[group.aspects[j]]), own)[0]
        if np.isnan(z).all():
            break
        size = np.nan_to_num(np.abs(z))
        p_value = tested.p_of(float(size.max()))
        if p_value.value > FALSE_ALARM:
            break
        certain = size >= min(float(size.max()), float(np.quantile(tested.greatest, 1.0 - FALSE_ALARM)))
        k, strength = _most_probable(tested, group, j, psi, np.flatnonzero(certain))
        found.append(_Found(k, strength, p_value))
        weight = one_weight(group, tested.columns, tested.units, k)[0]
        residual = residual - weight * float(weight @ residual) / max(float(weight @ weight), 1e-300)
    return found


def _most_probable(tested: Tested, group: Group, j: int, psi: Floats, index: Ints) -> tuple[int, float]:
    """Return the most probable of some regressors, and its statistic by the variance that all share.

    A statistic that is studentised in its own region would prefer the one where clusters happen to agree.
    """
    psi, exposure = psi[:, index], _exposure(tested, group, j)[:, index]
    total = psi.sum(axis=0)
    centred = psi - total / np.where(exposure.sum(axis=0) == 0, 1.0, exposure.sum(axis=0)) * exposure
    sums = tested.chains.sums(centred, int(tested.length[group.aspects[j]]))
    weight = np.maximum(_squares(tested, group, j)[index], 1e-300)
    square = total**2 / weight
    variance = float(np.median((sums**2).sum(axis=0) / weight))
    gain = square / max(variance, ROUNDING * float(square.max()))  # all clusters may agree to rounding
    edges = np.array([complexity(tested.regressors[i]) for i in index])
    chosen = int(np.argmax(gain - edges * np.log(len(psi))))
    return int(index[chosen]), float(np.sqrt(gain[chosen]))


def _squares(tested: Tested, group: Group, j: int) -> Floats:
    """Return the sum of squared weights of each regressor, (regressors,)."""
    parts = []
    for column in tested.columns:
        weight = group.valid * group.plain_weight(column.form)[tested.units]
        own = weight**2 if column.factor is None else weight**2 * np.abs(column.factor)
        everything = np.zeros(len(own), dtype=np.int64)
        parts.append(bin_sums(column, everything, own, 1, absolute=True)[0] @ column.combine**2)
    return np.concatenate(parts)


def complexity(regressor: Regressor) -> int:
    """Return the number of edges of a region, which are estimated; a harmonic has a period and a phase."""
    return regressor.n_edges + 2 * int(regressor.phase_of_s > 0)


def _exposure(tested: Tested, group: Group, j: int) -> Floats:
    """Return the sum over each cluster that a difference of one would add to each statistic, (clusters, regressors)."""
    n = int(tested.cluster.max()) + 1
    own = group.valid * group.weight[:, j] * group.recorded[tested.units]
    parts = []
    for column in tested.columns:
        weight = own * group.plain_weight(column.form)[tested.units]
        parts.append(bin_sums(column, tested.cluster, weight, n, absolute=True) @ column.combine)
    return np.concatenate(parts, axis=1)


def group_of(tested: Tested, a: int) -> Group:
    """Return the group of an aspect."""
    return next(each for each in tested.groups if a in each.aspects)


def location_of(tested: Tested, a: int, k: int, p_value: PValue) -> Location:
    """Return the difference of an aspect in the region of a regressor."""
    group = group_of(tested, a)
    size = size_of(tested, group, int(np.flatnonzero(group.aspects == a)[0]), k)
    return Location(ASPECTS[a], region_of(tested.regressors[k], tested.columns), size, p_value)


def size_of(tested: Tested, group: Group, j: int, k: int) -> Interval:
    """Return the mean difference in a region in natural units, with a 90 % interval clustered by visit."""
    weight, phi = one_weight(group, tested.columns, tested.units, k)
    n = int(tested.cluster.max()) + 1
    exposure = np.bincount(tested.cluster, weight * phi * group.recorded[tested.units], n)
    psi = np.bincount(tested.cluster, weight * group.natural[:, j], n)
    total = exposure.sum()
    value = float(psi.sum() / total) if total != 0 else float("nan")
    left = tested.chains.sums((psi - value * exposure)[:, None], int(tested.length[group.aspects[j]]))
    error = float(np.sqrt((left**2).sum()) / abs(total)) if total != 0 else float("nan")
    unit = ASPECTS[group.aspects[j]].unit
    return Interval(value, value - TWO_SIDED * error, value + TWO_SIDED * error, unit)


def region_of(regressor: Regressor, columns: Sequence[Column]) -> dict[str, Range]:
    """Return the region of a regressor of some columns, open sides closed at the recording's extremes."""
    span = {name: both for column in columns for name, both in column.span.items()}
    if regressor.phase_of_s > 0:
        return {"period_s": (regressor.phase_of_s, regressor.phase_of_s)}
    out = {}
    for name, low, high in regressor.region:
        if name == "abs_angle" and low == -np.inf:
            name, low = "angle", -high
        ends = span.get(name, (low, high))
        out[name] = (float(max(low, ends[0])), float(min(high, ends[1])))
    return out
