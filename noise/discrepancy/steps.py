"""Whether the recording's register counts in coarser steps than the simulation's."""

from __future__ import annotations

import numpy as np

from noise.cells import Batch
from noise.discrepancy.search import spread_over_blocks
from noise.discrepancy.verdict import Interval, Named
from noise.law import Floats

COARSER = 1.5  # times the simulation's step; ours


def coarser_steps(simulated_step: float, recorded: Batch) -> tuple[Named, Floats] | None:
    """Return the rounding as a named effect with its gain by block, or None where the steps are the simulation's.

    A law that knows of the steps gives each of them the probability of all the finer ones that it stands for: every
    echo is worth the logarithm of their number. Nothing else than coarse steps keeps every reading on a grid.

    Args:
        simulated_step: of the simulation's register, m.
        recorded: readings.
    """
    ratio = recorded.resolution / simulated_step
    if ratio < COARSER or not recorded.reading.echo.any():
        return None
    gain = np.log(ratio) * recorded.per_block(recorded.reading.echo.astype(np.float64))
    step, total = recorded.resolution, float(gain.sum())
    told = f"Readings come in steps of {1000 * step:.3g} mm; the simulation's in {1000 * simulated_step:.2g} mm."
    parameters = {"step_m": Interval(step, step, step, "m")}
    return Named("quantisation", (), 1.0, parameters, total, spread_over_blocks(gain), told), gain
