"""Shares: how much of the misfit each cause explains, and how much nothing explains, on visits nothing was fitted to.

With the log-likelihoods L0 of the law, L1 of the corrected law and L2 of the corrected law pooled with a quantile
regression forest of conditions, time and memory, the misfit is L2 - L0 and the causes explain (L1 - L0) / (L2 - L0) of
it. What the same pool gains on the simulation under its own law is subtracted from L2: the law, not the recording,
lacks it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.optimize import minimize_scalar

from acquisition.arrays import Floats
from noise.discrepancy.baseline.forest import Grown
from noise.discrepancy.name.hypothesis import Hypothesis, standard_error
from noise.discrepancy.name.search import Search
from noise.discrepancy.result import LEVEL, Interval
from noise.fitting.likelihood import log_likelihood

N_BOOTSTRAP = 1000


@dataclass(frozen=True, eq=False)
class Shares:
    """Shares of the misfit.

    Attributes:
        causes: share of each effect, by leaving it out.
        gains: log-likelihood that is lost without each effect, nats, with its standard error.
        leads: log-likelihood relative to a forest in the place of each effect, nats, with its standard error.
        together: share of all effects.
        rest: share that no effect explains.
    """

    causes: dict[str, Interval]
    gains: dict[str, tuple[float, float]]
    leads: dict[str, tuple[float, float]]
    together: Interval
    rest: Interval


@dataclass(eq=False)
class Rest:
    """What a forest knows of readings that a law lacks.

    Attributes:
        search: readings and the law of the simulation.
        recorded: forest of the readings of all parts.
        simulated: forest of the simulation's readings; None where its law is known exactly.
    """

    search: Search
    recorded: Grown
    simulated: Grown | None

    def gain(self, found: Hypothesis) -> Floats:
        """Return what the pool gains on each unit beyond what it gains on simulated ones, nats, (units,)."""
        parts, law = self.search.parts, np.concatenate(self.search.predictions(found.effects, found.stacks))
        ends = np.cumsum([len(part) for part in parts])[:-1]
        gained = np.split(pool_gain(law, self._forest), ends)
        sums = np.concatenate([part.unit_sums(each) for part, each in zip(parts, gained, strict=True)])
        return sums - self._on_simulation * np.concatenate([np.bincount(part.unit) for part in parts])

    @cached_property
    def _forest(self) -> Floats:
        """Log probability of the readings of all parts by trees that have not seen their visits, nats, (n,)."""
        nats, first = self.recorded.nats, self.search.folds.in_first(self.search.joined)
        return nats if len(self.search.parts) == 1 else np.concatenate([nats[first], nats[~first]])

    @cached_property
    def _on_simulation(self) -> float:
        """What the pool gains on the simulation beyond its own law, nats per ping."""
        forest = self.simulated
        if forest is None:
            return 0.0
        return float(pool_gain(log_likelihood(self.search.common, forest.batch), forest.nats).mean())


def pool_gain(law: Floats, other: Floats) -> Floats:
    """Return what the best linear opinion pool of two predictions gains beyond the first, nats, (n,).

    The pool is the mixture of both with one weight (Stone 1961; Hall and Mitchell 2007).

    Args:
        law: log probability of each reading by the first, nats, (n,).
        other: by the second, nats, (n,).
    """
    ratio = np.exp(np.clip(other - law, -700.0, 700.0))
    found = minimize_scalar(lambda w: -np.log1p(w * (ratio - 1.0)).sum(), bounds=(0.0, 1.0), method="bounded")
    gain = np.log1p(found.x * (ratio - 1.0))
    return np.asarray(gain if gain.sum() > 0.0 else np.zeros_like(gain))


def shares(rest: Rest, none: Hypothesis, found: Hypothesis, rng: np.random.Generator) -> Shares:
    """Return the shares of the effects of a hypothesis.

    Args:
        rest: what a forest knows beyond it.
        none: hypothesis without differences.
        found: the selected hypothesis.
        rng: draws the bootstrap samples.
    """
    search = rest.search
    others = {name: none if len(found.effects) == 1 else search.left_out(found, name) for name in found.effects}
    lost = {name: found.nats - other.nats for name, other in others.items()}
    leads = {name: lost[name] - rest.gain(other) for name, other in others.items()}
    draws = _bootstrap(np.stack([found.nats - none.nats, rest.gain(found), *lost.values()]), rng)
    return Shares(
        {name: _ratio(draws[2 + k], draws) for k, name in enumerate(lost)},
        _with_errors(lost, search.pings),
        _with_errors(leads, search.pings),
        _ratio(draws[0], draws),
        _ratio(draws[1].clip(min=0.0), draws),
    )


def _with_errors(per_visit: Mapping[str, Floats], pings: Floats) -> dict[str, tuple[float, float]]:
    return {name: (float(each.sum()), standard_error(each, pings)) for name, each in per_visit.items()}


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
