"""Figures of a recording: credence surfaces, detection, readings against distance and over time."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from acquisition import Recording, SettingError
from acquisition.io.files import write_bytes
from acquisition.io.places import OutputFolder
from acquisition.io.units import doubtful_units
from training.common.progress import bar
from training.recordings.figures import FIGURES


@dataclass(frozen=True)
class Args:
    """Settings of `sonar-gym plot`.

    Example:
        sonar-gym plot rec.csv --out figures --where gain=14
    """

    recording: Annotated[Path, tyro.conf.Positional]
    """Recording to draw."""
    out: OutputFolder
    """Output folder of the figures, PNG."""
    where: tuple[str, ...] = ()
    """Draw only rows with these values: column=value."""
    bearing: str = "angle_deg"
    """Column, deg, for the angular axis of surfaces; pitch_deg shows the vertical field of view."""
    skip_bad_rows: bool = False
    """Omit and list invalid rows instead of rejecting the file."""


def main(args: Args) -> None:
    """Draw every figure and print its file name and content."""
    recording = Recording.load(args.recording, args.skip_bad_rows)
    for warning in doubtful_units(recording):
        print(f"warning: {warning}")
    for text in args.where:
        recording = chosen(recording, text)
    recording = over(recording, args.bearing)
    lines = []
    with bar("drawing", len(FIGURES)) as update:
        for number, (name, (draw, content)) in enumerate(FIGURES.items()):
            lines.append(f"{write_bytes(args.out / name, draw(recording))}: {content}")
            update(number + 1, len(FIGURES))
    print("\n".join([*lines, *(f"omitted: {fault}" for fault in recording.rejected)]))


def over(recording: Recording, column: str) -> Recording:
    """Return the recording with another column in place of the bearing.

    Raises:
        SettingError: the recording has no such numeric column.
    """
    if column not in ("angle_deg", *recording.covariates):
        raise SettingError(f"--bearing {column}: expected one of angle_deg, {', '.join(recording.covariates)}")
    return replace(recording, table=recording.table.assign(angle_deg=recording.table[column]))


def chosen(recording: Recording, text: str) -> Recording:
    """Return the rows in which a column has a value, given as column=value.

    Raises:
        SettingError: there is no such column or no such row.
    """
    name, equals, value = text.partition("=")
    if not equals or not recording.has(name):
        raise SettingError(f"--where {text}: expected column=value with one of {', '.join(recording.table.columns)}")
    column = recording.table[name]
    try:
        mask = np.isclose(column.to_numpy(np.float64), float(value))
    except ValueError:
        mask = (column.astype(str) == value).to_numpy()
    if not mask.any():
        some = ", ".join(str(item) for item in column.unique()[:10])
        raise SettingError(f"--where {text}: no row has that value; values include {some}")
    return recording.select(mask)
