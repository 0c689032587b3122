"""Whether what a diagnosis asks to be measured next settles what it could not tell apart."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from noise.discrepancy.common.rules import TIE
from noise.discrepancy.judge.verdict import CLAIMS
from training.proof.scoring.score import TELLABLE, Line, Scored, at_least, quantile, share

MOST_TIMES = 100.0  # as much as anywhere: pings anywhere may tell nothing, or the wrong thing


def lines(trials: Sequence[Scored]) -> list[Line]:
    """Return the lines of the table: how often rivals are settled, and how much more a ping tells than one anywhere."""
    told = [t for t in trials if t.kind in TELLABLE and t.said in CLAIMS and t.verdict["next_measurement"]]
    open_ = [t for t in told if all(map(t.holds, causes(t)))]
    settled = [s for t in open_ if (s := is_settled(t)) is not None]
    times = [x for t in open_ for x in against_anywhere(t)]
    return [
        share("next measurement settles", "≥ 80 %", settled, at_least(0.8)),
        quantile("next measurement: nats a ping against anywhere, median", "≥ 3", times, 0.5, 3.0),
    ]


def causes(trial: Scored) -> list[dict[str, Any]]:
    """Return what was concealed."""
    return list(trial.answer["causes"])


def is_settled(trial: Scored) -> bool | None:
    """Tell whether every rival of the truth is excluded, and the truth is not; None where nothing says so.

    Pings settle a pair if together with the recording they prefer the truth by as much as the diagnosis wants to
    exclude a rival. A thermometer does if what it shows is nearer to what was told of it exactly if that is the truth.
    """
    told = [_side(trial, row) * (row["observed"] + row["here"]) >= TIE for row in _rows(trial)]
    asked = zip(trial.verdict["next_measurement"], trial.verdict["next_settings"], strict=True)
    told += [s for m, settings in asked if (s := _by_thermometer(trial, m, settings)) is not None]
    told += [False for m in trial.verdict["next_measurement"] if m["pings"] == 0 and _concerns(trial, m["separates"])]
    return all(told) if told else None


def against_anywhere(trial: Scored) -> list[float]:
    """Return how many times as much each measured pair was told by as by the same number of pings anywhere."""
    out = []
    for row in _rows(trial):
        here, anywhere = (_side(trial, row) * row[name] for name in ("here", "anywhere"))
        most = MOST_TIMES if here > 0 else 0.0
        out.append(min(here / anywhere, most) if anywhere > 0 else most)
    return out


def _rows(trial: Scored) -> list[dict[str, Any]]:
    """Return measured pairs of which one is the truth."""
    return [row for row in trial.scores.get("followed") or [] if _side(trial, row)]


def _side(trial: Scored, row: dict[str, Any]) -> int:
    """Return 1 where the effect that was named is a truth, -1 where its rival is, 0 where both or neither are."""
    first, second = (_true(trial, row[name]) for name in ("replaces", "effect"))
    return int(first) - int(second)


def _true(trial: Scored, effect: str) -> bool:
    return any(effect in cause["accepted"] for cause in causes(trial))


def _concerns(trial: Scored, effects: Sequence[str]) -> bool:
    return 0 < sum(_true(trial, effect) for effect in effects) < len(effects)


def _by_thermometer(trial: Scored, measurement: dict[str, Any], settings: dict[str, Any]) -> bool | None:
    """Tell whether a thermometer decides rightly between warm air and another cause; None where none is asked for."""
    told = settings.get("expected", {}).get("warmer_k")
    if told is None or "warmer_k" not in trial.answer or not _concerns(trial, measurement["separates"]):
        return None
    fits = abs(trial.answer["warmer_k"] - told) < 0.5 * abs(told)
    return bool(fits == _true(trial, "sound_speed"))
