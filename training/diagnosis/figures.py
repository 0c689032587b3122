"""Figures of a diagnosis, as SVG text for HTML pages and as one matplotlib figure."""

from __future__ import annotations

from functools import partial

import numpy as np

from acquisition.arrays import Floats
from noise import metrics
from noise.discrepancy.report.numbers import PREVIOUS, quantity
from noise.discrepancy.result import Aspect, Diagnosis, Location, Verdict
from noise.law import CREDENCE_TOLERANCE
from training.common.canvas import AFTER, BEFORE, INK, SOFT, Axes, Draw, Figure, figure_of, svg
from training.diagnosis.maps import maps
from training.diagnosis.prediction import (
    AFTER_LABEL,
    BEFORE_LABEL,
    SHARES,
    Compared,
    along,
    axis,
    binned,
    column,
    mismatches,
    observed,
)

MAX_POINTS = 2500
MAX_SHOWN = 2  # located mismatches with a figure of their own
ALT = {  # of each figure of a page, in words
    "scores": "Bars: mean prediction error of each model on unseen visits",
    "mismatch_0": "Curves: recording and predictions along the condition of the first difference",
    "mismatch_1": "Curves: recording and predictions along the condition of another difference",
    "histogram": "Histogram: reading minus prediction of each model",
    "calibration": "Histogram: quantiles of the readings in the prediction of each model",
    "map_before": "Map: median error of the simulation at each position",
    "map_after": "Map: median error of the corrected model at each position",
    "map_outliers": "Map: share of readings far from the target at each position",
    "readings": "Curves: readings and median predictions along a condition",
    "detection": "Curves: share of pings with an echo, recorded and predicted, along a condition",
    "credence": "Curves: share of readings within 10 % of the truth, recorded and predicted, along a condition",
}


def _shade(axes: Axes, compared: Compared, found: Location | None, name: str) -> None:
    if found is not None and name in found.region and name != "period_s":
        factor, half = axis(name, compared.before.batch)[1], 0.5 if name == "run" else 0.0
        low, high = (factor * bound for bound in found.region[name])
        low, high = np.clip((low - half, high + half), *axes.get_xlim())
        axes.axvspan(low, high, color="#f2c94c", alpha=0.22, lw=0, zorder=0, label="located here")


def _set_axis(axes: Axes, compared: Compared, name: str, value: Floats) -> None:
    """Label the axis of a column with these values; one of few values has a tick at each."""
    axes.set_xlabel(axis(name, compared.before.batch)[0])
    if name == "previous_reading":
        axes.set_xticks(list(PREVIOUS), [text.replace("something ", "something\n") for text in PREVIOUS.values()])
    if name == "order":  # groups that double
        axes.set_xscale("function", functions=(np.log1p, np.expm1))
        axes.set_xticks(np.unique(value))


def errors_along(axes: Axes, compared: Compared, name: str, found: Location | None = None) -> None:
    """Draw median and quartiles of reading minus prediction along a column."""
    axes.axhline(0, color=SOFT, lw=0.8)
    top, value = 0.0, column(compared.before.batch, name, found)
    assert value is not None
    for prediction, colour, text, style in compared.each:
        x, middle = binned(value, prediction.error_mm, np.nanmedian)
        low, high = (binned(value, prediction.error_mm, partial(np.nanquantile, q=q))[1] for q in (0.25, 0.75))
        axes.fill_between(x, low, high, color=colour, alpha=0.2, lw=0)
        axes.plot(x, middle, style, color=colour, lw=1.8, label=text, marker="o" if len(x) < 12 else None, ms=4)
        top = max(top, float(np.abs(middle).max(initial=0.0)))
    limit = float(np.clip(1.2 * top, 2.0 * compared.limit_mm, 5.0 * compared.limit_mm))
    axes.set(ylabel="reading − prediction (mm)", ylim=(-limit, limit))
    _set_axis(axes, compared, name, value)
    _shade(axes, compared, found, name)
    axes.legend(loc="best")


def shares_along(axes: Axes, compared: Compared, name: str, aspect: Aspect, found: Location | None = None) -> None:
    """Draw the observed and predicted share of what an aspect counts along a column."""
    batch, bins = compared.before.batch, 16
    value = column(batch, name, found)
    assert value is not None
    x, y = binned(value, observed(batch, aspect).astype(np.float64), np.mean, bins)
    axes.plot(x, 100 * y, "o", ms=5, color=INK, label="recorded")
    top = 100 * y.max()
    for prediction, colour, text, style in compared.each:
        x, y = binned(value, prediction.probability(aspect), np.mean, bins)
        axes.plot(x, 100 * y, style, color=colour, lw=1.8, label=text)
        top = max(top, 100 * y.max())
    axes.set(ylabel=SHARES[aspect], ylim=(-0.03 * top, 1.15 * max(top, 1.0)))
    _set_axis(axes, compared, name, value)
    _shade(axes, compared, found, name)
    axes.legend(loc="best")


def mismatch(axes: Axes, compared: Compared, found: Location | None) -> None:
    """Draw a located mismatch along the condition where it was located; errors along any condition if none was."""
    name = along(found, compared.before.batch)
    assert name is not None
    if found is not None and found.aspect in SHARES:
        shares_along(axes, compared, name, found.aspect, found)
    else:
        errors_along(axes, compared, name, found)


def histogram(axes: Axes, compared: Compared) -> None:
    """Draw the distribution of reading minus prediction; the outermost bars hold all errors beyond them."""
    step = 1000.0 * compared.before.batch.resolution
    width = step * max(1, round(0.1 * compared.limit_mm / step))  # whole register steps, else some bars hold more steps
    edges = width * (np.arange(-30, 32) - 0.5)
    limit = float(edges[-1]) - 0.5 * width
    for prediction, colour, text, _ in compared.each:
        error = prediction.error_mm[np.isfinite(prediction.error_mm)]
        share = 100.0 * np.histogram(np.clip(error, -limit, limit), edges)[0] / max(len(error), 1)
        axes.stairs(share, edges, color=colour, lw=1.6, fill=False, label=text)
        axes.stairs(share, edges, color=colour, alpha=0.18, fill=True)
    axes.axvline(0, color=SOFT, lw=0.8)
    axes.set(xlabel="reading − prediction (mm)", ylabel="echoes (%)")
    axes.legend(loc="best")


def scores(axes: Axes, verdict: Verdict, corrected: bool) -> None:
    """Draw mean prediction errors on unseen visits as bars."""
    test = verdict.held_out
    rows = [(BEFORE_LABEL, test.before.crps_m, BEFORE)]
    rows += [("emulator", test.emulator.crps_m, SOFT)] if test.emulator != test.before else []
    rows += [(AFTER_LABEL, test.after.crps_m, AFTER)] if corrected else []
    rows += [("own nearest positions", test.repeatability_m, INK)]
    rows = [row for row in rows if np.isfinite(row[1])][::-1]
    size = [1000.0 * row[1] for row in rows]
    axes.barh([row[0] for row in rows], size, color=[row[2] for row in rows], height=0.62)
    for k, value in enumerate(size):
        axes.text(value, k, f" {quantity(value / 1000.0, 'm')}", va="center")
    axes.set(xlabel="mean prediction error (mm)", xlim=(0, 1.25 * max(size, default=1.0)))


def readings(axes: Axes, compared: Compared, name: str) -> None:
    """Draw readings and median predictions along a column."""
    batch = compared.before.batch
    value = column(batch, name)
    assert value is not None
    rows = np.unique(np.linspace(0, len(batch) - 1, min(len(batch), MAX_POINTS)).astype(np.int64))
    echo = batch.reading.echo[rows]
    size = 6 if len(rows) < 500 else 3
    axes.plot(
        value[rows][echo],
        1000.0 * batch.reading.range[rows][echo],
        ".",
        ms=size,
        color=INK,
        alpha=0.45,
        rasterized=True,
        label="recorded",
    )
    for prediction, colour, text, style in compared.each:
        x, y = binned(value, 1000.0 * np.where(prediction.median > 0, prediction.median, np.nan), np.nanmedian)
        axes.plot(x, y, style, color=colour, lw=1.8, label=text)
    axes.set(xlabel=axis(name, compared.before.batch)[0], ylabel="reading (mm)")
    axes.legend(loc="best")


def credence(axes: Axes, compared: Compared, name: str) -> None:
    """Draw the share of readings within 10 % of the truth along a column."""
    batch = compared.before.batch
    value = column(batch, name)
    assert value is not None
    near = np.abs(batch.reading.range - batch.ping.distance) <= CREDENCE_TOLERANCE * batch.ping.distance
    x, y = binned(value, (batch.reading.echo & near).astype(np.float64), np.mean, 16)
    axes.plot(x, 100 * y, "o", ms=5, color=INK, label="recorded")
    for prediction, colour, text, style in compared.each:
        x, y = binned(value, prediction.law.credence(), np.mean, 16)
        axes.plot(x, 100 * y, style, color=colour, lw=1.8, label=text)
    axes.set(xlabel=axis(name, compared.before.batch)[0], ylabel="readings within ±10 % (%)", ylim=(-3, 105))
    axes.legend(loc="best")


def calibration(axes: Axes, compared: Compared, seed: int) -> None:
    """Draw histograms of PIT values, which are uniform for a correct model."""
    edges = np.linspace(0, 1, 21)
    for prediction, colour, text, style in compared.each:
        u = metrics.pit(prediction.law, prediction.batch.reading, np.random.default_rng(seed))
        axes.stairs(np.histogram(u, edges)[0] / len(u) * 20, edges, color=colour, lw=1.8, label=text, ls=style)
    axes.axhline(1, color=SOFT, lw=0.8)
    axes.set(xlabel="quantile of the reading in the prediction (PIT)", ylabel="density", ylim=(0, 6))
    axes.legend(loc="best")


def overview(diagnosis: Diagnosis) -> Figure:
    """Return a figure with the greatest mismatch, the histogram of errors and the scores, where they exist."""
    compared, draws = Compared.of(diagnosis), list[Draw]()
    where = next(iter(mismatches(diagnosis.verdict)), None)
    if compared.has_errors:
        draws += [lambda axes: histogram(axes, compared)]
    if along(where, compared.before.batch) is not None:
        draws.insert(0, lambda axes: mismatch(axes, compared, where))
    draws.append(lambda axes: scores(axes, diagnosis.verdict, diagnosis.corrected is not None))
    return figure_of(draws, (5.2 * len(draws), 3.6))


def all_figures(diagnosis: Diagnosis, seed: int = 0) -> dict[str, str]:
    """Return the figures of a report by name; those that the recording cannot fill are absent.

    Errors and scores show visits that no estimate used; mismatches and maps show all.
    """
    verdict, corrected = diagnosis.verdict, diagnosis.corrected is not None
    whole = Compared.of(diagnosis)
    unseen = Compared.of(diagnosis, diagnosis.unseen) if diagnosis.unseen.any() else whole
    draws: dict[str, Draw] = {"scores": lambda axes: scores(axes, verdict, corrected)}
    for k, found in enumerate(_shown(verdict, whole)):
        draws[f"mismatch_{k}"] = partial(mismatch, compared=whole, found=found)
    if whole.has_errors:
        draws["histogram"] = partial(histogram, compared=unseen)
        draws["calibration"] = partial(calibration, compared=unseen, seed=seed)
    draws |= maps(whole)
    name = along(None, unseen.before.batch)
    if name is not None:
        draws["readings"] = partial(readings, compared=unseen, name=name)
        draws["detection"] = partial(shares_along, compared=unseen, name=name, aspect=Aspect.DETECTION)
        draws["credence"] = partial(credence, compared=unseen, name=name)
    return {name: svg(draw, name, ALT[name]) for name, draw in draws.items()}


def _shown(verdict: Verdict, whole: Compared) -> list[Location | None]:
    """Return the located mismatches that are drawn, each along another column or in another aspect."""
    found: dict[tuple[Aspect | None, str | None], Location | None] = {}
    every: list[Location | None] = [*mismatches(verdict)]
    for each in every or [None]:
        drawn = each.aspect if each and each.aspect in SHARES else None  # all others show the errors of echoes
        key = (drawn, along(each, whole.before.batch))
        if key[1] is not None and (whole.has_errors or key[0] in SHARES):
            found.setdefault(key, each)
    return list(found.values())[:MAX_SHOWN]
