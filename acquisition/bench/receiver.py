"""The receiver: arrivals become a waveform, and the waveform trips a comparator.

Waveforms are complex baseband with one sample a carrier period; the voltage is Im[z exp(i 2 pi 40 kHz t)]. A
comparator of one polarity sees one positive peak a period, so which period is first over the threshold, and hence the
slip of half a wavelength between pings, is decided here exactly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from acquisition.bench.air import Floats
from acquisition.bench.scene import Arrivals
from acquisition.bench.setup import Setup
from acquisition.bench.transducer import FINE, OMEGA, PERIOD, Complexes, pulse_phases
from acquisition.bench.unit import Unit

# gain of the analogue stage over the code in register 1 (Devantech SRF08 manual; Linux drivers/iio/proximity/srf08.c)
# fmt: off
GAINS = (
    94, 97, 100, 103, 107, 110, 114, 118, 123, 128, 133, 139, 145, 152, 159, 168,
    177, 187, 199, 212, 227, 245, 265, 288, 317, 352, 395, 450, 524, 626, 777, 1025,
)
# fmt: on
GAIN_STEP = 70e-6  # s a step, from the burst's start
SIGMAS = 7.0  # noise reaches no further: exp(-7^2/2) = 2e-11 a sample
BAND = float(np.exp(-np.pi * 10e3 * PERIOD))  # a sample of the amplifier's band-pass, Q = 4 at 40 kHz, on the next
# a wall at 6 m in air of 1.29 dB/m just reaches the threshold at full gain
REFERENCE = 12.0 * 10.0 ** (1.29 * 12.0 / 20.0)


@dataclass(frozen=True)
class Waveform:
    """Echo of one group at the receiver's input, over the comparator's threshold at full gain, (samples,)."""

    signal: Complexes
    slope: Complexes
    length: float  # half the way, m, weighted by what arrives

    @classmethod
    def of(cls, unit: Unit, arrivals: Arrivals, air: Air, samples: int) -> Waveform:
        """Sum the pulses of all arrivals that begin within the waveform."""
        path = np.hypot(arrivals.length, 0.5 * unit.baseline)
        delay = 2.0 * path / air.speed
        loss = 10.0 ** (-air.absorption_db * 2.0 * path / 20.0)
        weight = loudness(unit) * loss * arrivals.amplitude * np.exp(-1j * OMEGA * delay)
        signal = _sum_pulses(delay, weight, pulse_phases(unit, round(air.temperature_c)), samples)
        share = np.abs(weight)
        length = float((share * path).sum() / max(share.sum(), 1e-300))
        return cls(signal, np.gradient(signal, PERIOD), length)


@dataclass(frozen=True)
class Air:
    """Air of one visit: degC, m/s, dB/m."""

    temperature_c: float
    speed: float
    absorption_db: float


def _sum_pulses(delay: Floats, weight: Complexes, phases: Complexes, samples: int) -> Complexes:
    """Return sum of weight * pulse(t - delay) at whole periods, (samples,).

    A delay lies between two fine steps and is shared linearly between them; all delays within one period make one row
    of fine steps, and only rows that hold any are turned into pulses.
    """
    length = phases.shape[1]
    out = np.zeros(samples + length + 1, dtype=np.complex128)
    keep = delay < samples * PERIOD
    position = delay[keep] / (PERIOD / FINE)
    step = np.floor(position).astype(np.int64)
    share = position - step
    steps, parts = np.append(step, step + 1), np.append(weight[keep] * (1.0 - share), weight[keep] * share)
    starts, row = np.unique(steps // FINE, return_inverse=True)
    grid = _histogram(row * FINE + steps % FINE, parts, len(starts) * FINE).reshape(-1, FINE)
    for start, pulse in zip(starts, grid @ phases, strict=True):
        out[start : start + length] += pulse
    return out[:samples]


def _histogram(index: NDArray[np.int64], weight: Complexes, size: int) -> Complexes:
    return np.bincount(index, weight.real, size) + 1j * np.bincount(index, weight.imag, size)


def gain_over_time(cap: int, samples: int) -> Floats:
    """Return the amplifier's gain over its greatest, one value a period: a step every 70 us up to the cap."""
    code = np.minimum((np.arange(samples) * PERIOD / GAIN_STEP + 1e-9).astype(np.int64), cap)
    return np.asarray(GAINS, dtype=np.float64)[code] / GAINS[-1]


def noise(shape: tuple[int, int], rng: np.random.Generator) -> NDArray[np.complex64]:
    """Draw complex noise in the amplifier's band, unit variance in each part."""
    pings, samples = shape
    white = rng.standard_normal((pings, samples + 3, 2), dtype=np.float32).view(np.complex64)[..., 0]
    pair = white[:, 1:] + np.float32(BAND) * white[:, :-1]
    both = pair[:, 2:] + np.float32(BAND**2) * pair[:, :-2]
    return (both * np.float32(1.0 / np.sqrt(1.0 + BAND**2 + BAND**4 + BAND**6))).astype(np.complex64, copy=False)


@dataclass(frozen=True)
class Sent:
    """What differs from ping to ping of m pings that share their waveforms of g groups.

    Attributes:
        factor: level of each group, complex, (m, g).
        delay: by how much each group comes late, s, (m, g); small against the pulse.
        noise: factor on the receiver's noise, (m,).
        other: what comes from elsewhere, over the threshold at full gain, (m, samples), or (1, samples) for all.
    """

    factor: Complexes
    delay: Floats
    noise: Floats
    other: Complexes

    def __getitem__(self, rows: slice) -> Sent:
        """Return some of the pings."""
        other = self.other if len(self.other) == 1 else self.other[rows]
        return Sent(self.factor[rows], self.delay[rows], self.noise[rows], other)


def voltages(
    waves: list[Waveform], sent: Sent, unit: Unit, setup: Setup, rng: np.random.Generator
) -> tuple[NDArray[np.complex64], int]:
    """Return the amplified waveforms of m pings over the comparator's threshold, (m, k), and their first sample.

    Only the k samples are worked out between the first and the last where the threshold can be reached at all.

    Args:
        waves: one a group, g of them.
        sent: what differs from ping to ping.
        unit: the electronics.
        setup: the gain's cap.
        rng: the noise.
    """
    gain = gain_over_time(setup.gain, len(waves[0].signal))
    signal = np.stack([wave.signal for wave in waves] + [wave.slope for wave in waves]) * gain
    turned = sent.factor * np.exp(-1j * OMEGA * sent.delay)
    weight = np.concatenate([turned, -turned * sent.delay], axis=1)
    hiss = unit.noise * gain
    other = gain * np.abs(sent.other).max(axis=0)
    live = _live(np.abs(weight).max(axis=0) @ np.abs(signal) + other + SIGMAS * sent.noise.max() * hiss)
    total = weight.astype(np.complex64) @ signal[:, live].astype(np.complex64)
    total += noise(total.shape, rng) * (sent.noise[:, None] * hiss[live]).astype(np.float32)
    if sent.other.any():
        total += (sent.other[:, live] * gain[live]).astype(np.complex64)
    return total, live.start


def _live(bound: Floats) -> slice:
    """Return the samples between the first and the last at which an upper bound of the level reaches the threshold."""
    reached = np.flatnonzero(bound >= 1.0)
    return slice(max(int(reached[0]) - 1, 0), int(reached[-1]) + 2) if len(reached) else slice(0, 0)


def crossings(z: NDArray[np.complex64], unit: Unit) -> tuple[NDArray[np.int64], Floats]:
    """Return ping numbers and times of all upward crossings of the threshold, in order, (k,) each.

    Between two samples the level is linear and the phase turns once; a positive peak at or over the threshold is
    preceded by a crossing, a quarter period or less before it.
    """
    trip = 1.0 + 0.5 * unit.hysteresis
    if not z.size:
        return np.empty(0, dtype=np.int64), np.empty(0)
    power = z.real**2 + z.imag**2
    over = power >= trip**2
    over[:, :-1] |= over[:, 1:]
    over[:, -1] = False
    flat = np.flatnonzero(over)
    flat = flat[~_deaf(power.reshape(-1), flat, unit)]
    here, there = z.reshape(-1)[flat].astype(np.complex128), z.reshape(-1)[flat + 1].astype(np.complex128)
    turn = 2.0 * np.pi + np.angle(there * here.conj())
    first = np.mod(0.5 * np.pi - np.angle(here), 2.0 * np.pi) / turn
    part = np.stack([first, first + 2.0 * np.pi / turn], axis=1)
    level = np.abs(here)[:, None] * (1.0 - part) + np.abs(there)[:, None] * part
    row, column = np.nonzero((part < 1.0) & (level >= trip))
    early = np.arccos(trip / level[row, column]) / turn[row]
    ping, sample = np.divmod(flat[row], z.shape[1])
    return ping, (sample + part[row, column] - early) * PERIOD


def _deaf(power: NDArray[np.float32], flat: NDArray[np.int64], unit: Unit) -> NDArray[np.bool_]:
    """Tell which samples lie in the recovery after the amplifier clipped."""
    rail = unit.rail**2
    before = np.arange(1, round(unit.recovery / PERIOD) + 1)
    return (power[np.maximum(flat[:, None] - before, 0)] >= rail).any(axis=1) & (power[flat] < rail)


def loudness(unit: Unit) -> float:
    """Return what an amplitude of 1 (the pressure at 1 m) comes to over the threshold at full gain."""
    return REFERENCE * float(10.0 ** (unit.sensitivity_db / 20.0))
