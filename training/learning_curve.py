"""How an agent's driving came along: one picture, made anew after every leg of its training."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from noise.credence import wilson
from training.canvas import AFTER, BEFORE, SOFT, Axes, panels

MILLION = 1e6


def learning_curve(history: Sequence[Mapping[str, Any]]) -> bytes:
    """Return shares parked and touched, with 95 % limits, and seconds an episode, by steps of trial, as PNG.

    Args:
        history: of a training, an entry a leg (`Policy.about["history"]`); steps 0 is what imitation alone has taught.
    """
    steps = [one["steps"] / MILLION for one in history]
    return panels([partial(_shares, steps, history), partial(_pace, steps, history)], (9.0, 3.4))


def _shares(steps: Sequence[float], history: Sequence[Mapping[str, Any]], ax: Axes) -> None:
    for name, label, colour in (("success", "parked", AFTER), ("collision", "touched something", BEFORE)):
        share = np.array([one[name] for one in history])
        ended = np.maximum([one["episodes"] for one in history], 1)
        spread = np.abs(np.array(wilson(np.rint(share * ended), ended)) - share)
        ax.errorbar(steps, 100 * share, yerr=100 * spread, color=colour, marker="o", ms=4, capsize=3, label=label)
    ax.set(title="While it still tries actions at random", xlabel=_LABEL, ylabel="episodes, %", ylim=(-3, 103))
    ax.legend(loc="center right")


def _pace(steps: Sequence[float], history: Sequence[Mapping[str, Any]], ax: Axes) -> None:
    ax.plot(steps, [one["seconds_an_episode"] for one in history], color=SOFT, marker="o", ms=4)
    ax.set(title="Length of an episode", xlabel=_LABEL, ylabel="s", ylim=(0, None))


_LABEL = "million steps of trial (0: imitation alone)"
