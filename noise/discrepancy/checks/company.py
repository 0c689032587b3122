"""Whether something else than the target answers, now here, now there: furniture that moves, somebody who walks by.

Single readings that stray look the same whatever makes them. Inside one stay, though, a faulty reading strays by
itself, while a thing in the room answers from one place as long as the stay lasts. So the first two strays of each
stay are compared: how often they agree, against how often the law says they would. What the law holds (clutter at its
place, a reading that is repeated, a stuck register) agrees with good reason and counts for nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import binom, poisson

from noise.discrepancy.locate.locate import Finding
from noise.fitting.batch import Batch
from noise.fitting.stack import Stack
from noise.law import EchoLaw, Floats

AGREE_M = 0.02  # strays of one stay this near to each other come from one thing; ours
RARE = 1e-3  # chance of a stray anywhere that every law allows; ours
FEWEST = 8  # stays with strays, below which nothing is told; ours
USUAL = 0.01  # share of stays in which this happens to any simulation; ours
HALF = 0.5  # of the stays that agree: a law that foresees fewer has left something out; ours


@dataclass(frozen=True)
class Company:
    """Strays of one stay that agree with each other.

    Attributes:
        n_visits: stays in all.
        told: stays with two strays or more.
        agree: of these, stays in which the first two agree.
        foreseen: number of stays in which they would by the law.
        nats: what the agreement is worth.
    """

    n_visits: int
    told: int
    agree: int
    foreseen: float
    nats: float

    @property
    def usual(self) -> float:
        """Share of stays in which strays agree though no law says so; Laplace's, so never nothing."""
        return (max(self.agree - self.foreseen, 0.0) + 1.0) / (self.n_visits + 2.0)

    def p_value(self, usual: float) -> float:
        """Return the chance that as many stays agree, where beside the law a share `usual` of them does.

        It is 1 where too few stays have strays, or the law foresees most of what agrees: then nothing is left out.
        """
        if self.told < FEWEST or self.foreseen >= HALF * self.agree:
            return 1.0
        by_law = np.arange(self.told + 1)
        more = poisson.sf(self.agree - by_law - 1, self.n_visits * usual)
        return float(binom.pmf(by_law, self.told, self.foreseen / self.told) @ more)

    def finding(self, usual: float) -> Finding:
        """Return it as a finding everywhere; its size is the share of stays in which something else answers."""
        share = (self.agree - self.foreseen) / max(self.n_visits, 1)
        return Finding("company", {}, share, "1", self.p_value(usual), self.nats)


def company(stack: Stack, batch: Batch) -> Company:
    """Return how strays of one stay agree.

    Args:
        stack: the law of single readings.
        batch: readings, whole stays.
    """
    middle = stack.expected(batch)
    away = batch.is_outlier(batch.reading.range - middle)
    if stack.model.remembers:  # a law that repeats readings repeats them to the digit: those are its own
        away &= ~batch.repeats
    first, second = _pairs(batch, away)
    if not len(first):
        return Company(batch.n_visits, 0, 0, 0.0, 0.0)
    chance = _chance(stack, batch, second, middle[second], batch.reading.range[first])
    agree = np.abs(batch.reading.range[first] - batch.reading.range[second]) < AGREE_M
    nats = float(-np.log(chance[agree]).sum())
    return Company(batch.n_visits, len(first), int(agree.sum()), float(chance.sum()), nats)


def chance_astray(law: EchoLaw, middle: Floats, near: Floats) -> Floats:
    """Return the chance of an echo farther than `near` from the `middle`, m, (n,) each."""
    return law.echo - (law.cdf(middle + near) - law.cdf(np.maximum(middle - near, 0.0)))


def _pairs(batch: Batch, away: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return rows of the first and of the second stray of every stay that has two."""
    rows = np.flatnonzero(away)
    begins = np.flatnonzero(np.diff(batch.visit[rows], prepend=-1))
    two = begins[np.append(np.diff(begins), len(rows) - begins[-1]) > 1] if len(begins) else begins
    return rows[two], rows[two + 1]


def _chance(stack: Stack, batch: Batch, second: np.ndarray, middle: Floats, place: Floats) -> Floats:
    """Return the law's chance that the second stray lies where the first did, given that it strays, (stays,)."""
    law = stack.model.law(batch.ping[second], batch.past[second])
    near = batch.reach[second]
    there = law.cdf(place + AGREE_M) - law.cdf(np.maximum(place - AGREE_M, 0.0))
    strays = chance_astray(law, middle, near)
    if stack.model.remembers:
        step = law.step(batch.past.range[second])
        repeated = np.where(batch.past.echo[second], law.between(law.edge(step - 1), law.edge(step)), 0.0)
        there, strays = there - repeated, strays - repeated
    floor = RARE * 2.0 * AGREE_M / law.max_range
    return np.clip((np.maximum(there, 0.0) + floor) / (np.maximum(strays, 0.0) + RARE), floor, 1.0)
