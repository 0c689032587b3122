"""The proof's picture: how often a cause is rightly named, and how often anything is said, by what there is to see."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from noise.credence import wilson
from training.common.canvas import AFTER, BEFORE, SOFT, Axes, panels
from training.proof.scoring.score import CLEAR, Band, Scored, by_separation

LEAST, MOST = 1.0, 500.0  # nats, of the axis


def accuracy(trials: Sequence[Scored]) -> bytes:
    """Return accuracy against separation, with 95 % limits, as PNG."""
    return panels([lambda axes: _draw(axes, by_separation(trials))], (6.4, 3.8))


def _draw(axes: Axes, bands: Sequence[Band]) -> None:
    middle = [_middle(band) for band in bands]
    right, trials = np.array([band.right for band in bands]), np.array([band.trials for band in bands])
    spread = np.abs(np.array(wilson(right * trials, trials)) - right)
    axes.errorbar(middle, right, yerr=spread, color=AFTER, marker="o", capsize=3, label="right, of all")
    axes.plot(middle, [band.answered for band in bands], color=BEFORE, marker="s", ls="--", label="said anything")
    axes.axvline(CLEAR, color=SOFT, lw=1, ls=":")
    axes.axhline(0.95, color=SOFT, lw=1, ls=":")
    for x, band in zip(middle, bands, strict=True):
        axes.annotate(f"{band.trials}", (x, -0.04), ha="center", va="top", fontsize=8, color=SOFT)
    axes.set(xscale="log", xlim=(LEAST, MOST), ylim=(-0.12, 1.05))
    axes.set(xlabel="separation: what somebody who knew the cause gains, nats", ylabel="share of trials")
    axes.set_title("Blind trials with a cause of the catalogue (numbers: trials)")
    axes.legend(loc="upper left")


def _middle(band: Band) -> float:
    """Return where a band is drawn, nats."""
    if np.isfinite(band.low) and np.isfinite(band.high):
        return float(np.sqrt(band.low * band.high))
    return float(band.low * 1.6 if np.isfinite(band.low) else band.high / 1.4)
