"""Shares: how much of the misfit each cause explains, and how much nothing explains, on visits nothing was fitted to.

With the log-likelihoods L0 of the law, L1 of the corrected law and L2 of the corrected law plus a flexible learner of
conditions, time and memory, the misfit is L2 - L0 and the causes explain (L1 - L0) / (L2 - L0) of it. What the same
learner gains on the simulation under its own law is subtracted from L2: the law, not the recording, lacks it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from acquisition.arrays import Floats
from noise.discrepancy.baseline.emulator import empirical_term, learner_pings
from noise.discrepancy.name.search import Hypothesis, Search, standard_error
from noise.discrepancy.result import LEVEL, Interval
from noise.fitting.batch import Batch
from noise.fitting.learn_smooth import Learned
from noise.fitting.stack import Stack

N_BOOTSTRAP = 1000


@dataclass(frozen=True, eq=False)
class Shares:
    """Shares of the misfit.

    Attributes:
        causes: share of each effect, by leaving it out.
        gains: log-likelihood that is lost without each effect, nats, with its standard error.
        together: share of all effects.
        rest: share that no effect explains.
    """

    causes: dict[str, Interval]
    gains: dict[str, tuple[float, float]]
    together: Interval
    rest: Interval


@dataclass(eq=False)
class Learner:
    """A flexible learner of conditions, time and memory, as a measure of what a law lacks.

    Attributes:
        search: readings and the law of the simulation.
        seed: of its folds and centres, so that laws are compared on the same ones.
    """

    search: Search
    seed: int

    @cached_property
    def batch(self) -> Batch:
        """Recorded readings of both folds that it learns from."""
        return learner_pings(self.search.joined)

    def learned(self, law: Stack) -> Learned:
        """Return a law with what the recording shows beyond it, and the gain on unseen visits."""
        return empirical_term(law, self.batch, np.random.default_rng(self.seed))

    def gain(self, learned: Learned) -> Floats:
        """Return what it gains on each visit beyond what it gains on simulated ones, nats, (n_visits,)."""
        count = np.bincount(self.batch.visit)
        return np.asarray(learned.gain - self._on_simulation * count)

    @cached_property
    def _on_simulation(self) -> float:
        """What it gains on the simulation under its own law, nats per ping."""
        simulated = self.search.simulated
        if simulated is None:
            return 0.0
        own = empirical_term(self.search.common, simulated, np.random.default_rng(self.seed))
        return max(float(own.gain.sum()), 0.0) / len(learner_pings(simulated))


def shares(
    learner: Learner, none: Hypothesis, found: Hypothesis, rest: Learned | None, rng: np.random.Generator
) -> Shares:
    """Return the shares of the effects of a hypothesis.

    Args:
        learner: learns what a law lacks.
        none: hypothesis without differences.
        found: the selected hypothesis.
        rest: what was learned beyond it; None where a test finds nothing left.
        rng: draws the bootstrap samples.
    """
    search, batch = learner.search, learner.batch
    others = {name: none if len(found.effects) == 1 else search.left_out(found, name) for name in found.effects}
    nats = search.crossed_nats(found, batch)
    explained = nats - search.crossed_nats(none, batch)
    lost = {name: nats - search.crossed_nats(other, batch) for name, other in others.items()}
    learnt = np.zeros_like(explained) if rest is None else learner.gain(rest)
    draws = _bootstrap(np.stack([explained, learnt, *lost.values()]), rng)
    gains = {name: found.nats - other.nats for name, other in others.items()}
    return Shares(
        {name: _ratio(draws[2 + k], draws) for k, name in enumerate(lost)},
        {name: (float(gain.sum()), standard_error(gain)) for name, gain in gains.items()},
        _ratio(draws[0], draws),
        _ratio(draws[1].clip(min=0.0), draws),
    )


def _bootstrap(per_visit: Floats, rng: np.random.Generator) -> Floats:
    """Return sums over visits, (k, 1 + draws): the sample's own and those of bootstrap samples of visits."""
    n = per_visit.shape[1]
    weights = rng.multinomial(n, np.full(n, 1.0 / n), N_BOOTSTRAP)
    return np.concatenate([per_visit.sum(axis=1, keepdims=True), per_visit @ weights.T], axis=1)


def _ratio(part: Floats, draws: Floats) -> Interval:
    """Return the ratio of a part to the misfit with its bootstrap interval, within 0 to 1."""
    whole = draws[0].clip(min=0.0) + draws[1].clip(min=0.0)
    ratio = np.clip(np.divide(part, whole, out=np.zeros_like(part), where=whole > 0), 0.0, 1.0)
    tail = 0.5 * (1.0 - LEVEL)
    low, high = np.quantile(ratio[1:], [tail, 1.0 - tail])
    return Interval(float(ratio[0]), float(low), float(high), "1")
