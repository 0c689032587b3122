"""What a diagnosis says besides its verdict, as plain data; it knows no answer."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from noise.discrepancy.result import Diagnosis


def said(found: Diagnosis) -> dict[str, Any]:
    """Return intervals of parameters, located regions, and what the decision model knew."""
    verdict = found.verdict
    return {
        "intervals": {
            cause.effect: {name: [v.value, v.low, v.high] for name, v in cause.parameters.items()}
            for cause in verdict.causes
        },
        "regions": [{name: list(bounds) for name, bounds in each.region.items()} for each in verdict.where],
        "evidence": {name: asdict(each) for name, each in found.evidence.items()},
        "likely": {name: dict(each) for name, each in found.likely.items()},
    }
