"""Medium effects: the influence of the air on the travel time and the level of the sound."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from acquisition.arrays import Floats
from acquisition.ping import CELSIUS, TEMPERATURE
from noise.effects.base import EchoSample, Effect, Parameter, Stage
from noise.effects.state import Path, State
from noise.statistics import winsorised

ASSUMED_SPEED = 344.83  # m/s; 58 us/cm, the constant of the HC-SR04 family and the working assumption for the SRF08
SPEED_AT_0C = 331.3  # m/s, dry air


def sound_speed(temperature_c: Tensor) -> Tensor:
    """Return the speed of sound in dry air, m/s: c = 331.3 sqrt(1 + T/273.15)."""
    return SPEED_AT_0C * (1.0 + temperature_c / CELSIUS) ** 0.5


ASSUMED_TEMPERATURE_C = CELSIUS * ((ASSUMED_SPEED / SPEED_AT_0C) ** 2 - 1.0)  # 22.8 degC: 58 us/cm

AIR_SD_K = 0.5  # standard deviation of an unmeasured air temperature, a heated room: 0.5 to 1 K; chosen here
AIR_SCALE_SD = 0.5 * AIR_SD_K / (CELSIUS + ASSUMED_TEMPERATURE_C)  # resulting relative error of distances
REFERENCE_C = 20.0  # logged temperature at which the air has the temperature `temperature_c`
MAX_SCALE_ERROR = 0.1  # largest relative error of an echo of the target; chosen here
DAY_S = 86_400.0
N_PERIODS = 192  # number of periods in the search for an oscillation; chosen here
MIN_LOG_RATIO = 0.5  # smallest logarithm of the ratio of two different periods; chosen here
MIN_SPAN_K = 3.0  # a log with a smaller range is dominated by its error of 0.5 K; chosen here


class SoundSpeed(Effect):
    """Air temperature other than the sensor assumes: range = distance * c(assumed) / c(true).

    With a logged thermometer the air temperature is temperature_c + logged_share (logged - 20 degC); a share of 1 is a
    sensor without temperature compensation. This dependence distinguishes the effect from an error of the clock.
    """

    name = "sound_speed"
    stage = Stage.MEDIUM
    summary = "The speed of sound differs from the sensor's assumption: all ranges are scaled"
    parameters = (
        Parameter(
            "temperature_c",
            "degC",
            ASSUMED_TEMPERATURE_C,
            -20.0,
            60.0,
            "c = 331.3 sqrt(1+T/273.15)",
            (ASSUMED_TEMPERATURE_C,),
            typical=8.0,
            adds=True,
        ),
        Parameter(
            "logged_share",
            "1",
            0.0,
            -1.0,
            2.0,
            "1 = uncompensated, -1 = compensated twice, 2 = air that swings twice as much as the log",
            (0.0, 1.0),
            covariate=TEMPERATURE,
            span=MIN_SPAN_K,
        ),
    )
    temperature_c: Tensor
    logged_share: Tensor

    def apply(self, state: State) -> State:
        """Scale every path by the ratio of speeds; exactly 1 at the assumed temperature."""
        logged = state.conditions.covariates.get(TEMPERATURE)
        beyond = 0.0 if logged is None else self.logged_share * (logged - REFERENCE_C)
        kelvin = torch.clamp(CELSIUS + self.temperature_c + beyond, min=200.0)
        ratio = ((CELSIUS + ASSUMED_TEMPERATURE_C) / kelvin) ** 0.5
        return state.map_paths(lambda path: replace(path, length=path.length * ratio))

    def statement(self) -> str:
        """Return a sentence with the relative error and the temperature."""
        warm, share = self.values["temperature_c"], self.values["logged_share"]
        error = ((CELSIUS + ASSUMED_TEMPERATURE_C) / (CELSIUS + warm)) ** 0.5 - 1.0
        size = f"Readings run {'long' if error >= 0 else 'short'} by {100 * abs(error):.2g} % of distance"
        if not share:
            return f"{size}: the air was at {warm:.1f} degC, the sensor assumes {ASSUMED_TEMPERATURE_C:.1f} degC."
        slope = -50.0 * share / (CELSIUS + warm)
        change = f"change by {slope:+.2g} % of distance per kelvin of the thermometer"
        sense = "long" if error >= 0 else "short"
        return f"Readings {change}; at {REFERENCE_C:g} degC, they run {sense} by {100 * abs(error):.2g} %."


class AirAbsorption(Effect):
    """Absorption of `alpha_db_per_m` on the way there and back: level -> level - 2 alpha length."""

    name = "air_absorption"
    stage = Stage.MEDIUM
    summary = "Air absorbs the sound: far echoes are weaker"
    parameters = (
        Parameter(
            "alpha_db_per_m", "dB/m", 0.0, 0.0, 3.0, "ISO 9613-1 at 40 kHz: 0.4 to 1.5 dB/m", (0.7, 1.3), adds=True
        ),
    )
    alpha_db_per_m: Tensor

    def apply(self, state: State) -> State:
        """Attenuate every path by its length."""
        return state.map_paths(self._absorb)

    def _absorb(self, path: Path) -> Path:
        return replace(path, level_db=path.level_db - 2.0 * self.alpha_db_per_m * path.length)

    def statement(self) -> str:
        """Return a sentence with the absorption and its loss at 6 m."""
        alpha = self.values["alpha_db_per_m"]
        more, weaker = ("more", "weaker") if alpha >= 0.0 else ("less", "stronger")
        return f"Air absorbs {abs(alpha):.2g} dB/m {more}: echoes from 6 m are {12 * abs(alpha):.1f} dB {weaker}."


class Scintillation(Effect):
    """Turbulence varies the level of a whole ping: sigma = sigma(6 m) (length / 6 m)^(11/12).

    All paths of a ping share one latent normal level, integrated by Gauss-Hermite quadrature.
    """

    name = "scintillation"
    stage = Stage.MEDIUM
    summary = "Turbulent air varies the level of echoes from ping to ping, most of all far ones"
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
        """Return a sentence with the standard deviation at 6 m."""
        size = self.values["sigma_at_6m_db"]
        return f"Turbulent air varies the level of echoes from ping to ping, by {size:.2g} dB at 6 m."


def _growth(length: Tensor) -> Tensor:
    return (torch.clamp(length, min=0.01) / 6.0) ** (11.0 / 12.0)


def _swing(name: str, start: float) -> Parameter:
    """Return the parameter of one phase of an oscillation of the air temperature."""
    source = "heating 0.3 to 1.5 K; between -10 and 45 °C: chosen here"
    return Parameter(name, "K", 0.0, -27.5, 27.5, source, (start,), typical=1.0, adds=True)


class ThermalDrift(Effect):
    """The air temperature changes during the recording: T + rate t + a sin(2 pi t / period) + b cos(2 pi t / period).

    `sine_k` and `cosine_k` define the amplitude and phase of the oscillation; time counts from the recording's start.
    """

    name = "thermal_drift"
    stage = Stage.MEDIUM
    needs_time = by_clock = True
    summary = "The air warms or cools during the recording: the scale of ranges changes with time"
    parameters = (
        Parameter(
            "rate_k_per_h",
            "K/h",
            0.0,
            -165.0,
            165.0,
            "rooms 0.3 to 1.5 K in hours; from -10 to 45 °C in 20 min: chosen here",
            (0.5, -0.5),
            typical=1.0,
            adds=True,
        ),
        _swing("sine_k", 0.3),
        _swing("cosine_k", 0.0),
        # bounds wide enough that the estimate of a daily cycle does not end at one
        Parameter(
            "period_s", "s", 3600.0, 60.0, 2.0 * DAY_S, "heating to a day: chosen here", (600.0, 3600.0), cycle=True
        ),
    )
    rate_k_per_h: Tensor
    sine_k: Tensor
    cosine_k: Tensor
    period_s: Tensor

    def apply(self, state: State) -> State:
        """Scale every path by the current speed of sound."""
        warmer = self.warming(state.conditions.time)
        ratio = (1.0 + warmer / (CELSIUS + ASSUMED_TEMPERATURE_C)) ** -0.5
        return state.map_paths(lambda path: replace(path, length=path.length * ratio))

    @classmethod
    def guesses(cls, echoes: EchoSample) -> list[dict[str, float]]:
        """Return the least-squares slope and oscillation at the periods that explain most.

        A constant error and one of the scale, which are no drift, are fitted beside them.
        """
        time, distance, error = echoes.time, echoes.distance, echoes.range - echoes.distance
        near = np.abs(error) < MAX_SCALE_ERROR * np.maximum(distance, 0.01)
        if near.sum() < 8 or not np.ptp(time[near]):
            return []
        return _oscillations(time[near], distance[near], winsorised(error[near]))

    def warming(self, time: Tensor) -> Tensor:
        """Return the change of the air temperature at a time in s, K, limited to +-50 K."""
        phase = 2.0 * math.pi * time / self.period_s
        swing = self.sine_k * torch.sin(phase) + self.cosine_k * torch.cos(phase)
        return torch.clamp(self.rate_k_per_h * time / 3600.0 + swing, -50.0, 50.0)

    def statement(self) -> str:
        """Return a sentence with the rate and the oscillation."""
        v = self.values
        amplitude = math.hypot(v["sine_k"], v["cosine_k"])
        wave = f"an oscillation of {amplitude:.2g} K with a period of {v['period_s'] / 60:.0f} min"
        change = f"{v['rate_k_per_h']:+.2g} K per hour and {wave}"
        return f"The air temperature changed during the recording, by {change}: the scale of ranges changes with time."


def _oscillations(time: Floats, distance: Floats, error: Floats) -> list[dict[str, float]]:
    """Return the best two oscillations of clearly different periods, and the best slope, fitted to errors of range."""
    per_kelvin = -0.5 * distance / (CELSIUS + ASSUMED_TEMPERATURE_C)
    shortest, longest = 60.0, float(np.clip(2.0 * np.ptp(time), 120.0, 2.0 * DAY_S))
    found, steady = [], [np.ones_like(time), distance, per_kelvin * time / 3600.0]
    for period in np.append(np.geomspace(shortest, longest, N_PERIODS), min(DAY_S, longest)):
        phase = 2.0 * np.pi * time / period
        columns = np.stack([*steady, per_kelvin * np.sin(phase), per_kelvin * np.cos(phase)], axis=1)
        best, *_ = np.linalg.lstsq(columns, error, rcond=None)
        left = float(np.sum((error - columns @ best) ** 2))
        found.append((left, {"rate_k_per_h": best[2], "sine_k": best[3], "cosine_k": best[4], "period_s": period}))
    found.sort(key=lambda each: each[0])
    first = found[0][1]
    apart = [one for _, one in found if abs(np.log(one["period_s"] / first["period_s"])) > MIN_LOG_RATIO]
    slope = float(np.linalg.lstsq(np.stack(steady, axis=1), error, rcond=None)[0][2])
    alone = {"rate_k_per_h": slope, "sine_k": 0.0, "cosine_k": 0.0, "period_s": 3600.0}
    return [{name: float(value) for name, value in one.items()} for one in (first, *apart[:1], alone)]
