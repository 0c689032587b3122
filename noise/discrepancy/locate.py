"""Where and in which respect readings disagree with a law: a scan of regions, with one p-value for all it looked at.

Each aspect is a score of single readings that is zero on average under the law, whatever pings share inside a block;
regions are intervals of at most two condition features. A region's statistic is its sum of block scores over their
root sum of squares; the greatest over all regions and aspects is compared with the same after flipping the signs of
whole blocks at random (wild cluster bootstrap), which keeps the correlation inside blocks and between regions.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from noise.cells import Batch
from noise.discrepancy.residuals import ASPECTS, EXTRA, Residuals, residuals
from noise.law import Floats
from noise.stack import Stack

ONE_SIDED = ("early", "late", "repeat")  # fewer strays than expected only says that the scatter was fitted too wide
SHADOWS = ("spread", "skew", "time_correlation")  # a bias bends them wherever it changes: told of after it
LAST = 1e6
MORE = 1.3  # how much greater than a simulation's own a misfit must be to count; ours
FLIPS = 400
LEAST_BLOCKS = 6
STEADY = 0.05  # share by which intervals between pings may vary and still be one pace; ours
MM, DEG = 1e-3, np.pi / 180.0


@dataclass(frozen=True)
class Finding:
    """One place and respect in which readings disagree with a law.

    Attributes:
        aspect: one of "bias", "scale", "spread", "skew", "detection", "extra_mode", "time_correlation",
            "rhythm", "transient".
        region: condition column -> (low, high) in the column's unit; empty is everywhere.
        size: how much, in `unit`.
        unit: "m" for bias, "1" for shares, ratios and correlations.
        p_value: of the greatest statistic, all regions and aspects counted.
        nats: half the squared statistic: what correcting it would be worth.
        place: where an extra mode sits, as (what it follows, m): "fixed range", "beyond the target", "times distance";
            of a rhythm, ("period", s).
    """

    aspect: str
    region: dict[str, tuple[float, float]]
    size: float
    unit: str
    p_value: float
    nats: float
    place: tuple[str, float] | None = None


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
    starts = np.unique(batch.first)
    size = np.diff(np.r_[starts, len(batch)])
    columns = {k: np.add.reduceat(v, starts) / size for k, v in list(features(batch).items())[:most_features]}
    out: list[Region] = [({}, np.ones(len(starts), dtype=bool))]
    for name, value in columns.items():
        out += [({name: (low, high)}, mask) for low, high, mask in _intervals(value, 6) if not mask.all()]
    for one, two in combinations(columns, 2):
        for low, high, mask in _intervals(columns[one], 4):
            for low2, high2, mask2 in _intervals(columns[two], 4):
                if not mask.all() and not mask2.all():
                    out.append(({one: (low, high), two: (low2, high2)}, mask & mask2))
    return [region for region in out if region[1].sum() >= min(LEAST_BLOCKS, len(starts))]


@dataclass(frozen=True)
class Misfit:
    """How far a law is from the simulation that it stands for.

    Attributes:
        by_aspect: greatest statistic of a scan of the simulation's own readings, (aspects,).
        blocks: that it was fitted to: it errs as the means of so many do, which no flip of the recording's signs shows.
    """

    by_aspect: Floats
    blocks: int


@dataclass(frozen=True)
class Scan:
    """All statistics of one scan.

    Attributes:
        statistic: of every region and aspect, (regions, aspects).
        highest: greatest statistic after each random flip, (flips,).
        where: the regions.
    """

    statistic: Floats
    highest: Floats
    where: list[Region]

    def p_value(self, statistic: float) -> float:
        """Return the family-wise p-value of a statistic."""
        return float((1 + np.sum(self.highest >= statistic)) / (1 + len(self.highest)))

    @property
    def best(self) -> float:
        """The greatest statistic."""
        return float(np.abs(self.statistic).max(initial=0.0))

    @property
    def by_aspect(self) -> Floats:
        """The greatest statistic of each aspect, (aspects,)."""
        return np.abs(self.statistic).max(axis=0, initial=0.0)

    def beyond(self, known: Misfit | None, blocks: int) -> Scan:
        """Return the scan of so many blocks less what a law errs that stands for a simulation; itself, if none does."""
        if known is None:
            return self
        tempered = self.statistic / np.sqrt(1.0 + blocks / known.blocks)
        return replace(self, statistic=np.where(np.abs(tempered) > MORE * known.by_aspect, tempered, 0.0))


def scan(seen: Residuals, batch: Batch, rng: np.random.Generator) -> Scan:
    """Scan all regions for every aspect.

    A statistic is studentised by its blocks, but never by less than independent pings would vary: where an event of
    small probability did not happen, all blocks agree and their own scatter would be nothing.
    """
    one_sided = np.array([aspect in ONE_SIDED for aspect in ASPECTS])
    scanned = flipped(batch.per_block(seen.score), batch.per_block(seen.variance), regions(batch), rng, one_sided)
    return replace(scanned, statistic=np.where(one_sided, np.maximum(scanned.statistic, 0.0), scanned.statistic))


def flipped(
    by_block: Floats,
    least: Floats,
    where: list[Region],
    rng: np.random.Generator,
    one_sided: NDArray[np.bool_] | None = None,
) -> Scan:
    """Return sums of block scores over regions, studentised, and the greatest after each flip of blocks' signs.

    Args:
        by_block: scores, (blocks, aspects).
        least: variance below which no block's score is trusted to vary, (blocks, aspects).
        where: regions.
        rng: for the flips.
        one_sided: aspects of which only a positive sum counts, (aspects,).
    """
    one_sided = np.zeros(by_block.shape[1], dtype=bool) if one_sided is None else one_sided
    mask = np.stack([region[1] for region in where]).astype(np.float64)
    root = np.sqrt(np.maximum(mask @ by_block**2, mask @ least)) + 1e-9
    highest = np.empty(FLIPS)
    for k in range(FLIPS):
        sign = rng.integers(0, 2, len(by_block)) * 2.0 - 1.0
        highest[k] = _two_sided((mask @ (by_block * sign[:, None])) / root, one_sided).max()
    return Scan((mask @ by_block) / root, highest, where)


def _two_sided(statistic: Floats, one_sided: NDArray[np.bool_]) -> Floats:
    return np.where(one_sided, statistic, np.abs(statistic))


def locate(
    stack: Stack,
    batch: Batch,
    rng: np.random.Generator,
    most: int = 5,
    level: float = 0.05,
    known: Misfit | None = None,
) -> list[Finding]:
    """Return the findings of a scan under a level, strongest first, at most one an aspect.

    Args:
        stack: the law, its nuisances fitted.
        batch: readings.
        rng: for randomised PIT values and flips.
        most: number of findings.
        level: greatest p-value.
        known: how far the law is from the simulation itself; see `Scan.beyond`.
    """
    seen = residuals(stack, batch, rng)
    scanned = scan(seen, batch, rng).beyond(known, batch.blocks)
    out: list[Finding] = []
    shadow = np.array([aspect in SHADOWS for aspect in ASPECTS])
    for flat in np.argsort(np.where(shadow, LAST, 0.0) - np.abs(scanned.statistic), axis=None, kind="stable"):
        row, column = np.unravel_index(flat, scanned.statistic.shape)
        value = float(scanned.statistic[row, column])
        p = scanned.p_value(abs(value))
        if p > level or len(out) >= most:
            if not shadow[column] and len(out) < most:
                continue
            break
        aspect = _bias_or_scale(ASPECTS[column], scanned.where[row], seen, batch)
        finding = describe(aspect, scanned.where[row], seen, batch, p, value)
        if _family(finding.aspect) not in {_family(f.aspect) for f in out}:
            out.append(finding)
    return out


def _bias_or_scale(aspect: str, where: Region, seen: Residuals, batch: Batch) -> str:
    """Return which of the two leaves less over, block by block: the same error everywhere, or a share of distance."""
    rows = _typical(seen, batch, where[1][batch.block])
    if aspect not in ("bias", "scale") or rows.sum() < 4:
        return aspect
    block, distance = batch.block[rows], batch.ping.distance[rows]
    error = (batch.reading.range - seen.middle)[rows]
    count = np.maximum(np.bincount(block), 1)
    e, d = np.bincount(block, error) / count, np.bincount(block, distance) / count
    e, d = e[np.bincount(block) > 0], d[np.bincount(block) > 0]
    constant, share = np.median(e), np.median(e / np.maximum(d, 0.01))
    return "bias" if np.abs(e - constant).sum() <= np.abs(e - share * d).sum() else "scale"


def _family(aspect: str) -> str:
    """Return what an aspect is a shadow of: a bias also bends spread and skew wherever it changes."""
    return "bias" if aspect in ("bias", "scale", "spread", "skew") else aspect


def describe(aspect: str, where: Region, seen: Residuals, batch: Batch, p: float, statistic: float) -> Finding:
    """Return a finding with its size in plain units."""
    inside = where[1][batch.block]
    nats = statistic**2 / 2.0
    kind = {"early": "extra_mode", "late": "extra_mode", "repeat": "time_correlation"}.get(aspect, aspect)
    size, unit, place = _SIZES[kind](seen, batch, inside)
    return Finding(kind, where[0], size, unit, p, nats, place)


Size = tuple[float, str, tuple[str, float] | None]


def _typical(seen: Residuals, batch: Batch, inside: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Tell which echoes inside are near enough to the expected range to speak of bias."""
    return inside & batch.near(batch.reading.range - seen.middle)


def _bias(seen: Residuals, batch: Batch, inside: NDArray[np.bool_]) -> Size:
    rows = _typical(seen, batch, inside)
    return (float(np.median((batch.reading.range - seen.middle)[rows])) if rows.any() else 0.0), "m", None


def _scale(seen: Residuals, batch: Batch, inside: NDArray[np.bool_]) -> Size:
    rows = _typical(seen, batch, inside)
    if rows.sum() < 3:
        return 0.0, "1", None
    share = (batch.reading.range - seen.middle)[rows] / np.maximum(batch.ping.distance[rows], 0.01)
    return float(np.median(share)), "1", None


def _spread(seen: Residuals, batch: Batch, inside: NDArray[np.bool_]) -> Size:
    """Return the ratio of the scatter seen to the scatter expected, from the PIT's own quartiles."""
    u = seen.u[inside & ~np.isnan(seen.u)]
    if len(u) < 4:
        return 1.0, "1", None
    from scipy.special import ndtri

    quartile = ndtri(np.clip(np.quantile(u, [0.25, 0.75]), 1e-6, 1 - 1e-6))
    return float(np.ptp(quartile) / 1.3490), "1", None


def _skew(seen: Residuals, batch: Batch, inside: NDArray[np.bool_]) -> Size:
    u = seen.u[inside & ~np.isnan(seen.u)]
    return float(np.mean(u > 0.5) - 0.5) if len(u) else 0.0, "1", None


def _detection(seen: Residuals, batch: Batch, inside: NDArray[np.bool_]) -> Size:
    return float(np.mean(seen.silent[inside]) - np.mean(~batch.reading.echo[inside])), "1", None


def _extra(seen: Residuals, batch: Batch, inside: NDArray[np.bool_]) -> Size:
    u = np.nan_to_num(seen.u, nan=0.5)
    rows = inside & ((u < EXTRA) | (u > 1.0 - EXTRA))
    return float(rows.sum() / max(inside.sum(), 1)), "1", _place(batch, rows)


def _place(batch: Batch, rows: NDArray[np.bool_]) -> tuple[str, float] | None:
    """Return what the place of stray readings follows: the description that scatters least."""
    if rows.sum() < 4:
        return None
    reading, distance = batch.reading.range[rows], np.maximum(batch.ping.distance[rows], 0.01)
    ratio = reading / distance
    kinds = {"fixed range": reading, "beyond the target": reading - distance, "times distance": ratio}
    to_metres = {"times distance": float(np.median(distance))}
    scatter = {
        name: np.median(np.abs(value - np.median(value))) * to_metres.get(name, 1.0) for name, value in kinds.items()
    }
    best = min(scatter, key=lambda name: scatter[name])
    return best, float(np.median(kinds[best]))


def _lag(seen: Residuals, batch: Batch, inside: NDArray[np.bool_]) -> Size:
    x = np.nan_to_num(2.0 * seen.u - 1.0)
    pair = inside & (batch.count > 0)
    rows = np.flatnonzero(pair)
    return (float(np.corrcoef(x[rows], x[rows - 1])[0, 1]) if len(rows) > 3 and np.ptp(x[rows]) > 0 else 0.0), "1", None


_SIZES = {
    "bias": _bias,
    "scale": _scale,
    "spread": _spread,
    "skew": _skew,
    "detection": _detection,
    "extra_mode": _extra,
    "time_correlation": _lag,
}
