"""Readings seen through a law: a score for every aspect in which they can disagree, zero on average if they agree."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from acquisition import Reading
from noise.fitting.batch import Batch
from noise.fitting.stack import Stack
from noise.fitting.visit_effects import BANKS, bank_weights, law_of, marginal, sequential
from noise.law import EchoLaw, Floats
from noise.physical import PhysicalLaw

ASPECTS = ("bias", "scale", "spread", "skew", "detection", "early", "late", "time_correlation", "repeat")
EXTRA = 1e-3  # share of echoes beyond which a reading counts as one of an extra mode
SMALL = 0.01  # keeps the score of what hardly ever happens from outweighing everything else


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


def _mixed(laws: Sequence[PhysicalLaw], weights: Floats, reading: Reading, rng: np.random.Generator) -> Floats:
    """Return PIT values under a mixture of laws that hear equally often; weights (laws, n) or (laws, 1)."""
    within = rng.random(len(reading))
    with torch.no_grad():
        parts = [w * pit(law, reading, within) for w, law in zip(weights, laws, strict=True)]
    return sum(parts, np.zeros(len(reading)))


def seen_alone(stack: Stack, batch: Batch, rng: np.random.Generator) -> tuple[Floats, PhysicalLaw]:
    """Return PIT values of readings in cells not heard of yet, and the law of a carefully placed target."""
    with torch.no_grad():
        model, cells = stack.build()
        laws = marginal(law_of(model, batch), cells, batch)
    shares = np.array([[share] for _, share in BANKS])
    return _mixed(laws, shares, batch.reading, rng), laws[0]


def seen_in_cell(stack: Stack, batch: Batch, rng: np.random.Generator) -> tuple[Floats, PhysicalLaw]:
    """Return PIT values of readings given those before in their cell, and the law of each under a careful placement."""
    with torch.no_grad():
        model, cells = stack.build()
        whole = law_of(model, batch)
        given, weights = sequential(whole, cells, batch), bank_weights(whole, cells, batch)
    return _mixed(given, weights, batch.reading, rng), given[0]


def residuals(stack: Stack, batch: Batch, rng: np.random.Generator) -> Residuals:
    """Return scores of every aspect for every reading of a batch."""
    u, law = seen_alone(stack, batch, rng)
    after, next_law = seen_in_cell(stack, batch, rng)
    x, own = (np.nan_to_num(2.0 * value - 1.0) for value in (u, after))
    heard = (~np.isnan(u)).astype(np.float64)
    stretch = (batch.ping.distance - batch.ping.distance.mean()) / max(float(np.std(batch.ping.distance)), 1e-9)
    p, binary = np.clip(law.no_echo, 0.0, 1.0), np.sqrt(EXTRA)
    repeat, repeat_variance = _repeats(next_law, batch)
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
    score = (batch.repeats - expected) / np.sqrt(expected * (1.0 - expected) + SMALL)
    return np.where(known, score, 0.0), np.where(known, _share(expected), 0.0)
