"""Cross-fitted conditional means by ridge regression on splines and radial functions of the conditions.

The means are those of the scores, g(x), and of the indicator of the recording, m(x) = P(D = 1 | x). Folds consist of
whole clusters. All outcomes share the Gram matrices of the folds, and each outcome has its own ridge strength, chosen
by cross-validation over the same folds.

With the same training data for g and m, the error of g at one cluster depends on the noise of another exactly where
the error of m depends on its D, and vice versa, so that products of both do not average out: the variance of a
statistic exceeds its estimate by a share of about four effective parameters per cluster. The folds are therefore
arranged in a circle: g is estimated on the near folds and m on the far ones (Newey and Robins 2018, double
cross-fitting), a symmetric relation under which no pair of clusters contributes to both.

Pings of one visit under one condition enter as one row, a *unit*, with weights.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from acquisition.arrays import Floats, Ints

N_FOLDS = 10
N_NEAR = 3  # folds at so many steps or fewer on the circle estimate g, 6 of 10; the others estimate m, 3 of 10
N_KNOTS = 8  # of the piecewise linear spline of each condition
MAX_CENTRES = 96  # of radial functions; more cost time and changed no result on 133,100 pings
CLUSTERS_PER_CENTRE = 4
SCALES = (0.35, 0.8)  # of radial functions, in standard deviations of a condition: fine and coarse
RIDGES = 10.0 ** np.arange(2.0, -7.0, -1.0)  # strengths per unit weight that cross-validation chooses from
GRID = 1e-7  # conditions are equal within this share of their range


def units_of(visit: Ints, x: Floats) -> Ints:
    """Return the unit of each ping: one visit under unchanged x; rows of a visit are adjacent, (n,)."""
    tolerance = GRID * np.maximum(np.ptp(x, axis=0), 1e-12)
    new = (np.diff(visit) != 0) | np.any(np.abs(np.diff(x, axis=0)) > tolerance, axis=1)
    return np.r_[0, np.cumsum(new)].astype(np.int64)


@dataclass(frozen=True, eq=False)
class Basis:
    """Features of conditions, and further features that only the means of scores use.

    Attributes:
        features: (units, p); the first `n_condition` columns depend on the conditions alone.
        n_condition: number of features of the conditions.
    """

    features: Floats
    n_condition: int


def basis_of(x: Floats, law: Floats, cluster: Ints, rng: np.random.Generator) -> Basis:
    """Return the features of units.

    Args:
        x: conditions, (units, d).
        law: level above the threshold, dB, and slope of the detection probability there under the law, (units, 2).
        cluster: cluster of each unit, (units,).
        rng: draws the centres of radial functions.
    """
    z = (x - x.mean(axis=0)) / np.maximum(x.std(axis=0), 1e-12)
    splines = [_hats(column) for column in z.T]
    n_centres = min(MAX_CENTRES, len(np.unique(cluster)) // CLUSTERS_PER_CENTRE)
    centres = z[rng.choice(len(z), size=min(n_centres, len(z)), replace=False)]
    radial = [_radial(z, part, SCALES[k] * np.sqrt(z.shape[1])) for k, part in enumerate(np.array_split(centres, 2))]
    own = [np.ones((len(z), 1)), *splines, *radial]
    slope = law[:, 1:]
    level = _hats(law[:, 0])
    with_law = [level, *(level * column[:, None] for column in z.T), slope, *(slope * part for part in splines)]
    features = np.concatenate([*own, *with_law], axis=1)
    return Basis(features, sum(part.shape[1] for part in own))


def _hats(value: Floats) -> Floats:
    """Return the piecewise linear B-splines with knots at quantiles, (n, knots)."""
    knots = np.unique(np.quantile(value, np.linspace(0.0, 1.0, N_KNOTS)))
    if len(knots) < 2 or np.ptp(knots) < 1e-9:
        return np.empty((len(value), 0))
    return np.stack([np.interp(value, knots, row) for row in np.eye(len(knots))], axis=1)


def _radial(z: Floats, centres: Floats, scale: float) -> Floats:
    distance = (z**2).sum(1)[:, None] - 2.0 * z @ centres.T + (centres**2).sum(1)
    return np.exp(-0.5 * np.maximum(distance, 0.0) / scale**2)


def folds_of(cluster: Ints, rng: np.random.Generator) -> list[Ints]:
    """Return the rows of each fold; clusters are divided at random."""
    n = int(cluster.max()) + 1
    fold = (rng.permutation(n) % min(N_FOLDS, n))[cluster]
    return [np.flatnonzero(fold == k) for k in range(min(N_FOLDS, n))]


class CrossFit:
    """Ridge regressions, one for each fold, trained on the near or on the far folds, for any number of outcomes.

    Args:
        features: (units, p).
        weight: number of pings of each unit, (units,).
        folds: rows of each fold.
        near: whether to train on the near folds.
    """

    def __init__(self, features: Floats, weight: Floats, folds: list[Ints], near: bool) -> None:
        self.features, self.weight, self.folds = features, weight, folds
        self.total = max(float(weight.sum()), 1.0)
        self.used = _training_folds(len(folds), near)
        self.grams = np.stack([self._gram(rows) for rows in folds])
        self.solved = [np.linalg.eigh(self.grams[used].sum(axis=0)) for used in self.used]

    def _gram(self, rows: Ints) -> Floats:
        scaled = self.features[rows] * np.sqrt(self.weight[rows])[:, None]
        return scaled.T @ scaled

    def predict(self, sums: Floats) -> Floats:
        """Return the cross-fitted mean of each outcome at each unit, (units, k), given sums over units, (units, k)."""
        mean = sums.sum(axis=0) / self.total
        centred = sums - self.weight[:, None] * mean
        parts = np.stack([self.features[rows].T @ centred[rows] for rows in self.folds])
        candidates = [self._solutions(k, parts[used].sum(axis=0)) for k, used in enumerate(self.used)]
        loss = np.sum([_loss(c, self.grams[k], parts[k]) for k, c in enumerate(candidates)], axis=0)
        best = np.argmin(loss, axis=0)
        out = np.empty_like(centred)
        for rows, candidate in zip(self.folds, candidates, strict=True):
            out[rows] = self.features[rows] @ candidate[best, :, np.arange(len(best))].T
        return out + mean

    def _solutions(self, fold: int, moment: Floats) -> Floats:
        """Return coefficients for each ridge strength, (ridges, p, k)."""
        value, vector = self.solved[fold]
        rotated = vector.T @ moment
        shrunk = rotated / (np.maximum(value, 0.0) + RIDGES[:, None] * self.total)[:, :, None]
        return np.asarray(vector @ shrunk)


def _training_folds(n: int, near: bool) -> list[Ints]:
    """Return the folds that each fold is predicted from; all others where there are too few for a circle."""
    number = np.arange(n)
    steps = [np.minimum((number - k) % n, (k - number) % n) for k in range(n)]
    if n < N_FOLDS:
        return [np.flatnonzero(step > 0) for step in steps]
    return [np.flatnonzero((step > 0) & ((step <= N_NEAR) == near)) for step in steps]


def _loss(coefficients: Floats, gram: Floats, moment: Floats) -> Floats:
    """Return squared errors on a fold up to a constant, (ridges, k)."""
    fitted = (coefficients * (gram @ coefficients)).sum(axis=1)
    return fitted - 2.0 * (coefficients * moment).sum(axis=1)
