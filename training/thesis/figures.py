"""Figures 4.3 to 5.1 and A.1 of the thesis, drawn of a comparison."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from training.common.canvas import AFTER, BEFORE, SOFT, Axes, Draw, panels
from training.thesis.credence import MIRROR, READINGS, RUBBER, Surfaces
from training.thesis.data import Floats
from training.thesis.findings import Findings
from training.thesis.numbers import A1_TRAIN, A1_VALIDATION
from training.thesis.optimisers import OPTIMISERS
from training.thesis.runs import Job

# Okabe and Ito's colours, told apart by the colour-blind
COLOURS = ("#999999", "#d55e00", "#e69f00", "#0072b2", "#009e73", "#000000")


def all_figures(findings: Findings) -> dict[str, bytes]:
    """Return each figure as PNG, by the thesis's number of it."""
    sizes = findings.comparison.sizes
    tables = [_optimisers(findings, hidden) for hidden in sizes]
    reflectors = {"figure-4.5": MIRROR, "figure-4.6": RUBBER}
    return {
        "figure-4.3": panels(tables, (3.2 * len(sizes), 3.4), share_y=True),
        "figure-4.4": panels([_training(findings, j, t) for j, t in _pair(findings)], (7.0, 3.2), share_y=True),
        "figure-a.1": panels([_longest(findings), _printed], (7.0, 3.2)),
        **{name: _surfaces(findings, (reflector,)) for name, reflector in reflectors.items()},
        "figure-5.1": _surfaces(findings, (MIRROR, RUBBER)),
    }


def _pair(findings: Findings) -> list[tuple[list[Job], str]]:
    units = findings.comparison.figure
    return [(findings.comparison.mlp, f"MLP, {units} neurons"), (findings.comparison.lstm, f"LSTM, {units} cells")]


def _band(axes: Axes, losses: Floats, colour: str, label: str, style: str = "-") -> None:
    """Draw the mean over seeds and the range of them."""
    passes = np.arange(1, losses.shape[1] + 1)
    axes.plot(passes, losses.mean(axis=0), color=colour, lw=1.6, label=label, ls=style)
    axes.fill_between(passes, losses.min(axis=0), losses.max(axis=0), color=colour, alpha=0.18, lw=0)


def _floor(axes: Axes, findings: Findings) -> None:
    axes.axhline(findings.samples.floor(), color=SOFT, lw=0.9, ls=":", label="no function gets below")


def _optimisers(findings: Findings, hidden: int) -> Draw:
    def draw(axes: Axes) -> None:
        for (name, optimiser), colour in zip(OPTIMISERS.items(), COLOURS, strict=True):
            losses = findings.curves(findings.comparison.table(hidden, name), "validation")
            _band(axes, losses, colour, optimiser.title)
        _floor(axes, findings)
        axes.set(xlabel="passes", title=f"{hidden} neurons")
        if hidden == findings.comparison.sizes[0]:
            axes.set(ylabel="validation loss")
        if hidden == findings.comparison.sizes[-1]:
            axes.legend(loc="upper right", fontsize=7, ncol=2)

    return draw


def _training(findings: Findings, jobs: list[Job], title: str) -> Draw:
    def draw(axes: Axes) -> None:
        _band(axes, findings.curves(jobs, "train"), BEFORE, "training (dropout on)", "--")
        _band(axes, findings.curves(jobs, "validation"), AFTER, "validation")
        _floor(axes, findings)
        axes.set(xlabel="passes", ylabel="loss", title=title)
        axes.legend(fontsize=8)

    return draw


def _longest(findings: Findings) -> Draw:
    return _training(findings, findings.comparison.long, f"{findings.comparison.longest[0]} neurons, this recording")


def _printed(axes: Axes) -> None:
    passes = np.arange(1, len(A1_TRAIN) + 1)
    axes.plot(passes, A1_TRAIN, color=BEFORE, lw=1.6, ls="--", label="training (dropout on)")
    axes.plot(passes, A1_VALIDATION, color=AFTER, lw=1.6, label="validation")
    axes.set(xlabel="passes", ylabel="loss", title="30 neurons, in the thesis")
    axes.legend(fontsize=8)


def _surfaces(findings: Findings, reflectors: Sequence[str]) -> bytes:
    """Draw the credence of readings, of the MLP's and of the LSTM's mapped readings, a row a reflector."""
    names = {READINGS: "readings", "MLP": "mapped by MLP", "LSTM": "mapped by LSTM"}
    draws = [_surface(findings.surfaces, k, r, f"{r}: {text}") for r in reflectors for k, text in names.items()]
    size = (9.0, 2.8 * len(reflectors))
    return panels(draws, size, columns=len(names), colours=("credence", 0.0, 1.0))


def _surface(surfaces: Surfaces, name: str, reflector: str, title: str) -> Draw:
    def draw(axes: Axes) -> None:
        cells = surfaces.of(reflector)
        angle, distance, value = grid(
            surfaces.angle[cells], surfaces.distance[cells], surfaces.credence[name][0, cells]
        )
        a, d = np.meshgrid(np.deg2rad(np.clip(between(angle), 0.0, None)), between(distance), indexing="ij")
        axes.pcolormesh(d * np.cos(a), d * np.sin(a), value, vmin=0.0, vmax=1.0, cmap="viridis", rasterized=True)
        axes.set(aspect="equal", facecolor="#f4f5f7")
        axes.set_xlabel("along the axis (m)", fontsize=9)
        axes.set_ylabel("aside (m)", fontsize=9)
        axes.set_title(title, fontsize=9)
        axes.tick_params(labelsize=8)

    return draw


def grid(angle: Floats, distance: Floats, value: Floats) -> tuple[Floats, Floats, Floats]:
    """Return the angles and distances of a survey and the value at each crossing, nan where none was measured."""
    angles, row = np.unique(np.round(angle, 6), return_inverse=True)
    distances, column = np.unique(np.round(distance, 4), return_inverse=True)
    out = np.full((len(angles), len(distances)), np.nan)
    out[row, column] = value
    return angles, distances, out


def between(centre: Floats) -> Floats:
    """Return the edges of cells about their centres, halfway between neighbours, (n + 1,).

    >>> between(np.array([0.0, 1.0, 3.0]))
    array([-0.5,  0.5,  2. ,  4. ])
    """
    if len(centre) == 1:
        return centre[0] + np.array([-0.5, 0.5])
    half = np.diff(centre) / 2
    return np.concatenate([[centre[0] - half[0]], centre[:-1] + half, [centre[-1] + half[-1]]])
