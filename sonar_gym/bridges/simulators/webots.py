"""Lookup tables of Webots's DistanceSensor: reading them as models, and writing the table nearest to a model.

A row of `lookupTable` is a distance, m, the value that the sensor returns there, and the standard deviation of its
noise relative to that value; values between rows are interpolated. A sensor of type "sonar" returns its maximum for a
surface whose incidence exceeds 22.5 degrees. Source: Webots reference manual, DistanceSensor.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from acquisition import RecordingError, RecordingNotFoundError, SettingError
from acquisition.arguments import checked
from acquisition.arrays import Floats
from acquisition.io.files import is_file, read_limited
from noise import SonarModel
from noise.table import TableModel
from sonar_gym.bridges.simulators.nearest import Nearest, nearest_table

SONAR_INCIDENCE = float(np.pi / 8)  # rad; beyond it a "sonar" returns its maximum
RAYS = 9  # of an exported sensor; a "sonar" takes the nearest hit of all its rays
COLUMNS = 3
SENSOR = re.compile(r"\bDistanceSensor\s*\{")
TABLE = re.compile(r"\blookupTable\s*\[([^\]]*)\]")
NAME = re.compile(r'\bname\s+"([^"]*)"')
TYPE = re.compile(r'\btype\s+"([^"]*)"')
BRACE, MAX_DEPTH = re.compile(r"[{}]"), 100
COMMENT = re.compile(r"#[^\n]*")


@checked
def load_tables(path: Path, metres_per_unit: float | None = None) -> dict[str, TableModel]:
    """Return the distance sensors of a world or PROTO file as models, by name.

    Args:
        path: of the .wbt or .proto file.
        metres_per_unit: of the values that the sensors return, m. Without it, a program is assumed to invert the table:
            its readings have no bias, and the noise that the table's slope implies.

    Raises:
        RecordingNotFoundError: the file does not exist.
        RecordingError: the file has no lookup table, or a damaged one.
        SettingError: a table cannot be inverted.
    """
    if not is_file(path):
        raise RecordingNotFoundError(f"{path}: no such file; give a .wbt or .proto file of Webots")
    text = COMMENT.sub("", read_limited(path, RecordingError, "a world or PROTO file").decode("utf-8", "replace"))
    models: dict[str, TableModel] = {}
    for start in SENSOR.finditer(text):
        try:
            body = _braced(text, start.end())
        except RecordingError as error:
            raise RecordingError(f"{path}: {error}") from None
        found = TABLE.search(body)
        if found is None:
            continue
        name = NAME.search(body)
        label = name[1] if name else f"distance sensor {len(models) + 1}"
        kind = TYPE.search(body)
        rows = _rows(f"{path}, {label!r}", found[1])
        models[label] = _model(f"{path}, {label!r}", rows, metres_per_unit, kind is not None and kind[1] == "sonar")
    if not models:
        raise RecordingError(f"{path}: has no DistanceSensor with a lookupTable")
    return models


def _braced(text: str, start: int) -> str:
    """Return the text from behind an opening brace to the closing one.

    Raises:
        RecordingError: there is none, or the nodes in between are nested too deeply.
    """
    depth = 1
    for brace in BRACE.finditer(text, start):
        depth += 1 if brace[0] == "{" else -1
        if depth == 0:
            return text[start : brace.start()]
        if depth > MAX_DEPTH:
            break
    raise RecordingError(f"a DistanceSensor is not closed by }}, or has more than {MAX_DEPTH} nodes in each other")


def _rows(where: str, text: str) -> Floats:
    try:
        numbers = np.array([float(part) for part in text.replace(",", " ").split()])
    except ValueError as error:
        raise RecordingError(f"{where}: lookupTable: {error}") from None
    if len(numbers) < 2 * COLUMNS or len(numbers) % COLUMNS or not np.all(np.isfinite(numbers)):
        raise RecordingError(f"{where}: lookupTable has {len(numbers)} numbers, expected 2 or more rows of {COLUMNS}")
    rows = numbers.reshape(-1, COLUMNS)
    if np.any(np.diff(rows[:, 0]) <= 0.0) or rows[0, 0] < 0.0:
        raise RecordingError(f"{where}: the distances of lookupTable must be >= 0 m and increase")
    return rows


def _model(where: str, rows: Floats, metres_per_unit: float | None, is_sonar: bool) -> TableModel:
    distance, value, noise = rows.T
    if metres_per_unit is not None:
        mean, sigma = metres_per_unit * value, np.abs(metres_per_unit * value * noise)
    else:
        slope = np.diff(value) / np.diff(distance)
        if np.any(slope == 0.0) or np.any(np.sign(slope) != np.sign(slope[0])):
            raise SettingError(
                f"{where}: the values of lookupTable neither increase nor decrease throughout, so no distance follows "
                "from them; give --metres-per-unit if they are distances"
            )
        steepness = np.interp(distance, 0.5 * (distance[1:] + distance[:-1]), np.abs(slope))
        mean, sigma = distance, np.abs(value * noise) / steepness
    distances, means, sigmas = (tuple(map(float, column)) for column in (distance, mean, sigma))
    limit = SONAR_INCIDENCE if is_sonar else float(np.pi / 2)
    return TableModel(distances, means, sigmas, distances[-1], limit)


@checked
def export(model: SonarModel, max_range: float, aperture_deg: float, seed: int = 0) -> tuple[str, Nearest]:
    """Return a DistanceSensor node for the nearest table, and what the table leaves.

    The type is "sonar", the only one that returns the nearest hit of several rays; what its limit of incidence costs is
    part of the error.
    """
    nearest = nearest_table(model, max_range, SONAR_INCIDENCE, seed)
    table = nearest.table
    rows = zip(table.distances, table.means, table.sigmas, strict=True)
    lines = [f"    {d:.4g} {mean:.4g} {sigma / mean if mean > 0 else 0.0:.4g}" for d, mean, sigma in rows]
    text = "\n".join(
        [
            "DistanceSensor {",
            '  type "sonar"',
            f"  numberOfRays {RAYS}",
            f"  aperture {np.radians(aperture_deg):.4f}",
            "  lookupTable [",
            *lines,
            "  ]",
            "}",
        ]
    )
    return text + "\n", nearest
