"""The named baselines beside the package, on the same trials."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from training.proof.scoring.score import CLEAR, Scored


@dataclass(frozen=True)
class Method:
    """What another way of looking at the same trials comes to.

    Attributes:
        name: in words.
        alarm: whether it notices anything; None where it does not say.
        names: whether it names the cause rightly; None where it names nothing.
        closed: the share of the vault's gap that it closes; None where it corrects nothing.
    """

    name: str
    alarm: Callable[[Scored], bool] | None = None
    names: Callable[[Scored], bool] | None = None
    closed: Callable[[Scored], float] | None = None

    def row(self, null: Sequence[Scored], known: Sequence[Scored]) -> tuple[str, str, str, str, str]:
        """Return name, alarms on null, and of trials with a cause: noticed, rightly named, median gap closed."""
        false, seen = (_percent(self.alarm, group) for group in (null, known))
        gaps = [gap for gap in map(self.closed, known) if np.isfinite(gap)] if self.closed else []
        return self.name, false, seen, _percent(self.names, known), f"{np.median(gaps):.2f}" if gaps else "–"


METHODS = (
    Method("this package", lambda t: t.said != "none", lambda t: t.right, lambda t: t.closed),
    Method("classifier two-sample test", lambda t: bool(t.scores["classifier_z"] > 1.645)),
    Method("kernel two-sample test (MMD)", lambda t: bool(t.scores["kernel_p"] <= 0.05)),
)
SLOW_METHODS = (
    Method(
        "independent likelihood ratios",
        lambda t: bool(t.scores["independent_name"]),
        lambda t: t.scores["independent_name"] in t.answer["causes"][0]["accepted"],
    ),
    Method("Gaussian-process discrepancy", closed=lambda t: t.closed_by("vault_process")),
    Method("four-part beam model, EM", closed=lambda t: t.closed_by("vault_beam")),
)
ENDS = (("oracle", "–", "–", "100 %", "1.00"), ("chance", "–", "–", "3 %", "0.00"))


def baselines(trials: Sequence[Scored]) -> list[tuple[str, str, str, str, str]]:
    """Return a row by method: alarms on null; noticed, rightly named and gap closed at ≥ 15 nats; all in words."""
    null = [t for t in trials if t.kind == "null"]
    known = [t for t in trials if t.kind in ("effect", "matched", "confounded") and t.nats >= CLEAR]
    slow = SLOW_METHODS if any("independent_name" in t.scores for t in null + known) else ()
    ours, *others = (method.row(null, known) for method in (*METHODS, *slow))
    return [ours, *ENDS, *others]


def _percent(says: Callable[[Scored], bool] | None, trials: Sequence[Scored]) -> str:
    return f"{100 * np.mean([says(t) for t in trials]):.0f} %" if says is not None and len(trials) else "–"
