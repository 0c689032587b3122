"""A hypothesis about the effects in which a recording differs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.special import softmax

from acquisition.arrays import Floats
from noise.fitting.stack import Stack

BEHIND = 3.0  # standard errors by which what trails is out of reach
ALIKE = 0.9  # correlation of two gains over visits from which they are one explanation
N_DRAWS = 500  # of the Bayesian bootstrap


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """Effects that differ, fitted on each part and scored on the other; fitted and scored on one where there is one.

    Attributes:
        effects: effect ids, in the order in which they were added.
        stacks: fitted on each part.
        nats: log-likelihood of each recorded visit, by the fit of the other part.
        prior: log prior of the sizes and of the nuisance parameters, less what an estimate gains on its own readings.
    """

    effects: tuple[str, ...]
    stacks: tuple[Stack, ...]
    nats: Floats
    prior: float = 0.0

    @property
    def value(self) -> float:
        """Log-likelihood with the prior, nats: on visits that nothing was fitted to, or an estimate of it."""
        return float(self.nats.sum()) + self.prior


def standard_error(per_visit: Floats, pings: Floats | None = None) -> float:
    """Return the standard error of a sum over independent visits.

    Of visits of unequal length it is that of a ratio estimator (Cochran 1977): a long visit adds more, as expected.

    Args:
        per_visit: terms of the sum, (n,).
        pings: of each visit, (n,); alike by default.
    """
    if len(per_visit) < 2:
        return float("inf")
    size = np.ones(len(per_visit)) if pings is None else pings
    return float(np.linalg.norm(per_visit - size * per_visit.sum() / size.sum()))


def may_lead(lag: float, behind: Floats, least: float) -> bool:
    """Return whether what trails the best may lead on other visits.

    Args:
        lag: by how much it trails, nats.
        behind: the same on each visit, nats, (n,).
        least: what counts for nothing, nats.
    """
    return lag < max(least, BEHIND * standard_error(behind))


def alike(one: Floats, other: Floats) -> bool:
    """Return whether two gains of visits, (n,) each, are those of one explanation."""
    return bool(min(np.ptp(one), np.ptp(other)) > 0.0 and np.corrcoef(one, other)[0, 1] > ALIKE)


def first_kinds(gains: Mapping[str, Floats], n: int) -> list[str]:
    """Return the first effects of a mapping to gains of visits, as many as hold n kinds that do not gain alike."""
    kinds: list[Floats] = []
    out = []
    for name, gain in gains.items():
        if not any(alike(gain, other) for other in kinds):
            kinds.append(gain)
        if len(kinds) > n:
            break
        out.append(name)
    return out


def weights(fits: Mapping[str, Hypothesis], rng: np.random.Generator) -> dict[str, float]:
    """Return the probability of each hypothesis, by the Bayesian bootstrap over visits (pseudo-BMA+).

    No law is exactly true, so that log-likelihoods of thousands of readings overstate evidence. The bootstrap lets a
    difference count as much as it repeats itself from visit to visit (Yao, Vehtari, Simpson and Gelman 2018).
    """
    nats = np.stack([fit.nats for fit in fits.values()])
    draws = rng.dirichlet(np.ones(nats.shape[1]), N_DRAWS) * nats.shape[1]
    total = nats @ draws.T + np.array([[fit.prior] for fit in fits.values()])
    return dict(zip(fits, softmax(total, axis=0).mean(axis=1).tolist(), strict=True))
