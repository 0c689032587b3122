"""Shares: how much of the misfit each cause explains, and how much nothing explains, on visits nothing was fitted to.

With the log-likelihoods L0 of the law, L1 of the corrected law and L2 of the corrected law plus a flexible learner of
conditions, time and memory, the misfit is L2 - L0 and the causes explain (L1 - L0) / (L2 - L0) of it. What the same
learner gains on the simulation under its own law is subtracted from L2: the law, not the recording, lacks it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from acquisition.arrays import Floats
from noise.discrepancy.baseline.emulator import empirical_term
from noise.discrepancy.name.search import Hypothesis, Search, standard_error
from noise.discrepancy.result import LEVEL, Interval
from noise.fitting.batch import Batch
from noise.fitting.fit import log_likelihood
from noise.fitting.stack import Stack

N_BOOTSTRAP = 1000
LEARNER_PINGS = 1000  # of each fold


@dataclass(frozen=True, eq=False)
class Shares:
    """Shares of the misfit.

    Attributes:
        causes: share of each effect, by leaving it out.
        gains: log-likelihood that is lost without each effect, nats, with its standard error.
        together: share of all effects.
        rest: share that no effect explains.
        misfit_nats: L2 - L0.
    """

    causes: dict[str, Interval]
    gains: dict[str, tuple[float, float]]
    together: Interval
    rest: Interval
    misfit_nats: float


def shares(search: Search, none: Hypothesis, found: Hypothesis, is_left: bool, rng: np.random.Generator) -> Shares:
    """Return the shares of the effects of a hypothesis.

    Args:
        search: data of the search.
        none: hypothesis without differences.
        found: the selected hypothesis.
        is_left: whether a test finds anything left; otherwise nothing is learned.
        rng: draws the bootstrap samples and starts the learner.
    """
    explained = found.nats - none.nats
    learnt = _learnt(search, found, rng) if is_left else np.zeros_like(explained)
    single = len(found.effects) == 1
    lost = {n: explained if single else found.nats - search.left_out(found, n).nats for n in found.effects}
    draws = _bootstrap(np.stack([explained, learnt, *lost.values()]), rng)
    rest = _ratio(draws[1].clip(min=0.0), draws)
    each = {name: _ratio(draws[2 + k], draws) for k, name in enumerate(lost)}
    return Shares(
        each,
        {name: (float(gain.sum()), standard_error(gain)) for name, gain in lost.items()},
        _ratio(draws[0], draws),
        rest,
        float(explained.sum() + max(learnt.sum(), 0.0)),
    )


def _learnt(search: Search, found: Hypothesis, rng: np.random.Generator) -> Floats:
    """Return what a learner gains on each recorded visit beyond what it gains on simulated ones, nats."""
    pairs = list(zip(found.stacks, search.parts, strict=True))
    learned = [empirical_term(stack, part.thin(LEARNER_PINGS), rng) for stack, part in pairs]
    if all(new is old for new, (old, _) in zip(learned, pairs, strict=True)):
        return np.zeros_like(found.nats)
    crossed = ((learned[1], search.parts[0]), (learned[0], search.parts[1]))
    best = np.concatenate([part.visit_sums(log_likelihood(stack, part)) for stack, part in crossed])
    n_pings = sum(len(part) for part in search.parts)
    own = _gain_on_simulation(search.common, search.simulated, rng) * n_pings / len(best)
    return np.asarray(best - found.nats - own)


def _gain_on_simulation(law: Stack, simulated: Batch | None, rng: np.random.Generator) -> float:
    """Return what the learner gains on the simulation under its own law, nats per ping of unseen visits."""
    if simulated is None:
        return 0.0
    half = simulated.visit % 2 == 0
    fitted, scored = simulated.select(half), simulated.select(~half)
    learned = empirical_term(law, fitted.thin(LEARNER_PINGS), rng)
    gain = log_likelihood(learned, scored) - log_likelihood(law, scored)
    return max(float(gain.mean()), 0.0)


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
