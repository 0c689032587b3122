"""Verdict and diagnosis: what is claimed about a recording, with every number that the claim rests on.

`Verdict.to_dict` writes schema 2 of verdict.json. Lengths are in m in Python and in mm in the file.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquisition.brief import shortened
from noise.discrepancy.evidence import Evidence
from noise.discrepancy.presented import Presented
from noise.discrepancy.thresholds import BELIEVED, LEAST_CHANCE
from noise.fitting.batch import Batch
from noise.model import SonarModel

SCHEMA = 2
LEVEL = 0.9  # of every interval
MM = 1000.0
Range = tuple[float, float]


class Kind(StrEnum):
    """The verdict in one word."""

    NONE = "none"
    EXPLAINED = "explained"
    PARTLY_EXPLAINED = "partly_explained"
    UNEXPLAINED = "unexplained"
    TOO_LITTLE_DATA = "too_little_data"


class Aspect(StrEnum):
    """An aspect in which readings can differ from a law; `unit` is that of its size, `words` a name of the change."""

    unit: str
    words: str

    BIAS = "bias", "m", "mean error"
    SPREAD = "spread", "1", "change of the scatter of echoes"
    SKEW = "skew", "1", "lopsided scatter of echoes"
    DETECTION = "detection", "1", "change of the share of pings with an echo"
    EARLY = "early", "1", "change of the share of readings far before the target"
    LATE = "late", "1", "change of the share of readings far behind the target"
    REPEAT = "repeat", "1", "change of the share of readings that repeat the one before"
    MEMORY = "memory", "1", "change of how closely errors follow the error before"
    COINCIDENCE = "coincidence", "1", "change of how well far readings of one position agree"

    def __new__(cls, value: str, unit: str, words: str) -> Aspect:
        """Return a member with its unit and its description."""
        member = str.__new__(cls, value)
        member._value_, member.unit, member.words = value, unit, words
        return member


@dataclass(frozen=True)
class PValue:
    """A p-value of a bootstrap.

    Attributes:
        value: p-value; at the end of the bootstrap its resolution, 1 / (draws + 1).
        draws: number of bootstrap draws, of several tests divided by their number; 0 for a test without a bootstrap.
        n_regressors, n_aspects: number of statistics of which the greatest is tested.
    """

    value: float
    draws: int
    n_regressors: int = 1
    n_aspects: int = 1

    @property
    def at_end(self) -> bool:
        """Whether no draw of the bootstrap was as extreme, so that the p-value is an upper bound."""
        return self.draws > 0 and self.value <= 1.0 / (self.draws + 1) * (1.0 + 1e-9)

    def __str__(self) -> str:
        end = 1.0 / self.draws if self.at_end else LEAST_CHANCE
        return f"< {end:.1g}" if self.value <= end else f"{self.value:.2g}"

    @property
    def meaning(self) -> str:
        """The statistic and the resolution of the bootstrap, as words."""
        end = f", resolution 1 / {self.draws + 1}" if self.draws else ""
        return f"max over {self.n_regressors} regressors x {self.n_aspects} aspects{end}"


@dataclass(frozen=True)
class Interval:
    """A value with an interval of level `LEVEL`, in the unit given ("m", "degC", "1")."""

    value: float
    low: float
    high: float
    unit: str


@dataclass(frozen=True)
class Location:
    """A located mismatch.

    Attributes:
        aspect: what differs.
        region: column -> (low, high), SI units and rad; columns of the confidence region that are not restricted are
            absent. Columns are "distance", "angle", "incidence", "reflectance", "time", "interval_s", logged columns.
        size: mean difference in the region and its interval, in the aspect's unit.
        p_value: of the difference.
    """

    aspect: Aspect
    region: Mapping[str, Range]
    size: Interval
    p_value: PValue


@dataclass(frozen=True)
class Alternative:
    """Another effect in the place of a cause, with the probability that it is the one."""

    effect: str
    probability: float


@dataclass(frozen=True)
class Cause:
    """A difference between simulation and recording that a catalogue effect describes.

    Attributes:
        effect: effect id.
        probability: calibrated probability that this effect is a cause.
        alternatives: effects that the data do not exclude in its place.
        share: share of the misfit that it explains, 0 to 1, with its interval.
        gain_nats, gain_se: log-likelihood on unseen visits that is lost without it; standard error over visits.
        parameters: values in the recording, of signed sizes and lost readings their differences, with intervals.
        statement: one sentence with the number and unit that matters.
    """

    effect: str
    probability: float
    alternatives: tuple[Alternative, ...]
    share: Interval
    gain_nats: float
    gain_se: float
    parameters: Mapping[str, Interval]
    statement: str

    @property
    def believed(self) -> bool:
        """Whether this effect or one of its alternatives is more likely a cause than not."""
        return self.probability + sum(each.probability for each in self.alternatives) >= BELIEVED


@dataclass(frozen=True)
class Unexplained:
    """The rest: its share of the misfit, the test of the corrected law, and where it is; of alike files, trifles."""

    share: Interval
    p_value: PValue
    where: tuple[Location, ...] = ()
    description: str | None = None


@dataclass(frozen=True)
class Visible:
    """The least size of an effect or aspect that this recording shows with a power of 90 %."""

    effect: str
    least: float
    unit: str


@dataclass(frozen=True)
class Score:
    """Mean log-likelihood, nats per ping, and mean CRPS with silence counted, m, on unseen visits."""

    log_likelihood_per_ping: float
    crps_m: float


@dataclass(frozen=True)
class HeldOut:
    """Scores on visits that no estimate used, for the user's simulation, the emulator, and the corrected model.

    Attributes:
        n_pings, n_visits: size of the test set.
        before: the user's own simulation.
        emulator: the law that describes the simulation.
        after: the corrected model; that of `before` where no correction is offered.
        repeatability: CRPS of a forest of the recording's own readings, m: what the best model could reach.
        gain_per_ping: log-likelihood per ping of `after` minus `before`, nats, with its interval over visits.
    """

    n_pings: int
    n_visits: int
    before: Score
    emulator: Score
    after: Score
    repeatability_m: float
    gain_per_ping: Interval
    split: str = "visits"


@dataclass(frozen=True)
class Measurement:
    """A measurement that separates alternatives: what to do, in plain English, with how many pings.

    Attributes:
        do: instruction in plain English.
        separates: effect ids.
        pings: number of pings.
        conditions: proposed conditions, columns in SI units and rad, (n,) each; empty where another instrument decides.
        also: other settings by name (gain, interval_s, ...).
    """

    do: str
    separates: tuple[str, ...]
    pings: int
    conditions: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    also: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class BaselineCheck:
    """Whether the emulator describes the simulation, and how far the conditions of the two files overlap (0 to 1)."""

    describes_simulation: bool
    p_value: PValue
    overlap: float
    note: str = ""


@dataclass(frozen=True)
class Verdict:
    """Everything that is claimed about one recording; `warnings` holds plain sentences about the data."""

    verdict: Kind
    summary: str
    p_value: PValue
    where: tuple[Location, ...]
    causes: tuple[Cause, ...]
    unexplained: Unexplained
    could_have_seen: tuple[Visible, ...]
    held_out: HeldOut
    next_measurement: tuple[Measurement, ...]
    baseline_check: BaselineCheck
    warnings: tuple[str, ...] = ()

    def __repr__(self) -> str:
        return shortened(f"<Verdict {self.verdict}: {self.summary}>")

    def to_dict(self) -> dict[str, Any]:
        """Return the content of verdict.json."""
        rest = self.unexplained
        share = (rest.share.value, rest.share.low, rest.share.high)
        return {
            "schema": SCHEMA,
            "verdict": str(self.verdict),
            "summary": self.summary,
            "p_value": _plain(self.p_value.value),
            "p_value_text": str(self.p_value),
            "p_value_is": self.p_value.meaning,
            "where": [_location(each) for each in self.where],
            "causes": [_cause(each) for each in self.causes],
            "unexplained": {
                **dict(zip(("share", "low", "high"), map(_plain, share), strict=True)),
                "p_value": _plain(rest.p_value.value),
                "where": [_location(each) for each in rest.where],
                "description": rest.description,
            },
            "could_have_seen": [_visible(each) for each in self.could_have_seen],
            "held_out": _held_out(self.held_out),
            "next_measurement": [_measurement(each) for each in self.next_measurement],
            "baseline_check": {
                "describes_simulation": self.baseline_check.describes_simulation,
                "p_value": _plain(self.baseline_check.p_value.value),
                "overlap": _plain(self.baseline_check.overlap),
                "note": self.baseline_check.note,
            },
            "warnings": list(self.warnings),
        }


@dataclass(frozen=True, eq=False, repr=False)
class Diagnosis(Presented):
    """A verdict, the models, and the readings that figures are drawn from.

    Attributes:
        verdict: everything that is claimed.
        recorded: answered pings of the recording, n of them.
        simulated: readings of the simulation; None where a model with a known law was given.
        unseen: which recorded pings belong to visits that no estimate used, (n,).
        before: the user's own simulation as a law: the given model, or the readings of the nearest simulated visits.
        emulator: law that describes the simulation.
        corrected: the corrected model; None where no correction beats the simulation on unseen visits.
        causes_only: the corrected model without the empirical term; None where no cause is believed.
        recording: name of the recording.
        unanswered: number of pings without an answer, which were left out.
        difference: what differs, acting on the readings of the simulator, for `correct`; None where nothing found
            predicts the recording better than the simulation.
        left_out: believed cause that cannot act so -> why.
        evidence: what the decision model knew of each selected effect, believed or not.
        likely: selected effect -> effect in its place -> probability.
    """

    verdict: Verdict
    recorded: Batch
    simulated: Batch | None
    unseen: NDArray[np.bool_]
    before: SonarModel
    emulator: SonarModel
    corrected: SonarModel | None
    causes_only: SonarModel | None
    recording: str
    unanswered: int
    difference: SonarModel | None = None
    left_out: Mapping[str, str] = field(default_factory=dict)
    evidence: Mapping[str, Evidence] = field(default_factory=dict)
    likely: Mapping[str, Mapping[str, float]] = field(default_factory=dict)


def _plain(value: float) -> float | None:
    """Return a number that JSON can hold, rounded to what is meant."""
    return float(f"{value:.6g}") if math.isfinite(value) else None


DEG = 180.0 / math.pi
COLUMNS = {"distance": ("distance_mm", MM), "angle": ("angle_deg", DEG), "incidence": ("incidence_deg", DEG)}
COLUMNS |= {"time": ("time_s", 1.0), "abs_angle": ("abs_angle_deg", DEG), "movement": ("movement_mm", MM)}


def _location(found: Location) -> dict[str, Any]:
    named = {COLUMNS.get(name, (name, 1.0)): bounds for name, bounds in found.region.items()}
    size = _interval(found.size)
    return {
        "aspect": str(found.aspect),
        "region": {name: [_plain(factor * end) for end in ends] for (name, factor), ends in named.items()},
        "size": size["value"],
        **{name: size[name] for name in ("unit", "low", "high")},
        "p_value": _plain(found.p_value.value),
    }


def _interval(found: Interval) -> dict[str, Any]:
    factor, unit = (MM, "mm") if found.unit == "m" else (1.0, found.unit)
    numbers = {name: _plain(factor * getattr(found, name)) for name in ("value", "low", "high")}
    return {**numbers, "level": LEVEL, "unit": unit}


def _cause(cause: Cause) -> dict[str, Any]:
    return {
        "effect": cause.effect,
        "probability": _plain(cause.probability),
        "alternatives": [{"effect": a.effect, "probability": _plain(a.probability)} for a in cause.alternatives],
        "share": _plain(cause.share.value),
        "share_low": _plain(cause.share.low),
        "share_high": _plain(cause.share.high),
        "gain_nats": _plain(cause.gain_nats),
        "gain_se": _plain(cause.gain_se),
        "parameters": {name: _interval(value) for name, value in cause.parameters.items()},
        "statement": cause.statement,
    }


def _visible(each: Visible) -> dict[str, Any]:
    factor, unit = (MM, "mm") if each.unit == "m" else (1.0, each.unit)
    return {"effect": each.effect, "least": _plain(factor * each.least), "unit": unit}


def _score(score: Score) -> dict[str, Any]:
    return {"log_likelihood_per_ping": _plain(score.log_likelihood_per_ping), "crps_mm": _plain(MM * score.crps_m)}


def _held_out(held: HeldOut) -> dict[str, Any]:
    return {
        "split": held.split,
        "n_pings": held.n_pings,
        "n_visits": held.n_visits,
        "before": _score(held.before),
        "emulator": _score(held.emulator),
        "after": _score(held.after),
        "repeatability_mm": _plain(MM * held.repeatability_m),
        **{f"gain_per_ping_{end}": _plain(getattr(held.gain_per_ping, end)) for end in ("low", "high")},
    }


def _measurement(each: Measurement) -> dict[str, Any]:
    columns = {COLUMNS.get(name, (name, 1.0)): value for name, value in each.conditions.items()}
    rows = [
        {name: _plain(factor * value[k]) for (name, factor), value in columns.items()}
        for k in range(max((len(value) for value in columns.values()), default=0))
    ]
    named = {"do": each.do, "separates": list(each.separates), "pings": each.pings, "conditions": rows}
    return {**named, "also": dict(each.also)}
