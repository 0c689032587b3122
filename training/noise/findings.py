"""What is found out about noise models, and which of the aims set for them it reaches."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from acquisition import Recording
from noise import SonarModel, follow
from noise.credence import wilson
from noise.faults import Faulty
from noise.metrics import Score, credence_reliability
from noise.model import steps
from training.noise.compare import ARBITRARY, GAUSSIAN, Compared, place
from training.noise.draw_speed import FEW, LIMITS, MANY, Speed
from training.noise.memory_gain import CORRELATED, UNCORRELATED, Gain
from training.noise.recent_credence import CredenceScore, right

BAYES, ALONE, RECENT = "Bayes over the conditions met", "learned, this reading", "learned, last 8 readings"
WHERE = {"cells": "other conditions, known sensors", "units": "other sensors"}
WAY, GAP_GIVEN_CONDITION, GAP_GIVEN_READINGS, SURE = 0.95, 0.02, 0.05, 1.96


@dataclass(frozen=True)
class Told:
    """How credence given the condition, as a model says it, compares with what was recorded.

    Attributes:
        gap: mean of |said - came true| over bins of what was said.
        off: mean distance from each condition's own share.
        inside: share of conditions whose Wilson interval holds what was said.
    """

    gap: float
    off: float
    inside: float

    @classmethod
    def by(cls, model: SonarModel, test: Recording) -> Told:
        """Compare a model with a recording of which it remembers what came before each ping."""
        cell, true = place(test), right(test.ping, test.reading)
        hits, trials = np.bincount(cell, weights=true), np.bincount(cell)
        low, high = wilson(hits, trials)
        law = follow(model, test.ping, test.reading)
        mean = np.bincount(cell, weights=law.credence()) / trials
        inside = float(((mean >= low) & (mean <= high)).mean())
        return cls(
            credence_reliability(law, test.reading, cell).gap, float(np.abs(mean - hits / trials).mean()), inside
        )


NTH = {"first": (0, 0), "second": (1, 1), "third to sixth": (2, 5), "later": (6, 10_000)}


def by_nth(model: SonarModel, test: Recording) -> dict[str, Score]:
    """Return the log-likelihood of pings, nats, by how many of the same condition were heard before (`NTH`)."""
    cell, nth = place(test), np.empty(len(test), dtype=np.int64)
    for k, which in enumerate(steps(cell)):
        nth[which] = k
    value = follow(Faulty(model, [ARBITRARY]), test.ping, test.reading).log_prob(test.reading)
    rows = {name: (nth >= low) & (nth <= high) & test.reading.answered for name, (low, high) in NTH.items()}
    return {name: Score.of(value[which], cell[which]) for name, which in rows.items()}


@dataclass(frozen=True)
class Findings:
    """All that the page tells.

    Attributes:
        compared: models side by side, by where they were tested (`WHERE`).
        told: credence given the condition, by where and model.
        given: credence given the readings, by where and kind.
        gains: of memory, by world.
        heard: log-likelihood by model and by how many pings of a condition were heard before.
        speeds, paths: of models, and of ways to draw from one.
        shipped: names of the models under test.
    """

    compared: Mapping[str, Compared]
    told: Mapping[str, Mapping[str, Told]]
    given: Mapping[str, Mapping[str, CredenceScore]]
    gains: Mapping[str, Gain]
    heard: Mapping[str, Mapping[str, Score]]
    speeds: Mapping[str, Speed]
    paths: Mapping[str, Speed]
    shipped: tuple[str, ...]


@dataclass(frozen=True)
class Aim:
    """One aim: what was wanted, what came of it, and whether that is enough."""

    wanted: str
    came: str
    met: bool

    @property
    def row(self) -> str:
        """A row of a table in Markdown."""
        return f"| {self.wanted} | {self.came} | {'yes' if self.met else '**no**'} |"


def aims(found: Findings) -> list[Aim]:
    """Return every aim with what came of it."""
    return [
        *(aim for where in WHERE for aim in _likelihood(found, where)),
        *(_told(found, where) for where in WHERE),
        *(_given(found, where) for where in WHERE),
        *(_gain(found, name) for name in found.gains if name in (*CORRELATED, *UNCORRELATED)),
        *(_fast(found, n) for n in LIMITS),
    ]


def _likelihood(found: Findings, where: str) -> list[Aim]:
    one = found.compared[where]
    rivals = {k: s.log_likelihood.mean for k, s in one.scores.items() if k not in found.shipped}
    top, own = max(rivals, key=lambda k: rivals[k]), {k: one.scores[k].log_likelihood.mean for k in found.shipped}
    below = [name for name, value in own.items() if value <= rivals[top]]
    beaten = f"all above {top} ({rivals[top]:.2f})" if not below else f"{', '.join(below)} below {top}"
    way = {name: one.way(name) for name in found.shipped}
    gone = ", ".join(f"{100 * share:.0f} % {name}" for name, share in way.items())
    return [
        Aim(f"{WHERE[where]}: likelihood above every baseline", beaten, not below),
        Aim(f"{WHERE[where]}: 95 % of the way from {GAUSSIAN}, by the best", gone, max(way.values()) >= WAY),
    ]


def _told(found: Findings, where: str) -> Aim:
    gaps = {name: one.gap for name, one in found.told[where].items()}
    said = ", ".join(f"{gap:.3f} {name}" for name, gap in gaps.items())
    wanted = f"{WHERE[where]}: credence given the condition off by 0.02 at most"
    return Aim(wanted, said, max(gaps.values()) <= GAP_GIVEN_CONDITION)


def _given(found: Findings, where: str) -> Aim:
    gaps = {name: one.reliability.gap for name, one in found.given[where].items()}
    said = ", ".join(f"{gap:.3f} {name}" for name, gap in gaps.items())
    wanted = f"{WHERE[where]}: credence given the readings off by 0.05 at most"
    return Aim(wanted, said, max(gaps.values()) <= GAP_GIVEN_READINGS)


def _gain(found: Findings, name: str) -> Aim:
    gain = found.gains[name].gain
    low, high = gain.mean - SURE * gain.error, gain.mean + SURE * gain.error
    said = f"{gain.mean:.3f} nats a ping, 95 %: {low:.3f} to {high:.3f}"
    if name in UNCORRELATED:
        return Aim(f"memory gains nothing: {name}", said, low <= 0.0 <= high or abs(gain.mean) < 0.01)
    return Aim(f"memory gains: {name}", said, low > 0.0)


def _fast(found: Findings, n: int) -> Aim:
    name = found.shipped[0]
    taken = found.speeds[name].seconds[n]
    text = {FEW: f"{1e6 * taken:.0f} us", MANY: f"{1e3 * taken:.1f} ms"}
    limit = {FEW: "100 us", MANY: "15 ms"}
    return Aim(f"one draw of {n} pings in {limit[n]}", f"{text[n]}, {name}", taken <= LIMITS[n])
