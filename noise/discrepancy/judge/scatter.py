"""Whether single readings scatter otherwise than the simulation says.

Scatter is a nuisance while causes are searched, so that no cause is taken for scatter. A simulation that states its own
is held to it afterwards: the explanation is scored once with the recording's scatter and once with the simulation's.
"""

from __future__ import annotations

import numpy as np
from scipy.stats import norm

from acquisition.arrays import Floats
from noise.discrepancy.common.rules import spread_over_blocks
from noise.discrepancy.judge.verdict import Named
from noise.discrepancy.name.explanation import Interval
from noise.discrepancy.name.search import Crossed, Search
from noise.fitting.batch import Batch
from noise.fitting.stack import JITTER, NUISANCES, VISITS, Stack
from noise.fitting.starts import deviation_from_median

SCATTER = ((JITTER, "sigma_m"), (JITTER, "per_metre"))
INNER = 0.8  # share of readings of a stay that say how it scatters; ours
PLACED = (VISITS, "placement_m")
LEAST_RATIO = 1.3  # scatter that differs by less is no mismatch: one day's air moves less than another's; ours
POOR_RATIO = 2.0  # one that does not fully describe the simulation; ours


def scatter_m(stack: Stack, distance: float) -> float:
    """Return the standard deviation of single readings at a distance, m."""
    sigma, per_metre = (stack.get(key) for key in SCATTER)
    return float(np.hypot(sigma, per_metre * distance))


def changed_scatter(
    simulation: Stack, simulated: Batch, search: Search, chosen: list[str], cross: Crossed, describes: bool = True
) -> tuple[Named, Floats] | None:
    """Return the scatter as a named effect with its gain by block, or None where it is the simulation's own.

    Args:
        simulation: the law that stands for the simulation, its scatter fitted to its own readings.
        simulated: those readings.
        search: holds the parts of the recording.
        chosen: the effects of the explanation.
        cross: the explanation, fitted on either part with scatter free.
        describes: whether the law that stands for the simulation fully describes it.
    """
    held = cross.first.stack.put(SCATTER, [simulation.get(key) for key in SCATTER])
    others = tuple(key for key in NUISANCES if key not in SCATTER)
    gain = cross.nats - search.cross(held, chosen, others).nats
    distance = float(np.median(search.both.ping.distance))
    before = max(scatter_m(simulation, distance), _least(search.both))
    fits = (cross.first, cross.second)
    after = [max(scatter_m(fit.stack, distance), _least(search.both)) for fit in fits]
    least = LEAST_RATIO if describes else POOR_RATIO
    placed = simulation.get(PLACED)
    pairs = [(before, placed, x, fit.stack.get(PLACED)) for fit, x in zip(fits, after, strict=True)]
    if min(_apart(*pair) for pair in pairs) < least or not search.rules.believes(JITTER, gain):
        return None
    # two laws may share one scatter out between placement and jitter otherwise: the readings have to bear it out
    seen = within_stays(search.both) / within_stays(simulated)
    if max(seen, 1.0 / seen) < LEAST_RATIO or (seen > 1.0) != (after[0] > before):
        return None
    return _named(cross, gain, before, float(np.mean(after)), distance), gain


def _apart(before: float, placed_before: float, after: float, placed_after: float) -> float:
    """Return how many times as much the one scatters as the other, where that is beyond what may be placement in it.

    Slow air moves a whole stay, as placement does, quick air single readings: how much is which differs by the day.
    """
    return max(after / np.hypot(before, placed_before), before / np.hypot(after, placed_after))


def within_stays(batch: Batch) -> float:
    """Return the scatter of readings about the middle of their stay, m: of the inner four fifths, whatever strays."""
    away = deviation_from_median(batch)
    inner = float(np.quantile(np.abs(away), INNER)) / float(norm.ppf(0.5 + 0.5 * INNER)) if len(away) else 0.0
    return float(np.hypot(inner, _least(batch)))


def _least(batch: Batch) -> float:
    """Return the scatter that rounding to the register alone gives, m: less cannot be seen."""
    return batch.resolution / float(np.sqrt(12.0))


def _named(cross: Crossed, gain: Floats, before: float, after: float, distance: float) -> Named:
    word = "more" if after > before else "less"
    told = (
        f"Single readings scatter {word} than the simulation's: "
        f"by {1000 * after:.1f} mm at {distance:.1f} m, not {1000 * before:.1f} mm."
    )
    parameters = {}
    for key in SCATTER:
        values = sorted(fit.stack.get(key) for fit in (cross.first, cross.second))
        unit = cross.first.stack.parameter(key).unit
        parameters[key[1]] = Interval(float(np.mean(values)), values[0], values[1], unit)
    return Named(JITTER, (), 1.0, parameters, float(gain.sum()), spread_over_blocks(gain), told)
