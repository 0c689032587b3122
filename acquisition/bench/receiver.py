"""The receiver: arrivals become a waveform, the waveform trips a comparator, and what tripped goes into registers.

Waveforms are complex baseband with one sample a carrier period; the voltage is Im[z exp(i 2 pi 40 kHz t)]. A
comparator of one polarity sees one positive peak a period, so which period is first over the threshold, and hence the
slip of half a wavelength between pings, is decided here exactly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from acquisition.bench.air import CARRIER, Floats
from acquisition.bench.scene import Arrivals
from acquisition.bench.setup import Output, Setup
from acquisition.bench.transducer import FINE, PERIOD, Complexes, pulse_phases
from acquisition.bench.unit import Unit

# gain of the analogue stage over the code in register 1 (Devantech SRF08 manual; Linux drivers/iio/proximity/srf08.c)
# fmt: off
GAINS = (
    94, 97, 100, 103, 107, 110, 114, 118, 123, 128, 133, 139, 145, 152, 159, 168,
    177, 187, 199, 212, 227, 245, 265, 288, 317, 352, 395, 450, 524, 626, 777, 1025,
)
# fmt: on
GAIN_STEP = 70e-6  # s a step, from the burst's start
ECHOES = 17
OMEGA = 2.0 * np.pi * CARRIER
# time per unit: 58 us/cm and 148 us/inch, the constants of the family; microseconds are given as they are
PER_UNIT: dict[Output, float] = {"cm": 58e-6, "inch": 148e-6, "us": 1e-6}
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
        level = REFERENCE * 10.0 ** (unit.sensitivity_db / 20.0)
        weight = level * loss * arrivals.amplitude * np.exp(-1j * OMEGA * delay)
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

    A delay lies between two fine steps and is shared linearly between them. The fine steps of one period are a
    row of `rows`; each row's sum of pulses begins one sample after the row before it.
    """
    out = np.zeros(samples, dtype=np.complex128)
    keep = delay < (samples - 1) * PERIOD
    if not keep.any():
        return out
    position = delay[keep] / (PERIOD / FINE)
    index = np.floor(position).astype(np.int64)
    share = position - index
    first = int(index.min()) // FINE
    count = int(index.max() + 1) // FINE - first + 1
    grid = np.zeros(count * FINE, dtype=np.complex128)
    for shift, part in ((0, 1.0 - share), (1, share)):
        grid += _histogram(index - first * FINE + shift, weight[keep] * part, count * FINE)
    rows = grid.reshape(count, FINE) @ phases
    span = rows.shape[1] + count
    staggered = np.zeros((count, span), dtype=np.complex128)
    staggered[:, : rows.shape[1]] = rows
    total = staggered.reshape(-1)[: count * (span - 1)].reshape(count, span - 1).sum(axis=0)
    stop = min(samples, first + span - 1)
    out[first:stop] = total[: stop - first]
    return out


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


def voltages(
    waves: list[Waveform], factor: Complexes, delay: Floats, unit: Unit, setup: Setup, rng: np.random.Generator
) -> NDArray[np.complex64]:
    """Return the amplified waveforms of m pings, (m, samples), over the comparator's threshold.

    Args:
        waves: one a group, g of them.
        factor: level of each group in each ping, complex, (m, g).
        delay: by how much each group comes late in each ping, s, (m, g); small against the pulse.
        unit: the electronics.
        setup: the gain's cap.
        rng: the noise.
    """
    samples = len(waves[0].signal)
    gain = gain_over_time(setup.gain, samples)
    signal = np.stack([wave.signal for wave in waves] + [wave.slope for wave in waves]) * gain
    turned = factor * np.exp(-1j * OMEGA * delay)
    weight = np.concatenate([turned, -turned * delay], axis=1).astype(np.complex64)
    total = weight @ signal.astype(np.complex64)
    total += noise(total.shape, rng) * (unit.noise * gain).astype(np.float32)
    return total


def crossings(z: NDArray[np.complex64], unit: Unit) -> tuple[NDArray[np.int64], Floats]:
    """Return ping numbers and times of all upward crossings of the threshold, in order, (k,) each.

    Between two samples the level is linear and the phase turns once; a positive peak at or over the threshold is
    preceded by a crossing, a quarter period or less before it.
    """
    trip = 1.0 + 0.5 * unit.hysteresis
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


def first_echoes(ping: NDArray[np.int64], time: Floats, count: int, unit: Unit, listening: float) -> Floats:
    """Return the times of up to 17 echoes of each of `count` pings, s, (count, 17); NaN where there is none.

    Nothing counts before the blanking ends, within the dead time after an echo, or after listening ends.
    """
    stride = 1.0  # s: longer than any waveform
    key = ping * stride + time
    rows = np.arange(count)
    earliest = np.full(count, unit.blanking)
    out = np.full((count, ECHOES), np.nan)
    for k in range(ECHOES):
        at = np.searchsorted(key, rows * stride + earliest)
        found = at < len(key)
        found[found] = (ping[at[found]] == rows[found]) & (time[at[found]] <= listening)
        rows, at = rows[found], at[found]
        if not len(rows):
            break
        out[rows, k] = time[at]
        earliest = time[at] + unit.rearm
    return out


def to_codes(time: Floats, unit: Unit, output: Output) -> NDArray[np.uint16]:
    """Return what the firmware writes into its registers for times in s; 0 for none."""
    ticks = np.floor(np.maximum(time + unit.t_offset, 0.0) * (1.0 + unit.clock_error) / unit.tick)
    value = ticks * unit.tick / PER_UNIT[output]
    whole = np.rint(value) if unit.rounding == "nearest" else np.floor(value + 1e-9)
    return np.where(np.isnan(time), 0.0, np.clip(whole, 1.0, 65_535.0)).astype(np.uint16)
