"""Survey plans: which conditions to measure, how often, and in which order."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from itertools import groupby, product
from typing import Literal, get_args

import numpy as np

from acquisition.errors import SettingError
from acquisition.ping import Ping
from acquisition.survey.quantities import CONDITIONS, QUANTITIES, SWEEPS

Order = Literal["random", "walk", "grid"]
# from what is the most trouble to change to what is the least; distance goes last, to and fro
WALK = (*(n for n, q in SWEEPS.items() if q.by_hand), "reflectance", "angle_deg", "incidence_deg")
LIMITS = {"pings": (1, 1_000_000), "interval_s": (0.0, 3600.0), "move_s": (0.0, 86_400.0)}
MOST_CELLS = 1_000_000


@dataclass(frozen=True)
class Cell:
    """One condition of a survey, in the units of a recording's columns; `swept` has what is varied besides."""

    distance_mm: float
    angle_deg: float
    reflectance: float
    incidence_deg: float
    swept: tuple[tuple[str, float], ...] = ()

    @cached_property
    def values(self) -> dict[str, float]:
        """Return every quantity under its column's name."""
        return {**{name: getattr(self, name) for name in CONDITIONS}, **dict(self.swept)}

    @property
    def stand(self) -> dict[str, float]:
        """Return what somebody has to move or swap by hand."""
        return {name: value for name, value in self.values.items() if QUANTITIES[name].by_hand}

    def __str__(self) -> str:
        turned = (
            "" if self.incidence_deg == self.angle_deg else f", turned to an incidence of {self.incidence_deg:g} deg"
        )
        more = "".join(f", {QUANTITIES[name].what} {QUANTITIES[name].say(value)}" for name, value in self.swept)
        return f"{self.distance_mm:g} mm, {self.angle_deg:g} deg, reflectance {self.reflectance:g}{turned}{more}"


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
        incidences_deg: between beam and surface normal, each at every bearing, rather than what `facing` says.
        order: random: every cell by lot, so that drift cannot pass for distance. walk: for stands moved by hand; what
            is the most trouble to change changes least, each by lot, and distance goes to and fro. grid: along
            distances, then angles, then reflectors.
        seed: of the order.
        sweep: further quantities of `SWEEPS`, each with its values, all combinations.
    """

    angles_deg: tuple[float, ...]
    distances_mm: tuple[float, ...]
    reflectances: tuple[float, ...] = (0.1, 0.9)
    pings: int = 50
    interval_s: float = 2.4
    move_s: float = 20.0
    facing: bool = False
    incidences_deg: tuple[float, ...] = ()
    order: Order = "random"
    seed: int = 0
    sweep: Mapping[str, tuple[float, ...]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Refuse a plan without a ping, and values that nobody could arrange."""
        if min(len(self.angles_deg), len(self.distances_mm), len(self.reflectances)) < 1:
            raise SettingError("a plan needs at least one angle, distance and reflectance")
        for name, (low, high) in LIMITS.items():
            if not low <= getattr(self, name) <= high:
                raise SettingError(f"{name}: expected a number from {low:g} to {high:g}, got {getattr(self, name):g}")
        if self.order not in get_args(Order):
            raise SettingError(f"order: expected one of {', '.join(get_args(Order))}, got {self.order!r}")
        for name in self.sweep:
            if name not in SWEEPS:
                raise SettingError(f"sweep.{name}: no such quantity, expected one of {', '.join(SWEEPS)}")
        for key, column, values in self._axes():
            _check_axis(key, column, values)
        if len(self) > MOST_CELLS:
            raise SettingError(f"the plan has {len(self)} conditions, expected at most {MOST_CELLS}")

    def _axes(self) -> list[tuple[str, str, tuple[float, ...]]]:
        """Return key, column and values of everything that varies."""
        base = [
            ("distances_mm", "distance_mm", self.distances_mm),
            ("angles_deg", "angle_deg", self.angles_deg),
            ("incidences_deg", "incidence_deg", self.incidences_deg),
            ("reflectances", "reflectance", self.reflectances),
        ]
        return base + [(f"sweep.{name}", name, values) for name, values in self.sweep.items()]

    @cached_property
    def cells(self) -> tuple[Cell, ...]:
        """Return the conditions in the order in which they are measured."""
        grid = product(self.reflectances, self.angles_deg, self.distances_mm)
        swept = [tuple(zip(self.sweep, values, strict=True)) for values in product(*self.sweep.values())]
        cells = [
            Cell(distance, angle, reflectance, incidence, more)
            for reflectance, angle, distance in grid
            for incidence in self.incidences_deg or (0.0 if self.facing else angle,)
            for more in swept
        ]
        if self.order == "grid":
            return tuple(cells)
        shuffled = [cells[k] for k in np.random.default_rng(self.seed).permutation(len(cells))]
        return tuple(shuffled if self.order == "random" else _walked(shuffled))

    def __len__(self) -> int:
        """Return the number of cells."""
        axes = (self.angles_deg, self.distances_mm, self.reflectances, *self.sweep.values())
        return int(np.prod([len(axis) for axis in axes])) * max(len(self.incidences_deg), 1)

    @property
    def seconds(self) -> float:
        """How long it takes, s."""
        return len(self) * ((self.pings - 1) * self.interval_s + self.move_s)

    @cached_property
    def moves(self) -> int:
        """How often somebody has to move something by hand, the first arrangement included."""
        stands = [cell.stand for cell in self.cells]
        return sum(now != before for before, now in zip([{}, *stands], stands, strict=False))

    @property
    def way_m(self) -> float:
        """How far a stand is carried nearer and farther, m."""
        return float(np.abs(np.diff([cell.distance_mm for cell in self.cells])).sum()) * 1e-3

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


def _check_axis(key: str, column: str, values: tuple[float, ...]) -> None:
    if not values and key != "incidences_deg":
        raise SettingError(f"{key}: expected at least one value, got none")
    for value in values:
        QUANTITIES[column].check(value, key)
    common = Counter(values).most_common(1)
    if common and common[0][1] > 1:
        raise SettingError(f"{key}: {common[0][0]:g} stands there twice; give each value once, and more pings for more")


def _walked(shuffled: list[Cell]) -> list[Cell]:
    """Return cells in an order with few moves; levels follow each other as they first turn up in a shuffled list.

    Distance goes to and fro between arrangements, so that a steady drift cancels between neighbours.
    """
    first: dict[tuple[str, float], int] = {}
    for cell in shuffled:
        for item in cell.values.items():
            first.setdefault(item, len(first))

    def arrangement(cell: Cell) -> tuple[int, ...]:
        return tuple(first[name, cell.values[name]] for name in WALK if name in cell.values)

    out: list[Cell] = []
    for number, (_, group) in enumerate(groupby(sorted(shuffled, key=arrangement), key=arrangement)):
        out += sorted(group, key=lambda cell: cell.distance_mm, reverse=number % 2 == 1)
    return out


THESIS_ANGLES = (0.0, 5.0, 10.0, 15.0, 20.0, 22.5, 25.0, 30.0, 35.0, 40.0, 45.0)
PLANS: Mapping[str, Plan] = {
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
        angles_deg=THESIS_ANGLES,
        distances_mm=(30.0, *(float(d) for d in range(50, 6001, 50))),
        facing=True,
    ),
    # Esmi (2016), section 4.1: a second sonar as near as it goes and 50 mm away, beside and above, that fires more
    # often than the first, and by a clock of its own: no whole fraction of the first one's interval. With the second
    # one silent, each arrangement is its own control.
    "crosstalk": Plan(
        angles_deg=(0.0,),
        distances_mm=(500.0, 1000.0, 2000.0, 3000.0),
        reflectances=(0.9,),
        interval_s=0.5,
        facing=True,
        order="walk",
        sweep={
            "neighbour_gap_mm": (0.0, 50.0),
            "neighbour_turn_deg": (0.0, 90.0),
            "neighbour_period_s": (0.0, 0.0713, 0.1931),
        },
    ),
    # Esmi (2016), section 3.1.3: connections "not soldered in order to resemble defective connections"
    "loose": Plan(
        angles_deg=(0.0,),
        distances_mm=(300.0, 1000.0, 2000.0, 3000.0, 4500.0),
        reflectances=(0.1, 0.9),
        interval_s=0.2,
        order="walk",
        sweep={"loose_share": (0.0, 0.02, 0.1, 0.3)},
    ),
    # the vertical field of view, which Esmi (2016), section 5, leaves to future work
    "vertical": Plan(
        angles_deg=(0.0,),
        distances_mm=(300.0, 600.0, 1000.0, 1500.0, 2000.0, 3000.0, 4500.0, 6000.0),
        reflectances=(0.9,),
        pings=20,
        interval_s=0.1,
        order="walk",
        sweep={
            "height_mm": (500.0, 1000.0, 1500.0),
            "pitch_deg": tuple(float(p) for p in range(-45, 46, 5)),
        },
    ),
    # the gain register is a calibrated attenuator: the code at which an echo is lost tells its level over the threshold
    "gain-sweep": Plan(
        angles_deg=(0.0,),
        distances_mm=(1000.0, 2000.0),
        reflectances=(0.1, 0.9),
        pings=20,
        interval_s=0.1,
        order="walk",
        sweep={"gain": tuple(float(code) for code in range(32))},
    ),
}
