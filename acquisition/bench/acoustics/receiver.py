"""Receiver: waveforms of arrivals and the crossings of a comparator's threshold.

Waveforms are complex baseband with one sample per carrier period; the voltage is Im[z exp(i 2 pi 40 kHz t)]. A
unipolar comparator sees one positive peak per period, so the first period over the threshold, and hence the slip of
half a wavelength between pings, follows exactly.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from acquisition.arrays import Floats, Ints
from acquisition.bench.acoustics.arrivals import Complexes
from acquisition.bench.acoustics.transducer import OMEGA, OVERSAMPLING, PERIOD, pulse_phases, spectra
from acquisition.bench.laboratory.setup import Setup
from acquisition.bench.laboratory.unit import Unit

# gain of the analogue stage by the code in register 1 (Devantech SRF08 manual; Linux drivers/iio/proximity/srf08.c)
# fmt: off
GAINS = (
    94, 97, 100, 103, 107, 110, 114, 118, 123, 128, 133, 139, 145, 152, 159, 168,
    177, 187, 199, 212, 227, 245, 265, 288, 317, 352, 395, 450, 524, 626, 777, 1025,
)
# fmt: on
NOISE_BOUND_SIGMAS = 7.0  # bound of the noise: exceeded with probability exp(-7^2/2) = 2e-11 per sample
BAND_DECAY = float(np.exp(-np.pi * 10e3 * PERIOD))  # per sample, of the amplifier's band-pass, Q = 4 at 40 kHz
LEAD = 1  # periods before the start of the burst, as cubic interpolation needs a step on each side


@dataclass(frozen=True)
class Pulses:
    """Echoes to be summed, each a pulse with a delay and a complex weight.

    Attributes:
        row: index of the waveform, (k,).
        delay: s, (k,); negative for pulses that began before the waveform.
        weight: relative to the comparator's threshold at full gain, without the carrier's phase, (k,).
    """

    row: Ints
    delay: Floats
    weight: Complexes

    @classmethod
    def joined(cls, parts: list[Pulses]) -> Pulses:
        """Concatenate several sets of pulses."""
        row, delay, weight = ([getattr(part, name) for part in parts] for name in ("row", "delay", "weight"))
        return cls(np.concatenate(row), np.concatenate(delay), np.concatenate(weight))


def waveforms(unit: Unit, temperature_c: Floats, pulses: Pulses, samples: int) -> Complexes:
    """Return the sums of pulses, one sample per carrier period, including the carrier's phase, (rows, samples).

    Args:
        unit: sensor whose pulse shape is used.
        temperature_c: of each row, (rows,); it shifts the resonances.
        pulses: what arrives; pulses outside the waveform are ignored.
        samples: number of samples per waveform.
    """
    early = pulse_phases(unit, 20.0).shape[1] if len(pulses.delay) and pulses.delay.min() < 0.0 else 0
    lead = LEAD + early
    position = pulses.delay / (PERIOD / OVERSAMPLING) + lead * OVERSAMPLING
    keep = (position >= 1.0) & (position < (lead + samples) * OVERSAMPLING - 2)
    size = _fast_length(lead + samples + pulse_phases(unit, 20.0).shape[1])
    grid = _on_grid(pulses, position, keep, len(temperature_c), size)
    degree = np.rint(temperature_c).astype(np.int64)
    out = np.empty((len(degree), samples), dtype=np.complex128)
    for value in np.unique(degree):
        same = degree == value
        spectrum = (np.fft.fft(grid[same], axis=2) * spectra(unit, float(value), size)).sum(axis=1)
        out[same] = np.fft.ifft(spectrum, axis=1)[:, lead : lead + samples]
    return out


def _on_grid(pulses: Pulses, position: Floats, keep: NDArray[np.bool_], rows: int, size: int) -> Complexes:
    """Return the weights on a grid of delays, (rows, OVERSAMPLING, size), by cubic interpolation over four steps."""
    row, place, weight = pulses.row[keep], position[keep], pulses.weight[keep]
    phase = OMEGA * pulses.delay[keep]
    weight = weight * (np.cos(phase) - 1j * np.sin(phase))
    step = place.astype(np.int64)
    u = place - step
    down, up, below = 1.0 - u, 1.0 + u, 2.0 - u
    cubic = np.stack([-u * down * below, 3.0 * up * down * below, 3.0 * up * u * below, -up * u * down]) / 6.0
    at = step + np.array([[-1], [0], [1], [2]])
    index = (at % OVERSAMPLING * size + at // OVERSAMPLING + row * (OVERSAMPLING * size)).ravel()
    total = rows * OVERSAMPLING * size
    grid = np.empty(total, dtype=np.complex128)
    grid.real = np.bincount(index, (cubic * weight.real).ravel(), total)
    grid.imag = np.bincount(index, (cubic * weight.imag).ravel(), total)
    return grid.reshape(rows, OVERSAMPLING, size)


@lru_cache(maxsize=64)
def _fast_length(min_samples: int) -> int:
    """Return the smallest length of at least `min_samples` with a fast Fourier transform."""
    sizes = [2**a * 3**b * 5**c for a in range(4, 16) for b in range(5) for c in range(3)]
    return min(size for size in sizes if size >= min_samples)


def gain_over_time(cap: int, samples: int, step: float = 70e-6) -> Floats:
    """Return the amplifier's gain relative to its maximum, per period: one code every `step`, s, up to the cap."""
    code = np.full(samples, cap)
    if step > 0.0:
        code = np.minimum((np.arange(samples) * PERIOD / step + 1e-9).astype(np.int64), cap)
    return np.asarray(GAINS, dtype=np.float64)[code] / GAINS[-1]


def amplification(unit: Unit, setup: Setup, samples: int) -> Floats:
    """Return the relative gain divided by the comparator's threshold, which recovers from the burst, (samples,)."""
    sag = unit.sag * np.exp(-np.arange(samples) * PERIOD / unit.sag_tau_s)
    return gain_over_time(setup.gain, samples, unit.gain_step_s) / np.maximum(1.0 - sag, 0.01)


def noise(shape: tuple[int, int], rng: np.random.Generator) -> NDArray[np.complex64]:
    """Draw complex noise in the amplifier's band, unit variance in each part."""
    pings, samples = shape
    white = rng.standard_normal((pings, samples + 3, 2), dtype=np.float32).view(np.complex64)[..., 0]
    pair = white[:, 1:] + np.float32(BAND_DECAY) * white[:, :-1]
    both = pair[:, 2:] + np.float32(BAND_DECAY**2) * pair[:, :-2]
    return (both * np.float32(1.0 / np.sqrt(1.0 + BAND_DECAY**2 + BAND_DECAY**4 + BAND_DECAY**6))).astype(
        np.complex64, copy=False
    )


@dataclass(frozen=True)
class SharedWaveforms:
    """Waveforms of m pings as mixtures of c common components, each with its own level and small delay per ping.

    Attributes:
        component: common waveforms, (c, samples).
        level: factor of each component in each ping, (m, c).
        delay: extra delay, s, (m, c); small relative to the pulse.
    """

    component: Complexes
    level: Floats
    delay: Floats

    @cached_property
    def slope(self) -> Complexes:
        """Time derivative of the components, 1/s, (c, samples)."""
        return np.gradient(self.component, PERIOD, axis=1)

    def bound(self) -> Floats:
        """Return an upper bound of the level over all pings, (samples,)."""
        moved = np.abs(self.level * self.delay).max(axis=0)
        return self.level.max(axis=0) @ np.abs(self.component) + moved @ np.abs(self.slope)

    def total(self, active: slice) -> NDArray[np.complex64]:
        """Return each ping's waveform at the active samples, (m, k)."""
        phase = OMEGA * self.delay
        turned = self.level * (np.cos(phase) - 1j * np.sin(phase))
        both = np.concatenate([self.component[:, active], self.slope[:, active]])
        return np.concatenate([turned, -turned * self.delay], axis=1).astype(np.complex64) @ both.astype(np.complex64)


@dataclass(frozen=True)
class SeparateWaveforms:
    """Waveforms of m pings, one each, (m, samples)."""

    wave: Complexes

    def bound(self) -> Floats:
        """Return an upper bound of the level over all pings, (samples,)."""
        return np.abs(self.wave).max(axis=0)

    def total(self, active: slice) -> NDArray[np.complex64]:
        """Return each ping's waveform at the active samples, (m, k)."""
        return self.wave[:, active].astype(np.complex64)


def voltages(
    waves: list[SharedWaveforms | SeparateWaveforms],
    noise_rms: Floats,
    gain: Floats,
    threshold: Floats | None,
    rng: np.random.Generator,
) -> tuple[NDArray[np.complex64], int]:
    """Return the amplified waveforms of m pings relative to the threshold, (m, k), and the index of their first sample.

    Only the k samples between the first and the last at which the threshold can be reached are computed.

    Args:
        waves: terms of the sum.
        noise_rms: rms of the noise at full gain relative to the threshold, (m,).
        gain: from `amplification`, (samples,).
        threshold: relative to its nominal value, (m, samples), or None for the nominal value.
        rng: source of the noise.
    """
    bound = gain * (sum(wave.bound() for wave in waves) + NOISE_BOUND_SIGMAS * noise_rms.max())
    active = _active_samples(bound if threshold is None else bound / threshold.min(axis=0))
    total = np.asarray(sum(wave.total(active) for wave in waves))
    total += noise(total.shape, rng) * noise_rms[:, None].astype(np.float32)
    total *= gain[active].astype(np.float32)
    if threshold is not None:
        total /= threshold[:, active].astype(np.float32)
    return total, active.start


def _active_samples(bound: Floats) -> slice:
    """Return the samples between the first and the last at which an upper bound of the level reaches the threshold."""
    reached = np.flatnonzero(bound >= 1.0)
    return slice(max(int(reached[0]) - 1, 0), int(reached[-1]) + 2) if len(reached) else slice(0, 0)


def crossings(z: NDArray[np.complex64], unit: Unit) -> tuple[NDArray[np.int64], Floats]:
    """Return ping indices and times, s, of all upward threshold crossings, in order, (k,) each.

    Between two samples the root of the level is linear, as at the onset of a burst through two resonators, and the
    phase advances by a turn; a positive peak at or over the threshold follows a crossing within a quarter period.
    """
    trip = 1.0 + 0.5 * unit.hysteresis
    if not z.size:
        return np.empty(0, dtype=np.int64), np.empty(0)
    power = z.real**2 + z.imag**2
    over = power >= trip**2
    over[:, :-1] |= over[:, 1:]
    over[:, -1] = False
    flat = np.flatnonzero(over)
    flat = flat[~_in_recovery(power, flat, unit)]
    here, there = z.reshape(-1)[flat].astype(np.complex128), z.reshape(-1)[flat + 1].astype(np.complex128)
    turn = 2.0 * np.pi + np.angle(there * here.conj())
    first = np.mod(0.5 * np.pi - np.angle(here), 2.0 * np.pi) / turn
    part = np.stack([first, first + 2.0 * np.pi / turn], axis=1)
    level = (np.sqrt(np.abs(here))[:, None] * (1.0 - part) + np.sqrt(np.abs(there))[:, None] * part) ** 2
    row, column = np.nonzero((part < 1.0) & (level >= trip))
    early = np.arccos(trip / level[row, column]) / turn[row]
    ping, sample = np.divmod(flat[row], z.shape[1])
    return ping, (sample + part[row, column] - early) * PERIOD


def _in_recovery(power: NDArray[np.float32], flat: NDArray[np.int64], unit: Unit) -> NDArray[np.bool_]:
    """Return which samples lie in the amplifier's recovery after clipping."""
    ping, sample = np.divmod(flat, power.shape[1])
    before = sample[:, None] - np.arange(1, round(unit.recovery / PERIOD) + 1)
    clipped = power >= unit.rail**2
    return (clipped[ping[:, None], np.maximum(before, 0)] & (before >= 0)).any(axis=1) & ~clipped[ping, sample]
