"""Whether a sonar's first reading after a move still leans towards the place before: memory that no single law holds.

Filters, slew limits and hysteresis show here whatever else they do to the scatter. Inside one stay the target stands
still, so its first reading is compared with its later ones: how the target was placed, and what the air is like,
cancel; what is left leans to either side alike unless the sonar remembers.

A median over the last few readings leaves no lean on a coarse register: readings are those of the place before, and
then those of the new one. But it lets go of the place before after so many readings, where a command that is lost now
and then does so at random.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.stats import norm

from acquisition.arrays import Floats
from noise.discrepancy.locate.locate import Finding
from noise.fitting.batch import Batch
from noise.statistics import winsorised

FEWEST = 8  # moves, below which signs say nothing; ours
MANY = 12  # moves, from which on a sum of signed leans is as good as normal, and windows can be told; ours
FEWEST_PINGS = 4  # of a stay, for its later half to tell where readings settle; ours
APART_M = 0.05  # between two places, for the last reading of one to show in the other; ours
DRAWS = 9999  # of what chance does
CUT_OFF = 0.05  # share of stays whose number is not known, above which nothing is told; ours
SURE_P = 1e-3  # below which no law of single readings is believed


@dataclass(frozen=True)
class Transient:
    """How first readings lean towards the place before.

    Attributes:
        moves: number of moves it rests on.
        statistic: studentised sum; positive towards the place before.
        size_m: median lean towards the place before, m.
        p_value: of a lean this strong towards the place before, by chance.
    """

    moves: int
    statistic: float
    size_m: float
    p_value: float

    @property
    def finding(self) -> Finding:
        """It as a finding everywhere."""
        nats = 0.5 * max(self.statistic, 0.0) ** 2
        return Finding("transient", {}, self.size_m, "m", self.p_value, nats)


def transient(batch: Batch) -> Transient | None:
    """Return how first readings after a move lean; None where there are too few moves to tell.

    No law is asked where a reading is expected: one that repeats readings would expect the place before.

    Args:
        batch: readings, whole stays.
    """
    pairs = [_lean(batch, rows) for rows in batch.stationary_rows]
    known = np.array([pair for pair in pairs if pair is not None])
    if len(known) < FEWEST:
        return None
    lean, towards = known.T
    lean = lean - np.median(lean)  # of every first reading, wherever it comes from
    leaning = winsorised(lean, batch.resolution) * np.sign(towards)
    spread = float(np.sqrt((leaning**2).sum()))
    statistic = float(leaning.sum()) / spread if spread > 0 else 0.0
    p = float(norm.sf(statistic)) if len(known) >= MANY else _by_flips(leaning)
    return Transient(len(known), statistic, float(np.median(leaning)), p)


def _by_flips(leaning: Floats) -> float:
    """Return the share of all ways to give leans their signs that lean as much: exact, however few they are."""
    signs = np.array(list(product((1.0, -1.0), repeat=len(leaning))))
    return float(np.mean(signs @ np.abs(leaning) >= leaning.sum() - 1e-9))


def _lean(batch: Batch, rows: np.ndarray) -> tuple[float, float] | None:
    """Return first reading less the later ones, and how far off the place before was, m; None where nothing is told.

    A reading that repeats the last one to the digit is a repeat, which the catalogue knows, and no lean.
    """
    first, settled = rows[0], _settled(batch, rows)
    before = batch.last[first, 0]  # whenever it was: a filter keeps it through silence
    repeated = abs(batch.reading.range[first] - before) < 0.5 * batch.resolution
    if len(rows) < FEWEST_PINGS or not batch.reading.echo[first] or repeated:
        return None
    towards = before - settled  # nan where either was not heard
    return (float(batch.reading.range[first] - settled), float(towards)) if abs(towards) >= APART_M else None


def windowed(batch: Batch, rng: np.random.Generator) -> Finding | None:
    """Return whether readings let go of the place before after so many; None where there are too few moves to tell.

    Repeats at random last geometrically. Given their sum every way to share it out among the moves is then as likely,
    and their squares add up to less where each move takes as many. The size is how many a move takes.

    Args:
        batch: readings, whole stays.
        rng: for draws of what chance does.
    """
    left = [_left_behind(batch, rows) for rows in batch.stationary_rows]
    known = np.array([count for count in left if count is not None])
    counts = known[np.isfinite(known)]
    moves, total = len(counts), int(counts.sum())
    # numbers that are cut off agree with each other because they are
    if moves < MANY or total < MANY or len(known) - moves > CUT_OFF * len(known):
        return None
    # geometric numbers whose sum is known are multinomial with shares that are uniform on the simplex
    drawn = rng.multinomial(total, rng.dirichlet(np.ones(moves), DRAWS))
    p = (1.0 + np.sum((drawn**2).sum(axis=1) <= (counts**2).sum())) / (1.0 + DRAWS)
    return Finding("window", {}, total / moves, "1", float(p), -float(np.log(p)))


def _left_behind(batch: Batch, rows: np.ndarray) -> float | None:
    """Return how many first readings of a stay are of the place before; None where that cannot be told.

    Infinite where the earlier half of the stay has no other.
    """
    before, settled = batch.last[rows[0], 0], _settled(batch, rows)
    if len(rows) < 2 * FEWEST_PINGS or not batch.past.echo[rows[0]] or not abs(before - settled) >= 2.0 * APART_M:
        return None
    reading = batch.reading[rows[: len(rows) // 2]]
    old = reading.echo & (np.abs(reading.range - before) < APART_M)
    return float(np.argmin(old)) if not old.all() else np.inf


def _settled(batch: Batch, rows: np.ndarray) -> float:
    """Return where the later half of a stay reads, m; nan where it hears nothing."""
    later = batch.reading[rows[len(rows) // 2 :]]
    return float(np.median(later.range[later.echo])) if later.echo.any() else np.nan
