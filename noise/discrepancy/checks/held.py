"""Whether readings hold on to the place before: hysteresis, a dead band, play in a rail, which no single law holds.

A dead band shows twice. While the target stays, readings that scatter in the simulation do not change by a digit; and
after a short move they are still, to the digit, those of the place before. Play shows in where whole stays lie: on
the side that the target came from.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import binom, poisson, t

from acquisition.arrays import Floats
from noise.discrepancy.checks.smooth import lying
from noise.discrepancy.locate.locate import Finding
from noise.fitting.batch import Batch
from noise.fitting.stack import Stack
from noise.statistics import winsorised

FEWEST_PINGS = 5  # echoes of a stay, for it to show whether readings change; ours
FEWEST_STAYS = 12  # that show it, below which nothing is told; ours
STILL = 0.95  # share of stays that a dead band leaves without any change; ours
CALMER = 3.0  # ratio of odds of a still stay that another day's air may bring about; nulls of the rig: up to 1.7
MOVED_M = 0.02  # between two places, for a reading to show in the other; ours
FEWEST_KEPT = 3  # stays that give the reading of the place before, below which it is chance; ours
RARE = 1e-3  # chance of that in any stay which every law allows; ours
NEIGHBOURS = 8  # stays nearest in distance: what they were asked after is as good a guess as any of the place before
TERMS = 4  # of the polynomial in distance that is taken off before sides are compared; ours


@dataclass(frozen=True)
class Still:
    """How many stays show no change at all.

    Attributes:
        n_visits: those with enough echoes to show one.
        still: those of them whose echoes are alike to the digit.
    """

    n_visits: int
    still: int

    def p_value(self, usual: Still | None) -> float:
        """Return the chance of as many still stays, where a simulation's own stays are so often still.

        Args:
            usual: the same of the simulation; None where it is not known by its readings.
        """
        if usual is None or min(self.n_visits, usual.n_visits) < FEWEST_STAYS or self.still < STILL * self.n_visits:
            return 1.0
        odds = CALMER * (usual.still + 1.0) / (usual.n_visits - usual.still + 1.0)
        return float(binom.sf(self.still - 1, self.n_visits, odds / (1.0 + odds)))


def still(batch: Batch, step: float) -> Still:
    """Return how many stays show no change at all on a register of a step, m."""
    stays = [echoes for echoes in _echoes(batch) if len(echoes) >= FEWEST_PINGS]
    return Still(len(stays), sum(bool(np.ptp(np.rint(echoes / step)) == 0.0) for echoes in stays))


def held(stack: Stack, batch: Batch, usual: Still | None) -> Finding:
    """Return the strongest sign that readings hold on to the place before, as a finding everywhere, three looks taken.

    Its size is the share of moves after which the reading is still that of the place before, or the lean of whole
    stays towards it, m.

    Args:
        stack: the law of single readings.
        batch: readings, whole stays.
        usual: how many stays of the simulation are still; None where the law is the simulation.
    """
    share, p_kept = _kept(stack, batch)
    lean, p_lean = _leaning(stack, batch)
    looks = {
        "still": (1.0, still(batch, batch.resolution).p_value(usual)),
        "kept": (share, p_kept),
        "play": (lean, p_lean),
    }
    name = min(looks, key=lambda each: looks[each][1])
    size, p = looks[name]
    p = min(1.0, len(looks) * p)
    return Finding(name, {}, size, "m" if name == "play" else "1", p, -float(np.log(max(p, 1e-300))))


def _echoes(batch: Batch) -> list[Floats]:
    """Return the echoes of every stay, m; none of one in which the target moved."""
    heard = batch.reading.echo & batch.stationary[batch.visit]
    return [batch.reading.range[rows[heard[rows]]] for rows in batch.visit_rows]


def _kept(stack: Stack, batch: Batch) -> tuple[float, float]:
    """Return the share of moves after which the reading stays as it was, and the chance of as many.

    Had the sonar no memory, what was read before a stay could as well have been what was read before another.
    """
    left, stood = batch.last[batch.starts].T
    echoes, distance = _echoes(batch), batch.ping.distance[batch.starts]
    value = np.array([np.median(e) if len(e) >= FEWEST_PINGS and np.ptp(e) == 0.0 else np.nan for e in echoes])
    asked = np.array([len(e) >= FEWEST_PINGS for e in echoes]) & (np.abs(distance - stood) > MOVED_M)
    told = np.flatnonzero(asked & ~np.isnan(value))
    same = np.abs(left[None, :] - value[told, None]) < 0.5 * batch.resolution
    kept = same[np.arange(len(told)), told]
    if kept.sum() < FEWEST_KEPT:
        return 0.0, 1.0
    same[np.arange(len(told)), told] = False
    near = np.argsort(np.abs(distance[None, :] - distance[told, None]), axis=1)[:, 1 : NEIGHBOURS + 1]
    chance = np.maximum(same.mean(axis=1), np.take_along_axis(same, near, axis=1).mean(axis=1))
    law = np.array([stack.get(("stale_repeat", "probability")) ** len(echoes[k]) for k in told])
    expected = float((chance + law + RARE).sum())
    return float(kept.sum() / asked.sum()), float(poisson.sf(kept.sum() - 1, expected))


def _leaning(stack: Stack, batch: Batch) -> tuple[float, float]:
    """Return how far whole stays lie towards the place before, m, and the chance of it.

    What goes with distance is taken off first: near places are mostly come to from farther ones.
    """
    offset = lying(stack, batch)
    distance, stood = batch.ping.distance[batch.starts], batch.last[batch.starts, 1]
    use = ~np.isnan(offset) & (np.abs(stood - distance) > MOVED_M) & batch.stationary
    side = np.sign(stood - distance)[use]
    if len(side) < 3 * FEWEST_STAYS or min((side > 0).sum(), (side < 0).sum()) < FEWEST_STAYS:
        return 0.0, 1.0
    offset = winsorised(offset[use])
    along = np.polynomial.polynomial.polyvander(distance[use] - distance[use].mean(), TERMS - 1)
    offset, side = (y - along @ np.linalg.lstsq(along, y, rcond=None)[0] for y in (offset, side))
    lean = float(offset @ side) / float(side @ side)
    error_of = float(np.sqrt(((offset - lean * side) ** 2 * side**2).sum())) / float(side @ side)
    if error_of == 0.0:
        return lean, 1.0
    return lean, float(t.sf(lean / error_of, len(side) - TERMS - 1))
