"""How far the pings that were asked for tell surviving rivals apart, beside as many pings anywhere."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from acquisition import Recording
from noise.discrepancy import Diagnosis
from noise.discrepancy.judge.next_measurement import Measurement
from noise.discrepancy.judge.proposal import USUAL, Setting, floored, law
from noise.discrepancy.name.rivals import Rival
from noise.fitting.stack import Stack


def told(found: Diagnosis, folder: Path) -> list[dict[str, Any]]:
    """Return for each surviving rival what speaks for the effect that it would replace, nats.

    Args:
        found: the diagnosis that asked.
        folder: holds `measured-K.csv` and `anywhere-K.csv` of the K-th measurement that names conditions.
    """
    asked = [measurement for measurement in found.verdict.next_measurement if measurement.proposal is not None]
    return [
        _one(found, rival, measurement, folder, k)
        for k, measurement in enumerate(asked)
        for rival in found.rivals
        if rival.survives and {rival.replaces, rival.effect} <= set(measurement.separates)
    ]


def _one(found: Diagnosis, rival: Rival, measurement: Measurement, folder: Path, k: int) -> dict[str, Any]:
    assert measurement.proposal is not None
    here, anywhere = (Recording.load(folder / f"{name}-{k}.csv") for name in ("measured", "anywhere"))
    setting = measurement.proposal.setting
    return {
        "replaces": rival.replaces,
        "effect": rival.effect,
        "observed": rival.observed,
        "pings": len(here),
        "here": _ratio(found.explanation, rival.stack, setting, here),
        "anywhere": _ratio(found.explanation, rival.stack, USUAL, anywhere),
    }


def _ratio(own: Stack, other: Stack, setting: Setting, recording: Recording) -> float:
    """Return the log likelihood ratio of pings, each at a newly placed target, nats."""
    first, second = (law(setting.change(stack), recording.ping) for stack in (own, other))
    return float((floored(first, recording.reading) - floored(second, recording.reading)).sum())
