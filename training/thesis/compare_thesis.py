"""Compare the rig with the thesis's sonar by means of the networks that its author published.

The rig records the thesis's survey at the gain stated in the thesis and at full gain, each with nominal and with tuned
electronics. Networks of the author's architectures are trained on each recording, so that differences due to smoothing
by a network are not attributed to the sonar.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from acquisition import SettingError
from acquisition.io.files import write_bytes, write_text
from acquisition.io.places import OutputFolder
from acquisition.limits import Count, Limit, Seed
from training.common.canvas import AFTER, BEFORE, INK, SOFT, Axes, Draw, panels
from training.common.commit import commit
from training.common.progress import progress_bars
from training.common.records import write_record
from training.common.tables import markdown_table
from training.thesis.data import A1_VALIDATION, TABLES, Floats, Samples
from training.thesis.experiment import provenance
from training.thesis.rig import (
    BANDS_M,
    FREE_PARAMETERS,
    FULL_GAIN,
    RigStudy,
    Settings,
    Source,
    compare,
    published,
)
from training.thesis.surfaces import ANGLES_DEG, KINDS, REFLECTORS

FIGURE = "rig-versus-thesis.png"
THESIS, PREDICTED = "thesis", ", predicted"  # lines of the figure: its networks, and those trained on a rig
Lines = dict[str, dict[str, list[Any]]]
SHOWN_DEG = (0.0, 10.0, 20.0, 25.0, 30.0, 35.0, 40.0, 45.0)
PARAMETER_FORMATS = {
    "sensitivity_db": ("{:+.1f} dB", 1.0),
    "radius": ("{:.2f} mm", 1e3),
    "yaw": ("{:+.1f} deg", 180.0 / np.pi),
}
# Esmi (2016), table 4.1
PRINTED_ANGLE_DEG, PRINTED_REFLECTANCE, PRINTED_DISTANCE_M = 30.0, 0.9, 3.9
CREDENCES = {"never": "credence 0", "half": "credence about 0.5"}
SOURCES: dict[Source, str] = {"own": "its own", "author": "the thesis's"}


@dataclass(frozen=True)
class Args:
    """Settings of `sonar-gym compare-thesis`.

    Example:
        sonar-gym compare-thesis --networks MasterThesis --out rig-versus-thesis
    """

    networks: Path
    """Folder with the networks that the thesis's author published (*.h5, *.hdf5)."""
    out: OutputFolder
    """Folder for trained networks, tables and figure."""
    page: OutputFolder | None = None
    """Folder for tables and figure, if different from OUT."""
    trials: Count = 40
    """Number of units to try at each gain; 0 does not tune the electronics."""
    pings: Count = 50
    """Pings per condition."""
    seeds: Annotated[int, Limit(1, 1000)] = 3
    """Number of trainings of each network on each recording."""
    epochs: Count = 15
    """Passes of training; 15 as in the thesis."""
    seed: Seed = 1
    """Seed of the recordings."""

    @property
    def settings(self) -> Settings:
        """Extent of the comparison.

        Raises:
            SettingError: a value is below its minimum.
        """
        for name, minimum in (("trials", 0), ("pings", 1), ("seeds", 1), ("epochs", 1)):
            if getattr(self, name) < minimum:
                raise SettingError(f"--{name} must be at least {minimum}, got {getattr(self, name)}")
        return Settings(self.out / "networks", self.trials, self.pings, self.seeds, self.epochs, self.seed)


def main(args: Args) -> None:
    """Evaluate the author's networks, tune, record, train, and write tables and a figure."""
    settings, author, made_by = args.settings, published(args.networks), commit()
    made = provenance(["compare-thesis", "--networks", args.networks.name, "--out", args.out.name], args)
    with progress_bars() as report:
        study = compare(author, settings, report)
    folder = args.page or args.out
    write_bytes(
        folder / FIGURE, figure(write_record(folder / FIGURE, made_by, "sonar-gym compare-thesis", lines_of(study)))
    )
    text = page(study, f"{made}.")
    write_text(folder / "tables.md", text)
    print(text)


def page(study: RigStudy, about: str) -> str:
    """Return a page of all tables; `about` states the command and the commit."""
    sections = [
        *[(f"Mean distance of silent pings, {text} (m)", _silences(study, c)) for c, text in CREDENCES.items()],
        ("Differences from the thesis's sonar", _misfits(study)),
        ("Errors of networks on the rig's pings", _errors(study)),
        ("Mean error of networks on correct readings (mm; positive: too far)", _offsets(study)),
        ("The condition printed in the thesis", _printed_condition(study)),
    ]
    title = f"# The rig beside the thesis's sonar\n\n{about}\n"
    return "\n".join([title, *(f"## {heading}\n\n{text}\n" for heading, text in sections)])


def _silences(study: RigStudy, credence: str) -> str:
    """Return the silent distances of the thesis's networks and of each rig, by reflector and angle."""
    columns = [(row, int(np.abs(ANGLES_DEG - angle).argmin())) for row in range(len(REFLECTORS)) for angle in SHOWN_DEG]
    header = ["", *(f"{list(REFLECTORS)[row]}, {ANGLES_DEG[k]:g}°" for row, k in columns)]
    lines = {f"thesis: {name}": silence for name, silence in study.predictions.items()}
    for variant in study.variants:
        lines |= {
            variant.name: variant.silence,
            f"{variant.name}, predicted by its networks": variant.predicted_silence,
        }
    rows = [[name, *(_metres(getattr(one, credence)[at]) for at in columns)] for name, one in lines.items()]
    return markdown_table(header, rows)


def _misfits(study: RigStudy) -> str:
    """Return the differences of each rig's silent distances from the thesis's, and of its networks from their mean."""
    header = ["", *FREE_PARAMETERS, "of its own pings", "predicted by networks trained on them", "at a limit"]
    networks = [f"{silence.rms_difference(study.target):.2f}" for silence in study.predictions.values()]
    rows = [["thesis: its networks, from their mean", *["–"] * (len(FREE_PARAMETERS) + 1), " ".join(networks), "–"]]
    limits = {tuned.unit: tuned.at_limit for tuned in study.tunings.values()}
    for variant in study.variants:
        unit, silences = variant.rig.unit, (variant.silence, variant.predicted_silence)
        values = [text.format(scale * getattr(unit, name)) for name, (text, scale) in PARAMETER_FORMATS.items()]
        differences = [f"{silence.rms_difference(study.target):.2f}" for silence in silences]
        rows.append([variant.name, *values, *differences, ", ".join(limits.get(unit, ())) or "–"])
    return "Root mean square over 22 angles and reflectors, m; no silent pings count as 6 m.\n\n" + markdown_table(
        header, rows
    )


def _errors(study: RigStudy) -> str:
    """Return losses and errors by kind of ping, with the losses that the thesis printed."""
    header = ["rig", *(f"{kind}, %" for kind in KINDS), "floor", "loss, its own", "loss, the thesis's"]
    header += [f"{kind} pings, {whose} (mm)" for kind in KINDS for whose in SOURCES.values()]
    rows = []
    for variant in study.variants:
        errors = [variant.errors(source) for source in SOURCES]
        shares = [f"{100.0 * share:.1f}" for share in variant.shares]
        losses = [f"{loss:.4f}" for loss in (variant.samples.loss_floor(), *(one.loss for one in errors))]
        rows.append([variant.name, *shares, *losses, *(_millimetres(e.by_kind[k]) for k in KINDS for e in errors)])
    best = min(row.validation for row in TABLES[20].values())
    printed = f"{best:.4f} and {A1_VALIDATION[-1]:.4f}"
    text = f"Printed losses of networks of 20 and 30 neurons on the thesis's own pings: {printed}."
    return f"{text}\n\n{markdown_table(header, rows)}"


def _offsets(study: RigStudy) -> str:
    """Return the mean errors of networks on correct readings, by distance."""
    header = ["correct readings from", *(f"{low:g} to {min(high, 6.0):g} m" for low, high in pairwise(BANDS_M))]
    names: dict[Source, str] = {"own": "its own networks", "author": "the thesis's"}
    rows = [
        [f"{variant.name}, {name}", *map(_millimetres, variant.offsets(source))]
        for variant in study.variants
        for source, name in names.items()
    ]
    return markdown_table(header, rows)


def _printed_condition(study: RigStudy) -> str:
    """Return credence and readings of the condition in table 4.1."""
    rows: list[Sequence[str]] = [("thesis", "0.88", "3950 to 3970")]
    for variant in study.variants:
        credence, limits = printed_condition(variant.samples)
        rows.append((variant.name, f"{credence:.2f}", " to ".join(f"{limit:.0f}" for limit in limits) or "–"))
    return markdown_table(("mirror, 30°, 3900 mm", "credence", "readings, 10th to 90th percentile (mm)"), rows)


def printed_condition(samples: Samples) -> tuple[float, Floats]:
    """Return the credence of table 4.1's condition, and 10th and 90th percentile of its echoes, mm; none if silent."""
    angle, reflectance, _, credence = samples.feature.astype(np.float64).T
    selected = np.abs(45.0 * angle - PRINTED_ANGLE_DEG) < 0.1
    selected &= np.abs(reflectance - PRINTED_REFLECTANCE) < 0.01
    selected &= np.abs(samples.distance - PRINTED_DISTANCE_M) < 1e-3
    echoes = 1e3 * samples.reading[selected & (samples.reading > 0.0)]
    return float(credence[selected].mean()), np.percentile(echoes, [10, 90]) if len(echoes) else echoes


def _metres(value: float) -> str:
    return f"{value:.2f}" if np.isfinite(value) else "–"


def _millimetres(value: float) -> str:
    return f"{round(1e3 * value)}" if np.isfinite(value) else "–"


def lines_of(study: RigStudy) -> Lines:
    """Return the silent distances of the tables by line and credence; of the thesis those of each network."""
    shown, every = np.isin(ANGLES_DEG, SHOWN_DEG), study.predictions.values()
    lines = {THESIS: {c: [getattr(one, c)[:, shown].tolist() for one in every] for c in CREDENCES}}
    for variant in study.variants:
        for name, one in ((variant.name, variant.silence), (variant.name + PREDICTED, variant.predicted_silence)):
            lines[name] = {c: getattr(one, c)[:, shown].tolist() for c in CREDENCES}
    return lines


def figure(lines: Lines) -> bytes:
    """Return a figure of the silent distances by reflector and angle, as PNG."""
    draws = [_panel(lines, credence, row) for credence in CREDENCES for row in range(len(REFLECTORS))]
    return panels(draws, (8.0, 6.8), columns=2, share_y=True)


def _panel(lines: Lines, credence: str, row: int) -> Draw:
    def draw(axes: Axes) -> None:
        thesis = np.array(lines[THESIS][credence])[:, row]
        axes.fill_between(SHOWN_DEG, thesis.min(axis=0), thesis.max(axis=0), color=SOFT, alpha=0.35, lw=0)
        axes.plot(SHOWN_DEG, thesis.mean(axis=0), color=INK, lw=2.0, label="thesis")
        for name, one in lines.items():
            if name != THESIS:
                _plot_rig(axes, name, one[credence][row])
        axes.set(xlabel="angle (deg)", ylim=(0.0, 6.2), title=f"{list(REFLECTORS)[row]}, {CREDENCES[credence]}")
        if row == 0:
            axes.set_ylabel("mean distance (m)")
        if row == 0 and credence == "never":
            axes.legend(fontsize=9, loc="lower left")

    return draw


def _plot_rig(axes: Axes, name: str, values: Sequence[float]) -> None:
    """Plot a rig's silent distances as points, and the predictions of networks trained on it as a line."""
    rig = name.removesuffix(PREDICTED)
    colour = AFTER if f"gain {FULL_GAIN}" in rig else BEFORE
    marker, line = ("o", "-") if rig.endswith("tuned") else ("x", ":")
    if name == rig:
        axes.plot(SHOWN_DEG, values, marker, color=colour, ms=4, label=f"rig, {name}")
    else:
        axes.plot(SHOWN_DEG, values, line, color=colour, lw=1.1)
