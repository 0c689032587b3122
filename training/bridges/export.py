"""A sonar for other simulators: a unit of FMI, or the nearest that Webots or Gazebo hold, with its error."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from acquisition.io.files import write_text
from acquisition.io.places import OutputFile
from acquisition.limits import Limit, Seed
from noise import load_model
from sonar_gym.bridges.fmi.build import Count, build_unit
from sonar_gym.bridges.simulators import gazebo, webots
from sonar_gym.sensing.mounts import CONE_DEG

EXPORTS = {"webots": webots.export, "gazebo": gazebo.export}


@dataclass(frozen=True)
class Args:
    """Settings of `sonar-gym export`."""

    simulator: Annotated[Literal["webots", "gazebo", "fmi"], tyro.conf.Positional]
    """webots: a DistanceSensor with a lookup table. gazebo: an SDF sensor with Gaussian noise. fmi: a unit, 3.0."""
    model: Annotated[Path, tyro.conf.Positional]
    """Sonar: a name (srf08-mlp, ...) or the folder of a saved model."""
    out: OutputFile
    """File to write."""
    max_range: Annotated[float, Limit(0.05, 100.0, "m")] = 6.0
    """Maximum range, m, which the simulator returns without an echo."""
    aperture_deg: Annotated[float, Limit(0.1, 180.0, "deg")] = CONE_DEG
    """Full opening angle of the beam, deg."""
    seed: Seed = 0
    """Seed of the model's readings to which the sonar is fitted."""
    sensors: Count = 1
    """Number of sonars of the unit of FMI."""


def main(args: Args) -> None:
    """Write the sonar; of the nearest of a simulator, print what it leaves."""
    if args.simulator == "fmi":
        build_unit(load_model(args.model), args.out, args.sensors, args.max_range)
        print(f"{args.out}: unit of FMI 3.0, {args.sensors} sonars with {args.model}")
        return
    text, nearest = EXPORTS[args.simulator](load_model(args.model), args.max_range, args.aperture_deg, args.seed)
    write_text(args.out, text)
    print(
        f"{args.out}: {nearest.crps_mm:.0f} mm CRPS against readings of {args.model}; the model itself: "
        f"{nearest.model_crps_mm:.0f} mm; left by the simulator: {nearest.left_mm:.0f} mm"
    )
    if nearest.silent > 0.0:
        print(
            f"{100 * nearest.silent:.0f} % of the readings have no echo, which {args.simulator} cannot draw by chance"
        )
