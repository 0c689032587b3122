"""The proof's picture: how often a cause is rightly named, and how often anything is said, by what there is to see."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.stats import binomtest

from training.canvas import AFTER, BEFORE, SOFT, Axes, panels
from training.proof.score import CLEAR, Opened, by_separation

LEAST, MOST = 1.0, 500.0  # nats, of the axis


def accuracy(trials: Sequence[Opened]) -> bytes:
    """Return accuracy against separation, with 95 % limits, as PNG."""
    return panels([lambda axes: _draw(axes, trials)], (6.4, 3.8))


def _draw(axes: Axes, trials: Sequence[Opened]) -> None:
    rows = by_separation(trials)
    middle = [_middle(words) for words, *_ in rows]
    limits = [binomtest(round(right * n), n).proportion_ci(0.95, "wilson") for _, n, _, right, _ in rows]
    right = np.array([row[3] for row in rows])
    low = right - np.array([each.low for each in limits])
    high = np.array([each.high for each in limits]) - right
    axes.errorbar(middle, right, yerr=[low, high], color=AFTER, marker="o", capsize=3, label="right, of all")
    axes.plot(middle, [row[2] for row in rows], color=BEFORE, marker="s", ls="--", label="said anything")
    axes.axvline(CLEAR, color=SOFT, lw=1, ls=":")
    axes.axhline(0.95, color=SOFT, lw=1, ls=":")
    for x, (_, n, *_) in zip(middle, rows, strict=True):
        axes.annotate(f"{n}", (x, -0.04), ha="center", va="top", fontsize=8, color=SOFT)
    axes.set(xscale="log", xlim=(LEAST, MOST), ylim=(-0.12, 1.05))
    axes.set(xlabel="separation: what somebody who knew the cause gains, nats", ylabel="share of trials")
    axes.set_title("Blind trials with a cause of the catalogue (numbers: trials)")
    axes.legend(loc="upper left")


def _middle(words: str) -> float:
    """Return where a range of separations, in words, is drawn."""
    edges = [float(each) for each in words.replace("<", "").replace("≥", "").split(" to ")]
    if len(edges) == 2:
        return float(np.sqrt(edges[0] * edges[1]))
    return float(edges[0] / 1.4) if words.startswith("<") else float(edges[0] * 1.6)
