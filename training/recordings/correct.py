"""What a diagnosis found, applied to the readings of the simulator."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from acquisition import Recording, SettingError
from acquisition.io.places import OutputFile
from acquisition.limits import Seed
from noise.replay import corrected_readings
from noise.store import load_model


@dataclass(frozen=True)
class Args:
    """Settings of `sonar-gym correct`."""

    result: Annotated[Path, tyro.conf.Positional]
    """Output folder of `sonar-gym diagnose`."""
    simulated: Annotated[Path, tyro.conf.Positional]
    """Readings of the simulator (recording), under any conditions."""
    out: OutputFile
    """Recording to write: Parquet if the name ends in .parquet, otherwise CSV."""
    seed: Seed = 0
    """Seed of the draws."""


def main(args: Args) -> None:
    """Correct a recording and print what changed."""
    folder = args.result / "difference"
    if not (folder / "model.json").is_file():
        raise SettingError(
            f"{args.result}: holds no difference/, so that there is nothing to apply; give the output folder of "
            "`sonar-gym diagnose` where it found a difference that it can describe"
        )
    simulated = Recording.load(args.simulated)
    corrected = corrected_readings(load_model(folder), simulated, np.random.default_rng(args.seed))
    corrected.save(args.out)
    both = simulated.reading.echo & corrected.reading.echo
    change = corrected.reading.range[both] - simulated.reading.range[both]
    heard = [100.0 * float(each.reading.echo.mean()) for each in (simulated, corrected)]
    median = 1e3 * float(np.median(change)) if both.any() else 0.0
    print(f"{args.out}: {len(corrected)} pings; echoes {heard[0]:.1f} % -> {heard[1]:.1f} %; median {median:+.1f} mm")
