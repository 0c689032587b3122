"""What a line of the records must hold, so that damaged ones, and those of another version, are named."""

from __future__ import annotations

import json

from pydantic import BaseModel, ConfigDict

from noise.discrepancy.evidence import Evidence


class _Part(BaseModel):
    """A part of a record; further fields are allowed."""

    model_config = ConfigDict(strict=True)


class _True(_Part):
    effect: str
    accepted: list[str]
    size: float
    parameter: str | None
    value: float | None
    aspects: list[str]
    region: dict[str, list[float]]


class _Alternative(_Part):
    effect: str
    probability: float


class _Named(_Alternative):
    share: float | None
    alternatives: list[_Alternative]


class _Where(_Part):
    aspect: str


class _Crps(_Part):
    crps_mm: float | None


class _HeldOut(_Part):
    before: _Crps
    after: _Crps
    repeatability_mm: float | None


class _Verdict(_Part):
    verdict: str
    p_value: float
    causes: list[_Named]
    where: list[_Where]
    held_out: _HeldOut


class _Crpses(_Part):
    before: float
    again: float
    corrected: float
    causes_only: float
    own: float
    corrected_error: float
    own_error: float
    gap_error: float


class _Scores(_Crpses):
    near: _Crpses | None = None  # records of older versions lack it


class _Head(_Part):
    family: str
    kind: str
    number: int
    seed: int
    pings: int
    id: str
    commit: str
    causes: list[_True]
    fault: str
    n: int


class _Failed(_Head):
    error: str


class _Diagnosed(_Head):
    error: None
    seconds: float
    verdict: _Verdict
    intervals: dict[str, dict[str, list[float]]]
    overlap: list[float | None]
    evidence: dict[str, Evidence]
    likely: dict[str, dict[str, float]]
    scores: _Scores | None


def check_line(line: bytes) -> None:
    """Check one line of the records.

    Raises:
        ValueError: it is no record.
    """
    record = json.loads(line)
    ended = isinstance(record, dict) and record.get("error") is not None
    (_Failed if ended else _Diagnosed).model_validate_json(line)
