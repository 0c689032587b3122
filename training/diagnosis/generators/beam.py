"""Family "beam": the four-part beam model of probabilistic robotics, with parameters that vary with the condition.

A ping reads the first of: a hit (normal), an unexpected object (exponential), an object of the scene; with small
probabilities it reads nothing or anything (uniform). Source: Thrun, Burgard, Fox, Probabilistic Robotics (2005), 6.3.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from acquisition import Ping
from acquisition.arrays import Floats
from acquisition.ping import TEMPERATURE
from training.diagnosis.generators.surveys import WIDE, drawn_surveys
from training.diagnosis.generators.world import (
    FULL_SCALE_M,
    LINK_CAUSES,
    Cause,
    Family,
    Planted,
    Register,
    Rng,
    World,
    scattered,
    sign,
)

SPEED, SPEED_C = 344.83, 22.766  # m/s that the sensor assumes, 58 us per cm, and its temperature, degC
ZERO_C = 273.15


def speed_ratio(temperature_c: Floats | float) -> Floats:
    """Return assumed by true speed of sound, at an air temperature in degC."""
    return np.sqrt((ZERO_C + SPEED_C) / (ZERO_C + np.asarray(temperature_c, dtype=np.float64)))


@dataclass(frozen=True)
class BeamSonar:
    """Four-part beam model whose parameters are smooth functions of distance, angle, incidence and reflectance.

    Attributes:
        level_db: of a perpendicular mirror at 1 m above the threshold, dB.
        per_metre_db: further loss, dB/m, and `per_decade_db` by spreading, dB.
        beam_deg: bearing at which the level is 12 dB lower, and `tilt_deg` the incidence.
        reflectance_db: loss at reflectance 0.1, dB.
        slope_db: width of the logistic detection curve, dB.
        fading_db: standard deviation of the level at 6 m, dB.
        noise_m, noise_per_metre: standard deviation of a hit, m, and its growth.
        walk_m: lateness of a hit at the threshold, m.
        offset_m, scale: register = scale (range + offset).
        temperature_c: of the air; `warming_k` and `warming_s` a slow cycle of it, K and s.
        cold_m, cold_s: excess after power-on, m, and its time constant, s.
        yaw_deg: of the beam's axis.
        axial_m: distance of the axis of rotation behind the reflector's face, m.
        alarms_per_m: rate of unexpected objects, 1/m.
        nothing, anything: probabilities of no echo and of a uniform reading.
        clutter: probability and range, m, of a fixed object; `behind` of one behind the reflector.
        gate_m: end of the listening window, m.
        placement_m: standard deviation of the placement in each visit, m.
    """

    level_db: float
    per_metre_db: float
    per_decade_db: float
    beam_deg: float
    tilt_deg: float
    reflectance_db: float
    slope_db: float
    noise_m: float
    noise_per_metre: float
    walk_m: float
    alarms_per_m: float
    nothing: float
    anything: float
    placement_m: float
    fading_db: float = 0.0
    offset_m: float = 0.0
    scale: float = 1.0
    temperature_c: float = SPEED_C
    warming_k: float = 0.0
    warming_s: float = 3600.0
    cold_m: float = 0.0
    cold_s: float = 300.0
    yaw_deg: float = 0.0
    axial_m: float = 0.0
    clutter: tuple[float, float] = (0.0, 1.0)
    behind: tuple[float, float] = (0.0, 0.3)
    gate_m: float = FULL_SCALE_M

    def level(self, ping: Ping, distance: Floats, rng: Rng) -> Floats:
        """Return the level of the hit above the threshold, dB, (n,)."""
        bearing, tilt = np.rad2deg(ping.angle) - self.yaw_deg, np.rad2deg(ping.incidence)
        loss = self.per_metre_db * distance + self.per_decade_db * np.log10(distance)
        loss = loss + 12.0 * (bearing / self.beam_deg) ** 2 + 12.0 * (tilt / self.tilt_deg) ** 2
        loss = loss - self.reflectance_db * np.log10(np.maximum(ping.reflectance, 0.01))
        return self.level_db - loss + self.fading_db * (distance / 6.0) * rng.standard_normal(len(ping))

    def read(self, ping: Ping, rng: Rng) -> tuple[Ping, Floats]:
        """Return the pings and readings, m, 0 for no echo."""
        n = len(ping)
        distance = scattered(ping, self.placement_m, rng) + self.axial_m * (1.0 - np.cos(ping.incidence))
        level = self.level(ping, distance, rng)
        chance = 1.0 / (1.0 + np.exp(-np.clip(level / self.slope_db, -50.0, 50.0)))
        late = self.walk_m * np.exp(-np.maximum(level, 0.0) / 10.0)
        hit = distance + late + (self.noise_m + self.noise_per_metre * distance) * rng.standard_normal(n)
        hit = np.where(rng.random(n) < chance, hit, np.inf)
        object_m = np.where(rng.random(n) < self.clutter[0], self.clutter[1] + 0.01 * rng.standard_normal(n), np.inf)
        behind = np.where(rng.random(n) < self.behind[0], distance + self.behind[1], np.inf)
        alarm = rng.exponential(1.0 / max(self.alarms_per_m, 1e-9), n)
        first = np.minimum(np.minimum(hit, alarm), np.minimum(object_m, behind))
        first = np.where(first < self.gate_m, first, 0.0)
        return ping, self._disturbed(self._registered(first, ping.time), rng)

    def _registered(self, first: Floats, time: Floats) -> Floats:
        """Return what the timer makes of ranges, m."""
        air = self.temperature_c + self.warming_k * np.sin(2.0 * np.pi * time / self.warming_s)
        value = self.scale * (first * speed_ratio(air) + self.offset_m + self.cold_m * np.exp(-time / self.cold_s))
        return np.where(first > 0.0, np.maximum(value, 1e-3), 0.0)

    def _disturbed(self, value: Floats, rng: Rng) -> Floats:
        """Return readings of which a few are nothing or anything."""
        luck = rng.random(len(value))
        value = np.where(luck < self.anything, rng.uniform(0.0, FULL_SCALE_M, len(value)), value)
        return np.where((luck >= self.anything) & (luck < self.anything + self.nothing), 0.0, value)


def draw_world(rng: Rng) -> World:
    """Return a random beam model."""
    sonar = BeamSonar(
        level_db=rng.uniform(22.0, 38.0),
        per_metre_db=rng.uniform(1.0, 5.0),
        per_decade_db=rng.uniform(10.0, 30.0),
        beam_deg=rng.uniform(12.0, 35.0),
        tilt_deg=rng.uniform(12.0, 40.0),
        reflectance_db=rng.uniform(5.0, 20.0),
        slope_db=rng.uniform(1.0, 4.0),
        noise_m=rng.uniform(0.001, 0.008),
        noise_per_metre=rng.uniform(0.0, 0.004),
        walk_m=rng.uniform(0.0, 0.03),
        alarms_per_m=float(np.exp(rng.uniform(np.log(1e-4), np.log(0.02)))),
        nothing=rng.uniform(0.0, 0.02),
        anything=rng.uniform(0.0, 0.01),
        placement_m=rng.uniform(0.0, 0.004),
        fading_db=rng.uniform(0.0, 2.0),
        temperature_c=rng.uniform(15.0, 27.0),
    )
    return World(sonar, Register.draw(rng))


def changed(make: Callable[[Any, float, Rng], dict[str, Any]], value: str = "", by: float = 1.0) -> Any:
    """Return how a change of fields of a sonar is planted.

    Args:
        make: new values of fields, given the sonar, a size and a generator.
        value: field whose change is the true value of the cause's parameter; "" for none.
        by: factor from the field to the parameter.
    """

    def plant(world: World, size: float, rng: Rng) -> Planted:
        real = world.with_sonar(**make(world.sonar, size, rng))
        truth = by * (getattr(real.sonar, value) - getattr(world.sonar, value)) if value else None
        return Planted(world, real, truth)

    return plant


def _plant_air(world: World, size: float, rng: Rng) -> Planted:
    real = world.with_sonar(temperature_c=world.sonar.temperature_c + sign(rng) * 9.0 * size)
    ratio = (ZERO_C + real.sonar.temperature_c) / (ZERO_C + world.sonar.temperature_c)
    return Planted(world, real, (ZERO_C + SPEED_C) * ratio - ZERO_C)


def _plant_clutter(world: World, size: float, rng: Rng) -> Planted:
    at = float(rng.uniform(0.5, 1.8))
    real = world.with_sonar(clutter=(min(0.9, 0.12 * size), at))
    return Planted(world, real, at, {"distance": (at, FULL_SCALE_M)})


def _plant_behind(world: World, size: float, rng: Rng) -> Planted:
    at = float(rng.uniform(0.15, 0.6))
    return Planted(world, world.with_sonar(behind=(min(0.95, 0.5 * size), at)), at)


def _plant_gate(world: World, size: float, rng: Rng) -> Planted:
    at = 3.0 - 0.8 * min(size, 2.0)
    return Planted(world, world.with_sonar(gate_m=at), at, {"distance": (at, FULL_SCALE_M)})


SCALE_CAUSES = (
    Cause("sound_speed", _plant_air, ("bias",), ("clock_scale",), "temperature_c", hides=(TEMPERATURE,)),
    Cause(
        "clock_scale",
        changed(lambda s, k, r: {"scale": s.scale * (1.0 + sign(r) * 0.016 * k)}, "scale"),
        ("bias",),
        ("sound_speed",),
        "error",
    ),
    Cause(
        "zero_offset",
        changed(lambda s, k, r: {"offset_m": s.offset_m + sign(r) * 0.012 * k}, "offset_m"),
        ("bias",),
        parameter="offset_m",
    ),
)
CAUSES = (
    *SCALE_CAUSES,
    Cause(
        "thermal_drift",
        changed(lambda s, k, r: {"warming_k": 5.0 * k, "warming_s": float(r.uniform(600.0, 3000.0))}, "warming_k"),
        ("bias", "memory", "spread"),
        parameter="sine_k",
        hides=(TEMPERATURE,),
        needs=("time_s",),
    ),
    Cause(
        "warm_up",
        changed(
            lambda s, k, r: {"cold_m": sign(r) * 0.015 * k, "cold_s": float(np.exp(r.uniform(4.6, 6.7)))}, "cold_m"
        ),
        ("bias", "memory", "spread"),
        parameter="offset_m",
        needs=("time_s",),
    ),
    Cause(
        "sensitivity",
        changed(lambda s, k, r: {"level_db": s.level_db - 8.0 * k}, "level_db", -1.0),
        ("detection", "bias"),
        ("air_absorption",),
        "loss_db",
    ),
    Cause(
        "air_absorption",
        changed(lambda s, k, r: {"per_metre_db": s.per_metre_db + 3.0 * k}, "per_metre_db", 0.5),
        ("detection", "bias"),
        ("sensitivity",),
        "alpha_db_per_m",
    ),
    Cause(
        "beam_width",
        changed(lambda s, k, r: {"beam_deg": s.beam_deg / (1.0 + 0.5 * k)}),
        ("detection", "bias"),
        survey=WIDE,
    ),
    Cause(
        "boresight",
        changed(lambda s, k, r: {"yaw_deg": s.yaw_deg + sign(r) * 7.0 * k}, "yaw_deg"),
        ("detection", "bias"),
        parameter="yaw_deg",
        survey=WIDE,
    ),
    Cause(
        "specular_loss",
        changed(lambda s, k, r: {"tilt_deg": s.tilt_deg / (1.0 + 0.7 * k)}),
        ("detection", "bias"),
        needs=("incidence_deg",),
        survey={"incidence": "free"},
    ),
    Cause(
        "pivot_offset",
        changed(lambda s, k, r: {"axial_m": sign(r) * 0.2 * k}, "axial_m"),
        ("bias",),
        parameter="axial_m",
        needs=("incidence_deg",),
        survey={"incidence": "free"},
    ),
    Cause(
        "reflectance_loss",
        changed(lambda s, k, r: {"reflectance_db": s.reflectance_db + 15.0 * k}, "reflectance_db", 1.0 / 20.0),
        ("detection", "bias"),
        parameter="strength",
        needs=("reflectance",),
        survey={"reflectance": (0.1, 0.3, 0.6, 0.9)},
    ),
    Cause("scintillation", changed(lambda s, k, r: {"fading_db": s.fading_db + 18.0 * k}), ("detection", "spread")),
    Cause("travel_time_jitter", changed(lambda s, k, r: {"noise_m": s.noise_m * (1.0 + k)}), ("spread",)),
    Cause("time_walk", changed(lambda s, k, r: {"walk_m": s.walk_m + 0.04 * k}), ("bias", "skew")),
    Cause(
        "false_alarm",
        changed(lambda s, k, r: {"alarms_per_m": s.alarms_per_m + 0.06 * k}, "alarms_per_m"),
        ("early", "skew", "detection"),
        parameter="per_metre",
    ),
    Cause("fixed_clutter", _plant_clutter, ("early", "detection", "coincidence"), parameter="range_m"),
    Cause("background_reflector", _plant_behind, ("late", "detection", "skew"), parameter="behind_m", survey=WIDE),
    Cause("range_gate", _plant_gate, ("detection",), parameter="listen_m", survey={"distance_m": (0.3, 4.0)}),
    *LINK_CAUSES,
)


def another_day(world: World, rng: Rng) -> World:
    """Return the same sonar where reflectors are placed with another care."""
    return replace(world, sonar=replace(world.sonar, placement_m=float(rng.uniform(0.0, 0.005))))


FAMILY = Family(draw_world, drawn_surveys, CAUSES, another_day)
