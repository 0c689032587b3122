"""Figures of a diagnosis, as SVG text for HTML pages."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from acquisition.arrays import Floats, Ints
from noise.discrepancy import Diagnosis
from noise.discrepancy.locate.residuals import pit
from noise.fitting.batch import Batch
from noise.law import CREDENCE_TOLERANCE, EchoLaw
from noise.model import SonarModel
from training.common.canvas import AFTER, BEFORE, INK, SOFT, Axes, TwoSlopeNorm, svg

MAX_POINTS = 2500
MAX_LARGE_POINTS = 500  # up to this number, points are drawn larger
DEG = np.pi / 180.0


@dataclass(frozen=True)
class Prediction:
    """Law and median reading of one model for a batch."""

    batch: Batch
    law: EchoLaw
    median: Floats

    @classmethod
    def of(cls, model: SonarModel, batch: Batch) -> Prediction:
        """Return the prediction of a model for a batch."""
        law = model.law(batch.ping, batch.past)
        return cls(batch, law, law.quantile(0.5))

    @property
    def error_mm(self) -> Floats:
        """Reading minus predicted median, mm; nan without an echo or if the model predicts none."""
        known = self.batch.reading.echo & (self.median > 0)
        return np.where(known, 1000.0 * (self.batch.reading.range - self.median), np.nan)


def _sampled(n: int) -> Ints:
    return np.unique(np.linspace(0, n - 1, min(n, MAX_POINTS)).astype(np.int64))


def readings(before: Prediction, after: Prediction) -> str:
    """Draw readings and both predictions against true distance."""

    def draw(axes: Axes) -> None:
        batch = before.batch
        rows = _sampled(len(batch))
        echo = batch.reading.echo[rows]
        distance, reading = batch.ping.distance[rows], batch.reading.range[rows]
        size = 3 if len(rows) > MAX_LARGE_POINTS else 6
        axes.plot(distance[echo], reading[echo], ".", ms=size, color=INK, alpha=0.45, rasterized=True, label="recorded")
        silent = distance[~echo]
        if len(silent):
            axes.plot(silent, np.zeros(len(silent)), "|", ms=7, color=SOFT, rasterized=True, label="no echo")
        for each, colour, label in ((before, BEFORE, "model before"), (after, AFTER, "corrected model")):
            x, y = _binned(batch.ping.distance, np.where(each.median > 0, each.median, np.nan), np.nanmedian)
            axes.plot(x, y, color=colour, lw=1.8, label=label, ls="--" if each is before else "-")
        axes.set(xlabel="true distance (m)", ylabel="reading (m)")
        axes.set_ylim(bottom=-0.05 * max(reading.max(initial=0.1), 0.1))
        axes.legend(loc="upper left")

    return svg(draw, "readings")


def errors(before: Prediction, after: Prediction) -> str:
    """Draw reading minus prediction against distance."""

    def draw(axes: Axes) -> None:
        rows = _sampled(len(before.batch))
        limit = 2.5 * map_limit(before, after)
        axes.axhline(0, color=SOFT, lw=0.8)
        for each, colour, label in ((before, BEFORE, "model before"), (after, AFTER, "corrected model")):
            error = np.clip(each.error_mm[rows], -limit, limit)
            distance, size = each.batch.ping.distance[rows], 3 if len(rows) > MAX_LARGE_POINTS else 6
            axes.plot(distance, error, ".", ms=size, color=colour, alpha=0.4, rasterized=True, label=label)
        axes.set(xlabel="true distance (m)", ylabel="reading - prediction (mm)", ylim=(-limit * 1.05, limit * 1.05))
        axes.legend(loc="best", markerscale=3)

    return svg(draw, "errors")


def along_time(before: Prediction, after: Prediction) -> str:
    """Draw median and quartiles of reading minus prediction against time."""

    def draw(axes: Axes) -> None:
        limit = map_limit(before, after)
        minutes = before.batch.ping.time / 60.0
        axes.axhline(0, color=SOFT, lw=0.8)
        for each, colour, label in ((before, BEFORE, "model before"), (after, AFTER, "corrected model")):
            x, middle = _binned(minutes, each.error_mm, np.nanmedian)
            low, high = (_binned(minutes, each.error_mm, partial(np.nanquantile, q=q))[1] for q in (0.25, 0.75))
            axes.fill_between(x, low, high, color=colour, alpha=0.2, lw=0)
            axes.plot(x, middle, color=colour, lw=1.8, label=label, ls="--" if each is before else "-")
        axes.set(xlabel="time since the recording began (min)", ylabel="reading - prediction (mm)")
        axes.set_ylim(-2.0 * limit, 2.0 * limit)
        axes.legend(loc="best")

    return svg(draw, "along_time")


def _binned(x: Floats, y: Floats, summary: Callable[[Floats], float], bins: int = 24) -> tuple[Floats, Floats]:
    edges = np.unique(np.quantile(x, np.linspace(0, 1, bins + 1)))
    if len(edges) < 2:
        return np.array([x.mean()]), np.array([summary(y)])
    place = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, len(edges) - 2)
    filled = [k for k in range(len(edges) - 1) if np.isfinite(y[place == k]).any()]
    return np.array([x[place == k].mean() for k in filled]), np.array([summary(y[place == k]) for k in filled])


def _curve(
    before: Prediction, after: Prediction, name: str, truth: Floats, of: Callable[[EchoLaw], Floats], label: str
) -> str:
    def draw(axes: Axes) -> None:
        distance = before.batch.ping.distance
        x, y = _binned(distance, truth, np.mean, 16)
        axes.plot(x, 100 * y, "o", ms=5, color=INK, label="recorded")
        for each, colour, text in ((before, BEFORE, "model before"), (after, AFTER, "corrected model")):
            x, y = _binned(distance, of(each.law), np.mean, 16)
            axes.plot(x, 100 * y, color=colour, lw=1.8, ls="--" if each is before else "-", label=text)
        axes.set(xlabel="true distance (m)", ylabel=label, ylim=(-3, 105))
        axes.legend(loc="best")

    return svg(draw, name)


def detection(before: Prediction, after: Prediction) -> str:
    """Draw the share of pings with an echo against distance."""
    echo = before.batch.reading.echo.astype(np.float64)
    return _curve(before, after, "detection", echo, lambda law: law.echo, "pings with an echo (%)")


def credence(before: Prediction, after: Prediction) -> str:
    """Draw the share of readings within 10 % of the truth against distance."""
    batch = before.batch
    right = np.abs(batch.reading.range - batch.ping.distance) <= CREDENCE_TOLERANCE * batch.ping.distance
    truth = (batch.reading.echo & right).astype(np.float64)
    return _curve(before, after, "credence", truth, lambda law: law.credence(), "readings within ±10 % (%)")


def calibration(before: Prediction, after: Prediction, seed: int) -> str:
    """Draw histograms of PIT values, which are uniform for a correct model."""

    def draw(axes: Axes) -> None:
        edges = np.linspace(0, 1, 21)
        for each, colour, label in ((before, BEFORE, "model before"), (after, AFTER, "corrected model")):
            u = pit(each.law, each.batch.reading, np.random.default_rng(seed).random(len(each.batch)))
            u = np.where(each.batch.reading.echo & np.isnan(u), 0.5, u)  # readings of probability 0
            share = np.histogram(u[~np.isnan(u)], edges)[0] / max(np.sum(~np.isnan(u)), 1) * 20
            axes.stairs(share, edges, color=colour, lw=1.8, label=label, ls="--" if each is before else "-")
        axes.axhline(1, color=SOFT, lw=0.8)
        axes.set(xlabel="quantile of the reading in the prediction (PIT)", ylabel="density")
        axes.set_xticks([0, 0.5, 1], ["0 (short)", "0.5", "1 (long)"])
        axes.set_ylim(0, 6)
        axes.legend(loc="best")

    return svg(draw, "calibration")


def error_map(prediction: Prediction, name: str, limit_mm: float) -> str:
    """Draw the median error over distance and angle; conditions with mostly no echo are marked."""
    batch, error = prediction.batch, prediction.error_mm
    condition = np.unique(batch.condition, return_inverse=True)[1]
    count = np.bincount(condition)
    distance = np.bincount(condition, batch.ping.distance) / count
    angle = np.bincount(condition, batch.ping.angle) / count / DEG
    silent = np.bincount(condition, ~batch.reading.echo) / count
    order = np.argsort(condition, kind="stable")
    parts = np.split(error[order], np.cumsum(count)[:-1])
    value = np.array([np.nanmedian(p) if np.isfinite(p).any() else np.nan for p in parts])

    def draw(axes: Axes) -> None:
        known = np.isfinite(value)
        norm = TwoSlopeNorm(0.0, -limit_mm, limit_mm)
        shown = np.clip(value[known], -limit_mm, limit_mm)
        points = axes.scatter(
            distance[known], angle[known], c=shown, norm=norm, cmap="RdBu_r", s=34, lw=0.4, edgecolor=SOFT
        )
        lost = silent > 0.5
        axes.plot(distance[lost], angle[lost], "x", color=INK, ms=4, mew=0.9, label="mostly no echo", ls="")
        axes.set(xlabel="true distance (m)", ylabel="angle (deg)")
        bar = axes.figure.colorbar(points, ax=axes, pad=0.02)
        bar.set_label("reading - prediction (mm)")
        if lost.any():
            axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.0, fontsize=9)  # outside the axes

    return svg(draw, name)


def near(prediction: Prediction) -> Floats:
    """Return the errors of readings within 15 % + 10 cm of the prediction, mm."""
    error = prediction.error_mm[np.isfinite(prediction.error_mm)]
    distance = prediction.batch.ping.distance[np.isfinite(prediction.error_mm)]
    return error[np.abs(error) < 150.0 * distance + 100.0]


def map_limit(*predictions: Prediction) -> float:
    """Return the error at which the colours of several maps saturate, mm; outliers are excluded."""
    error = np.concatenate([near(prediction) for prediction in predictions])
    return max(float(np.quantile(np.abs(error), 0.9)) if len(error) else 5.0, 2.0)


def all_figures(diagnosis: Diagnosis, seed: int = 0) -> dict[str, str]:
    """Return the figures of a report by name. Curves show the test set; maps show all conditions."""
    split = diagnosis.split
    before, after = (Prediction.of(m, split.vault) for m in (diagnosis.shown_before, diagnosis.corrected))
    all_before, all_after = (Prediction.of(m, split.whole) for m in (diagnosis.shown_before, diagnosis.corrected))
    limit = map_limit(all_before, all_after)
    compared = any(np.isfinite(each.error_mm).any() for each in (before, after))  # false if no ping has an echo
    return {
        "map_before": error_map(all_before, "map_before", limit),
        "map_after": error_map(all_after, "map_after", limit),
        "along_time": along_time(all_before, all_after) if split.whole.timed and compared else "",
        "readings": readings(before, after),
        "errors": errors(before, after) if compared else "",
        "detection": detection(before, after),
        "credence": credence(before, after),
        "calibration": calibration(before, after, seed) if compared else "",
    }
