"""Maps of a recording: median errors and shares of outliers by position."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquisition.arrays import Floats
from noise.discrepancy.moments.sample import logged_names
from training.common.canvas import INK, SOFT, Axes, Draw, TwoSlopeNorm
from training.diagnosis.prediction import Compared, Prediction, axis, column, outliers

MIN_MAP_VISITS = 6  # a map of fewer positions shows nothing


def _visit_means(compared: Compared, value: NDArray[Any]) -> Floats:
    """Return the mean of a value, (n,), over each visit."""
    batch = compared.before.batch
    return batch.visit_sums(value) / batch.visit_sums(np.ones(len(batch)))


def map_axes(compared: Compared) -> tuple[str, str] | None:
    """Return the two columns of a map; None if the target stays at one place or there are few visits."""
    batch = compared.before.batch
    place = ("distance", "angle", "incidence", "reflectance")
    names = (name for name in (*place, *logged_names(batch.ping), "time") if name != "interval_s")
    varying = [name for name in names if column(batch, name) is not None]
    moves = len(varying) > 1 and varying[0] in place and batch.n_visits >= MIN_MAP_VISITS
    return (varying[0], varying[1]) if moves else None


def _positions(compared: Compared, names: tuple[str, str]) -> tuple[Floats, Floats]:
    x, y = (column(compared.before.batch, name) for name in names)
    assert x is not None
    assert y is not None
    return _visit_means(compared, x), _visit_means(compared, y)


def map_of_medians(axes: Axes, compared: Compared, prediction: Prediction, names: tuple[str, str]) -> None:
    """Draw the median error of every position; positions with mostly no echo are marked."""
    (x, y), batch = _positions(compared, names), compared.before.batch
    parts = [prediction.error_mm[rows] for rows in prediction.batch.visit_rows]
    value = np.array([np.nanmedian(part) if np.isfinite(part).any() else np.nan for part in parts])
    lost, known, limit = (
        _visit_means(compared, 1.0 - prediction.batch.reading.echo) > 0.5,
        np.isfinite(value),
        compared.limit_mm,
    )
    points = axes.scatter(
        x[known],
        y[known],
        c=np.clip(value[known], -limit, limit),
        norm=TwoSlopeNorm(0.0, -limit, limit),
        cmap="RdBu_r",
        s=30,
        lw=0.4,
        edgecolor=SOFT,
    )
    axes.plot(x[lost], y[lost], "x", color=INK, ms=4, mew=0.9, label="mostly no echo", ls="")
    axes.set(xlabel=axis(names[0], batch)[0], ylabel=axis(names[1], batch)[0])
    axes.figure.colorbar(points, ax=axes, pad=0.02).set_label("median error (mm)")
    if lost.any():
        axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.0, fontsize=9)  # outside the axes


def map_of_outliers(axes: Axes, compared: Compared, names: tuple[str, str]) -> None:
    """Draw the share of readings far from the target at every position."""
    (x, y), batch = _positions(compared, names), compared.before.batch
    share = 100.0 * _visit_means(compared, outliers(compared.before.batch).astype(np.float64))
    order = np.argsort(share, kind="stable")
    top = max(float(share.max()), 10.0)
    points = axes.scatter(
        x[order], y[order], c=share[order], vmin=0.0, vmax=top, cmap="YlOrRd", s=30, lw=0.4, edgecolor=SOFT
    )
    axes.set(xlabel=axis(names[0], batch)[0], ylabel=axis(names[1], batch)[0])
    axes.figure.colorbar(points, ax=axes, pad=0.02).set_label("readings far from the target (%)")


def maps(whole: Compared) -> dict[str, Draw]:
    """Return the maps of a recording by name; none if it has too few positions or echoes."""
    names = map_axes(whole)
    if names is None or not whole.has_errors:
        return {}
    drawn: dict[str, Draw] = {
        "map_before": partial(map_of_medians, compared=whole, prediction=whole.before, names=names),
        "map_outliers": partial(map_of_outliers, compared=whole, names=names),
    }
    if whole.after is not None:
        drawn["map_after"] = partial(map_of_medians, compared=whole, prediction=whole.after, names=names)
    return drawn
