"""Whether faults choose their places: a fault of a wire or a register strikes any ping, physics strikes by condition.

An effect that replaces readings can pass for anything that does: a reading that is never less than some limit comes
back to the digit as a stuck one does. But a fault asks neither how far off the target is nor where it faces, so strays
must be as many as the law says in every order of the stays; whether they are is a walk of sums along each condition,
against walks with the stays shuffled.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from acquisition.arrays import Floats
from noise.discrepancy.checks.company import chance_astray
from noise.discrepancy.locate.locate import Finding
from noise.discrepancy.locate.scan import by_block
from noise.fitting.batch import Batch
from noise.fitting.stack import Stack

FAULTS = ("stuck", "stale_repeat", "spike", "corrupted_byte")  # that strike whatever the condition
SHUFFLES = 4000
MOSTLY = 0.5  # of stretches in which the target stood: with fewer, the log is of a robot on its way; ours
FEWEST = 12  # stays, below which no order tells anything; ours
FEWEST_STRUCK = 4  # stays with strays, for the same; ours
LEAST = 0.25  # variance of a stay's count that any law is granted; ours
NOT_ASKED = ("time_s",)  # faults come and go


def selective(stack: Stack, batch: Batch, chosen: Sequence[str], rng: np.random.Generator) -> Finding | None:
    """Return how strays choose their places, as a finding; None where no fault is named or too few stays tell.

    Its size is the share of stays with strays, its place the condition that they go by.

    Args:
        stack: the law of single readings.
        batch: readings, whole stays.
        chosen: effects of the explanation.
        rng: for the shuffles.
    """
    if not set(chosen) & set(FAULTS) or batch.n_visits < FEWEST:
        return None
    excess, struck = _excess(stack, batch)
    if struck.sum() < FEWEST_STRUCK:
        return None
    asked = {name: column for name, column in by_block(batch).items() if name not in NOT_ASKED}
    columns = {name: column for name, column in asked.items() if np.ptp(column) > 0.0}
    if not columns:
        return None
    orders = np.array([np.argsort(column, kind="stable") for column in columns.values()])
    driven = np.mean(batch.stationary) < MOSTLY
    rank, p = _turned(excess, orders) if driven else _shuffled(excess, orders, rng)
    along = list(columns)[int(np.argmin(rank))]
    return Finding("selective", {}, float(struck.mean()), "1", p, -float(np.log(p)), (along, 0.0))


def _shuffled(excess: Floats, orders: NDArray[np.int64], rng: np.random.Generator) -> tuple[Floats, float]:
    """Return how rarely walks of sums stray as far in each order by chance, and the same of the farthest.

    Args:
        excess: strays of each stay beyond the law's, (stays,).
        orders: of the stays along each condition, (conditions, stays).
        rng: for the shuffles.
    """
    shuffled = rng.permuted(np.tile(excess, (SHUFFLES, 1)), axis=1)
    own = _highest(excess[orders])
    by_chance = np.array([_highest(shuffled[:, order]) for order in orders])
    # each condition against its own chance, then the best of them against the best by chance
    rank = np.array([(chance >= x).mean() for x, chance in zip(own, by_chance, strict=True)])
    least = np.min([_ranks(chance) for chance in by_chance], axis=0)
    return rank, float((1.0 + (least <= rank.min()).sum()) / (1.0 + SHUFFLES))


def _turned(excess: Floats, orders: NDArray[np.int64]) -> tuple[Floats, float]:
    """Return the same of stretches of a way, had the same strays come so much sooner or later.

    A robot stays near where it is: a fault that lasts strikes one place, wherever the robot is then. Shuffled, that
    would pass for a choice. Turns are few, so their own mean and scatter tell how rare a walk is.
    """
    turned = np.stack([np.roll(excess, k) for k in range(1, len(excess))])
    own = _highest(excess[orders])
    by_chance = np.array([_highest(turned[:, order]) for order in orders])
    scatter = np.maximum(by_chance.std(axis=1), 1e-9)
    rank = norm.sf((own - by_chance.mean(axis=1)) / scatter)
    return rank, float(np.clip(len(orders) * rank.min(), 1e-300, 1.0))


def _excess(stack: Stack, batch: Batch) -> tuple[Floats, np.ndarray]:
    """Return each stay's strays beyond those of the law, in standard deviations, and whether it has any, (blocks,).

    A stray is none of the target's, heard or not: what a law reads where it hears no target is a stray still.
    """
    middle = stack.direct(batch)[0]
    stray = batch.is_outlier(batch.reading.range - middle)
    p = np.clip(chance_astray(stack.model.law(batch.ping, batch.past), middle, batch.reach), 0.0, 1.0)
    count, expected, variance = (batch.visit_sums(x) for x in (stray.astype(np.float64), p, p * (1.0 - p)))
    return (count - expected) / np.sqrt(variance + LEAST), count > 0.0


def _highest(walks: Floats) -> Floats:
    """Return how far sums along the last axis stray from a straight way, whatever their end, (...,)."""
    length = walks.shape[-1]
    total = np.cumsum(walks, axis=-1)
    return np.abs(total - np.arange(1, length + 1) / length * total[..., -1:]).max(axis=-1)


def _ranks(values: Floats) -> Floats:
    """Return the share of values as high as each or higher, (n,)."""
    return 1.0 - np.searchsorted(np.sort(values), values) / len(values)
