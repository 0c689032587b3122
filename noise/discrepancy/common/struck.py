"""Whether single readings stray in more stays than in the simulation: what the spread of gains over stays cannot say.

A fault that strikes one stay in ten gains nothing anywhere else. Over stays its gain has so wide a spread that the
ratio of the two says how many stays it strikes and no more, at most the root of their number. That they are too many
for chance is told by counting them, in the recording and in the simulation.
"""

from __future__ import annotations

import numpy as np
from scipy.stats import binomtest

from noise.fitting.batch import Batch

FAR_M = 0.03  # from the middle of a stay: beyond what slips of a few waves, 9 mm each, do to one reading; ours
FEWEST = 5  # echoes of a stay, for its middle to be that of the target; ours


def struck(batch: Batch) -> tuple[int, int]:
    """Return the number of stays in which some echoes stray from most, and that of echoes that could have."""
    stays = [batch.error[rows[batch.reading.echo[rows]]] for rows in batch.stationary_rows]
    stays = [error for error in stays if len(error) >= FEWEST]
    return sum(_strays(error) for error in stays), sum(len(error) for error in stays)


def more_struck(recorded: Batch, simulated: Batch) -> float:
    """Return the chance of so many more struck stays in a recording, were readings as often astray in both.

    Two Poisson counts whose sum is known: the first is binomial, with the share that its echoes have. Stays are counted
    over the same number of pings in both, since longer ones are struck oftener, but not in proportion.
    """
    usual = min(int(np.median(np.bincount(batch.visit))) for batch in (recorded, simulated))
    (hit, echoes), (own, others) = (struck(batch.select(batch.count < usual)) for batch in (recorded, simulated))
    if hit + own == 0 or echoes == 0:
        return 1.0
    return float(binomtest(hit, hit + own, echoes / (echoes + others), alternative="greater").pvalue)


def _strays(error: np.ndarray) -> bool:
    far = np.abs(error - np.median(error)) > FAR_M
    return bool(far.any()) and float(far.mean()) < 0.5
