"""Draw a recording: credence surfaces, detection, readings against distance, course of time."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from acquisition import Recording, SettingError
from acquisition.io.files import write_bytes
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
    out: Path
    """Folder to write the figures to, as PNG."""
    where: tuple[str, ...] = ()
    """Only rows in which columns have these values: column=value."""
    bearing: str = "angle_deg"
    """Column in degrees to draw surfaces over; pitch_deg shows the vertical field of view."""
    skip_bad_rows: bool = False
    """Leave faulty rows out, and say which, rather than refuse the file."""


def main(args: Args) -> None:
    """Draw every figure and say what each shows."""
    recording = Recording.load(args.recording, args.skip_bad_rows)
    for text in args.where:
        recording = chosen(recording, text)
    recording = over(recording, args.bearing)
    told = []
    with bar("drawing", len(FIGURES)) as tell:
        for number, (name, (draw, shows)) in enumerate(FIGURES.items()):
            told.append(f"{write_bytes(args.out / name, draw(recording))}: {shows}")
            tell(number + 1, len(FIGURES))
    print("\n".join([*told, *(f"left out: {fault}" for fault in recording.rejected)]))


def over(recording: Recording, column: str) -> Recording:
    """Return the recording with another column in the place of the bearing.

    Raises:
        SettingError: it has no such column of numbers.
    """
    if column not in ("angle_deg", *recording.covariates):
        raise SettingError(f"--bearing {column}: expected one of angle_deg, {', '.join(recording.covariates)}")
    return replace(recording, table=recording.table.assign(angle_deg=recording.table[column]))


def chosen(recording: Recording, text: str) -> Recording:
    """Return the rows in which a column has a value.

    Raises:
        SettingError: no such column, or no such row.
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
        raise SettingError(f"--where {text}: no row has that value; there are {some}")
    return recording.select(mask)
