"""Transducers: the pulse that a burst becomes in both resonators, and the beam pattern."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from acquisition.bench.laboratory.air import CARRIER, Floats
from acquisition.bench.laboratory.unit import Unit

Complexes = NDArray[np.complex128]
BURST_CYCLES = 8  # 200 us at 40 kHz
OMEGA = 2.0 * np.pi * CARRIER
PERIOD = 1.0 / CARRIER  # s; also the sampling interval of every waveform
OVERSAMPLING = 2  # steps per period of the grid of delays, on which arrivals are interpolated by cubics
PULSE_STEP = PERIOD / 32  # s, sampling interval at which a pulse is computed
PULSE_LENGTH = 5.0e-3  # s, after which a pulse has decayed by 70 dB even at Q = 58
REFERENCE_C = 20.0
MIN_QUALITY = 0.2  # relative; far beyond -40 to 85 degC, bounds what a slope may do


def _resonator(t: Floats, f0: float, quality: float) -> Complexes:
    """Return the impulse response of a second-order resonator about the carrier, at times t >= 0."""
    rate = np.pi * f0 / quality
    response = rate * np.exp((2j * np.pi * (f0 - CARRIER) - rate) * t)
    response[0] *= 0.5  # trapezoidal rule
    return response


def pulse_at(unit: Unit, temperature_c: float, step: float) -> Complexes:
    """Return the echo of a point at zero delay: the burst through both resonators, of unit amplitude in steady state.

    The carrier is removed: the voltage is the imaginary part of the pulse times exp(i 2 pi 40 kHz t).
    """
    t = np.arange(0.0, PULSE_LENGTH, step)
    size = 2 * len(t)
    warmer = temperature_c - REFERENCE_C
    shift, quality = unit.f_slope * warmer, max(1.0 + unit.q_slope * warmer, MIN_QUALITY)
    burst = (t < BURST_CYCLES * PERIOD - 0.5 * step).astype(np.complex128)
    burst[0] = 0.5
    burst[round(BURST_CYCLES * PERIOD / step)] = 0.5
    resonators = ((unit.f_tx + shift, unit.q_tx * quality), (unit.f_rx + shift, unit.q_rx * quality))
    parts = (burst, *(_resonator(t, *resonator) for resonator in resonators))
    spectrum = np.prod([np.fft.fft(part, size) for part in parts], axis=0)
    return np.fft.ifft(spectrum)[: len(t)] * step**2


@lru_cache(maxsize=256)
def pulse_phases(unit: Unit, temperature_c: float) -> Complexes:
    """Return the pulse for delays of j / OVERSAMPLING periods, (OVERSAMPLING, samples), one sample per period.

    Scaled so that the nominal unit's echo peaks at 1; a poor or detuned resonator gives a weaker pulse.
    """
    fine = pulse_at(unit, temperature_c, PULSE_STEP)[:: round(PERIOD / OVERSAMPLING / PULSE_STEP)] / reference_peak()
    padded = np.concatenate([np.zeros(OVERSAMPLING, dtype=np.complex128), fine])
    starts = np.arange(0, len(fine) - OVERSAMPLING, OVERSAMPLING)
    return np.stack([padded[starts + OVERSAMPLING - j] for j in range(OVERSAMPLING)])


@lru_cache(maxsize=1)
def reference_peak() -> float:
    """Return the peak of the nominal unit's pulse: 11.7 dB below steady state."""
    return float(np.abs(pulse_at(Unit.nominal(), REFERENCE_C, PULSE_STEP)).max())


def _bessel_j1(x: NDArray[np.floating]) -> Floats:
    """Return the Bessel function J1 by its integral over [0, pi]; the midpoint rule converges geometrically."""
    angle = (np.arange(64) + 0.5) * np.pi / 64
    return np.cos(angle - x[..., None] * np.sin(angle)).mean(axis=-1)


@lru_cache(maxsize=64)
def spectra(unit: Unit, temperature_c: float, size: int) -> Complexes:
    """Return the discrete Fourier transforms of `pulse_phases`, (OVERSAMPLING, size)."""
    return np.fft.fft(pulse_phases(unit, temperature_c), size, axis=1)


@dataclass(frozen=True)
class Piston:
    """Beam pattern of a round piston in a baffle: relative pressure 2 J1(x)/x with x = k a sin(angle)."""

    ka: float

    def __call__(self, angle: Floats) -> Floats:
        """Return the relative pressure at angles off the axis, rad; 0 behind the piston."""
        return directivity(np.float64(self.ka), np.cos(angle))


def directivity(ka: Floats | np.float64, cosine: Floats) -> Floats:
    """Return a piston's relative pressure at angles off its axis of given cosines; 0 behind it."""
    # fmin: what lies behind the piston may have a cosine of NaN, and is 0 below
    position = np.fmin(ka / TABLE_STEP * np.sqrt(np.maximum(1.0 - cosine**2, 0.0)), TABLE_LENGTH - 1.0)
    at = position.astype(np.int32)
    table = _table()
    value = table[at]
    return np.where(cosine > 0.0, value + (position - at) * (table[at + 1] - value), 0.0)


TABLE_STEP, TABLE_LENGTH = 2.5e-3, 12_000


@lru_cache(maxsize=1)
def _table() -> Floats:
    x = np.arange(1, TABLE_LENGTH + 1) * TABLE_STEP
    return np.concatenate([[1.0], 2.0 * _bessel_j1(x) / x])
