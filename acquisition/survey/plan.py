"""Survey plans: the conditions to measure, the pings per condition, and the order."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from itertools import groupby, product
from typing import Annotated, Literal

import numpy as np

from acquisition.errors import SettingError
from acquisition.limits import Limit, Seed, check_settings, check_value, near, shown
from acquisition.ping import Ping
from acquisition.survey.quantities import CONDITION_QUANTITIES, QUANTITIES, SWEEPS

Order = Literal["random", "walk", "grid"]
# quantities from the most to the least laborious to change; distance comes last, alternately up and down
WALK_LEVELS = (*(n for n, q in SWEEPS.items() if q.by_hand), "reflectance", "angle_deg", "incidence_deg")
MAX_CONDITIONS = 1_000_000


@dataclass(frozen=True)
class Condition:
    """One condition of a survey, in the units of a recording's columns.

    Attributes:
        distance_mm, angle_deg, reflectance, incidence_deg: as in a recording.
        swept: names and values of additional quantities.
    """

    distance_mm: float
    angle_deg: float
    reflectance: float
    incidence_deg: float
    swept: tuple[tuple[str, float], ...] = ()

    @cached_property
    def values(self) -> dict[str, float]:
        """All quantities by column name."""
        return {**{name: getattr(self, name) for name in CONDITION_QUANTITIES}, **dict(self.swept)}

    @property
    def manual_values(self) -> dict[str, float]:
        """Quantities that are set by hand, by column name."""
        return {name: value for name, value in self.values.items() if QUANTITIES[name].by_hand}

    def __str__(self) -> str:
        turned = (
            "" if self.incidence_deg == self.angle_deg else f", turned to an incidence of {self.incidence_deg:g} deg"
        )
        more = "".join(f", {QUANTITIES[name].label} {QUANTITIES[name].text(value)}" for name, value in self.swept)
        return f"{self.distance_mm:g} mm, {self.angle_deg:g} deg, reflectance {self.reflectance:g}{turned}{more}"


@dataclass(frozen=True)
class SurveyPlan:
    """A grid of conditions.

    Attributes:
        angles_deg: bearings of the reflector off the beam axis.
        distances_mm: slant distances.
        reflectances: of the reflectors.
        pings: number of pings per condition.
        interval_s: time between pings.
        move_s: time between the last ping of a condition and the first of the next.
        facing: the reflector faces the sensor (incidence 0); otherwise it is parallel to the sensor's face, so that
            its incidence equals its bearing.
        incidences_deg: angles between beam and surface normal, each at every bearing; replaces `facing`.
        order: random: all conditions shuffled, so that drift is independent of distance. walk: for stands moved by
            hand; the most laborious quantities change least often, each in random order, and distance runs
            alternately up and down. grid: by reflectance, then angle, then distance.
        seed: of the order.
        sweep: additional quantities of `SWEEPS` with their values; all combinations are measured.
    """

    angles_deg: tuple[float, ...]
    distances_mm: tuple[float, ...]
    reflectances: tuple[float, ...] = (0.1, 0.9)
    pings: Annotated[int, Limit(1, 1_000_000)] = 50
    interval_s: Annotated[float, Limit(0.0, 3600.0, "s")] = 2.4
    move_s: Annotated[float, Limit(0.0, 86_400.0, "s")] = 20.0
    facing: bool = False
    incidences_deg: tuple[float, ...] = ()
    order: Order = "random"
    seed: Seed = 0
    sweep: Mapping[str, tuple[float, ...]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Raise SettingError for an empty plan and for values outside their limits."""
        check_settings(self, lambda field: field)
        if not isinstance(self.sweep, Mapping):
            raise SettingError(f"sweep: expected quantities with their values, got {shown(self.sweep)}")
        for name in ("angles_deg", "distances_mm", "reflectances", "incidences_deg"):
            object.__setattr__(self, name, tuple(getattr(self, name)))  # an array is neither true nor false
        if min(len(self.angles_deg), len(self.distances_mm), len(self.reflectances)) < 1:
            raise SettingError("a plan needs at least one angle, distance and reflectance")
        for name in self.sweep:
            if name not in SWEEPS:
                expected = f"{', '.join(SWEEPS)}{near(name, SWEEPS)}"
                raise SettingError(f"sweep.{name}: no such quantity, expected one of {expected}")
            check_value(f"sweep.{name}", self.sweep[name], tuple[float, ...])
        for key, column, values in self._axes():
            _check_axis(key, column, values)
        if len(self) > MAX_CONDITIONS:
            raise SettingError(f"the plan has {len(self)} conditions, expected at most {MAX_CONDITIONS}")

    def _axes(self) -> list[tuple[str, str, tuple[float, ...]]]:
        """Return key, column and values of each quantity of the plan."""
        base = [
            ("distances_mm", "distance_mm", self.distances_mm),
            ("angles_deg", "angle_deg", self.angles_deg),
            ("incidences_deg", "incidence_deg", self.incidences_deg),
            ("reflectances", "reflectance", self.reflectances),
        ]
        return base + [(f"sweep.{name}", name, values) for name, values in self.sweep.items()]

    @cached_property
    def conditions(self) -> tuple[Condition, ...]:
        """The conditions in the order in which they are measured."""
        grid = product(self.reflectances, self.angles_deg, self.distances_mm)
        swept = [tuple(zip(self.sweep, values, strict=True)) for values in product(*self.sweep.values())]
        conditions = [
            Condition(distance, angle, reflectance, incidence, more)
            for reflectance, angle, distance in grid
            for incidence in self.incidences_deg or (0.0 if self.facing else angle,)
            for more in swept
        ]
        if self.order == "grid":
            return tuple(conditions)
        shuffled = [conditions[k] for k in np.random.default_rng(self.seed).permutation(len(conditions))]
        return tuple(shuffled if self.order == "random" else _walk_order(shuffled))

    def __len__(self) -> int:
        """Return the number of conditions."""
        axes = (self.angles_deg, self.distances_mm, self.reflectances, *self.sweep.values())
        return math.prod(len(axis) for axis in axes) * max(len(self.incidences_deg), 1)

    @property
    def seconds(self) -> float:
        """Duration of the survey, s."""
        return len(self) * ((self.pings - 1) * self.interval_s + self.move_s)

    @cached_property
    def moves(self) -> int:
        """Number of changes by hand, including the first setup."""
        values = [condition.manual_values for condition in self.conditions]
        return sum(now != before for before, now in zip([{}, *values], values, strict=False))

    @property
    def travel_m(self) -> float:
        """Total change of distance over the survey, m."""
        return float(np.abs(np.diff([condition.distance_mm for condition in self.conditions])).sum()) * 1e-3

    def condition(self, number: int) -> Condition:
        """Return a condition by its number in the order."""
        return self.conditions[number]

    def ping(self, number: int) -> Ping:
        """Return the pings of a condition at their scheduled times.

        >>> PLANS["quick"].ping(0).time[:2]
        array([0. , 0.1])
        """
        condition = self.conditions[number]
        start = number * ((self.pings - 1) * self.interval_s + self.move_s)
        return Ping.of(
            distance=condition.distance_mm * 1e-3,
            angle=np.deg2rad(condition.angle_deg),
            incidence=np.deg2rad(condition.incidence_deg),
            reflectance=condition.reflectance,
            time=start + self.interval_s * np.arange(self.pings),
        )


def _check_axis(key: str, column: str, values: tuple[float, ...]) -> None:
    if not values and key != "incidences_deg":
        raise SettingError(f"{key}: expected at least one value, got none")
    for value in values:
        QUANTITIES[column].check(value, key)
    common = Counter(values).most_common(1)
    if common and common[0][1] > 1:
        raise SettingError(
            f"{key}: {common[0][0]:g} is given twice; give each value once, and raise `pings` for more pings"
        )


def _walk_order(shuffled: list[Condition]) -> list[Condition]:
    """Return shuffled conditions sorted for few moves; the levels of each quantity keep their shuffled order.

    Distance runs alternately up and down, so that a steady drift cancels between consecutive runs.
    """
    first: dict[tuple[str, float], int] = {}
    for condition in shuffled:
        for item in condition.values.items():
            first.setdefault(item, len(first))

    def levels(condition: Condition) -> tuple[int, ...]:
        return tuple(first[name, condition.values[name]] for name in WALK_LEVELS if name in condition.values)

    out: list[Condition] = []
    for number, (_, group) in enumerate(groupby(sorted(shuffled, key=levels), key=levels)):
        out += sorted(group, key=lambda condition: condition.distance_mm, reverse=number % 2 == 1)
    return out


THESIS_ANGLES = (0.0, 5.0, 10.0, 15.0, 20.0, 22.5, 25.0, 30.0, 35.0, 40.0, 45.0)
PLANS: Mapping[str, SurveyPlan] = {
    # 120 conditions, 3,600 pings: shows the effects of distance, angle and reflector
    "quick": SurveyPlan(
        angles_deg=(0.0, 2.5, 5.0, 15.0),
        distances_mm=tuple(float(d) for d in range(200, 3001, 200)),
        pings=30,
        interval_s=0.1,
    ),
    # 6,912 conditions, 55,296 pings: incidence independent of bearing, as for the walls and boxes around a robot
    "turned": SurveyPlan(
        angles_deg=(0.0, 6.0, 12.0, 18.0, 24.0, 30.0),
        distances_mm=(*(float(d) for d in range(30, 300, 45)), *(float(round(300 * 1.109**k)) for k in range(30))),
        reflectances=(0.1, 0.4, 0.7, 1.0),
        pings=8,
        interval_s=0.1,
        incidences_deg=(0.0, 2.0, 5.0, 10.0, 18.0, 30.0, 50.0, 85.0),
    ),
    # Esmi (2016), sections 3.2 and 4.1: 133,100 pings. In its table 4.1, 88 % of the pings to the mirror at 30 degrees
    # and 3900 mm read 3950 to 3970 mm; a mirror parallel to the sensor's face would read 3377 mm or nothing, so the
    # mirror faced the sensor.
    "thesis": SurveyPlan(
        angles_deg=THESIS_ANGLES,
        distances_mm=(30.0, *(float(d) for d in range(50, 6001, 50))),
        facing=True,
    ),
    # Esmi (2016), section 4.1: a second sonar at 0 and 50 mm, beside and above, which fires more often than the first
    # and asynchronously: its periods do not divide the interval of the first. Each arrangement is also measured with
    # the second sonar off, as a control.
    "crosstalk": SurveyPlan(
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
    "loose": SurveyPlan(
        angles_deg=(0.0,),
        distances_mm=(300.0, 1000.0, 2000.0, 3000.0, 4500.0),
        reflectances=(0.1, 0.9),
        interval_s=0.2,
        order="walk",
        sweep={"loose_share": (0.0, 0.02, 0.1, 0.3)},
    ),
    # the vertical field of view: future work in Esmi (2016), section 5
    "vertical": SurveyPlan(
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
    # the gain register is a calibrated attenuator: an echo vanishes at the code that equals its excess over threshold
    "gain-sweep": SurveyPlan(
        angles_deg=(0.0,),
        distances_mm=(1000.0, 2000.0),
        reflectances=(0.1, 0.9),
        pings=20,
        interval_s=0.1,
        order="walk",
        sweep={"gain": tuple(float(code) for code in range(32))},
    ),
}
