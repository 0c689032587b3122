"""A hypothesis about the effects in which a recording differs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from acquisition.arrays import Floats
from noise.fitting.stack import Stack


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


def standard_error(per_visit: Floats) -> float:
    """Return the standard error of a sum over independent visits."""
    return float(np.sqrt(len(per_visit)) * np.std(per_visit)) if len(per_visit) > 1 else float("inf")
