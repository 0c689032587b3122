"""A difference without a known cause, as a short formula: what the errors go with, never why.

Candidates are dimensionless: distance over a metre, angle over half a beam, time over the recording's length. Sparse
regression chooses among them in resamples of whole blocks; a term is kept if most resamples chose it.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from sklearn.linear_model import LassoLarsIC

from acquisition.arrays import Floats
from noise.discrepancy.locate.residuals import seen_alone
from noise.discrepancy.locate.scan import features
from noise.fitting.batch import Batch
from noise.fitting.stack import Stack

RESAMPLES = 40
STABLE = 0.7  # share of resamples that choose a term, for it to be kept
FEWEST = 16  # blocks; fewer allow any formula
HALF_BEAM_DEG = 27.5  # half of the SRF08's 55 degrees at -6 dB, Devantech
MM, DEG = 1e-3, np.pi / 180.0


@dataclass(frozen=True)
class Term:
    """One term of a formula: `coefficient`, mm, times `name`; chosen in `share` of the resamples."""

    name: str
    coefficient: float
    share: float


@dataclass(frozen=True)
class Formula:
    """What the errors of readings go with.

    Attributes:
        terms: greatest first.
        constant: mm.
        explained: share of the variance between blocks.
    """

    terms: tuple[Term, ...]
    constant: float
    explained: float

    def __str__(self) -> str:
        """Return the formula in one line."""
        parts = [f"{self.constant:+.1f} mm", *(f"{t.coefficient:+.1f} mm * {t.name}" for t in self.terms)]
        return f"reading - expected = {' '.join(parts)} (explains {100 * self.explained:.0f} % between positions)"


def formula(stack: Stack, batch: Batch, rng: np.random.Generator) -> Formula | None:
    """Return the formula that errors follow, or None where no term is stable.

    Args:
        stack: the best explanation.
        batch: readings.
        rng: for resamples of blocks.
    """
    u, law = seen_alone(stack, batch, rng)
    error = (batch.reading.range - law.quantile(0.5)) / MM
    near = ~np.isnan(u) & (np.abs(error) < 100.0 * batch.ping.distance + 50.0)
    count = batch.visit_sums(near.astype(np.float64))
    kept = count >= 2
    if kept.sum() < FEWEST:
        return None
    target = (batch.visit_sums(np.where(near, error, 0.0)) / np.maximum(count, 1.0))[kept]
    names, table = candidates(batch, kept)
    return _stable(names, table, target, rng) if names else None


def candidates(batch: Batch, kept: NDArray[np.bool_]) -> tuple[list[str], Floats]:
    """Return names and values of the candidate terms, (blocks, terms)."""
    size = np.diff(np.r_[batch.starts, len(batch)])
    column = {name: (batch.visit_sums(value) / size)[kept] for name, value in features(batch).items()}
    out: dict[str, Floats] = {}
    if "distance_mm" in column:
        d = column["distance_mm"] * MM
        out |= {"(distance / 1 m)": d, "(distance / 1 m)^2": d**2, "log(distance / 1 m)": np.log(np.maximum(d, 1e-3))}
    if "angle_deg" in column:
        a = column["angle_deg"] / HALF_BEAM_DEG
        out |= {"(angle / 27.5 deg)": a, "(angle / 27.5 deg)^2": a**2}
    if "distance_mm" in column and "angle_deg" in column:
        out["(distance / 1 m) * (angle / 27.5 deg)"] = column["distance_mm"] * MM * column["angle_deg"] / HALF_BEAM_DEG
    if "reflectance" in column:
        out["reflectance"] = column["reflectance"]
    if "time_s" in column:
        t = (column["time_s"] - column["time_s"].min()) / np.ptp(column["time_s"])
        out |= {"(time / whole recording)": t, "(time / whole recording)^2": t**2}
    usual = {"distance_mm", "angle_deg", "incidence_deg", "reflectance", "time_s", "interval_s"}
    out |= {f"({name} in standard deviations)": _standard(value) for name, value in column.items() if name not in usual}
    out = {name: value for name, value in out.items() if np.std(value) > 1e-9}
    return list(out), np.stack(list(out.values()), axis=1) if out else np.empty((int(kept.sum()), 0))


def _standard(value: Floats) -> Floats:
    return (value - value.mean()) / max(float(value.std()), 1e-12)


def _stable(names: list[str], table: Floats, target: Floats, rng: np.random.Generator) -> Formula | None:
    """Return the least-squares formula in the terms that most resamples choose."""
    low, high = np.quantile(target, [0.02, 0.98])
    bounded = np.clip(target, low, high)
    scaled = (table - table.mean(axis=0)) / table.std(axis=0)
    chosen = np.zeros(len(names))
    for _ in range(RESAMPLES):
        rows = rng.integers(0, len(target), len(target))
        chosen += _choose(scaled[rows], bounded[rows])
    share = chosen / RESAMPLES
    keep = np.flatnonzero(share >= STABLE)
    if not len(keep):
        return None
    design = np.column_stack([np.ones(len(target)), table[:, keep]])
    fitted = np.linalg.lstsq(design, bounded, rcond=None)[0]
    left = bounded - design @ fitted
    explained = float(1.0 - left.var() / max(bounded.var(), 1e-12))
    terms = [Term(names[k], float(c), float(share[k])) for k, c in zip(keep, fitted[1:], strict=True)]
    weight = {names[k]: abs(c) * table[:, k].std() for k, c in zip(keep, fitted[1:], strict=True)}
    return Formula(tuple(sorted(terms, key=lambda t: -weight[t.name])), float(fitted[0]), explained)


def _choose(table: Floats, target: Floats) -> NDArray[np.bool_]:
    """Return which terms a sparse regression chooses, by the Bayesian information criterion."""
    if target.std() < 1e-9:
        return np.zeros(table.shape[1], dtype=bool)
    noise = max(float(np.var(target - table @ np.linalg.lstsq(table, target, rcond=None)[0])), 1e-9)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # near-copies among candidates end the path early, which is what is wanted
        model = LassoLarsIC(criterion="bic", noise_variance=noise).fit(table, target - target.mean())
    return np.abs(model.coef_) > 1e-9
