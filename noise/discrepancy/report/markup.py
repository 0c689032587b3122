"""HTML fragments of a diagnosis, for notebooks and for the report: shares as one bar, causes as a table."""

from __future__ import annotations

import math
from html import escape

from noise.discrepancy.report import words
from noise.discrepancy.report.numbers import bounds, estimate, parameter, quantity, readable
from noise.discrepancy.result import Cause, Diagnosis, Interval, Verdict

# of causes; distinct for the colour-blind, dark below white labels
COLOURS = ("#1b6ca8", "#207d72", "#8a5fbf", "#946210", "#5a7d2a")
REST, TOGETHER, INK = "#b9c2cb", "#dde7ee", "#1d2733"
WIDTH, HEIGHT, MIN_LABEL = 1000.0, 44.0, 70.0  # of the drawing and of a segment that can hold its number
CELL = 'style="padding:3px 14px 3px 0;text-align:left"'


def shares(verdict: Verdict) -> list[tuple[str, Interval, str]]:
    """Return label, share and colour of every cause and of the unexplained rest."""
    found = [
        (words.name(cause.effect), cause.share, COLOURS[k % len(COLOURS)]) for k, cause in enumerate(verdict.causes)
    ]
    return [*found, ("unexplained", verdict.unexplained.share, REST)]


def share_bar(verdict: Verdict) -> str:
    """Return the shares of the difference as one SVG bar with the interval of each share as a line."""
    parts = shares(verdict)
    total = max(1.0, sum(_positive(share.value) for _, share, _ in parts))
    left, drawn = 0.0, [f'<rect width="{WIDTH:.0f}" height="{HEIGHT:.0f}" fill="{TOGETHER}"/>']
    for k, (label, share, colour) in enumerate(parts):
        width = WIDTH * _positive(share.value) / total
        drawn.append(_segment(left, width, label, share, colour))
        drawn.append(_whisker(left, share, total, HEIGHT + 7 + 9 * (k % 2)))
        left += width
    return (
        f'<svg viewBox="0 0 {WIDTH:.0f} {HEIGHT + 22:.0f}" role="img" aria-label="shares of the difference" '
        f'style="width:100%;max-width:1000px;display:block">{"".join(drawn)}</svg>'
    )


def _positive(share: float) -> float:
    """Return a share as a length: 0 if it is negative or unknown."""
    return max(share, 0.0) if math.isfinite(share) else 0.0


def _segment(left: float, width: float, label: str, share: Interval, colour: str) -> str:
    title = f"<title>{escape(label)}: {estimate(share)} ({bounds(share)})</title>"
    box = f'<rect x="{left:.1f}" width="{width:.1f}" height="{HEIGHT:.0f}" fill="{colour}">{title}</rect>'
    if width < MIN_LABEL:
        return box
    fill = INK if colour == REST else "#fff"
    text = quantity(share.value, "1")
    return (
        f'{box}<text x="{left + 10:.1f}" y="28" font-size="17" font-weight="600" fill="{fill}" '
        f'font-family="system-ui,sans-serif">{text}</text>'
    )


def _whisker(left: float, share: Interval, total: float, y: float) -> str:
    """Return a line at height y below a segment, from the low to the high end of its share."""
    low, high = (min(left + WIDTH * _positive(x) / total, WIDTH) for x in (share.low, share.high))
    ticks = "".join(f"M{x:.1f} {y - 4:.0f}v8" for x in (low, high))
    return f'<path d="M{low:.1f} {y:.0f}H{high:.1f}{ticks}" stroke="{INK}" stroke-width="1.5" fill="none"/>'


def legend(verdict: Verdict) -> str:
    """Return the bar's labels with shares and intervals."""
    rows = [
        f'<span style="white-space:nowrap;margin-right:22px"><i style="display:inline-block;width:12px;height:12px;'
        f'background:{colour};margin-right:6px"></i>{escape(label)}: <b>{estimate(share)}</b> '
        f"({bounds(share)})</span>"
        for label, share, colour in shares(verdict)
    ]
    return f'<div style="line-height:1.8">{" ".join(rows)}</div>'


def _row(cause: Cause) -> str:
    parameters = "; ".join(f"{readable(k, v.unit)} {parameter(k, v)}" for k, v in cause.parameters.items())
    rivals = ", ".join(f"{words.name(each.effect)} {quantity(each.probability, '1')}" for each in cause.alternatives)
    cells = (words.name(cause.effect), quantity(cause.probability, "1"), parameters, rivals)
    return f"<tr>{''.join(f'<td {CELL}>{escape(text)}</td>' for text in cells)}</tr>"


def compact(diagnosis: Diagnosis) -> str:
    """Return headline, bar and causes as HTML for a notebook."""
    verdict = diagnosis.verdict
    warnings = "".join(f"<p><b>Warning:</b> {escape(text)}</p>" for text in verdict.warnings)
    head = f"<p><b>{escape(words.headline(diagnosis))}</b></p>"
    if not verdict.causes:
        return f"<div>{warnings}{head}<p>{escape(words.fit_line(verdict))}</p></div>"
    rows = "".join(_row(cause) for cause in verdict.causes)
    heads = "".join(f"<th {CELL}>{text}</th>" for text in ("cause", "probability", "parameters", "alternatives"))
    table = f"<table><tr>{heads}</tr>{rows}</table>"
    fit = f"<p>{escape(words.fit_line(verdict))}</p>"
    return f'<div style="max-width:800px">{warnings}{head}{share_bar(verdict)}{legend(verdict)}{table}{fit}</div>'
