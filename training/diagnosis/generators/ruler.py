"""Family "ruler": a set taken by hand, many readings at each of ten marks of a ruler."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from acquisition import Ping
from acquisition.arrays import Floats
from training.diagnosis.generators.beam import SCALE_CAUSES, SPEED_C, changed, speed_ratio
from training.diagnosis.generators.world import LINK_CAUSES, Cause, Family, Register, Rng, Surveys, World, scattered

MARKS = 10
READINGS = (4, 300)  # at a mark
FEW = 40  # pings of a hasty set


@dataclass(frozen=True)
class RulerSonar:
    """A sonar in front of a wall, as a hobbyist measures it.

    Attributes:
        scale, offset_m, temperature_c: of the range, as a sensor computes it that assumes 344.8 m/s.
        noise_m: standard deviation of a reading, m.
        curvature: relative error that grows with the distance, 1/m.
        tail: share of readings whose error is ten times larger.
        alarms_per_m: rate of false echoes before the wall, 1/m.
        missed: share of pings without echo at 1 m; it grows with the distance.
        operator_m: standard deviation of the placement at each visit, m.
        cold_m, cold_s: excess after power-on, m, and its time constant, s.
        gate_m: end of the listening window, m.
    """

    noise_m: float
    curvature: float
    tail: float
    missed: float
    operator_m: float
    scale: float = 1.0
    offset_m: float = 0.0
    temperature_c: float = SPEED_C
    alarms_per_m: float = 0.0
    cold_m: float = 0.0
    cold_s: float = 120.0
    gate_m: float = 11.0

    def read(self, ping: Ping, rng: Rng) -> tuple[Ping, Floats]:
        """Return the pings and readings, m, 0 for no echo."""
        n = len(ping)
        wall = scattered(ping, self.operator_m, rng)
        cold = self.cold_m * np.exp(-ping.time / self.cold_s)
        error = self.noise_m * rng.standard_normal(n) * np.where(rng.random(n) < self.tail, 10.0, 1.0)
        away = wall * (1.0 + self.curvature * wall) * float(speed_ratio(self.temperature_c))
        value = self.scale * (away + self.offset_m + cold) + error
        alarm = rng.exponential(1.0 / max(self.alarms_per_m, 1e-9), n)
        value = np.where(alarm < wall, alarm, value)
        lost = (rng.random(n) < np.minimum(self.missed * wall, 0.9)) | (value > self.gate_m)
        return ping, np.where(lost, 0.0, np.maximum(value, 1e-3))


def draw_world(rng: Rng) -> World:
    """Return a random sensor and operator, most often with a register that truncates to centimetres."""
    sonar = RulerSonar(
        noise_m=float(rng.uniform(0.0005, 0.006)),
        curvature=float(rng.normal(0.0, 0.002)),
        tail=float(rng.uniform(0.0, 0.02)),
        missed=float(rng.uniform(0.0, 0.02)),
        operator_m=float(rng.uniform(0.001, 0.004)),
        offset_m=float(rng.normal(0.0, 0.005)),
        temperature_c=float(rng.uniform(17.0, 27.0)),
    )
    return World(sonar, Register(0.01, truncated=True) if rng.random() < 0.6 else Register.draw(rng))


def draw_surveys(rng: Rng, pings: int, fixed: Mapping[str, Any]) -> Surveys:
    """Return sets at ten marks, of which few have 40 readings in total; the fresh set has other marks."""
    total = FEW if rng.random() < 0.1 else pings
    return surveys_at(int(np.clip(total // MARKS, *READINGS)), rng)


def surveys_at(each: int, rng: Rng) -> Surveys:
    """Return sets of `each` readings at ten marks, which simulation and recording share in half of the trials."""
    step, first = float(rng.choice([0.05, 0.1, 0.2, 0.3])), float(rng.choice([0.05, 0.1, 0.2]))
    marks = np.round(first + step * np.arange(MARKS), 3)
    other = marks if rng.random() < 0.5 else marks + 0.5 * step
    between = np.round(first + step * (MARKS - 1) * np.sort(rng.uniform(0.0, 1.0, MARKS // 3 + 1)), 3)
    missing = ("time_s",) if rng.random() < 0.3 else ()
    return Surveys(_set(marks, each, rng), _set(other, each, rng), _set(between, each, rng), missing)


def _set(marks: Floats, each: int, rng: Rng) -> Ping:
    """Return a set in ascending, descending or random order, in one run or in one for each mark."""
    order = [np.arange(len(marks)), np.arange(len(marks))[::-1], rng.permutation(len(marks))][rng.integers(3)]
    wait = np.full(len(marks) * each, float(rng.choice([0.05, 0.1, 0.5])))
    wait[::each] = rng.uniform(10.0, 60.0, len(marks))
    visit = np.repeat(np.arange(len(marks)), each)
    run = visit if rng.random() < 0.5 else 0 * visit
    return Ping.of(np.repeat(marks[order], each), time=np.round(np.cumsum(wait) - wait[0], 3), run=run)


def another_day(world: World, rng: Rng) -> World:
    """Return the same sensor in the hands of another operator."""
    return replace(world, sonar=replace(world.sonar, operator_m=float(rng.uniform(0.001, 0.004))))


CAUSES = (
    *SCALE_CAUSES,
    Cause(
        "warm_up",
        changed(lambda s, k, r: {"cold_m": 0.02 * k, "cold_s": float(r.uniform(60.0, 300.0))}, "cold_m"),
        ("bias", "memory", "spread"),
        parameter="offset_m",
        needs=("time_s",),
    ),
    Cause("travel_time_jitter", changed(lambda s, k, r: {"noise_m": s.noise_m * (1.0 + 1.5 * k)}), ("spread",)),
    Cause(
        "false_alarm",
        changed(lambda s, k, r: {"alarms_per_m": 0.08 * k}, "alarms_per_m"),
        ("early", "skew"),
        parameter="per_metre",
    ),
    *LINK_CAUSES,
)
FAMILY = Family(draw_world, draw_surveys, CAUSES, another_day)
