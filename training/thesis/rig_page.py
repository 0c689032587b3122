"""The rig beside the thesis's sonar: tables in Markdown and one figure."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from training.common.canvas import AFTER, BEFORE, INK, SOFT, Axes, Draw, panels
from training.thesis.data import READING_M, Floats
from training.thesis.numbers import A1_VALIDATION, TABLES
from training.thesis.page import markdown
from training.thesis.rig import AUTHOR, BANDS_M, FULL, OWN, Case, Study
from training.thesis.silence import ANGLES_DEG, KINDS, REFLECTORS, Silence
from training.thesis.tuning import FREE

FIGURE = "rig-versus-thesis.png"
SHOWN_DEG = (0.0, 10.0, 20.0, 25.0, 30.0, 35.0, 40.0, 45.0)
UNIT_WORDS = {
    "sensitivity_db": ("{:+.1f} dB", 1.0),
    "radius": ("{:.2f} mm", 1e3),
    "yaw": ("{:+.1f} deg", 180.0 / np.pi),
}
# Esmi (2016), table 4.1: mirror at 30 degrees and 3900 mm
PRINTED_CELL = {"angle_deg": 30.0, "reflectance": 0.9, "distance_m": 3.9}
EDGES = {"never": "where it never read right", "half": "where it did in about half of its pings"}


def page(study: Study, about: str) -> str:
    """Return all tables; `about` says what made them."""
    parts = [
        f"# The rig beside the thesis's sonar\n\n{about}",
        *[f"## Mean distance of silent pings, {EDGES[e]} (m)\n\n{silences(study, e)}" for e in EDGES],
        f"## How far apart\n\n{misfits(study)}",
        f"## What networks make of the rig's pings\n\n{errors(study)}",
        f"## Right readings put farther than they were (mm)\n\n{offsets(study)}",
        f"## The one condition that was printed\n\n{printed_cell(study)}",
    ]
    return "\n\n".join(parts) + "\n"


def silences(study: Study, edge: str) -> str:
    """Return where silent pings were made, by whose account, reflector and angle."""
    columns = [(row, int(np.abs(ANGLES_DEG - angle).argmin())) for row in range(len(REFLECTORS)) for angle in SHOWN_DEG]
    heading = ["", *(f"{list(REFLECTORS)[row]}, {ANGLES_DEG[k]:g}°" for row, k in columns)]

    def line(name: str, silence: Silence) -> list[str]:
        return [name, *(_number(getattr(silence, edge)[at]) for at in columns)]

    rows = [line(f"thesis: {name}", silence) for name, silence in study.answers.items()]
    for case in study.cases:
        rows += [line(case.name, case.silence), line(f"{case.name}, by its networks", case.blurred)]
    return markdown(heading, rows)


def misfits(study: Study) -> str:
    """Return how far each rig's silence is from the thesis's, and how far the author's networks are from each other."""
    heading = ["", *FREE, "of its own pings", "by networks trained on them", "at a limit"]
    own = [f"{silence.apart(study.target):.2f}" for silence in study.answers.values()]
    rows = [["thesis: its networks from their mean", *["–"] * (len(FREE) + 1), " ".join(own), "–"]]
    limits = {tuned.unit: tuned.at_limit for tuned in study.tunings.values()}
    for case in study.cases:
        values = [_said(name, getattr(case.rig.unit, name)) for name in FREE]
        apart = [f"{s.apart(study.target):.2f}" for s in (case.silence, case.blurred)]
        rows.append([case.name, *values, *apart, ", ".join(limits.get(case.rig.unit, ())) or "–"])
    return (
        "Root mean square over 22 angles and reflectors, m; nowhere silent counts as silent from 6 m on.\n\n"
        + markdown(heading, rows)
    )


def errors(study: Study) -> str:
    """Return losses, beside what is printed, and errors by kind of ping."""
    heading = ["rig", *(f"{kind}, %" for kind in KINDS), "floor", "loss, its own", "loss, the thesis's"]
    heading += [f"{kind} pings, {whose} (mm)" for kind in KINDS for whose in ("its own", "the thesis's")]
    rows = []
    for case in study.cases:
        own, author = case.errors(OWN), case.errors(AUTHOR)
        shares = [f"{100.0 * share:.1f}" for share in case.shares]
        by_kind = [_millimetres(who.by_kind[kind]) for kind in KINDS for who in (own, author)]
        losses = [f"{loss:.4f}" for loss in (case.samples.floor(), own.loss, author.loss)]
        rows.append([case.name, *shares, *losses, *by_kind])
    best = min(row.validation for row in TABLES[20].values())
    printed = f"{best:.4f} and {A1_VALIDATION[-1]:.4f}"
    told = f"Printed losses of networks of 20 and 30 neurons on the thesis's own pings: {printed}."
    return f"{told}\n\n{markdown(heading, rows)}"


def offsets(study: Study) -> str:
    """Return by how much networks put right readings too far, by distance."""
    heading = [
        "right readings from",
        *(f"{a:g} to {min(b, 6.0):g} m" for a, b in pairwise(BANDS_M)),
    ]
    rows = []
    for case in study.cases:
        for whose, words in ((OWN, "its own networks"), (AUTHOR, "the thesis's")):
            rows.append([f"{case.name}, {words}", *map(_millimetres, case.offsets(whose))])
    return markdown(heading, rows)


def printed_cell(study: Study) -> str:
    """Return credence and readings of the condition in table 4.1."""
    rows: list[Sequence[str]] = [("thesis", "0.88", "3950 to 3970")]
    for case in study.cases:
        credence, heard = cell_readings(case)
        middle = f"{heard.min():.0f} to {heard.max():.0f}" if len(heard) else "–"
        rows.append((case.name, f"{credence:.2f}", middle))
    return markdown(("mirror, 30°, 3900 mm", "credence", "readings but the outer tenths (mm)"), rows)


def cell_readings(case: Case) -> tuple[float, Floats]:
    """Return the credence of table 4.1's condition and its readings between the 10th and 90th per cent, mm."""
    angle, reflectance, reading, credence = case.samples.feature.astype(np.float64).T
    here = np.abs(45.0 * angle - PRINTED_CELL["angle_deg"]) < 0.1
    here &= np.abs(reflectance - PRINTED_CELL["reflectance"]) < 0.01
    here &= np.abs(case.samples.distance - PRINTED_CELL["distance_m"]) < 1e-3
    heard = 1e3 * READING_M * reading[here & (reading > 0.0)]
    inner = np.percentile(heard, [10, 90]) if len(heard) else heard
    return float(credence[here].mean()), inner


def _said(name: str, value: float) -> str:
    text, scale = UNIT_WORDS[name]
    return text.format(scale * value)


def _number(value: float) -> str:
    return f"{value:.2f}" if np.isfinite(value) else "–"


def _millimetres(value: float) -> str:
    return f"{round(1e3 * value)}" if np.isfinite(value) else "–"


def figure(study: Study) -> bytes:
    """Return a figure of where each sonar was silent, by reflector and angle, as PNG."""
    draws = [_panel(study, edge, row) for edge in EDGES for row in range(len(REFLECTORS))]
    return panels(draws, (9.0, 6.8), columns=2, share_y=True)


def _panel(study: Study, edge: str, row: int) -> Draw:
    def draw(axes: Axes) -> None:
        told = np.array([getattr(silence, edge)[row] for silence in study.answers.values()])
        axes.fill_between(ANGLES_DEG, told.min(axis=0), told.max(axis=0), color=SOFT, alpha=0.35, lw=0)
        axes.plot(ANGLES_DEG, told.mean(axis=0), color=INK, lw=2.0, label="the thesis's sonar, by its networks")
        for case in study.cases:
            _draw_case(axes, case, edge, row)
        name = list(REFLECTORS)[row]
        axes.set(xlabel="angle (deg)", ylim=(0.0, 6.2), title=f"{name}, {EDGES[edge]}")
        axes.title.set_fontsize(9)
        if row == 0:
            axes.set_ylabel("mean distance of silent pings (m)")
        if row == 0 and edge == "never":
            axes.legend(fontsize=7.5, loc="lower left")

    return draw


def _draw_case(axes: Axes, case: Case, edge: str, row: int) -> None:
    """Draw a rig's own silence as points, and what networks trained on it tell as a line through them."""
    colour = AFTER if case.rig.setup.gain == FULL else BEFORE
    turned = case.name.endswith("tuned")
    axes.plot(
        ANGLES_DEG,
        getattr(case.silence, edge)[row],
        "o" if turned else "x",
        color=colour,
        ms=4,
        label=f"rig, {case.name}",
    )
    axes.plot(ANGLES_DEG, getattr(case.blurred, edge)[row], "-" if turned else ":", color=colour, lw=1.1)
