"""What a model predicts for the pings of a recording, and the observed values that figures compare with it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from acquisition.arrays import Bits, Floats
from noise.discrepancy.moments.regressors import octave, previous_place, since_echo
from noise.discrepancy.moments.sample import logged_names
from noise.discrepancy.report.numbers import time_unit
from noise.discrepancy.result import Aspect, Diagnosis, Location, Verdict
from noise.effects.base import target_tolerance
from noise.fitting.batch import Batch
from noise.law import EchoLaw
from noise.model import SonarModel, StatefulModel, order_of, with_order
from training.common.canvas import AFTER, BEFORE

BEFORE_LABEL, AFTER_LABEL = "your simulation", "corrected model"
MAX_PINGS = 10_000  # in a figure; more cost seconds and are not visible
DEG = 180.0 / np.pi
# column -> label of its axis, factor to the unit of the label
AXES = {
    "distance": ("true distance (mm)", 1000.0),
    "angle": ("angle (deg)", DEG),
    "abs_angle": ("angle to either side (deg)", DEG),
    "incidence": ("incidence angle (deg)", DEG),
    "reflectance": ("reflectance", 1.0),
    "run": ("session (counted from 0)", 1.0),
    "interval_s": ("time since the previous ping (ms)", 1000.0),
    "temperature_c": ("logged temperature (°C)", 1.0),
    "humidity_pct": ("logged humidity (%)", 1.0),
    "range_mm": ("maximum range (mm)", 1.0),
    "range_rate_mps": ("range rate (m/s)", 1.0),
    "order": ("earlier pings of the visit (at least)", 1.0),
    "previous_reading": ("what the ping before read", 1.0),
    "movement": ("change of distance since the last echo (mm)", 1000.0),
    "period_s": ("time within the period (s)", 1.0),
}
# columns of the past of each ping; NaN where it has none
PAST: dict[str, Callable[[Batch], Floats]] = {
    "order": lambda batch: octave(order_of(batch.ping)),
    "previous_reading": previous_place,
    "movement": since_echo,
}
SHARES = {
    Aspect.DETECTION: "pings with an echo (%)",
    Aspect.EARLY: "readings far before the target (%)",
    Aspect.LATE: "readings far behind the target (%)",
    Aspect.COINCIDENCE: "readings far behind the target (%)",
    Aspect.REPEAT: "readings equal to the one before (%)",
}


@dataclass(frozen=True, eq=False)
class Prediction:
    """Law and median reading of one model for a batch."""

    batch: Batch
    law: EchoLaw

    @classmethod
    def of(cls, model: SonarModel, batch: Batch) -> Prediction:
        """Return the prediction of a model for a batch, each ping given the reading before it."""
        return cls(batch, model.law(batch.ping, batch.past))

    @cached_property
    def median(self) -> Floats:
        """Median of the predicted echoes, m, (n,); 0 where none is possible."""
        return self.law.quantile(0.5)

    @cached_property
    def error_mm(self) -> Floats:
        """Reading minus predicted median, mm, (n,); NaN without an echo or if the model predicts none."""
        known = self.batch.reading.echo & (self.median > 0)
        return np.where(known, 1000.0 * (self.batch.reading.range - self.median), np.nan)

    @property
    def near_mm(self) -> Floats:
        """Errors of readings within the tolerance about the target, mm."""
        near = np.abs(self.error_mm) < 1000.0 * target_tolerance(self.batch.ping.distance)
        return self.error_mm[near]

    def probability(self, aspect: Aspect) -> Floats:
        """Return the predicted probability of what an aspect counts, (n,)."""
        law, distance = self.law, self.batch.ping.distance
        tolerance = target_tolerance(distance)
        if aspect is Aspect.EARLY:
            return law.arrival(distance - tolerance)
        if aspect in (Aspect.LATE, Aspect.COINCIDENCE):
            return law.echo - law.arrival(distance + tolerance)
        if aspect is Aspect.REPEAT:
            step = law.step(self.batch.past.range)
            return np.where(self.batch.past.echo, law.between(law.edge(step - 1), law.edge(step)), 0.0)
        return law.echo


def observed(batch: Batch, aspect: Aspect) -> Bits:
    """Return which pings show what an aspect counts, (n,)."""
    error, tolerance = batch.reading.range - batch.ping.distance, target_tolerance(batch.ping.distance)
    if aspect is Aspect.EARLY:
        return batch.reading.echo & (error < -tolerance)
    if aspect in (Aspect.LATE, Aspect.COINCIDENCE):
        return batch.reading.echo & (error > tolerance)
    return batch.repeats if aspect is Aspect.REPEAT else batch.reading.echo


def outliers(batch: Batch) -> Bits:
    """Return which pings read far before or behind the target, (n,)."""
    return observed(batch, Aspect.EARLY) | observed(batch, Aspect.LATE)


def predictor(diagnosis: Diagnosis) -> SonarModel:
    """Return the user's simulation, or its emulator where the simulation has no law of single pings."""
    before = diagnosis.before
    if isinstance(before, StatefulModel):
        return diagnosis.emulator
    known = before.law(diagnosis.recorded.ping[:1], diagnosis.recorded.past[:1]).has_probabilities
    return before if known else diagnosis.emulator


def thinned(batch: Batch) -> Batch:
    """Return at most `MAX_PINGS` pings, evenly over the recording, each with its order in the visit."""
    rows = np.unique(np.linspace(0, len(batch) - 1, min(len(batch), MAX_PINGS)).astype(np.int64))
    mask = np.zeros(len(batch), dtype=bool)
    mask[rows] = True
    return batch if mask.all() else replace(batch, ping=with_order(batch.ping)).select(mask)


@dataclass(frozen=True, eq=False)
class Compared:
    """Predictions of the user's simulation and, if one is offered, of the corrected model."""

    before: Prediction
    after: Prediction | None

    @classmethod
    def of(cls, diagnosis: Diagnosis, rows: Bits | None = None) -> Compared:
        """Return the predictions for the recording, or for the pings at a mask, at most `MAX_PINGS` of them."""
        batch = thinned(diagnosis.recorded if rows is None else diagnosis.recorded.select(rows))
        after = None if diagnosis.corrected is None else Prediction.of(diagnosis.corrected, batch)
        return cls(Prediction.of(predictor(diagnosis), batch), after)

    @property
    def each(self) -> list[tuple[Prediction, str, str, str]]:
        """Prediction, colour, label and line style of each model."""
        first = (self.before, BEFORE, BEFORE_LABEL, "--")
        return [first] if self.after is None else [first, (self.after, AFTER, AFTER_LABEL, "-")]

    @property
    def limit_mm(self) -> float:
        """Error at which axes and colours saturate, mm; outliers are excluded."""
        error = np.concatenate([prediction.near_mm for prediction, *_ in self.each])
        return max(float(np.quantile(np.abs(error), 0.9)) if len(error) else 5.0, 2.0)

    @property
    def has_errors(self) -> bool:
        """Whether any reading can be compared with a prediction."""
        return bool(np.isfinite(self.before.error_mm).any())


def column(batch: Batch, name: str, found: Location | None = None) -> Floats | None:
    """Return a column of the conditions or of the past in the unit of its axis, (n,); NaN where it is unknown.

    It is None if it was not logged or does not vary.

    Args:
        batch: readings.
        name: column of a region.
        found: mismatch of which a period is that of "period_s".
    """
    ping = batch.ping
    value = {"abs_angle": np.abs(ping.angle), **ping.covariates, **vars(ping)}.get(name)
    if value is None and name in PAST:
        value = PAST[name](batch)
    if value is None and name == "period_s" and found is not None:
        value = ping.time % found.region[name][0]
    if value is None or (name == "time" and not batch.timed):
        return None
    known = value[np.isfinite(value)]
    if not len(known) or np.ptp(known) < 1e-3 * max(1.0, np.abs(known).max()):
        return None
    return np.asarray(value, dtype=np.float64) * axis(name, batch)[1]


def axis(name: str, batch: Batch) -> tuple[str, float]:
    """Return the label of a column's axis and the factor to its unit."""
    if name == "time":
        factor, unit = time_unit(float(batch.ping.time.max()))
        return f"time since the recording began ({unit})", factor
    return AXES.get(name, (name, 1.0))


def mismatches(verdict: Verdict) -> list[Location]:
    """Return the located mismatches, those that causes leave or that are too small to matter last."""
    return [*verdict.where, *verdict.unexplained.where]


def along(found: Location | None, batch: Batch) -> str | None:
    """Return the column that the region of a mismatch restricts most, else one that varies; None if none does."""
    region = {} if found is None else found.region
    widths = {}
    for name, (low, high) in region.items():
        value = column(batch, name, found)
        if value is not None:
            factor = axis(name, batch)[1]
            inside = (value >= factor * low) & (value <= factor * high)
            widths[name] = float(inside.mean())
    if widths:
        return min(widths, key=lambda name: widths[name])
    others = ("distance", "angle", "incidence", "reflectance", "time", *logged_names(batch.ping), "run")
    return next((name for name in others if column(batch, name) is not None), None)


def binned(x: Floats, y: Floats, summary: Callable[[Floats], float], bins: int = 24) -> tuple[Floats, Floats]:
    """Return mean x and a summary of y in bins of equal counts, or at each of few x; empty bins are omitted."""
    known = np.isfinite(x)
    x, y = x[known], y[known]
    different, bin_of = np.unique(x, return_inverse=True)
    if len(different) > bins:
        edges = np.unique(np.quantile(x, np.linspace(0, 1, bins + 1)))
        bin_of = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, len(edges) - 2)
    filled = [k for k in np.unique(bin_of) if np.isfinite(y[bin_of == k]).any()]
    centres = np.array([x[bin_of == k].mean() for k in filled])
    return centres, np.array([summary(y[bin_of == k]) for k in filled])
