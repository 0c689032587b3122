"""Family "rays": the nearest of a cone of rays plus Gaussian noise, as robot simulators model a sonar.

Gazebo and Webots cast rays over the field of view and return the shortest range with noise. Kind "simulator" compares
this simulation with the waveform rig.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from acquisition import Ping
from acquisition.arrays import Floats
from training.diagnosis.generators import rig, rig_causes
from training.diagnosis.generators.beam import SCALE_CAUSES, SPEED_C, changed, speed_ratio
from training.diagnosis.generators.surveys import WIDE, drawn_surveys
from training.diagnosis.generators.world import (
    FULL_SCALE_M,
    LINK_CAUSES,
    Cause,
    Family,
    Planted,
    Register,
    Rng,
    Surveys,
    World,
    scattered,
    sign,
)


@dataclass(frozen=True)
class RaySonar:
    """The nearest intersection of a fan of rays with a flat plate, a box beside it and a wall behind it.

    Attributes:
        half_deg: half the field of view, deg, and `rays` the number of rays.
        plate_m: half the width of the plate, m.
        wall_m: distance of the wall, m.
        noise_m, noise_per_metre: standard deviation of a range, m, and its growth.
        steepest_deg: incidence beyond which a ray is not returned, deg.
        box: probability that a ray meets an object in the way, and its distance, m.
        post: probability of a reading of an object behind a plate that is not met, and how far behind, m.
        yaw_deg, axial_m, scale, offset_m, temperature_c, gate_m, placement_m: see `beam.BeamSonar`.
    """

    half_deg: float
    rays: int
    plate_m: float
    wall_m: float
    noise_m: float
    noise_per_metre: float
    steepest_deg: float
    placement_m: float
    box: tuple[float, float] = (0.0, 1.0)
    post: tuple[float, float] = (0.0, 0.3)
    yaw_deg: float = 0.0
    axial_m: float = 0.0
    scale: float = 1.0
    offset_m: float = 0.0
    temperature_c: float = SPEED_C
    gate_m: float = FULL_SCALE_M

    def nearest(self, ping: Ping, distance: Floats) -> Floats:
        """Return the shortest ray that meets the plate, m, (n,); infinity for none."""
        ray = np.deg2rad(np.linspace(-self.half_deg, self.half_deg, self.rays) + self.yaw_deg)
        steep = ray - (ping.angle - ping.incidence)[:, None]  # incidence of each ray on the plate, (n, rays)
        length = (distance * np.cos(ping.incidence))[:, None] / np.maximum(np.cos(steep), 1e-3)
        beside = np.abs(length * np.exp(1j * ray) - (distance * np.exp(1j * ping.angle))[:, None])
        met = (beside <= self.plate_m) & (np.abs(steep) < np.deg2rad(self.steepest_deg))
        return np.where(met, length, np.inf).min(axis=1)

    def read(self, ping: Ping, rng: Rng) -> tuple[Ping, Floats]:
        """Return the pings and readings, m, 0 for no echo."""
        n = len(ping)
        distance = scattered(ping, self.placement_m, rng) + self.axial_m * (1.0 - np.cos(ping.incidence))
        nearest = self.nearest(ping, distance)
        behind = np.where(rng.random(n) < self.post[0], distance + self.post[1], np.inf)
        nearest = np.minimum(np.where(np.isfinite(nearest), nearest, behind), self.wall_m)
        nearest = np.minimum(nearest, np.where(rng.random(n) < self.box[0], self.box[1], np.inf))
        noise = (self.noise_m + self.noise_per_metre * nearest) * rng.standard_normal(n)
        value = self.scale * (nearest * float(speed_ratio(self.temperature_c)) + self.offset_m) + noise
        return ping, np.where(nearest < self.gate_m, np.maximum(value, 1e-3), 0.0)


def draw_world(rng: Rng) -> World:
    """Return a random simulator; in half of them the wall is out of range."""
    wall = float(rng.uniform(4.5, 7.0))
    sonar = RaySonar(
        half_deg=float(rng.uniform(8.0, 30.0)),
        rays=int(rng.integers(5, 32)),
        plate_m=float(rng.uniform(0.15, 0.5)),
        wall_m=wall,
        noise_m=float(rng.uniform(0.002, 0.01)),
        noise_per_metre=float(rng.choice([0.0, rng.uniform(0.0, 0.005)])),
        steepest_deg=float(rng.uniform(30.0, 80.0)),
        placement_m=float(rng.uniform(0.0, 0.002)),
        gate_m=wall - 0.5 if rng.random() < 0.5 else FULL_SCALE_M,
    )
    return World(sonar, Register.draw(rng) if rng.random() < 0.5 else Register(0.001))


def draw_surveys(rng: Rng, pings: int, fixed: Mapping[str, Any]) -> Surveys:
    """Return surveys without a thermometer, which a simulator of rays does not have."""
    return drawn_surveys(rng, pings, {"temperature_c": None, **fixed})


def against_rig(world: World, rng: Rng) -> tuple[World, World]:
    """Return a simulation by rays and the waveform rig, with the same register, in two of five trials changed."""
    real = rig.another_day(replace(rig.draw_world(rng), register=world.register), rng)
    if rng.random() < 0.4:
        cause = rig_causes.CAUSES[int(rng.integers(len(rig_causes.CAUSES)))]
        real = cause.plant(real, float(rng.uniform(0.5, 2.0)), rng).recorded
    return world, real


def _plant_box(world: World, size: float, rng: Rng) -> Planted:
    at = float(rng.uniform(0.5, 1.8))
    real = world.with_sonar(box=(min(0.9, 0.10 * size), at))
    return Planted(world, real, at, {"distance": (at, FULL_SCALE_M)})


def _plant_post(world: World, size: float, rng: Rng) -> Planted:
    at = float(rng.uniform(0.1, 0.6))
    return Planted(world, world.with_sonar(post=(min(0.95, 0.5 * size), at)), at)


def _plant_gate(world: World, size: float, rng: Rng) -> Planted:
    at = 2.8 - 0.8 * min(size, 2.0)
    return Planted(world, world.with_sonar(gate_m=at), at, {"distance": (at, FULL_SCALE_M)})


CAUSES = (
    *SCALE_CAUSES,
    Cause("travel_time_jitter", changed(lambda s, k, r: {"noise_m": s.noise_m * (1.0 + k)}), ("spread",)),
    Cause(
        "beam_width",
        changed(lambda s, k, r: {"half_deg": s.half_deg / (1.0 + 0.6 * k)}),
        ("detection", "late", "bias"),
        survey=WIDE,
    ),
    Cause(
        "boresight",
        changed(lambda s, k, r: {"yaw_deg": sign(r) * 7.0 * k}, "yaw_deg"),
        ("detection", "late", "bias"),
        parameter="yaw_deg",
        survey=WIDE,
    ),
    Cause(
        "specular_loss",
        changed(lambda s, k, r: {"steepest_deg": s.steepest_deg / (1.0 + 2.0 * k)}),
        ("detection", "late", "bias"),
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
    Cause("fixed_clutter", _plant_box, ("early", "coincidence"), parameter="range_m"),
    Cause("background_reflector", _plant_post, ("late", "detection"), parameter="behind_m", survey=WIDE),
    Cause("range_gate", _plant_gate, ("detection",), parameter="listen_m", survey={"distance_m": (0.3, 4.0)}),
    *LINK_CAUSES,
)
FAMILY = Family(draw_world, draw_surveys, CAUSES, simulator=against_rig)
