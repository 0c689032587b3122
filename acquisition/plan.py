"""Survey plans: which conditions to measure, how often, and in which order."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np

from acquisition.errors import SettingError
from acquisition.ping import Ping


@dataclass(frozen=True)
class Cell:
    """One condition of a survey, in the units of a recording's columns."""

    distance_mm: float
    angle_deg: float
    reflectance: float
    incidence_deg: float

    def __str__(self) -> str:
        turned = (
            "" if self.incidence_deg == self.angle_deg else f", turned to an incidence of {self.incidence_deg:g} deg"
        )
        return f"{self.distance_mm:g} mm, {self.angle_deg:g} deg, reflectance {self.reflectance:g}{turned}"


@dataclass(frozen=True)
class Plan:
    """A grid of conditions.

    Attributes:
        angles_deg: bearings of the reflector off the beam's axis.
        distances_mm: slant distances.
        reflectances: of the reflectors.
        pings: a cell.
        interval_s: from ping to ping.
        move_s: between the last ping of a cell and the first of the next.
        facing: the reflector is turned to face the sensor; otherwise it stays parallel to the sensor's face, so that
            its incidence is its bearing.
        seed: of the random order of cells; None goes along distances, then angles, then reflectors, which asks for
            the fewest moves but lets drift pass for distance.
        incidences_deg: between beam and surface normal, each at every bearing, rather than what `facing` says.
    """

    angles_deg: tuple[float, ...]
    distances_mm: tuple[float, ...]
    reflectances: tuple[float, ...] = (0.1, 0.9)
    pings: int = 50
    interval_s: float = 2.4
    move_s: float = 20.0
    facing: bool = False
    seed: int | None = 0
    incidences_deg: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        """Refuse a plan without a ping."""
        if min(self.pings, len(self.angles_deg), len(self.distances_mm), len(self.reflectances)) < 1:
            raise SettingError("a plan needs at least one angle, distance, reflectance and ping a cell")

    @cached_property
    def cells(self) -> tuple[Cell, ...]:
        """Return the conditions in the order in which they are measured."""
        grid = product(self.reflectances, self.angles_deg, self.distances_mm)
        cells = [
            Cell(distance, angle, reflectance, incidence)
            for reflectance, angle, distance in grid
            for incidence in self.incidences_deg or (0.0 if self.facing else angle,)
        ]
        if self.seed is None:
            return tuple(cells)
        return tuple(cells[k] for k in np.random.default_rng(self.seed).permutation(len(cells)))

    def __len__(self) -> int:
        """Return the number of cells."""
        return len(self.cells)

    def cell(self, number: int) -> Cell:
        """Return one condition, by its number in the order."""
        return self.cells[number]

    def ping(self, number: int) -> Ping:
        """Return the pings of one cell, at the times at which they are due.

        >>> PLANS["quick"].ping(0).time[:2]
        array([0. , 0.1])
        """
        cell = self.cells[number]
        start = number * ((self.pings - 1) * self.interval_s + self.move_s)
        return Ping.of(
            distance=cell.distance_mm * 1e-3,
            angle=np.deg2rad(cell.angle_deg),
            incidence=np.deg2rad(cell.incidence_deg),
            reflectance=cell.reflectance,
            time=start + self.interval_s * np.arange(self.pings),
        )


PLANS = {
    # 120 conditions, 3,600 pings: enough to see distance, angle and reflector at work
    "quick": Plan(
        angles_deg=(0.0, 2.5, 5.0, 15.0),
        distances_mm=tuple(float(d) for d in range(200, 3001, 200)),
        pings=30,
        interval_s=0.1,
    ),
    # 6,912 conditions, 55,296 pings: reflectors turned apart from their bearing, as walls and boxes stand to a robot
    "turned": Plan(
        angles_deg=(0.0, 6.0, 12.0, 18.0, 24.0, 30.0),
        distances_mm=(*(float(d) for d in range(30, 300, 45)), *(float(round(300 * 1.109**k)) for k in range(30))),
        reflectances=(0.1, 0.4, 0.7, 1.0),
        pings=8,
        interval_s=0.1,
        incidences_deg=(0.0, 2.0, 5.0, 10.0, 18.0, 30.0, 50.0, 85.0),
    ),
    # Esmi (2016), sections 3.2 and 4.1: 133,100 pings. Its table 4.1 has the mirror at 30 degrees and 3900 mm read 3950
    # to 3970 mm in 88 % of pings; parallel to the sensor's face it would mirror at 3377 mm or not at all, so it faced
    # the sensor.
    "thesis": Plan(
        angles_deg=(0.0, 5.0, 10.0, 15.0, 20.0, 22.5, 25.0, 30.0, 35.0, 40.0, 45.0),
        distances_mm=(30.0, *(float(d) for d in range(50, 6001, 50))),
        facing=True,
    ),
}
