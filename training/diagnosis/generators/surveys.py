"""Conditions, order and times of surveys in which a reflector is put down at one position after the other."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from acquisition import Ping
from acquisition.arrays import Floats, Ints
from acquisition.ping import TEMPERATURE
from training.diagnosis.generators.world import Rng, Surveys

ORDERS = ("random", "distance", "reflectance", "boustrophedon")
MAX_POSITIONS = 200  # of a survey; the rig computes each anew
FRESH_SHARE = 3  # a fresh recording has a third of the pings
WIDE = {"angle_deg": tuple(float(a) for a in range(-40, 41, 5))}  # a survey in which targets leave the beam


@dataclass(frozen=True)
class Design:
    """Layout of a survey.

    Attributes:
        positions: number of conditions, each visited once.
        pings: in each visit.
        order: of the visits: random, by distance, by reflectance (which is then a function of time), or along rows of
            equal angle, to and fro.
        distance_m: lowest and highest distance, m.
        angle_deg, reflectance: values to choose from.
        incidence: "angle" for reflectors parallel to the sensor's face, "zero" for reflectors turned to the sensor,
            "free" for any orientation.
        interval_s: lowest and highest interval between pings, s.
        move_s: between visits, s.
        runs: number of uninterrupted runs.
        temperature_c: mean of the logged air temperature, degC; None without a thermometer.
    """

    positions: int = 80
    pings: int = 15
    order: str = "random"
    distance_m: tuple[float, float] = (0.25, 3.5)
    angle_deg: tuple[float, ...] = (0.0,)
    reflectance: tuple[float, ...] = (0.9,)
    incidence: str = "angle"
    interval_s: tuple[float, float] = (0.1, 0.1)
    move_s: float = 20.0
    runs: int = 1
    temperature_c: float | None = None

    @classmethod
    def draw(cls, rng: Rng, pings: int, **fixed: Any) -> Design:
        """Return a random layout of about `pings` pings; `fixed` settings are not drawn."""
        each = round(float(np.exp(rng.uniform(np.log(5), np.log(50)))))
        each = int(np.clip(each, max(1, pings // MAX_POSITIONS), max(1, pings // 12)))
        slow = float(np.exp(rng.uniform(np.log(0.08), np.log(0.5))))
        angles = [(0.0,), (-20.0, -10.0, 0.0, 10.0, 20.0), tuple(np.arange(-40.0, 41.0, 5.0))]
        reflectances = [(0.9,), (0.1, 0.9), (0.1, 0.3, 0.6, 0.9)]
        nearest = float(rng.uniform(0.15, 0.4))
        drawn: dict[str, Any] = {
            "positions": max(6, round(pings / each)),
            "pings": each,
            "order": str(rng.choice(ORDERS)),
            "distance_m": (nearest, nearest + float(rng.uniform(1.5, 4.0))),
            "angle_deg": angles[rng.choice(3, p=[0.15, 0.4, 0.45])],
            "reflectance": reflectances[rng.choice(3, p=[0.25, 0.5, 0.25])],
            "incidence": str(rng.choice(["angle", "zero", "free"])),
            "interval_s": (slow, slow * float(rng.uniform(1.0, 1.3))),
            "move_s": float(rng.uniform(5.0, 40.0)),
            "runs": int(rng.integers(1, 5)),
            "temperature_c": float(rng.uniform(17.0, 24.0)) if rng.random() < 0.3 else None,
        }
        return cls(**{**drawn, **fixed})

    def grid(self, rng: Rng) -> Ping:
        """Draw the conditions, (positions,), with distances in whole millimetres."""
        low, high = np.log(self.distance_m)
        angle = np.deg2rad(rng.choice(self.angle_deg, self.positions))
        free = np.deg2rad(rng.choice([-20.0, -10.0, -5.0, 0.0, 0.0, 5.0, 10.0, 20.0], self.positions))
        return Ping.of(
            distance=np.round(np.exp(rng.uniform(low, high, self.positions)), 3),
            angle=angle,
            incidence={"angle": angle, "zero": 0.0 * angle, "free": free}[self.incidence],
            reflectance=rng.choice(self.reflectance, self.positions),
        )

    def survey(self, grid: Ping, rng: Rng) -> Ping:
        """Return the pings of a survey of a grid, in the order of the design."""
        index = np.repeat(self._order(grid, rng), self.pings)
        wait = rng.uniform(*self.interval_s, len(index))
        wait[:: self.pings] = np.round(self.move_s * rng.uniform(0.7, 1.5, len(grid)), 1)
        time = np.round(np.cumsum(wait) - wait[0], 3)
        visit = np.repeat(np.arange(len(grid)), self.pings)
        covariates = {} if self.temperature_c is None else {TEMPERATURE: _temperature(self.temperature_c, time, rng)}
        return replace(grid[index], time=time, run=visit * self.runs // len(grid), covariates=covariates)

    def _order(self, grid: Ping, rng: Rng) -> Ints:
        """Return the order of the visits; ties are in random order."""
        tie = rng.permutation(len(grid))
        if self.order == "random":
            return tie
        if self.order == "boustrophedon":
            row = np.unique(grid.angle, return_inverse=True)[1]
            return np.lexsort((tie, np.where(row % 2, -grid.distance, grid.distance), row))
        return np.lexsort((tie, getattr(grid, self.order)))


def _temperature(mean_c: float, time: Floats, rng: Rng) -> Floats:
    """Return the temperature of a heated room, degC, to 0.1 degC: a cycle of the heating and a slow change."""
    period, phase = rng.uniform(1200.0, 4000.0), rng.uniform(0.0, 2.0 * np.pi)
    change = rng.uniform(-3.0, 3.0) * time / max(time[-1], 1.0)
    return np.round(mean_c + change + rng.uniform(0.3, 1.5) * np.sin(2.0 * np.pi * time / period + phase), 1)


def drawn_surveys(rng: Rng, pings: int, fixed: Mapping[str, Any]) -> Surveys:
    """Draw the surveys of a trial; simulation and recording share their grid in half of the trials.

    A survey without logged reflectance has reflectors of one kind, and one without logged incidence has reflectors
    parallel to the sensor's face, since a recording without these columns means just that.
    """
    missing = tuple(
        c for c, p in {"reflectance": 0.25, "incidence_deg": 0.3, "time_s": 0.15}.items() if rng.random() < p
    )
    fixed = {
        **({"reflectance": (0.9,)} if "reflectance" in missing else {}),
        **({"incidence": "angle"} if "incidence_deg" in missing else {}),
        **fixed,
    }
    if fixed.get("incidence") == "free":
        missing = tuple(c for c in missing if c != "incidence_deg")
    design = Design.draw(rng, pings, **fixed)
    same_grid, same_order = rng.random(2) < 0.5
    other = design if same_order else replace(design, order=str(rng.choice(ORDERS)))
    other = _another_day(other, rng)
    grid = design.grid(rng)
    fresh = replace(_another_day(other, rng), positions=max(4, design.positions // FRESH_SHARE), order="random")
    return Surveys(
        design.survey(grid, rng),
        other.survey(grid if same_grid else other.grid(rng), rng),
        fresh.survey(fresh.grid(rng), rng),
        missing,
    )


def _another_day(design: Design, rng: Rng) -> Design:
    """Return the layout on a day of another logged temperature."""
    if design.temperature_c is None:
        return design
    return replace(design, temperature_c=design.temperature_c + float(rng.uniform(-3.0, 3.0)))
