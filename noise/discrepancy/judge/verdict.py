"""The verdict: what is claimed, with every number that the claim rests on, and its machine-readable form."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from noise.discrepancy.common.rules import Attempt
from noise.discrepancy.judge.next_measurement import Measurement
from noise.discrepancy.locate.locate import Finding
from noise.discrepancy.locate.matched import Matched
from noise.discrepancy.name.explanation import Interval

CLAIMS = ("named", "confounded", "named_with_rest")
VERDICTS = ("none", *CLAIMS, "unknown")
MM_COLUMNS = 1000.0


@dataclass(frozen=True)
class Named:
    """One effect that is claimed.

    Attributes:
        effect: id.
        indistinguishable_from: rivals that the data do not exclude.
        probability: posterior, among itself and its rivals.
        parameters: with 90 % intervals.
        gain_nats, gain_se: what it adds given the other effects, across unseen cells; standard error over blocks.
        statement: one sentence with the number and unit that matters.
    """

    effect: str
    indistinguishable_from: tuple[str, ...]
    probability: float
    parameters: dict[str, Interval]
    gain_nats: float
    gain_se: float
    statement: str


@dataclass(frozen=True)
class Rest:
    """What the explanation leaves over, on cells that it was not fitted to.

    Attributes:
        present: whether anything does.
        p_value: of the residual scan.
        description: what it looks like; a description, not a cause.
        findings: where.
        learned_nats: what a learner without physics gains on it, beyond chance and beyond what it gains on the
            simulation itself, nats; `learned_of` from "conditions" or from "memory".
    """

    present: bool
    p_value: float
    description: str | None
    findings: tuple[Finding, ...] = ()
    learned_nats: float = 0.0
    learned_of: str = "conditions"


@dataclass(frozen=True)
class Score:
    """Quality on the vault.

    Attributes:
        log_likelihood_per_ping: prequential, nuisances fitted, nats.
        crps_mm: of echoes, mm; before is the given model as it stands.
    """

    log_likelihood_per_ping: float
    crps_mm: float


@dataclass(frozen=True)
class HeldOut:
    """Before and after on cells that nothing was fitted to; the gain has a 90 % interval over blocks."""

    split: str
    n_pings: int
    before: Score
    after: Score
    gain_per_ping_low: float
    gain_per_ping_high: float


@dataclass(frozen=True)
class BaselineCheck:
    """Whether the law that stands for the simulation describes it.

    Attributes:
        describes_simulation: whether a scan of held-out simulated cells finds nothing wrong but in what air may change.
        p_value: of that scan; 1 where the given model is used as it is.
        note: in words.
        wholly: whether nothing is wrong with how readings of one position scatter and hang together, either.
    """

    describes_simulation: bool
    p_value: float
    note: str
    wholly: bool = True


@dataclass(frozen=True)
class Verdict:
    """Everything that is claimed about one recording."""

    verdict: str
    p_value: float
    where: tuple[Finding, ...]
    effects: tuple[Named, ...]
    unknown: Rest
    held_out: HeldOut
    next_measurement: tuple[Measurement, ...]
    baseline_check: BaselineCheck
    attempts: tuple[Attempt, ...]
    matched: Matched | None = None

    @property
    def mismatch(self) -> bool:
        """Whether recording and model differ at all."""
        return self.verdict != "none"

    @property
    def claims(self) -> bool:
        """Whether a cause is named, be it one of several."""
        return self.verdict in CLAIMS

    def to_dict(self) -> dict[str, Any]:
        """Return the verdict file's content."""
        return {
            "mismatch": self.mismatch,
            "p_value": _plain(self.p_value),
            "verdict": self.verdict,
            "where": [_where(finding) for finding in self.where],
            "effects": [_effect(named) for named in self.effects],
            "unknown": {
                "present": self.unknown.present,
                "p_value": _plain(self.unknown.p_value),
                "description": self.unknown.description,
            },
            "held_out": _held_out(self.held_out),
            "next_measurement": [measurement.to_dict() for measurement in self.next_measurement],
            "next_settings": [measurement.settings() for measurement in self.next_measurement],
            "baseline_check": {
                "describes_simulation": self.baseline_check.describes_simulation,
                "p_value": _plain(self.baseline_check.p_value),
                "note": self.baseline_check.note,
            },
            "matched_cells": None
            if self.matched is None
            else {
                "cells": self.matched.cells,
                "p_value": _plain(self.matched.p_value),
                "shift_mm": _plain(MM_COLUMNS * self.matched.shift_m),
            },
            "tried": [_attempt(attempt) for attempt in self.attempts],
        }


def _plain(value: float) -> float | None:
    """Return a number that JSON can hold, rounded to what is meant."""
    return float(f"{value:.6g}") if math.isfinite(value) else None


def _where(finding: Finding) -> dict[str, Any]:
    in_mm = finding.unit == "m"
    return {
        "aspect": finding.aspect,
        "region": {column: [_plain(low), _plain(high)] for column, (low, high) in finding.region.items()},
        "size": _plain(finding.size * MM_COLUMNS if in_mm else finding.size),
        "unit": "mm" if in_mm else finding.unit,
        "p_value": _plain(finding.p_value),
        **({} if finding.place is None else {"place": list(finding.place)}),
    }


def _effect(named: Named) -> dict[str, Any]:
    return {
        "effect": named.effect,
        "indistinguishable_from": list(named.indistinguishable_from),
        "probability": _plain(named.probability),
        "parameters": {
            name: {"value": _plain(p.value), "low": _plain(p.low), "high": _plain(p.high), "unit": p.unit}
            for name, p in named.parameters.items()
        },
        "gain_nats": _plain(named.gain_nats),
        "gain_se": _plain(named.gain_se),
        "statement": named.statement,
    }


def _score(score: Score) -> dict[str, Any]:
    return {"log_likelihood_per_ping": _plain(score.log_likelihood_per_ping), "crps_mm": _plain(score.crps_mm)}


def _held_out(held: HeldOut) -> dict[str, Any]:
    return {
        "split": held.split,
        "n_pings": held.n_pings,
        "before": _score(held.before),
        "after": _score(held.after),
        "gain_per_ping_low": _plain(held.gain_per_ping_low),
        "gain_per_ping_high": _plain(held.gain_per_ping_high),
    }


def _attempt(attempt: Attempt) -> dict[str, Any]:
    return {
        "effect": attempt.effect,
        "given": list(attempt.given),
        "fitted_nats": _plain(attempt.screen_nats),
        "gain_nats": _plain(attempt.gain_nats),
        "gain_se": _plain(attempt.gain_se),
        "decision": attempt.decision,
    }
