"""Family "driving": the log of a robot that drives through a room; no condition occurs twice."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from acquisition import Ping
from acquisition.arrays import Floats
from training.diagnosis.generators.beam import SCALE_CAUSES, SPEED_C, changed, speed_ratio
from training.diagnosis.generators.world import (
    LINK_CAUSES,
    Cause,
    Family,
    Planted,
    Register,
    Rng,
    Surveys,
    World,
    starts_run,
)

SPEED_MPS = "speed_mps"


@dataclass(frozen=True)
class RobotSonar:
    """A sonar at the front of a robot whose pose is known from odometry and a map.

    Attributes:
        latency_s: age of a reading at its stamp, s: it belongs to the pose that long ago.
        odometry_m, odometry_s: standard deviation and correlation time of the error of the logged distance, m and s.
        noise_m, noise_per_metre: standard deviation of a range, m, and its growth.
        level_db, per_metre_db, tilt_deg: level of a perpendicular wall at 0 m, dB, loss per metre, dB/m, and incidence
            at which the level is 12 dB lower, deg.
        corner: share of readings by way of a corner, which are longer.
        alarms_per_m: rate of false echoes, 1/m.
        scale, offset_m, temperature_c, gate_m: see `beam.BeamSonar`.
    """

    odometry_m: float
    odometry_s: float
    noise_m: float
    noise_per_metre: float
    level_db: float
    per_metre_db: float
    tilt_deg: float
    corner: float
    alarms_per_m: float
    latency_s: float = 0.0
    scale: float = 1.0
    offset_m: float = 0.0
    temperature_c: float = SPEED_C
    gate_m: float = 6.0

    def read(self, ping: Ping, rng: Rng) -> tuple[Ping, Floats]:
        """Return the pings and readings, m, 0 for no echo."""
        n = len(ping)
        distance, tilt = self._then(ping, ping.distance), self._then(ping, ping.incidence)
        distance = np.maximum(distance + self.odometry_m * _correlated(ping, self.odometry_s, rng), 0.03)
        level = self.level_db - self.per_metre_db * distance - 12.0 * (np.rad2deg(tilt) / self.tilt_deg) ** 2
        missed = rng.random(n) > 1.0 / (1.0 + np.exp(-np.clip(level / 2.0, -50.0, 50.0)))
        way = distance * np.where(rng.random(n) < self.corner, rng.uniform(1.05, 1.5, n), 1.0)
        noise = (self.noise_m + self.noise_per_metre * distance) * rng.standard_normal(n)
        value = np.where(missed, np.inf, way + noise)
        value = np.minimum(value, rng.exponential(1.0 / max(self.alarms_per_m, 1e-9), n))
        heard = value < self.gate_m
        value = self.scale * (np.where(heard, value, 0.0) * float(speed_ratio(self.temperature_c)) + self.offset_m)
        return ping, np.where(heard, np.maximum(value, 0.01), 0.0)

    def _then(self, ping: Ping, column: Floats) -> Floats:
        """Return a column as it was a latency ago, from the log of the same run, (n,)."""
        out = column.copy()
        for run in np.unique(ping.run):
            rows = ping.run == run
            out[rows] = np.interp(ping.time[rows] - self.latency_s, ping.time[rows], column[rows])
        return out


def _correlated(ping: Ping, tau_s: float, rng: Rng) -> Floats:
    """Return an Ornstein-Uhlenbeck process of unit variance at the times of the pings, anew in each run, (n,)."""
    keep = np.where(starts_run(ping), 0.0, np.exp(-np.abs(np.diff(ping.time, prepend=ping.time[:1])) / tau_s))
    out = rng.standard_normal(len(ping)) * np.sqrt(1.0 - keep**2)
    for k in range(1, len(out)):
        out[k] += keep[k] * out[k - 1]
    return out


def _drive(room: Floats, n: int, rate_hz: float, start_s: float, rng: Rng) -> tuple[Floats, Floats, Floats]:
    """Return times, poses (x, y, heading) and speeds of a robot that follows a smooth random course in a room."""
    time = start_s + np.cumsum(rng.uniform(0.9, 1.1, n)) / rate_hz
    phase = rng.uniform(0.0, 2.0 * np.pi, (4, 1))
    slow = 2.0 * np.pi / rng.uniform(15.0, 60.0, (4, 1))
    wave = np.sin(slow * time + phase)
    place = room[:, None] * (0.5 + 0.32 * wave[:2] + 0.12 * wave[2:] * wave[:2])
    velocity = np.gradient(place, time, axis=1)
    heading = np.arctan2(velocity[1], velocity[0])
    return time, np.stack([*place, np.unwrap(heading)]), np.hypot(*velocity)


def _wall(room: Floats, pose: Floats) -> tuple[Floats, Floats]:
    """Return the distance of the wall ahead, m, and the incidence on it, rad, at poses (3, n)."""
    ahead = np.stack([np.cos(pose[2]), np.sin(pose[2])])
    gap = np.where(ahead > 0.0, room[:, None] - pose[:2], pose[:2])
    reach = gap / np.maximum(np.abs(ahead), 1e-6)
    first = np.argmin(reach, axis=0)
    pick = first, np.arange(pose.shape[1])
    return reach[pick], np.arccos(np.clip(np.abs(ahead[pick]), 0.0, 1.0)) * np.sign(ahead[1 - first, pick[1]])


def _log(room: Floats, n: int, rate_hz: float, speed: bool, rng: Rng) -> Ping:
    """Return the log of some drives in one room."""
    runs = int(rng.integers(1, 4))
    parts = [_drive(room, -(-n // runs), rate_hz, 600.0 * k, rng) for k in range(runs)]
    time, pose, velocity = (np.concatenate([part[k] for part in parts], axis=-1)[..., :n] for k in range(3))
    distance, incidence = _wall(room, pose)
    run = np.repeat(np.arange(runs), -(-n // runs))[:n]
    ping = Ping.of(np.round(distance, 4), 0.0, np.round(incidence, 4), time=np.round(time - time[0], 3), run=run)
    return replace(ping, covariates={SPEED_MPS: np.round(velocity, 3)}) if speed else ping


def draw_world(rng: Rng) -> World:
    """Return a random robot."""
    sonar = RobotSonar(
        odometry_m=float(rng.uniform(0.0, 0.012)),
        odometry_s=float(rng.uniform(3.0, 30.0)),
        noise_m=float(rng.uniform(0.002, 0.008)),
        noise_per_metre=float(rng.uniform(0.0, 0.004)),
        level_db=float(rng.uniform(20.0, 40.0)),
        per_metre_db=float(rng.uniform(1.0, 5.0)),
        tilt_deg=float(rng.uniform(15.0, 40.0)),
        corner=float(rng.uniform(0.0, 0.05)),
        alarms_per_m=float(rng.uniform(0.0, 0.005)),
        temperature_c=float(rng.uniform(17.0, 27.0)),
    )
    return World(sonar, Register.draw(rng))


def draw_surveys(rng: Rng, pings: int, fixed: Mapping[str, Any]) -> Surveys:
    """Return drives in one room; in half of the trials the recording is of the same drive as the simulation."""
    room, rate = rng.uniform(2.5, 6.0, 2), float(rng.uniform(10.0, 20.0))
    speed = bool(rng.random() < 0.4)
    simulated = _log(room, pings, rate, speed, rng)
    recorded = simulated if rng.random() < 0.5 else _log(room, pings, rate, speed, rng)
    fresh = _log(rng.uniform(2.5, 6.0, 2), pings // 3, rate, speed, rng)
    return Surveys(simulated, recorded, fresh, ("reflectance",))


def _plant_gate(world: World, size: float, rng: Rng) -> Planted:
    at = 2.5 - 0.7 * min(size, 2.0)
    return Planted(world, world.with_sonar(gate_m=at), at, {"distance": (at, 6.0)})


CAUSES = (
    Cause(
        "latency",
        changed(lambda s, k, r: {"latency_s": s.latency_s + min(0.3, 0.15 * k)}, "latency_s"),
        ("bias", "spread", "memory"),
        parameter="latency_s",
    ),
    *SCALE_CAUSES,
    Cause("travel_time_jitter", changed(lambda s, k, r: {"noise_m": s.noise_m * (1.0 + k)}), ("spread",)),
    Cause(
        "sensitivity",
        changed(lambda s, k, r: {"level_db": s.level_db - 8.0 * k}, "level_db", -1.0),
        ("detection",),
        ("air_absorption", "specular_loss"),
        "loss_db",
    ),
    Cause("specular_loss", changed(lambda s, k, r: {"tilt_deg": s.tilt_deg / (1.0 + 0.5 * k)}), ("detection",)),
    Cause(
        "false_alarm",
        changed(lambda s, k, r: {"alarms_per_m": s.alarms_per_m + 0.08 * k}, "alarms_per_m"),
        ("early", "skew", "detection"),
        parameter="per_metre",
    ),
    Cause("range_gate", _plant_gate, ("detection",), parameter="listen_m"),
    *LINK_CAUSES,
)
FAMILY = Family(draw_world, draw_surveys, CAUSES)
