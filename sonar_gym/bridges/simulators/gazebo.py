"""SDF sensors of Gazebo: the ray sensor with Gaussian noise nearest to a model.

SDF's `ray` and `gpu_lidar` sensors hold a range and a Gaussian noise with one mean and one standard deviation.
Source: SDFormat specification, elements `ray` and `noise`.
"""

from __future__ import annotations

import math
from xml.etree import ElementTree

from acquisition.arguments import checked
from noise import SonarModel
from sonar_gym.bridges.simulators.nearest import NEAR_M, Nearest, nearest_gaussian

RAYS = 9  # across the beam; a sonar is the nearest of them
RATE_HZ = 10.0


@checked
def export(model: SonarModel, max_range: float, aperture_deg: float, seed: int = 0) -> tuple[str, Nearest]:
    """Return a `<sensor>` element for the nearest Gaussian noise, and what it leaves."""
    nearest = nearest_gaussian(model, max_range, seed)
    half = math.radians(0.5 * aperture_deg)
    sensor = ElementTree.Element("sensor", name="sonar", type="gpu_lidar")
    _add(sensor, "update_rate", RATE_HZ)
    lidar = ElementTree.SubElement(sensor, "lidar")
    scan = ElementTree.SubElement(ElementTree.SubElement(lidar, "scan"), "horizontal")
    for name, value in {"samples": RAYS, "resolution": 1, "min_angle": -half, "max_angle": half}.items():
        _add(scan, name, value)
    span = ElementTree.SubElement(lidar, "range")
    for name, value in {"min": NEAR_M, "max": max_range, "resolution": model.resolution}.items():
        _add(span, name, value)
    noise = ElementTree.SubElement(lidar, "noise")
    ElementTree.SubElement(noise, "type").text = "gaussian"
    _add(noise, "mean", nearest.table.means[0])
    _add(noise, "stddev", nearest.table.sigmas[0])
    ElementTree.indent(sensor)
    return ElementTree.tostring(sensor, encoding="unicode") + "\n", nearest


def _add(parent: ElementTree.Element, name: str, value: float) -> None:
    ElementTree.SubElement(parent, name).text = f"{value:.6g}"
