"""In which respect, and where, an explanation gains: what a scan of regions is too blunt to say of a few stays.

A scan asks whether readings of a region lean away from the law on average. Five readings that no law allows lean on
nothing, and may yet be worth a hundred nats. Once they are explained, the explanation itself tells: whether it gains on
echoes that are heard or missed, on those that stray, or on how those of the target lie.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray

from acquisition.arrays import Floats
from noise.discrepancy.locate.locate import ALARM, Finding, bias_or_scale, describe, family, place_of
from noise.discrepancy.locate.residuals import EXTRA, Residuals
from noise.discrepancy.locate.scan import Blocks, Region, regions
from noise.fitting.batch import Batch
from noise.fitting.fit import log_likelihood
from noise.fitting.stack import Stack
from noise.fitting.visit_effects import detection_probability, law_of

LEAST = 1e-9  # probability below which none is told from another
FEW = 0.1  # of the echoes: more that the law did not allow say that it is too narrow; ours
MOST = 0.9  # of what is gained, that a region holds; ours
DRAWS = 200
SURE = 0.05  # p-value of a region; ours


def gained(
    before: Stack,
    after: Stack,
    batch: Batch,
    seen: Residuals,
    p: float,
    rng: np.random.Generator,
    peer: Blocks | None = None,
) -> Finding | None:
    """Return the respect in which an explanation gains most, and where; None where it gains nothing.

    Args:
        before: the law without the explanation.
        after: and with it.
        batch: readings, whole stays.
        seen: they, under the law without it.
        p: p-value of the gain.
        rng: for the shuffling of stays.
        peer: the readings of the simulation that the law stands for; see `scan`.
    """
    shares = by_aspect(before, after, batch)
    total = {name: float(share.sum()) for name, share in shares.items()}
    if sum(total.values()) <= 0.0:
        return None
    aspect = max(total, key=lambda name: total[name])
    nats = total[aspect]
    where = _region(batch, batch.visit_sums(shares[aspect]), rng)
    if aspect == "extra_mode":
        inside = where[1][batch.visit]
        rows = inside & (shares[aspect] > 0.0)
        return Finding(aspect, where[0], float(rows.sum() / inside.sum()), "1", p, nats, place_of(batch, rows))
    if aspect == "bias":
        aspect = bias_or_scale(aspect, where, seen, batch)
    return describe(aspect, where, seen, batch, p, np.sqrt(2.0 * nats), peer)


def with_gained(where: Sequence[Finding], told: Finding | None) -> tuple[Finding, ...]:
    """Return what a scan located, with what the explanation tells, where no such thing was surely located."""
    if told is None or any(_same(each, told) for each in where):
        return tuple(where)
    kept = [each for each in where if family(each.aspect) != family(told.aspect)]
    return tuple(sorted([*kept, told], key=lambda each: (each.carried, -each.nats)))


def _same(each: Finding, told: Finding) -> bool:
    sure = each.p_value < ALARM or each.aspect == told.aspect
    return sure and not each.carried and family(each.aspect) == family(told.aspect)


def by_aspect(before: Stack, after: Stack, batch: Batch) -> dict[str, Floats]:
    """Return what each reading is better explained by, nats, by the respect in which it is, (n,) each.

    An echo is first heard, then lies somewhere: the two gains add up. How the target's echoes lie is their "bias" where
    the explanation moves where they are expected by more than half the register's step. Where it does not, few that the
    law did not allow are of an "extra_mode", near as they may be; the others, and many of them, tell of "spread".
    """
    heard = batch.reading.echo
    gain = log_likelihood(after, batch) - log_likelihood(before, batch)
    lying = np.where(heard, gain - (_log_hearing(after, batch) - _log_hearing(before, batch)), 0.0)
    middle = before.expected(batch)
    moved = np.median(np.abs(after.expected(batch) - middle)[heard]) if heard.any() else 0.0
    how = "bias" if moved > 0.5 * batch.resolution else "spread"
    barred = heard & (lying > -np.log(EXTRA))
    astray = batch.is_outlier(batch.reading.range - middle)
    if how == "spread" and barred.sum() < FEW * heard.sum():
        astray |= barred
    return {
        "detection": gain - lying,
        "extra_mode": np.where(astray, lying, 0.0),
        how: np.where(astray, 0.0, lying),
    }


def _log_hearing(stack: Stack, batch: Batch) -> Floats:
    """Return the log probability of echo or silence, whichever there was, given the cell's pings before, (n,)."""
    with torch.no_grad():
        model, cells = stack.build()
        given = detection_probability(law_of(model, batch), cells, batch)[1]
    return np.asarray(np.log(np.clip(given.numpy(), LEAST, 1.0)))


def _region(batch: Batch, gain: Floats, rng: np.random.Generator) -> Region:
    """Return the smallest region that holds most of a gain, everywhere where chance makes one as small, (blocks,)."""
    where = regions(batch)
    inside = np.stack([mask for _, mask in where]).astype(np.float64)
    share = inside.mean(axis=1)
    smallest = _smallest(inside, share, gain)
    by_chance = [share[_smallest(inside, share, rng.permutation(gain))] for _ in range(DRAWS)]
    sure = (1 + np.sum(np.array(by_chance) <= share[smallest])) / (1 + DRAWS) < SURE
    return where[smallest] if sure else where[0]


def _smallest(inside: Floats, share: Floats, gain: Floats) -> int:
    """Return the row of the smallest region that holds most of a gain; the first region is everywhere."""
    holds: NDArray[np.bool_] = inside @ gain >= MOST * gain.sum()
    return int(np.argmin(np.where(holds, share, 1.0 + share)))
