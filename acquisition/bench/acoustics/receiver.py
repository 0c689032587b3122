"""The receiver: arrivals become waveforms, and waveforms trip a comparator.

Waveforms are complex baseband with one sample a carrier period; the voltage is Im[z exp(i 2 pi 40 kHz t)]. A
comparator of one polarity sees one positive peak a period, so which period is first over the threshold, and hence the
slip of half a wavelength between pings, is decided here exactly.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from acquisition.bench.acoustics.air import Floats
from acquisition.bench.acoustics.arrivals import Complexes, Integers
from acquisition.bench.acoustics.transducer import FINE, OMEGA, PERIOD, pulse_phases, spectra
from acquisition.bench.setup import Setup
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
LEAD = 1  # periods before the burst's start that a waveform begins with: a cubic needs a step on each side


@dataclass(frozen=True)
class Pulses:
    """Echoes to be summed up, each a pulse at a delay with a complex weight.

    Attributes:
        row: of the waveform that each belongs to, (k,).
        delay: s, (k,); those that began before the waveform have negative ones.
        weight: over the comparator's threshold at full gain, the carrier's phase not yet in it, (k,).
    """

    row: Integers
    delay: Floats
    weight: Complexes

    @classmethod
    def joined(cls, parts: list[Pulses]) -> Pulses:
        """Return all parts as one."""
        row, delay, weight = ([getattr(part, name) for part in parts] for name in ("row", "delay", "weight"))
        return cls(np.concatenate(row), np.concatenate(delay), np.concatenate(weight))


def waveforms(unit: Unit, temperature_c: Floats, pulses: Pulses, samples: int) -> Complexes:
    """Return the sums of pulses at whole periods, (rows, samples), the carrier's phase in them.

    Args:
        unit: whose pulse it is.
        temperature_c: of each row, (rows,); resonances follow it.
        pulses: what arrives; those that begin after the waveform, or have died before it, are left out.
        samples: of each waveform.
    """
    early = pulse_phases(unit, 20.0).shape[1] if len(pulses.delay) and pulses.delay.min() < 0.0 else 0
    lead = LEAD + early
    position = pulses.delay / (PERIOD / FINE) + lead * FINE
    keep = (position >= 1.0) & (position < (lead + samples) * FINE - 2)
    size = _fast_length(lead + samples + pulse_phases(unit, 20.0).shape[1])
    grid = _gathered(pulses, position, keep, len(temperature_c), size)
    degree = np.rint(temperature_c).astype(np.int64)
    out = np.empty((len(degree), samples), dtype=np.complex128)
    for value in np.unique(degree):
        same = degree == value
        spectrum = (np.fft.fft(grid[same], axis=2) * spectra(unit, float(value), size)).sum(axis=1)
        out[same] = np.fft.ifft(spectrum, axis=1)[:, lead : lead + samples]
    return out


def _gathered(pulses: Pulses, position: Floats, keep: NDArray[np.bool_], rows: int, size: int) -> Complexes:
    """Return the pulses' weights on a grid of delays, (rows, FINE, size), each shared among four steps by a cubic."""
    row, place, weight = pulses.row[keep], position[keep], pulses.weight[keep]
    phase = OMEGA * pulses.delay[keep]
    weight = weight * (np.cos(phase) - 1j * np.sin(phase))
    step = place.astype(np.int64)
    u = place - step
    down, up, below = 1.0 - u, 1.0 + u, 2.0 - u
    cubic = np.stack([-u * down * below, 3.0 * up * down * below, 3.0 * up * u * below, -up * u * down]) / 6.0
    at = step + np.array([[-1], [0], [1], [2]])
    index = (at % FINE * size + at // FINE + row * (FINE * size)).ravel()
    total = rows * FINE * size
    gathered = np.empty(total, dtype=np.complex128)
    gathered.real = np.bincount(index, (cubic * weight.real).ravel(), total)
    gathered.imag = np.bincount(index, (cubic * weight.imag).ravel(), total)
    return gathered.reshape(rows, FINE, size)


@lru_cache(maxsize=64)
def _fast_length(least: int) -> int:
    """Return the smallest length of at least that many samples whose Fourier transform is fast."""
    sizes = [2**a * 3**b * 5**c for a in range(4, 16) for b in range(5) for c in range(3)]
    return min(size for size in sizes if size >= least)


def gain_over_time(cap: int, samples: int) -> Floats:
    """Return the amplifier's gain over its greatest, one value a period: a step every 70 us up to the cap."""
    code = np.minimum((np.arange(samples) * PERIOD / GAIN_STEP + 1e-9).astype(np.int64), cap)
    return np.asarray(GAINS, dtype=np.float64)[code] / GAINS[-1]


def amplification(unit: Unit, setup: Setup, samples: int) -> Floats:
    """Return the gain over the greatest one, against the comparator's threshold as that recovers from the burst."""
    sag = unit.sag * np.exp(-np.arange(samples) * PERIOD / unit.sag_tau_s)
    return gain_over_time(setup.gain, samples) / np.maximum(1.0 - sag, 0.01)


def noise(shape: tuple[int, int], rng: np.random.Generator) -> NDArray[np.complex64]:
    """Draw complex noise in the amplifier's band, unit variance in each part."""
    pings, samples = shape
    white = rng.standard_normal((pings, samples + 3, 2), dtype=np.float32).view(np.complex64)[..., 0]
    pair = white[:, 1:] + np.float32(BAND) * white[:, :-1]
    both = pair[:, 2:] + np.float32(BAND**2) * pair[:, :-2]
    return (both * np.float32(1.0 / np.sqrt(1.0 + BAND**2 + BAND**4 + BAND**6))).astype(np.complex64, copy=False)


@dataclass(frozen=True)
class Mixture:
    """m pings that share v waveforms, each with a level and a small delay of its own.

    Attributes:
        voice: the waveforms, (v, samples).
        factor: level of each in each ping, (m, v).
        late: by how much each comes late, s, (m, v); small against the pulse.
    """

    voice: Complexes
    factor: Floats
    late: Floats

    @cached_property
    def slope(self) -> Complexes:
        """Change of the waveforms with time, 1/s, (v, samples)."""
        return np.gradient(self.voice, PERIOD, axis=1)

    def bound(self) -> Floats:
        """Return what no ping exceeds, (samples,)."""
        moved = np.abs(self.factor * self.late).max(axis=0)
        return self.factor.max(axis=0) @ np.abs(self.voice) + moved @ np.abs(self.slope)

    def summed(self, live: slice) -> NDArray[np.complex64]:
        """Return each ping's waveform at some samples, (m, k)."""
        phase = OMEGA * self.late
        turned = self.factor * (np.cos(phase) - 1j * np.sin(phase))
        both = np.concatenate([self.voice[:, live], self.slope[:, live]])
        return np.concatenate([turned, -turned * self.late], axis=1).astype(np.complex64) @ both.astype(np.complex64)


@dataclass(frozen=True)
class Alone:
    """m pings with a waveform of its own each, (m, samples)."""

    wave: Complexes

    def bound(self) -> Floats:
        """Return what no ping exceeds, (samples,)."""
        return np.abs(self.wave).max(axis=0)

    def summed(self, live: slice) -> NDArray[np.complex64]:
        """Return each ping's waveform at some samples, (m, k)."""
        return self.wave[:, live].astype(np.complex64)


def voltages(
    waves: list[Mixture | Alone], hiss: Floats, gain: Floats, threshold: Floats | None, rng: np.random.Generator
) -> tuple[NDArray[np.complex64], int]:
    """Return the amplified waveforms of m pings over the comparator's threshold, (m, k), and their first sample.

    Only the k samples are worked out between the first and the last where the threshold can be reached at all.

    Args:
        waves: to be added up.
        hiss: rms of the noise at full gain over the threshold, (m,).
        gain: from `amplification`, (samples,).
        threshold: over its usual value, (m, samples), or None where it is that.
        rng: the noise.
    """
    bound = gain * (sum(wave.bound() for wave in waves) + SIGMAS * hiss.max())
    live = _live(bound if threshold is None else bound / threshold.min(axis=0))
    total = np.asarray(sum(wave.summed(live) for wave in waves))
    total += noise(total.shape, rng) * hiss[:, None].astype(np.float32)
    total *= gain[live].astype(np.float32)
    if threshold is not None:
        total /= threshold[:, live].astype(np.float32)
    return total, live.start


def _live(bound: Floats) -> slice:
    """Return the samples between the first and the last at which an upper bound of the level reaches the threshold."""
    reached = np.flatnonzero(bound >= 1.0)
    return slice(max(int(reached[0]) - 1, 0), int(reached[-1]) + 2) if len(reached) else slice(0, 0)


def crossings(z: NDArray[np.complex64], unit: Unit) -> tuple[NDArray[np.int64], Floats]:
    """Return ping numbers and times of all upward crossings of the threshold, in order, (k,) each.

    Between two samples the level's root is linear, as at the onset of a burst through two resonators, and the phase
    turns once; a positive peak at or over the threshold is preceded by a crossing, a quarter period or less before it.
    """
    trip = 1.0 + 0.5 * unit.hysteresis
    if not z.size:
        return np.empty(0, dtype=np.int64), np.empty(0)
    power = z.real**2 + z.imag**2
    over = power >= trip**2
    over[:, :-1] |= over[:, 1:]
    over[:, -1] = False
    flat = np.flatnonzero(over)
    flat = flat[~_deaf(power, flat, unit)]
    here, there = z.reshape(-1)[flat].astype(np.complex128), z.reshape(-1)[flat + 1].astype(np.complex128)
    turn = 2.0 * np.pi + np.angle(there * here.conj())
    first = np.mod(0.5 * np.pi - np.angle(here), 2.0 * np.pi) / turn
    part = np.stack([first, first + 2.0 * np.pi / turn], axis=1)
    level = (np.sqrt(np.abs(here))[:, None] * (1.0 - part) + np.sqrt(np.abs(there))[:, None] * part) ** 2
    row, column = np.nonzero((part < 1.0) & (level >= trip))
    early = np.arccos(trip / level[row, column]) / turn[row]
    ping, sample = np.divmod(flat[row], z.shape[1])
    return ping, (sample + part[row, column] - early) * PERIOD


def _deaf(power: NDArray[np.float32], flat: NDArray[np.int64], unit: Unit) -> NDArray[np.bool_]:
    """Tell which samples lie in the recovery after the amplifier clipped."""
    ping, sample = np.divmod(flat, power.shape[1])
    before = sample[:, None] - np.arange(1, round(unit.recovery / PERIOD) + 1)
    clipped = power >= unit.rail**2
    return (clipped[ping[:, None], np.maximum(before, 0)] & (before >= 0)).any(axis=1) & ~clipped[ping, sample]
