"""How an agent's driving came along: one picture, made anew after every leg of its training."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from noise.credence import wilson
from training.common.canvas import AFTER, BEFORE, SOFT, Axes, panels

MILLION = 1e6


def learning_curve(history: Sequence[Mapping[str, Any]]) -> bytes:
    """Return shares parked and touched, with 95 % limits, and seconds an episode, by steps of all cars, as PNG.

    Args:
        history: of a training, an entry a leg (`Policy.about["history"]`); leg 0, where there is one, is imitation.
    """
    taught, points = course(history)
    return panels([partial(_shares, taught, points), partial(_pace, taught, points)], (9.0, 3.4))


def course(history: Sequence[Mapping[str, Any]]) -> tuple[float, list[tuple[float, Mapping[str, Any]]]]:
    """Return where imitation ends, and what episodes up to each point came to, if any: million steps of all cars."""
    tenths = [tenth for one in history for tenth in one.get("course", ())]
    each = tenths[0]["steps"] if tenths else 0
    taught = (tenths[-1]["steps"] + each) / MILLION if tenths else 0.0
    points = [(one["steps"] / MILLION, one) for one in tenths]
    points += [(taught + one["steps"] / MILLION, one) for one in history]
    return taught, [(at, one) for at, one in points if one["episodes"]]


def _shares(taught: float, points: Sequence[tuple[float, Mapping[str, Any]]], ax: Axes) -> None:
    steps = [at for at, _ in points]
    for name, label, colour in (("success", "parked", AFTER), ("collision", "touched something", BEFORE)):
        share = np.array([one[name] for _, one in points])
        ended = np.array([one["episodes"] for _, one in points])
        spread = np.abs(np.array(wilson(np.rint(share * ended), ended)) - share)
        ax.errorbar(steps, 100 * share, yerr=100 * spread, color=colour, marker="o", ms=4, capsize=3, label=label)
    _shade(taught, ax)
    ax.set(title="In training, tries at random included", xlabel=_LABEL, ylabel="episodes, %", ylim=(-3, 103))
    ax.legend(loc="center right")


def _pace(taught: float, points: Sequence[tuple[float, Mapping[str, Any]]], ax: Axes) -> None:
    lengths = [one["seconds_an_episode"] for _, one in points]
    ax.plot([at for at, _ in points], lengths, color=SOFT, marker="o", ms=4)
    _shade(taught, ax)
    ax.set(title="Length of an episode", xlabel=_LABEL, ylabel="s", ylim=(0, None))


def _shade(taught: float, ax: Axes) -> None:
    if taught:
        ax.axvspan(0.0, taught, color=SOFT, alpha=0.12, lw=0, label="imitation")


_LABEL = "million steps of 0.1 s, all cars"
