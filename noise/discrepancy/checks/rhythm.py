"""Whether readings move to a beat: a swaying stand, the mains, a fan.

A disturbance of fixed period looks like scatter to any law of single readings. Here residuals, freed of each block's
own mean and size, are laid on a fine grid of time and transformed at once to all frequencies. What keeps its phase from
block to block adds up; what merely drags on from ping to ping does not. The power of the sum over the sum of the
blocks' own powers is therefore exponentially distributed where nothing beats, whatever pings of a block share.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.fft import next_fast_len, rfft

from acquisition.arrays import Floats
from noise.discrepancy.locate.locate import Finding
from noise.fitting.batch import Batch
from noise.fitting.stack import Stack

TICK_S = 1e-3  # finest grid of time; logs hold no more
MOST_BINS = 1 << 20
HIGHEST_HZ = 120.0  # the mains' second harmonic; ours
LEAST_PINGS = 40
MOST_IN_BLOCK = 100  # pings of a block that are paired with each other; ours
CANDIDATES = 120  # frequencies near the highest peak that are fitted to tell it from its aliases; ours
ALIKE = 3.0  # nats by which one alias must fit better to be believed; ours
NEARLY = 0.7  # of the highest peak
FAR = 3.0  # usual errors of a block, beyond which one counts no more; ours
LEAST_STEPS = 0.3  # of the register, that any block's errors are taken for: what rounding alone makes; ours
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


def rhythm(stack: Stack, batch: Batch) -> Rhythm | None:
    """Return the strongest beat of the residuals; None where no time was logged or there are too few pings.

    Args:
        stack: the law, of which only where an echo is expected counts: a beat may have made its scatter too wide.
        batch: readings, whole blocks.
    """
    if not batch.timed or len(batch) < LEAST_PINGS:
        return None
    error = batch.reading.range - stack.expected(batch)
    few = batch.is_target(error) & (batch.count < MOST_IN_BLOCK)
    error = _without_means(error, few, batch)
    # every block counts alike, however much its readings scatter
    usual = batch.visit_sums(np.abs(error)) / np.maximum(batch.visit_sums(few.astype(np.float64)), 1.0)
    score = np.clip(error / (usual + LEAST_STEPS * batch.resolution)[batch.visit], -FAR, FAR)
    seen = Beat(batch.ping.time[few], _without_means(score, few, batch)[few], error[few], batch.visit[few])
    return seen.strongest(_longest_period(batch))


def _without_means(value: Floats, known: NDArray[np.bool_], batch: Batch) -> Floats:
    """Return the values less their block's mean; 0 where they are not known."""
    mean = batch.visit_sums(np.where(known, value, 0.0)) / np.maximum(batch.visit_sums(known.astype(np.float64)), 1.0)
    return np.where(known, value - mean[batch.visit], 0.0)


def _longest_period(batch: Batch) -> float:
    """Return the longest period that shows inside blocks, s."""
    ends = np.r_[batch.starts[1:], len(batch)] - 1
    lasting = batch.ping.time[ends] - batch.ping.time[batch.starts]
    return float(np.median(lasting[lasting > 0])) / LOWEST_CYCLES if (lasting > 0).any() else 0.0


@dataclass(frozen=True)
class Beat:
    """Scores at given times, s, errors, m, and the block of each, ascending; none has a mean over its block, (n,)."""

    time: Floats
    score: Floats
    error: Floats
    visit: NDArray[np.int64]

    def strongest(self, longest_s: float) -> Rhythm | None:
        """Return the strongest beat with a period up to `longest_s`."""
        if len(self.time) < LEAST_PINGS:
            return None
        since = self.time - self.time.min()
        tick = max(TICK_S, float(since.max()) / MOST_BINS)
        place = np.rint(since / tick).astype(np.int64)
        size = next_fast_len(2 * int(place.max()) + 2, real=True)  # a beat between two frequencies is lower by 2/10
        frequency = np.arange(size // 2 + 1) / (size * tick)
        # at half the rate of a lattice of times there is no phase to keep
        highest = min(HIGHEST_HZ, 0.5 / _lattice(place) / tick - 1.0 / longest_s) if longest_s > 0 else 0.0
        open_ = (frequency >= 1.0 / max(longest_s, tick)) & (frequency <= highest)
        if not open_.any():
            return None
        power = np.abs(rfft(np.bincount(place, self.score, size)))[open_] ** 2
        own = self._own_power(place, size)[open_]
        height = power / np.maximum(own, 1e-6 * own.max() + 1e-300)
        top = float(height.max())
        p = _by_chance(height, own)
        near = frequency[open_][np.argsort(-np.where(height > NEARLY * top, power, 0.0))[:CANDIDATES]]
        between = np.array([-0.4, -0.2, 0.0, 0.2, 0.4]) / (size * tick)
        best, amplitude, worth = self._fitted((near[:, None] + between).ravel())
        return Rhythm(1.0 / best, amplitude, max(p, 1e-300), max(top, worth))

    def _own_power(self, place: NDArray[np.int64], size: int) -> Floats:
        """Return the sum of the blocks' own powers at every frequency: the transform of lags inside blocks."""
        lagged = np.zeros(size)
        starts = np.searchsorted(self.visit, np.unique(self.visit))
        for at, score in zip(np.split(place, starts[1:]), np.split(self.score, starts[1:]), strict=True):
            lag = np.abs(at[:, None] - at[None, :]) % size
            np.add.at(lagged, lag.ravel(), np.outer(score, score).ravel())
        return np.maximum(rfft(lagged).real, 0.0)

    def _fitted(self, near: Floats) -> tuple[float, float, float]:
        """Return which of some frequencies fits the errors best, Hz, its amplitude, m, and its worth, nats.

        Strays do not count; worth is that of a normal scatter which shrinks by as much as the beat explains.
        """
        size = 4.0 * float(np.median(np.abs(self.error))) + 1e-9
        error = np.clip(self.error, -size, size)
        count = np.bincount(self.visit)[self.visit]
        misfit, amplitude = np.empty(len(near)), np.empty(len(near))
        for k, frequency in enumerate(near):
            phase = 2.0 * np.pi * frequency * self.time
            waves = np.stack([np.sin(phase), np.cos(phase)], axis=1)
            waves -= np.stack([np.bincount(self.visit, w)[self.visit] / count for w in waves.T], axis=1)
            weight = np.linalg.lstsq(waves, error, rcond=None)[0]
            misfit[k], amplitude[k] = ((error - waves @ weight) ** 2).sum(), np.hypot(*weight)
        # aliases that fit as well within chance: the slowest is told
        alike = misfit <= misfit.min() * (1.0 + 2.0 * ALIKE / len(error)) + 1e-15
        best = np.flatnonzero(alike)[np.argmin(np.where(alike, near, np.inf)[alike])]
        worth = 0.5 * len(error) * np.log((error**2).sum() / misfit[best]) if misfit[best] > 0 else 0.0
        return float(near[best]), float(amplitude[best]), float(worth)


def _by_chance(height: Floats, own: Floats) -> float:
    """Return the chance of such heights at any frequency, each given its share of alarms.

    Heights say how far blocks keep their phase, whatever power they have; so one may look first where that power is,
    and frequencies with more of it are given more (a weighted Bonferroni bound).
    """
    if own.max() == 0.0:  # readings that never change
        return 1.0
    log_share = 2.0 * np.log(np.maximum(own, 1e-12 * own.max()))
    log_share -= np.logaddexp.reduce(log_share)
    return float(np.exp(np.clip((-height - log_share).min(), -700.0, 0.0)))


def _lattice(place: NDArray[np.int64]) -> int:
    """Return the step of the lattice that all times lie on, in ticks."""
    return max(int(np.gcd.reduce(place)), 1)
