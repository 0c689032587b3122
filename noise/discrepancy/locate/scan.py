"""A scan of regions for every respect in which readings disagree with a law, with one p-value for all it looked at.

Each aspect is a score of single readings that is zero on average under the law, whatever pings share inside a block;
regions are intervals of at most two condition features. A region's statistic is its sum of block scores over their
root sum of squares; the greatest over all regions and aspects is compared with the same after flipping the signs of
whole blocks at random (wild cluster bootstrap), which keeps the correlation inside blocks and between regions.

Where the law only stands for a simulation, a recording's scores are held against those of the simulation's own readings
in the same region: where the law errs, it errs for both.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from acquisition.arrays import Floats
from noise.discrepancy.locate.residuals import ASPECTS, Residuals
from noise.fitting.batch import Batch

ONE_SIDED = ("early", "late", "repeat")  # fewer strays than expected only says that the scatter was fitted too wide
# what may change from day to day; how much of it is a mismatch, its size tells
OF_THE_DAY = np.array([aspect in ("spread", "skew", "time_correlation", "repeat") for aspect in ASPECTS])
FLIPS = 1000
LEAST_BLOCKS = 6
STEADY = 0.05  # share by which intervals between pings may vary and still be one pace; ours
MM, DEG = 1e-3, np.pi / 180.0


def features(batch: Batch) -> dict[str, Floats]:
    """Return the condition columns that vary, in their own units, (n,) each."""
    ping = batch.ping
    table = {
        "distance_mm": ping.distance / MM,
        "angle_deg": ping.angle / DEG,
        "incidence_deg": ping.incidence / DEG,
        "reflectance": ping.reflectance,
        "time_s": ping.time,
        **ping.covariates,
    }
    if np.allclose(ping.incidence, ping.angle):
        del table["incidence_deg"]
    if not batch.timed:
        del table["time_s"]
    within = table.get("interval_s", np.zeros(len(batch)))[batch.count > 0]
    if len(within) and np.ptp(np.quantile(within, [0.05, 0.95])) < STEADY * np.median(within):
        table.pop("interval_s", None)  # one steady pace: how long a move took is no condition
    return {name: value for name, value in table.items() if np.ptp(value) > 1e-6 * np.abs(value).max()}


def _intervals(value: Floats, bins: int) -> list[tuple[float, float, NDArray[np.bool_]]]:
    """Return (low, high, mask) of all intervals between quantile edges, the whole range included."""
    edges = np.unique(np.quantile(value, np.linspace(0, 1, bins + 1)))
    out = []
    for i, j in combinations(range(len(edges)), 2):
        inside = (value >= edges[i]) & ((value < edges[j]) | (j == len(edges) - 1))
        out.append((float(edges[i]), float(edges[j]), inside & (value <= edges[j])))
    return out


Region = tuple[dict[str, tuple[float, float]], NDArray[np.bool_]]


def regions(batch: Batch, most_features: int = 6) -> list[Region]:
    """Return regions as (limits by column, mask over blocks): everything, intervals, and pairs of intervals."""
    columns = dict(list(by_block(batch).items())[:most_features])
    out: list[Region] = [({}, np.ones(batch.n_visits, dtype=bool))]
    for name, value in columns.items():
        out += [({name: (low, high)}, mask) for low, high, mask in _intervals(value, 6) if not mask.all()]
    for one, two in combinations(columns, 2):
        for low, high, mask in _intervals(columns[one], 4):
            for low2, high2, mask2 in _intervals(columns[two], 4):
                if not mask.all() and not mask2.all():
                    out.append(({one: (low, high), two: (low2, high2)}, mask & mask2))
    return [region for region in out if region[1].sum() >= min(LEAST_BLOCKS, batch.n_visits)]


def by_block(batch: Batch) -> dict[str, Floats]:
    """Return the means of condition features over blocks, (blocks,) each."""
    size = batch.visit_sums(np.ones(len(batch)))
    return {name: batch.visit_sums(value) / size for name, value in features(batch).items()}


@dataclass(frozen=True)
class Blocks:
    """Readings as a law sees them, block by block.

    Attributes:
        seen: residuals under the law.
        batch: what they are of.
    """

    seen: Residuals
    batch: Batch

    @cached_property
    def score(self) -> Floats:
        """Scores of blocks, (blocks, aspects)."""
        return self.batch.visit_sums(self.seen.score)

    @cached_property
    def least(self) -> Floats:
        """Variance below which no block's score is trusted to vary, (blocks, aspects)."""
        return self.batch.visit_sums(self.seen.variance)

    @cached_property
    def pings(self) -> Floats:
        """Number of pings in each block, (blocks,)."""
        return self.batch.visit_sums(np.ones(len(self.batch)))

    @cached_property
    def columns(self) -> dict[str, Floats]:
        """Condition features, means of each block, (blocks,) each."""
        return by_block(self.batch)

    def inside(self, limits: dict[str, tuple[float, float]]) -> NDArray[np.bool_]:
        """Tell which blocks lie in a region; times, and what was not varied, are no bounds, (blocks,)."""
        inside = np.ones(len(self.pings), dtype=bool)
        for name, (low, high) in limits.items():
            if name in self.columns and name != "time_s":
                inside &= (self.columns[name] >= low) & (self.columns[name] <= high)
        return inside


@dataclass(frozen=True)
class Scan:
    """All statistics of one scan.

    Attributes:
        statistic: of every region and aspect, (regions, aspects).
        highest: greatest statistic of each aspect after each random flip, (flips, aspects).
        where: the regions.
    """

    statistic: Floats
    highest: Floats
    where: list[Region]

    def p_value(self, statistic: float) -> float:
        """Return the family-wise p-value of a statistic."""
        return float((1 + np.sum(self.highest.max(axis=1) >= statistic)) / (1 + len(self.highest)))

    @property
    def best(self) -> float:
        """The greatest statistic."""
        return float(np.abs(self.statistic).max(initial=0.0))

    @property
    def lasting(self) -> Scan:
        """The scan of what does not change from day to day alone."""
        return Scan(self.statistic[:, ~OF_THE_DAY], self.highest[:, ~OF_THE_DAY], self.where)


def scan(seen: Residuals, batch: Batch, rng: np.random.Generator, peer: Blocks | None = None) -> Scan:
    """Scan all regions for every aspect.

    A statistic is studentised by its blocks, but never by less than independent pings would vary: where an event of
    small probability did not happen, all blocks agree and their own scatter would be nothing.

    Args:
        seen: residuals under a law.
        batch: what they are of.
        rng: for the flips.
        peer: the readings of the simulation that the law stands for; regions are then held against them.
    """
    one_sided = np.array([aspect in ONE_SIDED for aspect in ASPECTS])
    own, where = Blocks(seen, batch), regions(batch)
    score, least, weight = own.score, own.least, np.stack([mask for _, mask in where]).astype(np.float64)
    if peer is not None:
        score, least, weight, where = _against(own, peer, where)
    scanned = flipped(score, least, where, rng, one_sided, weight)
    return replace(scanned, statistic=np.where(one_sided, np.maximum(scanned.statistic, 0.0), scanned.statistic))


def _against(own: Blocks, peer: Blocks, where: list[Region]) -> tuple[Floats, Floats, Floats, list[Region]]:
    """Return scores and their least variances, a simulation's after the recording's, and weights: means less means.

    Regions in which the simulation has too few blocks are left out.
    """
    usual = peer.score.sum(axis=0) / peer.pings.sum()
    score = np.concatenate([one.score - usual * one.pings[:, None] for one in (own, peer)])
    kept = [(region, inside) for region in where if (inside := peer.inside(region[0])).sum() >= LEAST_BLOCKS]
    kept = kept or [(where[0], np.ones(len(peer.pings), dtype=bool))]
    weight = np.stack(
        [np.concatenate([mask / (mask @ own.pings), inside / -(inside @ peer.pings)]) for (_, mask), inside in kept]
    )
    return score, np.concatenate([own.least, peer.least]), weight, [region for region, _ in kept]


def flipped(
    by_block: Floats,
    least: Floats,
    where: list[Region],
    rng: np.random.Generator,
    one_sided: NDArray[np.bool_] | None = None,
    weight: Floats | None = None,
) -> Scan:
    """Return weighted sums of block scores, studentised, and the greatest after each flip of blocks' signs.

    Args:
        by_block: scores, (blocks, aspects).
        least: variance below which no block's score is trusted to vary, (blocks, aspects).
        where: regions.
        rng: for the flips.
        one_sided: aspects of which only a positive sum counts, (aspects,).
        weight: of each block in each region, (regions, blocks); 1 inside where there is none.
    """
    one_sided = np.zeros(by_block.shape[1], dtype=bool) if one_sided is None else one_sided
    weight = np.stack([mask for _, mask in where]).astype(np.float64) if weight is None else weight
    root = np.sqrt(np.maximum(weight**2 @ by_block**2, weight**2 @ least)) + 1e-9 * weight.max(axis=1, keepdims=True)
    highest = np.empty((FLIPS, by_block.shape[1]))
    for k in range(FLIPS):
        sign = rng.integers(0, 2, len(by_block)) * 2.0 - 1.0
        highest[k] = _two_sided((weight @ (by_block * sign[:, None])) / root, one_sided).max(axis=0)
    return Scan((weight @ by_block) / root, highest, where)


def _two_sided(statistic: Floats, one_sided: NDArray[np.bool_]) -> Floats:
    return np.where(one_sided, statistic, np.abs(statistic))
