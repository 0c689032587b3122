"""Where and in which respect readings disagree with a law: a scan of regions, with one p-value for all it looked at.

Each aspect is a score of single readings that is zero on average under the law, whatever pings share inside a block;
regions are intervals of at most two condition features. A region's statistic is its sum of block scores over their
root sum of squares; the greatest over all regions and aspects is compared with the same after flipping the signs of
whole blocks at random (wild cluster bootstrap), which keeps the correlation inside blocks and between regions.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
import torch
from numpy.typing import NDArray

from acquisition import Reading
from noise.cells import BANKS, Batch, bank_weights, law_of, marginal, sequential
from noise.fit import Stack
from noise.law import EchoLaw, Floats
from noise.physical import PhysicalLaw

ASPECTS = ("bias", "scale", "spread", "skew", "detection", "early", "late", "time_correlation", "repeat")
ONE_SIDED = ("early", "late", "repeat")  # fewer strays than expected only says that the scatter was fitted too wide
EXTRA = 1e-3  # share of echoes beyond which a reading counts as one of an extra mode
SMALL = 0.01  # keeps the score of what hardly ever happens from outweighing everything else
SHADOWS = ("spread", "skew", "time_correlation")  # a bias bends them wherever it changes: told of after it
LAST = 1e6
MORE = 1.3  # how much greater than a simulation's own a misfit must be to count; ours
FLIPS = 400
LEAST_BLOCKS = 6
MM, DEG = 1e-3, np.pi / 180.0


@dataclass(frozen=True)
class Finding:
    """One place and respect in which readings disagree with a law.

    Attributes:
        aspect: one of "bias", "scale", "spread", "skew", "detection", "extra_mode", "time_correlation",
            "rhythm".
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


@dataclass(frozen=True)
class Residuals:
    """Readings seen through a law.

    Attributes:
        score: of every aspect, (n, aspects).
        variance: of each score under the law, pings taken as independent, (n, aspects).
        u: randomised PIT value of echoes, nan elsewhere, (n,).
        middle: median reading that the law expects of an echo, m, (n,).
        silent: probability of no echo that the law gives, (n,).
    """

    score: Floats
    variance: Floats
    u: Floats
    middle: Floats
    silent: Floats


def pit(law: EchoLaw, reading: Reading, within: Floats) -> Floats:
    """Return randomised PIT values of the echoes given that there was one, nan where there was none, (n,).

    Args:
        law: of the readings.
        reading: (n,).
        within: place inside the register's step, uniform on [0, 1), (n,).
    """
    step = law.step(reading.range)
    low, high, echo = law.cdf_step(step - 1), law.cdf_step(step), law.echo
    u = (low + within * (high - low)) / np.maximum(echo, 1e-12)
    return np.where(reading.echo & (echo > 1e-12), np.clip(u, 0.0, 1.0), np.nan)


def _mixed(laws: Sequence[PhysicalLaw], weights: Floats, reading: Reading, within: Floats) -> Floats:
    """Return PIT values under a mixture of laws that hear equally often; weights (laws, n) or (laws, 1)."""
    return sum((w * pit(law, reading, within) for w, law in zip(weights, laws, strict=True)), np.zeros(len(reading)))


def seen_alone(stack: Stack, batch: Batch, rng: np.random.Generator) -> tuple[Floats, PhysicalLaw]:
    """Return PIT values of readings in cells not heard of yet, and the law of a carefully placed target."""
    with torch.no_grad():
        model, cells = stack.build()
        laws = marginal(law_of(model, batch), cells, batch)
    shares = np.array([[share] for _, share in BANKS])
    return _mixed(laws, shares, batch.reading, rng.random(len(batch))), laws[0]


def residuals(stack: Stack, batch: Batch, rng: np.random.Generator) -> Residuals:
    """Return scores of every aspect for every reading of a batch."""
    u, law = seen_alone(stack, batch, rng)
    with torch.no_grad():
        model, cells = stack.build()
        whole = law_of(model, batch)
        given, weights = sequential(whole, cells, batch), bank_weights(whole, cells, batch)
    after = _mixed(given, weights, batch.reading, rng.random(len(batch)))
    x, own = (np.nan_to_num(2.0 * value - 1.0) for value in (u, after))
    heard = (~np.isnan(u)).astype(np.float64)
    stretch = (batch.ping.distance - batch.ping.distance.mean()) / max(float(np.std(batch.ping.distance)), 1e-9)
    p, binary = np.clip(law.no_echo, 0.0, 1.0), np.sqrt(EXTRA)
    repeat, repeat_variance = _repeats(given[0], batch)
    pairs = [
        (x, heard / 3.0),
        (x * stretch, heard * stretch**2 / 3.0),
        # within the block: block sums of squares about an unknown offset are too lopsided for flips of sign
        (heard * (3.0 * own**2 - 1.0) / 2.0, heard / 5.0),
        ((5.0 * own**3 - 3.0 * own) / 2.0, heard / 7.0),
        (((~batch.reading.echo) - p) / np.sqrt(p * (1.0 - p) + SMALL), _share(p)),
        (heard * ((u < EXTRA) - EXTRA) / binary, heard),
        (heard * ((u > 1.0 - EXTRA) - EXTRA) / binary, heard),
        (np.where(batch.count > 0, 3.0 * own * np.r_[0.0, own[:-1]], 0.0), heard),
        (repeat, repeat_variance),
    ]
    score, variance = (np.nan_to_num(np.stack(part, axis=1)) for part in zip(*pairs, strict=True))
    return Residuals(score, variance, u, law.quantile(0.5), p)


def _share(p: Floats) -> Floats:
    """Return the variance of a yes or no of probability p after division by sqrt(p (1 - p) + SMALL)."""
    return p * (1.0 - p) / (p * (1.0 - p) + SMALL)


def _repeats(law: EchoLaw, batch: Batch) -> tuple[Floats, Floats]:
    """Return how much more often than expected an echo repeats the last to the digit, and its variance, (n,) each."""
    step = law.step(batch.past.range)
    expected = law.cdf_step(step) - law.cdf_step(step - 1)
    known = batch.past.echo & batch.reading.echo
    same = np.abs(batch.past.range - batch.reading.range) < batch.resolution / 2.0
    score = (same - expected) / np.sqrt(expected * (1.0 - expected) + SMALL)
    return np.where(known, score, 0.0), np.where(known, _share(expected), 0.0)


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

    def beyond(self, known: Floats | None) -> Scan:
        """Return the scan without what is no larger than a simulation's own misfit of the same aspect, (aspects,)."""
        if known is None:
            return self
        return replace(self, statistic=np.where(np.abs(self.statistic) > MORE * known, self.statistic, 0.0))


def scan(seen: Residuals, batch: Batch, rng: np.random.Generator) -> Scan:
    """Scan all regions for every aspect.

    A statistic is studentised by its blocks, but never by less than independent pings would vary: where an event of
    small probability did not happen, all blocks agree and their own scatter would be nothing.
    """
    where = regions(batch)
    by_block = batch.per_block(seen.score)
    mask = np.stack([region[1] for region in where]).astype(np.float64)
    root = np.sqrt(np.maximum(mask @ by_block**2, mask @ batch.per_block(seen.variance))) + 1e-9
    one_sided = np.array([aspect in ONE_SIDED for aspect in ASPECTS])
    statistic = (mask @ by_block) / root
    highest = np.empty(FLIPS)
    for k in range(FLIPS):
        sign = rng.integers(0, 2, len(by_block)) * 2.0 - 1.0
        highest[k] = _two_sided((mask @ (by_block * sign[:, None])) / root, one_sided).max()
    return Scan(np.where(one_sided, np.maximum(statistic, 0.0), statistic), highest, where)


def _two_sided(statistic: Floats, one_sided: NDArray[np.bool_]) -> Floats:
    return np.where(one_sided, statistic, np.abs(statistic))


def locate(
    stack: Stack,
    batch: Batch,
    rng: np.random.Generator,
    most: int = 5,
    level: float = 0.05,
    known: Floats | None = None,
) -> list[Finding]:
    """Return the findings of a scan under a level, strongest first, at most one an aspect.

    Args:
        stack: the law, its nuisances fitted.
        batch: readings.
        rng: for randomised PIT values and flips.
        most: number of findings.
        level: greatest p-value.
        known: misfit by aspect that the law has with the simulation itself; see `Scan.beyond`.
    """
    seen = residuals(stack, batch, rng)
    scanned = scan(seen, batch, rng).beyond(known)
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
    near = np.abs(batch.reading.range - seen.middle) < 0.1 * batch.ping.distance + 0.05
    return inside & batch.reading.echo & near


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
