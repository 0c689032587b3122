"""What a hypothesis that was fitted on one part says of another, where that part hardly told its parameters.

A dozen positions may be heard, or missed, under any beam narrower than some width. The one that is fitted is then as
good as drawn by lot, and a position at its edge would count against the hypothesis by dozens of nats. So the likelihood
of each position is averaged over all values that fitted about as well (the posterior predictive of a flat prior).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.special import logsumexp
from scipy.stats import qmc

from acquisition.arrays import Floats
from noise.fitting.batch import Batch
from noise.fitting.fit import Fit, log_likelihood
from noise.fitting.stack import VISITS, Key
from noise.fitting.starts import between_bounds

HEARING: Key = (VISITS, "detection_weight")  # as little told where every position is either heard or missed
SURPRISE = 10.0  # nats by which a block is worse than where it was fitted itself: parameters, not chance, do that; ours
DRAWS = 64  # values of the parameters, a power of two; ours
NEARLY = 8.0  # nats of a fit: what is worse than the best by more has no weight to speak of


def unseen(fit: Fit, keys: Sequence[Key], fitted: Batch, batch: Batch, seen: Fit, seed: int) -> Floats:
    """Return log likelihoods of the blocks of a batch under what was fitted to another, nats, (blocks,).

    Args:
        fit: of the other.
        keys: parameters of the hypothesis.
        fitted: the other batch.
        batch: to predict.
        seen: the same hypothesis fitted to `batch` itself, which tells where a prediction failed.
        seed: of the values that are drawn.
    """
    plain = batch.visit_sums(log_likelihood(fit.stack, batch))
    if not keys or float((batch.visit_sums(log_likelihood(seen.stack, batch)) - plain).max()) < SURPRISE:
        return plain
    keys = (*keys, HEARING)
    points = qmc.Sobol(len(keys), rng=np.random.default_rng(seed)).random(DRAWS)
    drawn = [[between_bounds(fit.stack.parameter(key), u) for key, u in zip(keys, row, strict=True)] for row in points]
    stacks = [fit.stack, *(fit.stack.put(keys, row) for row in drawn)]
    weight = np.array([float(log_likelihood(stack, fitted).sum()) for stack in stacks])
    close = [k for k in range(len(stacks)) if weight[k] > weight[0] - NEARLY]
    told = np.stack([batch.visit_sums(log_likelihood(stacks[k], batch)) for k in close])
    share = weight[close] - logsumexp(weight[close])
    return np.asarray(logsumexp(told + share[:, None], axis=0))
