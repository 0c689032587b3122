"""Write a unit of FMI 3.0."""

from __future__ import annotations

import json
import shutil
import tempfile
from pathlib import Path
from typing import Annotated

from acquisition.arguments import checked
from acquisition.extras import require
from acquisition.io.files import write_bytes
from acquisition.limits import Limit, PositiveMetres
from noise import save_model
from sonar_gym.sensing.sonar import SonarChoice, resolve

UNIT = Path(__file__).with_name("sonar_gym_unit.py")
Count = Annotated[int, Limit(1, 1024)]  # more make a description of megabytes


@checked
def build_unit(model: SonarChoice, path: Path, sensors: Count = 1, max_range: PositiveMetres = 6.0) -> Path:
    """Write a unit of FMI 3.0 for co-simulation, and return its path.

    Its importer's process needs Python with sonar-gym; the model is part of the unit.

    Args:
        model: name, path or model of the sonars.
        path: file to write.
        sensors: number of sonars.
        max_range: maximum range, m; an echo beyond it is no echo.

    Raises:
        MissingExtraError: pythonfmu3 is not installed.
    """
    require("pythonfmu3", "fmi")
    from pythonfmu3.builder import FmuBuilder

    from sonar_gym.bridges.fmi import sonar_gym_unit as unit

    chosen = resolve(model)
    with tempfile.TemporaryDirectory() as folder:
        parts = [save_model(chosen, Path(folder) / unit.MODEL), Path(folder) / unit.SETTINGS]
        parts[1].write_text(json.dumps({"sensors": sensors, "max_range": max_range}))
        made = FmuBuilder.build_FMU(shutil.copy(UNIT, folder), Path(folder) / "made", parts)
        return write_bytes(path, made.read_bytes())
