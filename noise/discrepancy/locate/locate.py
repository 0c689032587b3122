"""Where and in which respect readings disagree with a law: the findings of a scan, in plain units."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from noise.discrepancy.locate.residuals import ASPECTS, EXTRA, Residuals, residuals
from noise.discrepancy.locate.scan import Blocks, Region, Scan, scan
from noise.fitting.batch import Batch
from noise.fitting.stack import Stack

SHADOWS = ("spread", "skew", "time_correlation")  # a bias bends them wherever it changes: told of after it
LAST = 1e6
ALARM = 0.01  # p-value of a scan below which something is there
LEAST_SPREAD = 0.05  # of what is expected; ours
LIVELIER = 1.5  # times the scatter inside stays, which another day's air alone may bring; ours


@dataclass(frozen=True)
class Finding:
    """One place and respect in which readings disagree with a law.

    Attributes:
        aspect: one of "bias", "scale", "spread", "skew", "detection", "extra_mode", "time_correlation",
            "rhythm", "transient", "trailing", "grip", "window", "still", "kept", "play", "company", "smooth", "form",
            "selective", "fading", "edge", "steps".
        region: condition column -> (low, high) in the column's unit; empty is everywhere.
        size: how much, in `unit`.
        unit: "m" for bias, "1" for shares, ratios and correlations.
        p_value: of the greatest statistic, all regions and aspects counted.
        nats: half the squared statistic: what correcting it would be worth.
        place: where an extra mode sits, as (what it follows, m): "fixed range", "beyond the target", "times distance";
            of a rhythm, ("period", s); of "smooth", "form" and "selective", (the column that it goes by, 0).
    """

    aspect: str
    region: dict[str, tuple[float, float]]
    size: float
    unit: str
    p_value: float
    nats: float
    place: tuple[str, float] | None = None

    @property
    def carried(self) -> bool:
        """Whether it only tells that the air of another day hangs together otherwise: nothing is amiss with that."""
        calm = self.aspect == "spread" and self.size < LIVELIER
        return calm or self.aspect in ("skew", "time_correlation")


def locate(
    stack: Stack,
    batch: Batch,
    rng: np.random.Generator,
    most: int = 5,
    level: float = 0.05,
    peer: Blocks | None = None,
) -> list[Finding]:
    """Return the findings of a scan under a level, strongest first, at most one an aspect; what air carries, last.

    Args:
        stack: the law, its nuisances fitted.
        batch: readings.
        rng: for randomised PIT values and flips.
        most: number of findings.
        level: greatest p-value.
        peer: the readings of the simulation that the law stands for; see `scan`.
    """
    seen = residuals(stack, batch, rng)
    return findings(seen, scan(seen, batch, rng, peer), batch, peer, most, level)


def findings(
    seen: Residuals, scanned: Scan, batch: Batch, peer: Blocks | None = None, most: int = 5, level: float = 0.05
) -> list[Finding]:
    """Return the findings of a scan that was made; see `locate`."""
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
        aspect = bias_or_scale(ASPECTS[column], scanned.where[row], seen, batch)
        finding = describe(aspect, scanned.where[row], seen, batch, p, value, peer)
        if family(finding.aspect) not in {family(f.aspect) for f in out}:
            out.append(finding)
    return sorted(out, key=lambda finding: finding.carried)


def bias_or_scale(aspect: str, where: Region, seen: Residuals, batch: Batch) -> str:
    """Return which of the two leaves less over, block by block: the same error everywhere, or a share of distance."""
    rows = _typical(seen, batch, where[1][batch.visit])
    if aspect not in ("bias", "scale") or rows.sum() < 4:
        return aspect
    block, distance = batch.visit[rows], batch.ping.distance[rows]
    error = (batch.reading.range - seen.middle)[rows]
    count = np.maximum(np.bincount(block), 1)
    e, d = np.bincount(block, error) / count, np.bincount(block, distance) / count
    e, d = e[np.bincount(block) > 0], d[np.bincount(block) > 0]
    constant, share = np.median(e), np.median(e / np.maximum(d, 0.01))
    return "bias" if np.abs(e - constant).sum() <= np.abs(e - share * d).sum() else "scale"


def family(aspect: str) -> str:
    """Return what an aspect is a shadow of: a bias also bends spread and skew wherever it changes."""
    return "bias" if aspect in ("bias", "scale", "spread", "skew") else aspect


def describe(
    aspect: str, where: Region, seen: Residuals, batch: Batch, p: float, statistic: float, peer: Blocks | None = None
) -> Finding:
    """Return a finding with its size in plain units: beyond what a simulation's own readings do there, with a peer."""
    nats = statistic**2 / 2.0
    kind = {"early": "extra_mode", "late": "extra_mode", "repeat": "time_correlation"}.get(aspect, aspect)
    size, unit, place = _SIZES[kind](seen, batch, where[1][batch.visit])
    if peer is not None:
        usual = _SIZES[kind](peer.seen, peer.batch, peer.inside(where[0])[peer.batch.visit])[0]
        size = size / max(usual, LEAST_SPREAD) if kind == "spread" else size - usual
    return Finding(kind, where[0], size, unit, p, nats, place)


Size = tuple[float, str, tuple[str, float] | None]


def _typical(seen: Residuals, batch: Batch, inside: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Tell which echoes inside are near enough to the expected range to speak of bias."""
    return inside & batch.is_target(batch.reading.range - seen.middle)


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
    return float(rows.sum() / max(inside.sum(), 1)), "1", place_of(batch, rows)


def place_of(batch: Batch, rows: NDArray[np.bool_]) -> tuple[str, float] | None:
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
