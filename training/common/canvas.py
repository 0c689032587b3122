"""Style and output of figures, as SVG text or PNG. The only module that imports matplotlib."""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Sequence
from html import escape
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize, TwoSlopeNorm
from matplotlib.figure import Figure
from matplotlib.projections.polar import PolarAxes

__all__ = [
    "AFTER",
    "BEFORE",
    "INK",
    "SOFT",
    "STYLE",
    "Axes",
    "Draw",
    "Figure",
    "PolarAxes",
    "TwoSlopeNorm",
    "figure_of",
    "panels",
    "svg",
]
Draw = Callable[[Axes], None]
INK, SOFT, BEFORE, AFTER = (
    "#1d2733",
    "#8794a3",
    "#c2571a",
    "#1b6ca8",
)  # distinct for the colour-blind
STYLE: dict[Any, Any] = {
    "font.family": "DejaVu Sans",
    "font.size": 11,
    "axes.edgecolor": SOFT,
    "axes.labelcolor": INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titlesize": 11,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.prop_cycle": f"cycler(color={[AFTER, BEFORE, SOFT, INK]})",
    "xtick.color": INK,
    "ytick.color": INK,
    "text.color": INK,
    "legend.frameon": False,
    "legend.fontsize": 10,
    "svg.fonttype": "path",
    "figure.dpi": 110,
}


class NotebookFigure(Figure):
    """Figure that a notebook shows although pyplot, which shows those that it made itself, did not make it."""

    def _repr_png_(self) -> bytes:
        out = io.BytesIO()
        self.savefig(out, format="png", metadata={"Software": None})
        return out.getvalue()


def svg(draw: Callable[[Axes], None], name: str, alt: str, size: tuple[float, float] = (5.4, 3.5)) -> str:
    """Return a figure with one pair of axes as scalable SVG text.

    Args:
        draw: draws on the axes.
        name: seed of the identifiers, which must differ between the figures of a page.
        alt: what the figure shows, for those who cannot see it.
        size: width and height, inches.
    """
    with mpl.rc_context({**STYLE, "svg.hashsalt": name}):
        figure = Figure(figsize=size, layout="constrained")
        draw(figure.add_subplot())
        out = io.StringIO()
        figure.savefig(out, format="svg", transparent=True, metadata={"Date": None, "Creator": None}, dpi=160)
    text = out.getvalue()[out.getvalue().index("<svg") :]
    for attribute in ("width", "height"):
        text = re.sub(rf'(<svg[^>]*?) {attribute}="[^"]*"', r"\1", text, count=1)
    return text.replace("<svg", f'<svg role="img" aria-label="{escape(alt)}"', 1)


def figure_of(draws: Sequence[Draw], size: tuple[float, float]) -> NotebookFigure:
    """Return a figure with several pairs of axes in one row, which a notebook shows.

    Args:
        draws: draw on one pair of axes each.
        size: width and height, inches.
    """
    with mpl.rc_context(STYLE):
        figure = NotebookFigure(figsize=size, layout="constrained")
        for draw, axes in zip(draws, figure.subplots(1, len(draws), squeeze=False)[0], strict=True):
            draw(axes)
    return figure


def panels(
    draws: Sequence[Callable[[Axes], None]],
    size: tuple[float, float],
    columns: int = 0,
    share_y: bool = False,
    colours: tuple[str, float, float] | None = None,
    projection: str | None = None,
) -> bytes:
    """Return a figure with several pairs of axes as PNG.

    Args:
        draws: draw on one pair of axes each.
        size: width and height, inches.
        columns: axes per row; 0 puts all in one row.
        share_y: whether all axes share the y scale.
        colours: label, minimum and maximum of a shared colour bar.
        projection: "polar", or None for Cartesian axes.
    """
    columns = columns or len(draws)
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=size, layout="constrained")
        kind = {"projection": projection}
        rows = -(-len(draws) // columns)
        axes = figure.subplots(rows, columns, sharey=share_y, squeeze=False, subplot_kw=kind).ravel()
        for draw, one in zip(draws, axes, strict=True):
            draw(one)
        if colours:
            scale = ScalarMappable(Normalize(*colours[1:]), "viridis")
            figure.colorbar(scale, ax=list(axes), shrink=0.8, pad=0.01).set_label(colours[0])
        out = io.BytesIO()
        # a wedge in polar axes reaches beyond the space that the layout gives it
        figure.savefig(out, format="png", dpi=100, bbox_inches="tight", metadata={"Software": None})
    return out.getvalue()
