"""Prior distribution of the conditions of each sonar in the street, from which credence given a reading follows.

A robot knows the kind of its world and which sonar gave a reading, but not its own position. The conditions of each
sonar are therefore sampled from streets of the task with the car near the reference path. A sonar that faces along the
street mostly measures faces at the edge of its cone; one that faces sideways measures them at normal incidence.
"""

from __future__ import annotations

from collections.abc import Hashable
from functools import lru_cache
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from acquisition import Ping
from noise import CredenceTable, SonarModel
from sonar_gym.parking.street import Street, StreetSettings, draw_street, reference_path
from sonar_gym.parking.vehicle import CarSettings
from sonar_gym.sensing.kernels import NOTHING, touches
from sonar_gym.sensing.mounts import Mount, in_world, mount_arrays
from sonar_gym.sensing.sonar import bin_edges, broad_table

Floats = NDArray[np.float64]
SEED = 2016  # fixed, so that every process computes the same prior
STREETS, POSES = 60, 12  # number of streets, and of poses in each
OFF_PATH, OFF_HEADING = 0.03, np.radians(5.0)  # m, rad; standard deviations from the path, chosen here
BROAD_WEIGHT = 0.05  # weight of the broad prior, for readings that the sample never gives


def _poses(street: Street, car: CarSettings, rng: np.random.Generator) -> list[Floats]:
    """Return collision-free poses near the path from the start to the gap."""
    path = reference_path(street, car)[:, :3]
    on_street = path[path[:, 0] >= street.start[0]]
    chosen = on_street[rng.integers(len(on_street), size=POSES)]
    chosen = chosen + rng.normal(size=chosen.shape) * [OFF_PATH, OFF_PATH, OFF_HEADING]
    return [pose for pose in chosen if touches(pose, car.body, street.scene.segments) == NOTHING]


@lru_cache(maxsize=16)
def street_pings(
    streets: StreetSettings, car: CarSettings, mounts: tuple[Mount, ...], max_range: float
) -> tuple[Ping, ...]:
    """Return a sample of the conditions of each sonar, each (n,), including empty cones."""
    rng = np.random.default_rng(SEED)
    local, half = mount_arrays(mounts)
    met = []
    for _ in range(STREETS):
        street = draw_street(streets, rng)
        poses = _poses(street, car, rng)
        met += [street.scene.cast(in_world(local, pose), half, max_range).ping(0.0) for pose in poses]
    fields = {name: np.stack([getattr(ping, name) for ping in met]) for name in FIELDS}
    return tuple(Ping.of(**{name: value[:, i] for name, value in fields.items()}) for i in range(len(mounts)))


FIELDS = ("distance", "angle", "incidence", "reflectance")


def street_credence(
    model: SonarModel, streets: StreetSettings, car: CarSettings, mounts: tuple[Mount, ...], max_range: float
) -> tuple[CredenceTable, ...]:
    """Return the credence given a reading for each sonar of a car in such streets; cached per model."""
    return _street_credence(cast(Hashable, model), streets, car, mounts, max_range)


@lru_cache(maxsize=16)
def _street_credence(
    model: Any, streets: StreetSettings, car: CarSettings, mounts: tuple[Mount, ...], max_range: float
) -> tuple[CredenceTable, ...]:
    edges, broad = bin_edges(max_range), broad_table(model, max_range)
    pings = street_pings(streets, car, mounts, max_range)
    return tuple(CredenceTable.over(model, ping, edges).mixed(broad, BROAD_WEIGHT) for ping in pings)
