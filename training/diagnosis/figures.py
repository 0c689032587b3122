"""Figures of a diagnosis, as SVG text that can be put into a page."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from noise.discrepancy import Diagnosis
from noise.discrepancy.residuals import pit
from noise.fitting.batch import Batch
from noise.law import CREDENCE_TOLERANCE, EchoLaw
from noise.model import SonarModel
from training.common.canvas import AFTER, BEFORE, INK, SOFT, Axes, TwoSlopeNorm, svg

Floats = NDArray[np.float64]
MOST_POINTS = 2500
FEW_POINTS = 500  # below this, points are drawn larger
DEG = np.pi / 180.0


@dataclass(frozen=True)
class Seen:
    """A batch through one model: median reading, law and residuals, for drawing."""

    batch: Batch
    law: EchoLaw
    median: Floats

    @classmethod
    def of(cls, model: SonarModel, batch: Batch) -> Seen:
        """Evaluate a model on a batch."""
        law = model.law(batch.ping, batch.past)
        return cls(batch, law, law.quantile(0.5))

    @property
    def error_mm(self) -> Floats:
        """Reading minus median reading of the model, mm; nan without an echo or where the model expects none."""
        known = self.batch.reading.echo & (self.median > 0)
        return np.where(known, 1000.0 * (self.batch.reading.range - self.median), np.nan)


def _sampled(n: int) -> NDArray[np.int64]:
    return np.unique(np.linspace(0, n - 1, min(n, MOST_POINTS)).astype(np.int64))


def readings(before: Seen, after: Seen) -> str:
    """Reading against true distance, with what both models expect."""

    def draw(axes: Axes) -> None:
        batch = before.batch
        rows = _sampled(len(batch))
        echo = batch.reading.echo[rows]
        distance, reading = batch.ping.distance[rows], batch.reading.range[rows]
        size = 3 if len(rows) > FEW_POINTS else 6
        axes.plot(distance[echo], reading[echo], ".", ms=size, color=INK, alpha=0.45, rasterized=True, label="recorded")
        silent = distance[~echo]
        if len(silent):
            axes.plot(silent, np.zeros(len(silent)), "|", ms=7, color=SOFT, rasterized=True, label="no echo")
        for seen, colour, label in ((before, BEFORE, "model before"), (after, AFTER, "corrected model")):
            x, y = _binned(batch.ping.distance, np.where(seen.median > 0, seen.median, np.nan), np.nanmedian)
            axes.plot(x, y, color=colour, lw=1.8, label=label, ls="--" if seen is before else "-")
        axes.set(xlabel="true distance (m)", ylabel="reading (m)")
        axes.set_ylim(bottom=-0.05 * max(reading.max(initial=0.1), 0.1))
        axes.legend(loc="upper left")

    return svg(draw, "readings")


def errors(before: Seen, after: Seen) -> str:
    """Reading minus what each model expects, against distance."""

    def draw(axes: Axes) -> None:
        rows = _sampled(len(before.batch))
        limit = 2.5 * map_limit(before, after)
        axes.axhline(0, color=SOFT, lw=0.8)
        for seen, colour, label in ((before, BEFORE, "model before"), (after, AFTER, "corrected model")):
            error = np.clip(seen.error_mm[rows], -limit, limit)
            distance, size = seen.batch.ping.distance[rows], 3 if len(rows) > FEW_POINTS else 6
            axes.plot(distance, error, ".", ms=size, color=colour, alpha=0.4, rasterized=True, label=label)
        axes.set(xlabel="true distance (m)", ylabel="reading - expected (mm)", ylim=(-limit * 1.05, limit * 1.05))
        axes.legend(loc="best", markerscale=3)

    return svg(draw, "errors")


def along_time(before: Seen, after: Seen) -> str:
    """Reading minus what each model expects, against time: the median of each stretch and the middle half."""

    def draw(axes: Axes) -> None:
        limit = map_limit(before, after)
        minutes = before.batch.ping.time / 60.0
        axes.axhline(0, color=SOFT, lw=0.8)
        for seen, colour, label in ((before, BEFORE, "model before"), (after, AFTER, "corrected model")):
            x, middle = _binned(minutes, seen.error_mm, np.nanmedian)
            low, high = (_binned(minutes, seen.error_mm, partial(np.nanquantile, q=q))[1] for q in (0.25, 0.75))
            axes.fill_between(x, low, high, color=colour, alpha=0.2, lw=0)
            axes.plot(x, middle, color=colour, lw=1.8, label=label, ls="--" if seen is before else "-")
        axes.set(xlabel="time since the recording began (min)", ylabel="reading - expected (mm)")
        axes.set_ylim(-2.0 * limit, 2.0 * limit)
        axes.legend(loc="best")

    return svg(draw, "along_time")


def _binned(x: Floats, y: Floats, summary: Callable[[Floats], float], bins: int = 24) -> tuple[Floats, Floats]:
    edges = np.unique(np.quantile(x, np.linspace(0, 1, bins + 1)))
    if len(edges) < 2:
        return np.array([x.mean()]), np.array([summary(y)])
    place = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, len(edges) - 2)
    kept = [k for k in range(len(edges) - 1) if np.isfinite(y[place == k]).any()]
    return np.array([x[place == k].mean() for k in kept]), np.array([summary(y[place == k]) for k in kept])


def _curve(before: Seen, after: Seen, name: str, truth: Floats, of: Callable[[EchoLaw], Floats], label: str) -> str:
    def draw(axes: Axes) -> None:
        distance = before.batch.ping.distance
        x, y = _binned(distance, truth, np.mean, 16)
        axes.plot(x, 100 * y, "o", ms=5, color=INK, label="recorded")
        for seen, colour, text in ((before, BEFORE, "model before"), (after, AFTER, "corrected model")):
            x, y = _binned(distance, of(seen.law), np.mean, 16)
            axes.plot(x, 100 * y, color=colour, lw=1.8, ls="--" if seen is before else "-", label=text)
        axes.set(xlabel="true distance (m)", ylabel=label, ylim=(-3, 105))
        axes.legend(loc="best")

    return svg(draw, name)


def detection(before: Seen, after: Seen) -> str:
    """Share of pings with an echo, against distance."""
    heard = before.batch.reading.echo.astype(np.float64)
    return _curve(before, after, "detection", heard, lambda law: law.echo, "pings with an echo (%)")


def credence(before: Seen, after: Seen) -> str:
    """Share of pings that read within 10 % of the truth, against distance."""
    batch = before.batch
    right = np.abs(batch.reading.range - batch.ping.distance) <= CREDENCE_TOLERANCE * batch.ping.distance
    truth = (batch.reading.echo & right).astype(np.float64)
    return _curve(before, after, "credence", truth, lambda law: law.credence(), "readings within ±10 % (%)")


def calibration(before: Seen, after: Seen, seed: int) -> str:
    """Histogram of PIT values: flat where a model's spread and shape are right."""

    def draw(axes: Axes) -> None:
        edges = np.linspace(0, 1, 21)
        for seen, colour, label in ((before, BEFORE, "model before"), (after, AFTER, "corrected model")):
            u = pit(seen.law, seen.batch.reading, np.random.default_rng(seed).random(len(seen.batch)))
            u = np.where(seen.batch.reading.echo & np.isnan(u), 0.5, u)  # the model excludes an echo: neither side
            share = np.histogram(u[~np.isnan(u)], edges)[0] / max(np.sum(~np.isnan(u)), 1) * 20
            axes.stairs(share, edges, color=colour, lw=1.8, label=label, ls="--" if seen is before else "-")
        axes.axhline(1, color=SOFT, lw=0.8)
        axes.set(xlabel="where the reading falls in what was expected", ylabel="times as often as it should")
        axes.set_xticks([0, 0.5, 1], ["shortest", "middle", "longest"])
        axes.set_ylim(0, 6)
        axes.legend(loc="best")

    return svg(draw, "calibration")


def error_map(seen: Seen, name: str, limit_mm: float) -> str:
    """Median error over distance and angle; cells where most pings were silent are marked."""
    batch, error = seen.batch, seen.error_mm
    cell = np.unique(batch.condition, return_inverse=True)[1]
    count = np.bincount(cell)
    distance = np.bincount(cell, batch.ping.distance) / count
    angle = np.bincount(cell, batch.ping.angle) / count / DEG
    silent = np.bincount(cell, ~batch.reading.echo) / count
    order = np.argsort(cell, kind="stable")
    parts = np.split(error[order], np.cumsum(count)[:-1])
    value = np.array([np.nanmedian(p) if np.isfinite(p).any() else np.nan for p in parts])

    def draw(axes: Axes) -> None:
        heard = np.isfinite(value)
        norm = TwoSlopeNorm(0.0, -limit_mm, limit_mm)
        shown = np.clip(value[heard], -limit_mm, limit_mm)
        points = axes.scatter(
            distance[heard], angle[heard], c=shown, norm=norm, cmap="RdBu_r", s=34, lw=0.4, edgecolor=SOFT
        )
        lost = silent > 0.5
        axes.plot(distance[lost], angle[lost], "x", color=INK, ms=4, mew=0.9, label="mostly no echo", ls="")
        axes.set(xlabel="true distance (m)", ylabel="angle (deg)")
        bar = axes.figure.colorbar(points, ax=axes, pad=0.02)
        bar.set_label("reading - expected (mm)")
        if lost.any():
            axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.0, fontsize=9)  # on no position

    return svg(draw, name)


def near(seen: Seen) -> Floats:
    """Return the errors of readings that lie within 15 % and 10 cm of what a model expects, mm."""
    error = seen.error_mm[np.isfinite(seen.error_mm)]
    distance = seen.batch.ping.distance[np.isfinite(seen.error_mm)]
    return error[np.abs(error) < 150.0 * distance + 100.0]


def map_limit(*seen: Seen) -> float:
    """Return the error at which the colours of several maps saturate, mm; strays from other paths do not count."""
    error = np.concatenate([near(s) for s in seen])
    return max(float(np.quantile(np.abs(error), 0.9)) if len(error) else 5.0, 2.0)


def all_figures(diagnosis: Diagnosis, seed: int = 0) -> dict[str, str]:
    """Return every figure of a report by name. Curves show the cells that nothing was fitted to; maps show all."""
    split = diagnosis.split
    before, after = (Seen.of(m, split.vault) for m in (diagnosis.shown_before, diagnosis.corrected))
    wide_before, wide_after = (Seen.of(m, split.whole) for m in (diagnosis.shown_before, diagnosis.corrected))
    limit = map_limit(wide_before, wide_after)
    compared = any(np.isfinite(seen.error_mm).any() for seen in (before, after))  # of silence there is no error to draw
    return {
        "map_before": error_map(wide_before, "map_before", limit),
        "map_after": error_map(wide_after, "map_after", limit),
        "along_time": along_time(wide_before, wide_after) if split.whole.timed and compared else "",
        "readings": readings(before, after),
        "errors": errors(before, after) if compared else "",
        "detection": detection(before, after),
        "credence": credence(before, after),
        "calibration": calibration(before, after, seed) if compared else "",
    }
