"""Compare the rig with the sonar of the thesis, represented by its published networks.

The rig records the thesis's survey at the stated gain and at full gain, with its nominal unit and with a unit fitted
to the distances without echo. Networks of the same architecture are trained on each recording, so that smoothing by the
networks is not mistaken for a difference between the sonars.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from rich.progress import TaskID

from acquisition import SettingError
from acquisition.io.files import write_bytes, write_text
from training.common.canvas import AFTER, BEFORE, INK, SOFT, Axes, Draw, panels
from training.common.progress import bars
from training.common.tables import markdown_table
from training.thesis.data import (
    A1_VALIDATION,
    PRINTED_CONDITION,
    PRINTED_CREDENCE,
    PRINTED_READINGS_MM,
    TABLES,
    Floats,
    Samples,
)
from training.thesis.experiment import made_by
from training.thesis.rig import (
    ANGLES_DEG,
    AUTHOR,
    BANDS,
    FREE,
    FULL_GAIN,
    KINDS,
    MAX_DISTANCE,
    OWN,
    REFLECTORS,
    Report,
    RigStudy,
    RigVariant,
    SilentDistances,
    StudySettings,
    published,
    study,
)

FIGURE = "rig-versus-thesis.png"
SHOWN_DEG = (0.0, 10.0, 20.0, 25.0, 30.0, 35.0, 40.0, 45.0)
UNIT_FORMATS = {
    "sensitivity_db": ("{:+.1f} dB", 1.0),
    "radius": ("{:.2f} mm", 1e3),
    "yaw": ("{:+.1f} deg", 180.0 / np.pi),
}
SUBSETS = {
    "never_right": "conditions without any right reading",
    "half_right": "conditions with about half right readings",
}
SOURCES = {OWN: "its own networks", AUTHOR: "the thesis's"}


@dataclass(frozen=True)
class Args:
    """Settings of `sonar-gym compare-thesis`.

    Example:
        sonar-gym compare-thesis --networks MasterThesis --out rig-versus-thesis
    """

    networks: Path
    """Folder with the networks published by the author of the thesis (*.h5, *.hdf5)."""
    out: Path
    """Folder for trained networks, tables and figure."""
    page: Path | None = None
    """Folder for tables and figure, if not OUT."""
    trials: int = 40
    """Units to evaluate at each gain; 0 uses the nominal unit only."""
    pings: int = 50
    """Pings per condition."""
    seeds: int = 3
    """Number of trainings of each network on each recording."""
    epochs: int = 15
    """Passes of training; the thesis has 15."""
    seed: int = 1
    """Seed of the recordings."""

    @property
    def settings(self) -> StudySettings:
        """Extent of the study.

        Raises:
            SettingError: a setting is too small.
        """
        for name, minimum in (("trials", 0), ("pings", 1), ("seeds", 1), ("epochs", 1)):
            if getattr(self, name) < minimum:
                raise SettingError(f"--{name} must be at least {minimum}, got {getattr(self, name)}")
        return StudySettings(self.out / "networks", self.trials, self.pings, self.seeds, self.epochs, self.seed)


def main(args: Args) -> None:
    """Evaluate the published networks, fit units, record, train, and write tables and a figure."""
    settings, networks = args.settings, published(args.networks)
    words = ["--networks", args.networks.name, "--out", args.out.name]
    origin = f"{made_by('compare-thesis', words, args)}."
    with _bars() as report:
        outcome = study(networks, settings, report)
    folder = args.page or args.out
    write_bytes(folder / FIGURE, figure(outcome))
    text = page(outcome, origin)
    write_text(folder / "tables.md", text)
    print(text)


@contextmanager
def _bars() -> Iterator[Report]:
    """Show one progress bar per task."""
    with bars() as progress:
        tasks: dict[str, TaskID] = {}

        def report(name: str, done: int, total: int) -> None:
            if name not in tasks:
                tasks[name] = progress.add_task(name, total=total)
            progress.update(tasks[name], completed=done)

        yield report


def page(study: RigStudy, origin: str) -> str:
    """Return all tables in Markdown; `origin` is a sentence with the command and the commit."""
    silent = [f"## Mean distance of pings without echo, {SUBSETS[s]} (m)\n\n{_silent(study, s)}" for s in SUBSETS]
    parts = [
        f"# The rig beside the thesis's sonar\n\n{origin}",
        *silent,
        f"## Differences of the distances without echo\n\n{_misfits(study)}",
        f"## Errors of networks on the rig's pings\n\n{_errors(study)}",
        f"## Mean error of networks on right readings, positive for too far (mm)\n\n{_offsets(study)}",
        f"## The condition of table 4.1\n\n{_printed_condition(study)}",
    ]
    return "\n\n".join(parts) + "\n"


def _silent(study: RigStudy, subset: str) -> str:
    """Return the mean distances of pings without echo by sonar, reflector and angle."""
    columns = [(row, int(np.abs(ANGLES_DEG - angle).argmin())) for row in range(len(REFLECTORS)) for angle in SHOWN_DEG]
    header = ["", *(f"{list(REFLECTORS)[row]}, {ANGLES_DEG[k]:g}°" for row, k in columns)]

    def line(name: str, silent: SilentDistances) -> list[str]:
        return [name, *(_metres(getattr(silent, subset)[place]) for place in columns)]

    rows = [line(f"thesis: {name}", silent) for name, silent in study.author.items()]
    for variant in study.variants:
        rows += [line(variant.name, variant.silent), line(f"{variant.name}, by its networks", variant.smoothed)]
    return markdown_table(header, rows)


def _misfits(study: RigStudy) -> str:
    """Return the difference of each rig from the thesis, and of the published networks from their mean."""
    header = ["", *FREE, "recording", "networks trained on it", "at a limit"]
    author = [f"{silent.rms_difference(study.target):.2f}" for silent in study.author.values()]
    rows = [["thesis: its networks from their mean", *["–"] * (len(FREE) + 1), " ".join(author), "–"]]
    limits = {tuned.unit: tuned.at_limit for tuned in study.tunings.values()}
    for variant in study.variants:
        unit = variant.rig.unit
        values = [UNIT_FORMATS[name][0].format(UNIT_FORMATS[name][1] * getattr(unit, name)) for name in FREE]
        differences = [f"{s.rms_difference(study.target):.2f}" for s in (variant.silent, variant.smoothed)]
        rows.append([variant.name, *values, *differences, ", ".join(limits.get(unit, ())) or "–"])
    note = "Root mean square over 22 angles and reflectors, m; if every ping has an echo, the distance counts as 6 m."
    return f"{note}\n\n{markdown_table(header, rows)}"


def _errors(study: RigStudy) -> str:
    """Return losses, with those that the thesis prints, and errors by kind of ping."""
    header = ["rig", *(f"{kind}, %" for kind in KINDS), "floor", *(f"loss, {name}" for name in SOURCES.values())]
    header += [f"{kind} pings, {name} (mm)" for kind in KINDS for name in SOURCES.values()]

    def row(variant: RigVariant) -> list[str]:
        errors = [variant.errors(source) for source in SOURCES]
        shares = [f"{100.0 * share:.1f}" for share in variant.shares]
        losses = [f"{loss:.4f}" for loss in (variant.samples.loss_floor(), *(one.loss for one in errors))]
        return [variant.name, *shares, *losses, *(_millimetres(one.by_kind[kind]) for kind in KINDS for one in errors)]

    best = min(result.validation for result in TABLES[20].values())
    printed = f"{best:.4f} and {A1_VALIDATION[-1]:.4f}"
    note = f"Printed losses of networks of 20 and 30 neurons on the thesis's pings: {printed}."
    return f"{note}\n\n{markdown_table(header, map(row, study.variants))}"


def _offsets(study: RigStudy) -> str:
    """Return the mean errors of networks on right readings by distance."""
    header = ["right readings from", *(f"{a:g} to {min(b, MAX_DISTANCE):g} m" for a, b in pairwise(BANDS))]
    rows = [
        [f"{variant.name}, {name}", *map(_millimetres, variant.offsets(source))]
        for variant in study.variants
        for source, name in SOURCES.items()
    ]
    return markdown_table(header, rows)


def _printed_condition(study: RigStudy) -> str:
    """Return credence and readings in the condition of table 4.1."""
    rows = [("thesis", PRINTED_CREDENCE, PRINTED_READINGS_MM)]
    for variant in study.variants:
        credence, readings = condition_readings(variant.samples)
        text = f"{readings[0]:.0f} to {readings[1]:.0f}" if len(readings) else "–"
        rows.append((variant.name, f"{credence:.2f}", text))
    return markdown_table(("mirror, 30°, 3900 mm", "credence", "readings, 10 % to 90 % quantile (mm)"), rows)


def condition_readings(samples: Samples) -> tuple[float, Floats]:
    """Return the credence in the condition of table 4.1, and the 10 % and 90 % quantiles of any readings, mm."""
    chosen = np.abs(samples.angle_deg - PRINTED_CONDITION["angle_deg"]) < 0.1
    chosen &= np.abs(samples.feature[:, 1] - PRINTED_CONDITION["reflectance"]) < 0.01
    chosen &= np.abs(samples.distance - PRINTED_CONDITION["distance_m"]) < 1e-3
    readings = 1e3 * samples.range[chosen & (samples.range > 0.0)]
    quantiles = np.percentile(readings, [10, 90]) if len(readings) else readings
    return float(samples.feature[chosen, 3].astype(np.float64).mean()), quantiles


def _metres(value: float) -> str:
    return f"{value:.2f}" if np.isfinite(value) else "–"


def _millimetres(value: float) -> str:
    return f"{round(1e3 * value)}" if np.isfinite(value) else "–"


def figure(study: RigStudy) -> bytes:
    """Draw the mean distances of pings without echo by reflector and angle as PNG."""
    draws = [_panel(study, subset, row) for subset in SUBSETS for row in range(len(REFLECTORS))]
    return panels(draws, (9.0, 6.8), columns=2, share_y=True)


def _panel(study: RigStudy, subset: str, row: int) -> Draw:
    def draw(axes: Axes) -> None:
        author = np.array([getattr(silent, subset)[row] for silent in study.author.values()])
        axes.fill_between(ANGLES_DEG, author.min(axis=0), author.max(axis=0), color=SOFT, alpha=0.35, lw=0)
        axes.plot(ANGLES_DEG, author.mean(axis=0), color=INK, lw=2.0, label="the thesis's sonar, by its networks")
        for variant in study.variants:
            _draw_variant(axes, variant, subset, row)
        axes.set(xlabel="angle (deg)", ylim=(0.0, 6.2), title=f"{list(REFLECTORS)[row]}, {SUBSETS[subset]}")
        axes.title.set_fontsize(9)
        if row == 0:
            axes.set_ylabel("mean distance of pings without echo (m)", fontsize=9)
        if row == 0 and subset == "never_right":
            axes.legend(fontsize=7.5, loc="lower left")

    return draw


def _draw_variant(axes: Axes, variant: RigVariant, subset: str, row: int) -> None:
    """Draw a rig's recording as points and the networks trained on it as a line."""
    colour = AFTER if variant.rig.setup.gain == FULL_GAIN else BEFORE
    marker, line = ("o", "-") if variant.name.endswith("tuned") else ("x", ":")
    measured, smoothed = getattr(variant.silent, subset)[row], getattr(variant.smoothed, subset)[row]
    axes.plot(ANGLES_DEG, measured, marker, color=colour, ms=4, label=f"rig, {variant.name}")
    axes.plot(ANGLES_DEG, smoothed, line, color=colour, lw=1.1)
