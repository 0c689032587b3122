"""The wild cluster bootstrap of the greatest of many statistics, and of the least of the p-values of several tests."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from acquisition.arrays import Bits, Floats, Ints, Singles
from noise.discrepancy.moments.chains import Chains
from noise.discrepancy.result import Location, PValue, Visible

DRAWS = 2000
MIN_EFFECTIVE = 4.0  # clusters of equal size that its sum of squares is worth: no mismatch rests on one visit
LEAST_SUM = 1e-3  # root mean square of sums over clusters, scores being of order one; below, the register decides


@dataclass(frozen=True, eq=False)
class Greatest:
    """The greatest of the statistics of a test.

    Attributes:
        p_value: of the greatest |z|.
        draws: the greatest |z| in each draw of the bootstrap; empty where nothing could be tested.
    """

    p_value: PValue
    draws: Floats


@dataclass(frozen=True)
class Found:
    """Result of one test among others.

    Attributes:
        p_value: of the test.
        where: the located difference, if it rejects at `FALSE_ALARM`.
        visible: the least difference that is seen with a power of 90 %; None where that is not known.
    """

    p_value: PValue
    where: tuple[Location, ...] = ()
    visible: Visible | None = None


NOTHING = Found(PValue(1.0, 0, 0))


def signs_of(cluster: Ints, rng: np.random.Generator, draws: int = DRAWS) -> Singles:
    """Return a random sign of each cluster in each draw of the bootstrap, (draws, clusters)."""
    return (2.0 * rng.integers(0, 2, (draws, int(cluster.max()) + 1)) - 1.0).astype(np.float32)


def studentised(
    psi: Floats, allowed: Bits, chains: Chains | None = None, length: int = 1, unbiased: Floats | None = None
) -> tuple[Floats, Floats, Floats]:
    """Return z and scale of each regressor, z nan where too few clusters contribute, and scaled sums of the others.

    Args:
        psi: sums over clusters, (clusters, regressors).
        allowed: which regressors are tested, (regressors,).
        chains: of dependent clusters.
        length: number of neighbours in a chain that are not independent.
        unbiased: sums over clusters of which the squares are those of the variance, if not the same.
    """
    own = psi if unbiased is None else unbiased
    sums = own if chains is None else chains.sums(own, length)
    square = sums**2
    total = square.sum(axis=0)
    effective = total**2 / np.maximum((square**2).sum(axis=0), 1e-300) / length
    enough = allowed & (effective >= MIN_EFFECTIVE) & (total > LEAST_SUM**2 * len(psi))
    root = np.sqrt(total[enough])
    z = np.full(psi.shape[1], np.nan)
    z[enough] = psi[:, enough].sum(axis=0) / root
    return z, np.sqrt(total), (sums[:, enough] / root).astype(np.float32)


def leverage_factor(share: Floats) -> Floats:
    """Return 1 / sqrt(1 - h): residuals about a mean are too small where their cluster has a share h of it.

    With it, sums of squares over clusters are unbiased (HC2 of MacKinnon and White 1985; of clusters, Bell and
    McCaffrey 2002). A cluster that is a mean by itself has no residual, and the factor is 0.

    Args:
        share: of each cluster in each mean, from 0 to 1.
    """
    return np.where(share < 1.0, 1.0 / np.sqrt(np.maximum(1.0 - share, 1e-12)), 0.0)


def p_of_greatest(z: Floats, greatest: Floats, n_regressors: int) -> PValue:
    """Return the p-value of the greatest |z|, given the greatest in each draw under the null."""
    draws = len(greatest)
    if not np.isfinite(z).any():
        return PValue(1.0, draws, n_regressors, 1)
    return PValue(exceeded(float(np.nanmax(np.abs(z))), greatest), draws, n_regressors, 1)


def exceeded(z: float, greatest: Floats) -> float:
    """Return the share of draws in which the greatest |z| is at least a value, which counts as a draw itself."""
    return float((1 + np.sum(greatest >= z * (1 - 1e-6))) / (len(greatest) + 1))


def joint(*tests: Greatest) -> PValue:
    """Return the p-value of several tests of one hypothesis whose clusters have the same sign in the same draw.

    The least of their p-values is compared with that in each draw (Westfall and Young 1993, step 1). Tests that look
    at the same readings are alike, so that this is more powerful than Bonferroni's inequality.
    """
    run = [test for test in tests if len(test.draws)]
    if len(run) < 2:
        return (run or tests)[0].p_value
    least = np.min([_ranked(test.draws) for test in run], axis=0)
    value = float((1 + np.sum(least <= min(test.p_value.value for test in run))) / (len(least) + 1))
    each = [test.p_value for test in run]
    return PValue(value, len(least), sum(p.n_regressors for p in each), max(p.n_aspects for p in each))


def any_of(*tests: PValue) -> PValue:
    """Return the p-value of several tests of one hypothesis, 1 - (1 - p)^k of the smallest of k (Sidak 1967).

    It is exact for independent tests, and too large for those that tend to reject together.

    A test without a statistic, such as one of shared positions where there are none, is no test.
    """
    run = [each for each in tests if each.n_regressors] or list(tests)
    draws = (min((each.draws for each in run if each.draws), default=0) + 1) // len(run) - 1
    least = min(min(each.value for each in run), 1.0 - 1e-12)
    value = max(float(-np.expm1(len(run) * np.log1p(-least))), 1.0 / (draws + 1))
    return PValue(value, draws, sum(each.n_regressors for each in run), max(each.n_aspects for each in run))


def _ranked(draws: Floats) -> Floats:
    """Return the p-value that each draw would have, (draws,)."""
    return (len(draws) - np.searchsorted(np.sort(draws), draws * (1 - 1e-6))) / (len(draws) + 1)
