"""What a car in the street faces before it listens: the prior over which credence given a reading is taken.

A robot knows its kind of world and which of its sonars speaks, though not where it stands. So the conditions of each
sonar are sampled from streets like those of the task, with the car near the path that parks it: a sonar that looks
along the street mostly meets faces at the edge of its cone, one that looks sideways meets them squarely.
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
SEED = 2016  # the prior is the same for everyone
STREETS, POSES = 60, 12  # drawn, and poses in each
OFF_PATH, OFF_HEADING = 0.03, np.radians(5.0)  # m, rad; standard deviations about the path: ours
BROAD_WEIGHT = 0.05  # kept for readings that the sample never gives


def _poses(street: Street, car: CarSettings, rng: np.random.Generator) -> list[Floats]:
    """Return poses near the path from the start to the space at which the car touches nothing."""
    path = reference_path(street, car)[:, :3]
    on_street = path[path[:, 0] >= street.start[0]]
    chosen = on_street[rng.integers(len(on_street), size=POSES)]
    chosen = chosen + rng.normal(size=chosen.shape) * [OFF_PATH, OFF_PATH, OFF_HEADING]
    return [pose for pose in chosen if touches(pose, car.body, street.scene.segments) == NOTHING]


@lru_cache(maxsize=16)
def street_pings(
    streets: StreetSettings, car: CarSettings, mounts: tuple[Mount, ...], max_range: float
) -> tuple[Ping, ...]:
    """Return for each sonar a sample of the conditions that it meets, each (n,); empty cones are among them."""
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
    """Return the credence given a reading for each sonar of a car in such streets; computed once a model."""
    return _street_credence(cast(Hashable, model), streets, car, mounts, max_range)


@lru_cache(maxsize=16)
def _street_credence(
    model: Any, streets: StreetSettings, car: CarSettings, mounts: tuple[Mount, ...], max_range: float
) -> tuple[CredenceTable, ...]:
    edges, broad = bin_edges(max_range), broad_table(model, max_range)
    pings = street_pings(streets, car, mounts, max_range)
    return tuple(CredenceTable.over(model, ping, edges).mixed(broad, BROAD_WEIGHT) for ping in pings)
