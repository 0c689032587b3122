"""Credence given a reading on the street, from a prior over the conditions of each sonar.

The conditions of each sonar are sampled on streets like those of the task, with the car near the path that parks it. A
sonar that points along the street mostly detects faces at the edge of its cone; one that points sideways detects faces
at normal incidence.
"""

from __future__ import annotations

from collections.abc import Hashable
from functools import lru_cache
from typing import Any, cast

import numpy as np

from acquisition import Ping
from acquisition.arrays import Floats
from noise import CredenceTable, SonarModel
from sonar_gym.parking.street import Street, StreetSettings, draw_street, reference_path
from sonar_gym.parking.vehicle import CarSettings
from sonar_gym.sensing.kernels import NO_HIT, touches
from sonar_gym.sensing.mounts import Mount, in_world, mount_arrays
from sonar_gym.sensing.sonar import bin_edges, broad_table

SEED = 2016  # fixed, so that the prior is the same in every environment
STREETS, POSES = 60, 12  # number of streets, and of poses on each
OFF_PATH, OFF_HEADING = 0.03, np.radians(5.0)  # m, rad; standard deviations about the path, chosen here
BROAD_WEIGHT = 0.05  # weight of the broad prior, for readings that the sample never gives


def _poses(street: Street, car: CarSettings, rng: np.random.Generator) -> list[Floats]:
    """Return poses near the reference path, from the start to the space, at which the car touches nothing."""
    path = reference_path(street, car)[:, :3]
    on_street = path[path[:, 0] >= street.start[0]]
    poses = on_street[rng.integers(len(on_street), size=POSES)]
    poses = poses + rng.normal(size=poses.shape) * [OFF_PATH, OFF_PATH, OFF_HEADING]
    return [pose for pose in poses if touches(pose, car.body, street.scene.segments) == NO_HIT]


@lru_cache(maxsize=16)
def street_pings(
    streets: StreetSettings, car: CarSettings, mounts: tuple[Mount, ...], max_range: float
) -> tuple[Ping, ...]:
    """Return a sample of the conditions of each sonar, each (n,), including empty cones."""
    rng = np.random.default_rng(SEED)
    local, half = mount_arrays(mounts)
    pings = []
    for _ in range(STREETS):
        street = draw_street(streets, rng)
        poses = _poses(street, car, rng)
        pings += [street.scene.cast(in_world(local, pose), half, max_range).ping(0.0) for pose in poses]
    fields = {name: np.stack([getattr(ping, name) for ping in pings]) for name in FIELDS}
    return tuple(Ping.of(**{name: value[:, i] for name, value in fields.items()}) for i in range(len(mounts)))


FIELDS = ("distance", "angle", "incidence", "reflectance")


def street_credence(
    model: SonarModel, streets: StreetSettings, car: CarSettings, mounts: tuple[Mount, ...], max_range: float
) -> tuple[CredenceTable, ...]:
    """Return the credence given a reading for each sonar of a car on such streets; computed once per model."""
    return _street_credence(cast(Hashable, model), streets, car, mounts, max_range)


@lru_cache(maxsize=16)
def _street_credence(
    model: Any, streets: StreetSettings, car: CarSettings, mounts: tuple[Mount, ...], max_range: float
) -> tuple[CredenceTable, ...]:
    edges, broad = bin_edges(max_range), broad_table(model, max_range)
    samples = street_pings(streets, car, mounts, max_range)
    return tuple(CredenceTable.over(model, ping, edges).mixed(broad, BROAD_WEIGHT) for ping in samples)
