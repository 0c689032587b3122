"""Family "fixed": one target at a constant distance, read every ten minutes for weeks while the weather changes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from acquisition import Ping
from acquisition.arrays import Floats
from acquisition.ping import TEMPERATURE
from training.diagnosis.generators.beam import SPEED_C, changed, speed_ratio
from training.diagnosis.generators.world import LINK_CAUSES, Cause, Family, Planted, Register, Rng, Surveys, World, sign

STEP_S, DAY_S = 600.0, 86_400.0
REFERENCE_C = 20.0  # air temperature at which an uncompensated sensor is adjusted
WEATHER_S, WEATHER_K = 2.0 * DAY_S, 3.0  # correlation time and standard deviation of the weather


@dataclass(frozen=True)
class FixedSonar:
    """A sonar that is left alone.

    Attributes:
        share: of the temperature's influence that is not compensated; 0 for a compensated sensor.
        noise_m: standard deviation of a reading, m; `tail` the share of readings whose error is ten times larger.
        missed: share of pings without echo.
        alarms_per_m: rate of false echoes, 1/m.
        warming_k: amplitude of a daily cycle of the air that nobody logs, K.
        cold_m, cold_s, scale, offset_m, temperature_c: see `beam.BeamSonar`.
    """

    share: float
    noise_m: float
    tail: float
    missed: float
    alarms_per_m: float = 0.0
    warming_k: float = 0.0
    cold_m: float = 0.0
    cold_s: float = 3600.0
    scale: float = 1.0
    offset_m: float = 0.0
    temperature_c: float = SPEED_C

    def read(self, ping: Ping, rng: Rng) -> tuple[Ping, Floats]:
        """Return the pings and readings, m, 0 for no echo."""
        n = len(ping)
        logged = ping.covariates.get(TEMPERATURE, np.full(n, REFERENCE_C))
        air = self.temperature_c + self.share * (logged - REFERENCE_C)
        air = air + self.warming_k * np.sin(2.0 * np.pi * ping.time / DAY_S)
        error = self.noise_m * rng.standard_normal(n) * np.where(rng.random(n) < self.tail, 10.0, 1.0)
        away = ping.distance * speed_ratio(air) + self.offset_m + self.cold_m * np.exp(-ping.time / self.cold_s)
        value = np.minimum(self.scale * away + error, rng.exponential(1.0 / max(self.alarms_per_m, 1e-9), n))
        return ping, np.where(rng.random(n) < self.missed, 0.0, np.maximum(value, 1e-3))


def draw_world(rng: Rng) -> World:
    """Return a random sensor, compensated or not."""
    sonar = FixedSonar(
        share=float(rng.choice([0.0, 1.0])),
        noise_m=float(np.exp(rng.uniform(np.log(0.0003), np.log(0.005)))),
        tail=float(rng.uniform(0.0, 0.02)),
        missed=float(rng.uniform(0.0, 0.03)),
        offset_m=float(rng.normal(0.0, 0.003)),
    )
    return World(sonar, Register.draw(rng) if rng.random() < 0.5 else Register(0.001))


def weather(time: Floats, mean_c: float, daily_k: float, rng: Rng) -> Floats:
    """Return the air temperature, degC: a daily cycle, autoregressive weather and noise, to 0.1 degC."""
    keep = np.exp(-STEP_S / WEATHER_S)
    slow = WEATHER_K * rng.standard_normal(len(time)) * np.sqrt(1.0 - keep**2)
    slow[0] = WEATHER_K * rng.standard_normal()
    for k in range(1, len(slow)):
        slow[k] += keep * slow[k - 1]
    daily = daily_k * np.sin(2.0 * np.pi * (time / DAY_S + 0.65))
    return np.round(mean_c + daily + slow + 0.1 * rng.standard_normal(len(time)), 1)


def draw_surveys(rng: Rng, pings: int, fixed: Mapping[str, Any]) -> Surveys:
    """Return weeks at one target.

    With a thermometer the simulation may be of other weeks. Without one, both are of the same weeks, since two
    recordings of one sensor in other weather would differ. The fresh weeks come after the recorded ones.
    """
    logged = rng.random() < 0.6
    distance, mean_c, daily_k = round(rng.uniform(0.3, 4.0), 3), rng.uniform(8.0, 22.0), rng.uniform(2.0, 8.0)

    def weeks(n: int, start_s: float) -> Ping:
        time = start_s + STEP_S * np.arange(n, dtype=np.float64)
        return Ping.of(distance, time=time, temperature_c=weather(time, mean_c, daily_k, rng))

    recorded = weeks(pings, 0.0)
    simulated = weeks(pings, 0.0) if logged and rng.random() < 0.5 else recorded
    fresh = weeks(max(20, pings // 3), STEP_S * pings + DAY_S)
    missing = ("reflectance", "incidence_deg") if rng.random() < 0.5 else ()
    return Surveys(simulated, recorded, fresh, missing if logged else (*missing, TEMPERATURE))


def _plant_share(world: World, size: float, rng: Rng) -> Planted:
    share = min(1.5, size)
    return Planted(world.with_sonar(share=0.0), world.with_sonar(share=share), share)


def _plant_warming(world: World, size: float, rng: Rng) -> Planted:
    still = world.with_sonar(share=0.0)
    real = still.with_sonar(warming_k=4.0 * size)
    return Planted(still, real, real.sonar.warming_k)


CONSTANT = ("sound_speed", "clock_scale", "zero_offset")  # one and the same at a single distance
CAUSES = (
    Cause("sound_speed", _plant_share, ("bias", "spread", "memory"), (), "logged_share", needs=(TEMPERATURE,)),
    Cause("thermal_drift", _plant_warming, ("bias", "spread", "memory"), (), "sine_k", hides=(TEMPERATURE,)),
    Cause(
        "zero_offset",
        changed(lambda s, k, r: {"offset_m": s.offset_m + sign(r) * 0.012 * k}, "offset_m"),
        ("bias",),
        CONSTANT,
        "offset_m",
    ),
    Cause(
        "clock_scale",
        changed(lambda s, k, r: {"scale": s.scale * (1.0 + sign(r) * 0.012 * k)}, "scale"),
        ("bias",),
        CONSTANT,
        "error",
    ),
    Cause(
        "warm_up",
        changed(lambda s, k, r: {"cold_m": sign(r) * 0.04 * k, "cold_s": float(r.uniform(3600.0, 7200.0))}, "cold_m"),
        ("bias", "memory"),
        parameter="offset_m",
    ),
    Cause("travel_time_jitter", changed(lambda s, k, r: {"noise_m": s.noise_m * (1.0 + 1.5 * k)}), ("spread",)),
    Cause(
        "false_alarm",
        changed(lambda s, k, r: {"alarms_per_m": 0.06 * k}, "alarms_per_m"),
        ("early", "skew"),
        parameter="per_metre",
    ),
    *LINK_CAUSES,
)
FAMILY = Family(draw_world, draw_surveys, CAUSES)
