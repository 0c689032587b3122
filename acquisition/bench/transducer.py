"""Transducers: what a burst becomes on its way through both resonators, and how they favour the beam's axis."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from acquisition.bench.air import CARRIER, Floats
from acquisition.bench.unit import Unit

Complexes = NDArray[np.complex128]
CYCLES = 8  # of the burst: 200 us at 40 kHz
OMEGA = 2.0 * np.pi * CARRIER
PERIOD = 1.0 / CARRIER  # s; also the step of every waveform here, so each step holds one period of the carrier
FINE = 8  # delays are resolved to PERIOD / FINE before the carrier's phase is put back exactly
LENGTH = 5.0e-3  # s, after which a pulse has rung down: by 70 dB even at Q = 58
REFERENCE_C = 20.0


def _resonator(t: Floats, f0: float, quality: float) -> Complexes:
    """Return the impulse response of a second-order resonator about the carrier, at times t >= 0."""
    rate = np.pi * f0 / quality
    response = rate * np.exp((2j * np.pi * (f0 - CARRIER) - rate) * t)
    response[0] *= 0.5  # trapezoidal rule
    return response


def pulse_at(unit: Unit, temperature_c: float, step: float) -> Complexes:
    """Return the echo of a point at zero delay: the burst through both resonators, unit amplitude if it lasted.

    The carrier is taken out: the voltage is the imaginary part of the pulse times exp(i 2 pi 40 kHz t).
    """
    t = np.arange(0.0, LENGTH, step)
    size = 2 * len(t)
    shift = unit.f_slope * (temperature_c - REFERENCE_C)
    burst = (t < CYCLES * PERIOD - 0.5 * step).astype(np.complex128)
    burst[0] = 0.5
    burst[round(CYCLES * PERIOD / step)] = 0.5
    parts = (burst, _resonator(t, unit.f_tx + shift, unit.q_tx), _resonator(t, unit.f_rx + shift, unit.q_rx))
    spectrum = np.prod([np.fft.fft(part, size) for part in parts], axis=0)
    return np.fft.ifft(spectrum)[: len(t)] * step**2


@lru_cache(maxsize=256)
def pulse_phases(unit: Unit, temperature_c: float) -> Complexes:
    """Return the pulse for delays of j / FINE periods, (FINE, samples), one sample a period.

    Scaled so that the nominal unit's echo peaks at 1: a poor or detuned resonator is heard as a weak one.
    """
    fine = pulse_at(unit, temperature_c, PERIOD / FINE / 4)[::4] / reference_peak()
    padded = np.concatenate([np.zeros(FINE, dtype=np.complex128), fine])
    starts = np.arange(0, len(fine) - FINE, FINE)
    return np.stack([padded[starts + FINE - j] for j in range(FINE)])


@lru_cache(maxsize=1)
def reference_peak() -> float:
    """Return the peak of the nominal unit's pulse: 11.7 dB below what an endless burst would reach."""
    return float(np.abs(pulse_at(Unit.nominal(), REFERENCE_C, PERIOD / FINE / 4)).max())


def _bessel_j1(x: Floats) -> Floats:
    """Return the Bessel function J1 by its integral over [0, pi]; the midpoint rule converges geometrically."""
    angle = (np.arange(64) + 0.5) * np.pi / 64
    return np.cos(angle - x[..., None] * np.sin(angle)).mean(axis=-1)


@dataclass(frozen=True)
class Piston:
    """A round piston in a baffle: pressure against the axis is 2 J1(x)/x with x = k a sin(angle)."""

    ka: float

    def __call__(self, angle: Floats) -> Floats:
        """Return the relative pressure at angles off the axis, rad; nothing is sent backwards."""
        x = self.ka * np.sin(np.minimum(np.abs(angle), np.pi / 2))
        return np.where(np.abs(angle) < np.pi / 2, np.interp(x, *_table()), 0.0)


@lru_cache(maxsize=1)
def _table() -> tuple[Floats, Floats]:
    x = np.linspace(0.0, 12.0, 4001)
    return x, np.concatenate([[1.0], 2.0 * _bessel_j1(x[1:]) / x[1:]])
