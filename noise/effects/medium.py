"""Medium effects: what the air does to the time and the strength of sound."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from noise.effects.base import Effect, Parameter, Path, Seen, Stage, State
from noise.law import Floats
from noise.statistics import winsorised

ASSUMED_SPEED = 344.83  # m/s; 58 us/cm, the constant of the HC-SR04 family and the working assumption for the SRF08
CELSIUS = 273.15
SPEED_AT_0C = 331.3  # m/s, dry air


def sound_speed(temperature_c: Tensor) -> Tensor:
    """Return the speed of sound in dry air, m/s: c = 331.3 sqrt(1 + T/273.15)."""
    return SPEED_AT_0C * (1.0 + temperature_c / CELSIUS) ** 0.5


ASSUMED_TEMPERATURE_C = CELSIUS * ((ASSUMED_SPEED / SPEED_AT_0C) ** 2 - 1.0)  # 22.8 degC: where 58 us/cm is true


AIR_SD_K = (
    0.5  # of air that no thermometer was in: a heated room keeps to its setting within half a kelvin or one; ours
)
AIR_SCALE_SD = 0.5 * AIR_SD_K / (CELSIUS + ASSUMED_TEMPERATURE_C)  # what that makes of distances
LOGGED = "temperature_c"  # covariate: a thermometer beside the sensor, degC
REFERENCE_C = 20.0  # where `temperature_c` holds when a thermometer was logged
MOST_STRETCH = 0.1  # of distance: what is farther off is no echo of the target; ours
PERIODS = 48  # at which a swing of the air is looked for; ours
APART = 0.5  # logarithm of the ratio of two periods, less than which they are one; ours
LEAST_SWING_K = 3.0  # a log that varies less says nothing that its own error of 0.5 K would not; ours


class SoundSpeed(Effect):
    """Air at another temperature than the sensor assumes: range = distance * c(assumed) / c(true).

    Where a thermometer was logged, the air was at temperature_c + logged_share (logged - 20 degC): a share of 1 is a
    sensor that knows nothing of the temperature. No clock does that, which is how the two are told apart.
    """

    name = "sound_speed"
    stage = Stage.MEDIUM
    summary = "Sound travels faster or slower than the sensor assumes: all ranges are scaled"
    parameters = (
        Parameter(
            "temperature_c",
            "degC",
            ASSUMED_TEMPERATURE_C,
            -20.0,
            60.0,
            "c = 331.3 sqrt(1+T/273.15)",
            (ASSUMED_TEMPERATURE_C,),
        ),
        Parameter(
            "logged_share",
            "1",
            0.0,
            -0.5,
            1.5,
            "1 = uncompensated; wider: ours",
            (0.0, 1.0),
            covariate=LOGGED,
            span=LEAST_SWING_K,
        ),
    )
    temperature_c: Tensor
    logged_share: Tensor

    def apply(self, state: State) -> State:
        """Stretch every path by the ratio of speeds; exactly 1 at the assumed temperature."""
        logged = state.conditions.covariates.get(LOGGED)
        beyond = 0.0 if logged is None else self.logged_share * (logged - REFERENCE_C)
        kelvin = torch.clamp(CELSIUS + self.temperature_c + beyond, min=200.0)
        ratio = ((CELSIUS + ASSUMED_TEMPERATURE_C) / kelvin) ** 0.5
        return state.map_paths(lambda path: replace(path, length=path.length * ratio))

    def statement(self) -> str:
        """Return the error as a share of distance and the temperature behind it."""
        warm, share = self.values["temperature_c"], self.values["logged_share"]
        error = ((CELSIUS + ASSUMED_TEMPERATURE_C) / (CELSIUS + warm)) ** 0.5 - 1.0
        size = f"Readings run {'long' if error >= 0 else 'short'} by {100 * abs(error):.2g} % of distance"
        if not share:
            return f"{size}: the air was at {warm:.1f} degC, the sensor assumes {ASSUMED_TEMPERATURE_C:.1f} degC."
        slope = -50.0 * share / (CELSIUS + warm)
        return f"{size} in air of {warm:.1f} degC, and by {slope:+.2g} % for every kelvin that the thermometer rises."


class AirAbsorption(Effect):
    """Air takes `alpha_db_per_m` from the level for every metre there and back: level -> level - 2 alpha length."""

    name = "air_absorption"
    stage = Stage.MEDIUM
    summary = "Air absorbs the sound: far echoes are weaker"
    parameters = (
        Parameter("alpha_db_per_m", "dB/m", 0.0, 0.0, 3.0, "ISO 9613-1 at 40 kHz: 0.4 to 1.5 dB/m", (0.7, 1.3)),
    )
    alpha_db_per_m: Tensor

    def apply(self, state: State) -> State:
        """Weaken every path by its own length."""
        return state.map_paths(self._absorb)

    def _absorb(self, path: Path) -> Path:
        return replace(path, level_db=path.level_db - 2.0 * self.alpha_db_per_m * path.length)

    def statement(self) -> str:
        """Return the absorption and what it takes there and back at 6 m."""
        alpha = self.values["alpha_db_per_m"]
        return f"Air absorbs {alpha:.2g} dB/m: echoes from 6 m come back {12 * alpha:.1f} dB weaker."


class Scintillation(Effect):
    """Turbulence makes the level of a whole ping rise and fall: sigma = sigma(6 m) (length / 6 m)^(11/12).

    One latent normal level for all paths of a ping, integrated by Gauss-Hermite quadrature.
    """

    name = "scintillation"
    stage = Stage.MEDIUM
    summary = "Turbulent air makes echoes stronger and weaker from ping to ping, far ones most"
    parameters = (
        Parameter("sigma_at_6m_db", "dB", 0.0, 0.0, 8.0, "Tatarskii; 0.1-1 dB still, 1-3 dB heated", (1.0, 3.0)),
    )
    sigma_at_6m_db: Tensor
    nodes = 7

    def apply(self, state: State) -> State:
        """Spread every path over the nodes of the level."""
        node, weight = np.polynomial.hermite_e.hermegauss(self.nodes)
        spread = torch.from_numpy(node)[:, None] * self.sigma_at_6m_db
        faded = state.map_paths(lambda path: replace(path, level_db=path.level_db + spread * _growth(path.length)))
        return replace(faded, log_weight=torch.log(torch.from_numpy(weight / weight.sum()))[:, None])

    def statement(self) -> str:
        """Return its size at 6 m."""
        size = self.values["sigma_at_6m_db"]
        return f"Turbulent air makes echoes stronger and weaker from ping to ping, by {size:.2g} dB at 6 m."


def _growth(length: Tensor) -> Tensor:
    return (torch.clamp(length, min=0.01) / 6.0) ** (11.0 / 12.0)


class ThermalDrift(Effect):
    """The air's temperature moves while recording: T(t) = T + rate t + a sin(2 pi t / period) + b cos(2 pi t / period).

    `sine_k` and `cosine_k` together are the amplitude and phase of one swing; time counts from the recording's start.
    """

    name = "thermal_drift"
    stage = Stage.MEDIUM
    summary = "The air warms or cools while recording: ranges are scaled by an amount that changes with time"
    parameters = (
        Parameter(
            "rate_k_per_h", "K/h", 0.0, -20.0, 20.0, "rooms: 0.3 to 1.5 K within hours; wider: ours", (0.5, -0.5)
        ),
        Parameter("sine_k", "K", 0.0, -15.0, 15.0, "heating cycles, 0.3 to 1.5 K; days outdoors: ours", (0.3,)),
        Parameter("cosine_k", "K", 0.0, -15.0, 15.0, "heating cycles, 0.3 to 1.5 K; days outdoors: ours", (0.0,)),
        Parameter("period_s", "s", 3600.0, 60.0, 86400.0, "heating cycles to a day: ours", (600.0, 3600.0)),
    )
    rate_k_per_h: Tensor
    sine_k: Tensor
    cosine_k: Tensor
    period_s: Tensor

    def apply(self, state: State) -> State:
        """Stretch every path by the speed of the moment."""
        warmer = self.warming(state.conditions.time)
        ratio = (1.0 + warmer / (CELSIUS + ASSUMED_TEMPERATURE_C)) ** -0.5
        return state.map_paths(lambda path: replace(path, length=path.length * ratio))

    @classmethod
    def guesses(cls, seen: Seen) -> list[dict[str, float]]:
        """Return the slope and swing of least squares at the periods at which a swing explains most."""
        time, stretch = seen.time, seen.range / np.maximum(seen.distance, 0.01) - 1.0
        near = np.abs(stretch) < MOST_STRETCH
        if near.sum() < 8 or not np.ptp(time[near]):
            return []
        return _swings(time[near], -2.0 * (CELSIUS + ASSUMED_TEMPERATURE_C) * winsorised(stretch[near]))

    def warming(self, time: Tensor) -> Tensor:
        """Return how much warmer than at rest the air is at a time in s, K, bounded to +-50 K."""
        phase = 2.0 * math.pi * time / self.period_s
        swing = self.sine_k * torch.sin(phase) + self.cosine_k * torch.cos(phase)
        return torch.clamp(self.rate_k_per_h * time / 3600.0 + swing, -50.0, 50.0)

    def statement(self) -> str:
        """Return rate and swing."""
        v = self.values
        swing = math.hypot(v["sine_k"], v["cosine_k"])
        moved = f"{v['rate_k_per_h']:+.2g} K an hour and a swing of {swing:.2g} K every {v['period_s'] / 60:.0f} min"
        return f"The air's temperature moved while recording, by {moved}: ranges are scaled by what changes with time."


def _swings(time: Floats, warmer: Floats) -> list[dict[str, float]]:
    """Return the best two swings through temperatures at times, their periods no neighbours, and the best slope."""
    shortest, longest = 60.0, float(np.clip(2.0 * np.ptp(time), 120.0, 86400.0))
    found = []
    for period in np.geomspace(shortest, longest, PERIODS):
        phase = 2.0 * np.pi * time / period
        columns = np.stack([np.ones_like(time), time / 3600.0, np.sin(phase), np.cos(phase)], axis=1)
        best, *_ = np.linalg.lstsq(columns, warmer, rcond=None)
        left = float(np.sum((warmer - columns @ best) ** 2))
        found.append((left, {"rate_k_per_h": best[1], "sine_k": best[2], "cosine_k": best[3], "period_s": period}))
    found.sort(key=lambda each: each[0])
    first = found[0][1]
    apart = [one for _, one in found if abs(np.log(one["period_s"] / first["period_s"])) > APART]
    slope = float(np.polyfit(time / 3600.0, warmer, 1)[0])
    alone = {"rate_k_per_h": slope, "sine_k": 0.0, "cosine_k": 0.0, "period_s": 3600.0}
    return [{name: float(value) for name, value in one.items()} for one in (first, *apart[:1], alone)]
