"""Whether the recording's register counts in coarser steps than the simulation's, rounded or cut down to them."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from acquisition.arrays import Floats
from noise.discrepancy.common.rules import Attempt, spread_over_blocks
from noise.discrepancy.judge.verdict import Named
from noise.discrepancy.locate.locate import Finding
from noise.discrepancy.name.explanation import Interval
from noise.discrepancy.name.rivals import SAME
from noise.discrepancy.name.search import Crossed, Search
from noise.fitting.batch import Batch
from noise.fitting.fit import maximise
from noise.fitting.stack import SPREAD, Stack

COARSER = 1.5  # times the simulation's step; ours
CUT = ("truncation", "step_m")


def coarser_steps(
    simulated_step: float, recorded: Batch, stack: Stack, never: Collection[str] = (), chosen: Collection[str] = ()
) -> tuple[Named, Floats] | None:
    """Return the steps as a named effect with its gain by block, or None where they are the simulation's.

    A law that knows of the steps gives each of them the probability of all the finer ones that it stands for: every
    echo is worth the logarithm of their number. Nothing else than coarse steps keeps every reading on a grid; whether
    readings were rounded or cut down to it shows in half a step of offset, or not at all.

    Args:
        simulated_step: of the simulation's register, m.
        recorded: readings.
        stack: the explanation of everything else.
        never: effects that are not to be named.
        chosen: effects of the explanation that the search has found.
    """
    ratio = recorded.resolution / simulated_step
    if ratio < COARSER or not recorded.reading.echo.any():
        return None
    gain = np.log(ratio) * recorded.visit_sums(recorded.reading.echo.astype(np.float64))
    step, total = recorded.resolution, float(gain.sum())
    names = tuple(name for name in _names(stack, recorded, chosen) if name not in never)
    if not names:
        return None
    told = f"Readings come in steps of {1000 * step:.3g} mm; the simulation's in {1000 * simulated_step:.2g} mm."
    if names[0] == CUT[0]:
        told = f"{told} They are cut down to them, and run short by {500 * step:.3g} mm on average."
    parameters = {"step_m": Interval(step, step, step, "m")}
    return Named(names[0], names[1:], 1.0, parameters, total, spread_over_blocks(gain), told), gain


def steps_left(simulated_step: float, recorded: Batch, named: Collection[str]) -> list[Finding]:
    """Return coarser steps that no name is left for, as a finding: they are seen, whatever is known not to make them.

    Args:
        simulated_step: of the simulation's register, m.
        recorded: readings.
        named: effects that are named.
    """
    ratio = recorded.resolution / simulated_step
    if ratio < COARSER or not recorded.reading.echo.any() or {*named} & {CUT[0], "quantisation"}:
        return []
    nats = float(np.log(ratio) * recorded.reading.echo.sum())
    return [Finding("steps", {}, recorded.resolution, "m", 0.0, nats)]


def cut_instead(simulated_step: float, search: Search, chosen: list[str], cross: Crossed) -> tuple[list[str], Crossed]:
    """Leave out a shift that is no more than readings cut down to coarser steps, which nobody rounded: half a step.

    Args:
        simulated_step: of the simulation's register, m.
        search: its readings.
        chosen: effects of the explanation.
        cross: the explanation.

    Returns:
        The effects, and the explanation; its stacks cut readings down where that takes an effect's place.
    """
    if search.both.resolution / simulated_step < COARSER or CUT[0] in (*search.never, *chosen):
        return chosen, cross
    total = float(cross.nats.sum())
    for name in chosen:
        others = [other for other in chosen if other != name]
        start = search.reset(cross.first.stack, name).put([CUT], [search.both.resolution])
        cut = search.cross(start, others)
        nats = float(cut.nats.sum())
        if nats > total - search.rules.tie_nats:
            told = f"readings cut down to {1000 * search.both.resolution:.3g} mm explain it as well"
            search.attempts.append(Attempt(name, tuple(others), np.nan, total - nats, np.nan, told))
            return others, cut
    return chosen, cross


def _names(stack: Stack, batch: Batch, chosen: Collection[str]) -> tuple[str, ...]:
    """Return what the steps may be, the likelier first: rounding, and cutting down unless the search has found that."""
    if CUT[0] in stack.values and stack.get(CUT) > 0:
        return ("quantisation",) if CUT[0] in chosen else CUT[:1]
    cut = stack.put([CUT], [batch.resolution])
    rounded_nats, cut_nats = (maximise(each, SPREAD, batch, 30).nats for each in (stack, cut))
    order = ("truncation", "quantisation") if cut_nats > rounded_nats else ("quantisation", "truncation")
    return order if abs(cut_nats - rounded_nats) < SAME else order[:1]
