"""Whether readings move to a beat: a swaying stand, the mains, a fan.

A disturbance of fixed period looks like scatter to any law of single readings. Here residuals, freed of each block's
own mean, are laid on a fine grid of time and transformed at once to all frequencies: what keeps its phase from block to
block adds up, what merely drags on from ping to ping does not. The height of a peak over its neighbourhood is
exponentially distributed where nothing beats, whatever pings of a block share.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.fft import next_fast_len, rfft

from noise.cells import Batch
from noise.discrepancy.locate import Finding, seen_alone
from noise.fit import Stack
from noise.law import Floats

TICK_S = 1e-3  # finest grid of time; logs hold no more
MOST_BINS = 1 << 21
HIGHEST_HZ = 120.0  # the mains' second harmonic; ours
LEAST_PINGS = 40
SEGMENT = 64  # frequencies over which the background is taken, at least
LOWEST_CYCLES = 0.75  # of a block: slower movement is taken out with its mean; ours


@dataclass(frozen=True)
class Rhythm:
    """The strongest beat.

    Attributes:
        period_s: of it; where pings come at regular times, the slowest that fits.
        amplitude_m: how far readings move to either side.
        p_value: that any beat looks as strong by chance, all frequencies counted.
        nats: what knowing it would be worth.
    """

    period_s: float
    amplitude_m: float
    p_value: float
    nats: float

    @property
    def finding(self) -> Finding:
        """The beat as a finding everywhere."""
        return Finding("rhythm", {}, self.amplitude_m, "m", self.p_value, self.nats, ("period", self.period_s))


def rhythm(stack: Stack, batch: Batch, rng: np.random.Generator) -> Rhythm | None:
    """Return the strongest beat of the residuals; None where no time was logged or there are too few pings.

    Args:
        stack: the law, its nuisances fitted.
        batch: readings, whole blocks.
        rng: for randomised PIT values.
    """
    if not batch.timed or len(batch) < LEAST_PINGS:
        return None
    u, law = seen_alone(stack, batch, rng)
    heard = ~np.isnan(u)
    error = np.where(heard, batch.reading.range - law.quantile(0.5), 0.0)
    score = _without_means(np.where(heard, 2.0 * u - 1.0, 0.0), heard, batch)
    return strongest(batch.ping.time, score, _without_means(error, heard, batch), _longest_period(batch))


def _without_means(value: Floats, known: np.ndarray, batch: Batch) -> Floats:
    """Return the values less their block's mean; 0 where they are not known."""
    mean = batch.per_block(np.where(known, value, 0.0)) / np.maximum(batch.per_block(known.astype(np.float64)), 1.0)
    return np.where(known, value - mean[batch.block], 0.0)


def _longest_period(batch: Batch) -> float:
    """Return the longest period that shows inside blocks, s."""
    starts = np.unique(batch.first)
    ends = np.r_[starts[1:], len(batch)] - 1
    lasting = batch.ping.time[ends] - batch.ping.time[starts]
    return float(np.median(lasting[lasting > 0])) / LOWEST_CYCLES if (lasting > 0).any() else 0.0


def strongest(time: Floats, score: Floats, error: Floats, longest_s: float) -> Rhythm | None:
    """Return the strongest beat of scores at given times, s; `error` in m gives its size, (n,) each."""
    since = time - time.min()
    tick = max(TICK_S, float(since.max()) / MOST_BINS)
    if longest_s <= 2.0 * tick:
        return None
    place = np.rint(since / tick).astype(np.int64)
    size = next_fast_len(int(place.max()) + 1, real=True)
    power = np.abs(rfft(np.bincount(place, score, size))) ** 2
    frequency = np.arange(len(power)) / (size * tick)
    open_ = (frequency >= 1.0 / longest_s) & (frequency <= min(HIGHEST_HZ, 0.5 / _lattice(place) / tick))
    if open_.sum() < 2 * SEGMENT:
        return None
    frequency, height = frequency[open_], _over_background(power[open_], size * tick / longest_s)
    top = float(height.max())
    best = float(frequency[int(np.argmax(height))])
    p = float(-np.expm1(len(height) * np.log1p(-np.exp(-top)))) if top < 700 else 0.0
    return Rhythm(1.0 / best, _amplitude(since, error, best), max(p, 1e-300), top)


def _lattice(place: np.ndarray) -> int:
    """Return the step of the lattice that all times lie on, in ticks."""
    return max(int(np.gcd.reduce(place)), 1)


def _over_background(power: Floats, wide: float) -> Floats:
    """Return the spectrum over its local mean, which is taken from medians: a peak does not hide itself."""
    width = int(max(SEGMENT, min(2.0 * wide, len(power) // 4)))
    edges = np.arange(0, len(power) - width // 2, width)
    middle = np.array([np.median(power[k : k + width]) for k in edges]) / np.log(2.0)
    floor = np.interp(np.arange(len(power)), edges + width / 2.0, np.maximum(middle, 1e-12 * power.max() + 1e-300))
    return power / floor


def _amplitude(since: Floats, error: Floats, frequency: float) -> float:
    """Return the amplitude of the wave that fits the errors best, robust to strays, m."""
    size = 4.0 * np.median(np.abs(error[error != 0])) if (error != 0).any() else 1.0
    phase = 2.0 * np.pi * frequency * since
    waves = np.stack([np.sin(phase), np.cos(phase)], axis=1)
    fitted = np.linalg.lstsq(waves, np.clip(error, -size, size), rcond=None)[0]
    return float(np.hypot(*fitted))
