"""The law that stands for a simulation known by its readings: what sonars usually have, and a smooth part, fitted.

It is fitted twice, with a threshold below which echoes are missed and without one, and each is led to its end: faults
and silent cells pass for a threshold until the smooth part is there.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from noise.discrepancy.checks.company import company
from noise.discrepancy.common.workers import ALONE, Workers
from noise.fitting.batch import Batch
from noise.fitting.empirical import DISTANCE_KNOTS, Flexible
from noise.fitting.fit import Fit, highest, log_likelihood, maximise
from noise.fitting.stack import JITTER, NUISANCES, SPREAD, VISITS, Key, Stack
from noise.fitting.starts import extra_modes, nuisance_starts, robust_scatter, starting_points
from noise.physical import PhysicalModel

# what a simulated sonar usually has, to begin from: an axis, a beam, a threshold; the smooth part does the rest
PLAIN: dict[Key, float] = {
    ("clock_scale", "error"): 0.0,
    ("zero_offset", "offset_m"): 0.0,
    ("dropped_reading", "probability"): 0.002,
    ("spike", "probability"): 0.002,
    ("cycle_slip", "probability"): 0.2,
}
LOSS: Key = ("sensitivity", "loss_db")
WEAKENED: dict[Key, float] = {
    LOSS: 38.0,
    ("specular_loss", "strength"): 0.8,
    ("beam_width", "ka"): 2.0,
    ("time_walk", "scale"): 0.5,
    ("reflectance_loss", "strength"): 0.5,
}
FAULTS = ("spike", "dropped_reading", "cycle_slip")  # of the emulator, that anything unexplained passes for
LOSSES_DB = (30.0, 38.0, 42.0, 46.0, 50.0)  # to begin from where other things answer: no slope tells them apart; ours
LOOSE: dict[Key, float] = {(VISITS, "placement_m"): 0.004, (VISITS, "urn_weight"): 0.3}  # to begin from; ours
FEW_MISSED = 0.002  # share of pings that miss the target, below which nothing is known of a threshold; ours
THINGS = ("background_reflector", "fixed_clutter")  # that may answer in place of the target
FEWEST_AGREE = 3  # stays whose strays agree, below which nothing else is asked for; ours
LEAST_GAIN = 10.0  # nats of a fit with such a thing, for its four parameters; ours
TILT_GAIN = 2.0  # nats, for each number of the tilt; ours
LEAST_LOSS = 0.5  # nats; a part of the emulator that is missed less than this is left out; ours


def emulator(both: Batch, seed: int, workers: Workers = ALONE) -> Stack:
    """Return the law and nuisances that describe a simulation's readings.

    Args:
        both: the readings.
        seed: of starting points.
        workers: processes that share the climbs.
    """
    bare = nuisance_starts(Stack.of(PhysicalModel((), both.resolution)), both)
    climb = partial(_climbed, both)
    tops = [highest(workers.map(climb, [stack.at(PLAIN) for stack in bare]))]
    if levels_tell(both):
        # from where echoes are, and how far cells repeat themselves, a threshold is found that is not from elsewhere
        faint = [tops[0].stack.at(WEAKENED), *(stack.at({**PLAIN, **WEAKENED}) for stack in bare)]
        tops.append(highest(workers.map(climb, [*faint, *in_company(bare[0], both)])))
    ends = workers.map(lambda top: smoothed(with_other_things(top, both, seed).stack, both), tops)
    return folded(_pruned(highest(ends).stack, both))


def _climbed(batch: Batch, stack: Stack) -> Fit:
    return maximise(stack, (*free_of(stack), *NUISANCES), batch, 40, LEAST_LOSS)


def smoothed(stack: Stack, batch: Batch) -> Fit:
    """Return the fit of a stack with a smooth part; with its tilt only where readings ask for it."""
    smooth = replace(stack, extra={Flexible.name: Flexible})
    fine: tuple[Key, ...] = tuple((Flexible.name, p.name) for p in Flexible.parameters)
    smooth = smooth.put(fine, [0.0] * len(fine))
    tilt = [key for key in fine if key[1].startswith("tilt")]
    free = tuple(key for key in (*free_of(smooth), *NUISANCES) if key not in tilt)
    plain = maximise(smooth, free, batch, 80)
    tilted = maximise(smooth, (*free, *tilt), batch, 80)
    return tilted if tilted.nats > plain.nats + TILT_GAIN * len(tilt) else plain


def levels_tell(batch: Batch) -> bool:
    """Tell whether a simulation's readings depend on how loud an echo is: some are missed, or reflectors differ.

    Where none is missed a threshold could stand anywhere below, and what it does to the moment of reading would hold it
    where no recording can move it. A target is missed, too, where something behind it answers in its place.
    """
    missed = ~batch.reading.echo | (batch.error > batch.reach)
    return float(np.mean(missed)) > FEW_MISSED or bool(np.ptp(batch.ping.reflectance) > 0.0)


def in_company(bare: Stack, batch: Batch) -> list[Stack]:
    """Return where to begin if something else answers wherever the target is too faint; nothing if nothing stands out.

    Such echoes pass for spikes, losses and cells that repeat themselves, and no climb leads back from there: its own
    parameters and the levels are climbed first, with faults as rare and cells as loose as they usually are.

    Args:
        bare: a law with nuisances and nothing else.
        batch: the simulation's readings.
    """
    modes = [mode for mode in dict.fromkeys(extra_modes(batch)) if mode > 0.0]
    if not modes:
        return []
    usual = {**PLAIN, **WEAKENED, (JITTER, "sigma_m"): robust_scatter(batch), **LOOSE}
    things = [thing for mode in modes for thing in _answering(mode)]
    starts = [{**usual, LOSS: loss, **thing} for loss in LOSSES_DB for thing in things]
    put = [bare.at(start) for start in starts]
    best = max(put, key=lambda stack: log_likelihood(stack, batch).sum())
    free = tuple(key for key in free_of(best) if key[0] not in FAULTS)
    return [maximise(best, (*free, *SPREAD), batch, 40, LEAST_LOSS).stack]


def _answering(mode: float) -> tuple[dict[Key, float], dict[Key, float]]:
    """Return things that nearly always answer at a length, m: behind the target, or in the room."""
    behind, fixed = THINGS
    backdrop = {(behind, "presence"): 0.9, (behind, "behind_m"): mode, (behind, "loss_db"): 5.0}
    return backdrop, {(fixed, "presence"): 0.9, (fixed, "range_m"): mode, (fixed, "spread_m"): 0.02}


def with_other_things(fit: Fit, batch: Batch, seed: int) -> Fit:
    """Return a fit with what else answers in the simulation: not asked for it, the recording would seem to add it.

    Args:
        fit: of what simulated sonars usually have.
        batch: the simulation's readings.
        seed: of starting points.
    """
    rng = np.random.default_rng([seed, 12])
    if company(fit.stack, batch).agree < FEWEST_AGREE:
        return fit
    for name in THINGS:
        start = max(starting_points(fit.stack, name, batch, rng), key=lambda s: log_likelihood(s, batch).sum())
        found = _climbed(batch, start)
        fit = found if found.nats > fit.nats + LEAST_GAIN else fit
    return fit


def _pruned(stack: Stack, batch: Batch) -> Stack:
    """Drop what the readings do not speak for: under other conditions it would do harm that nobody asked for."""
    for name in dict.fromkeys(key[0] for key in (*PLAIN, *WEAKENED) if key[0] in stack.values):
        without = stack.without(name)
        if log_likelihood(stack, batch).sum() - log_likelihood(without, batch).sum() < LEAST_LOSS:
            stack = without
    return stack


def folded(stack: Stack) -> Stack:
    """Return the stack with its scale and offset moved into the smooth part, which holds any line exactly.

    A scale or offset that is named later then says by how much the recording differs from the simulation.
    """
    scale, offset = 1.0 + stack.get(("clock_scale", "error")), stack.get(("zero_offset", "offset_m"))
    keys = [(Flexible.name, f"bias_d{k}") for k in range(len(DISTANCE_KNOTS))]
    line = [scale * (d + stack.get(key)) + offset - d for d, key in zip(DISTANCE_KNOTS, keys, strict=True)]
    return stack.put(keys, line).without("clock_scale").without("zero_offset")


def free_of(stack: Stack) -> tuple[Key, ...]:
    """Return every parameter of a stack but the nuisances': what an emulator is fitted in."""
    keys = ((name, p.name) for name in stack.values for p in stack.known[name].parameters)
    return tuple(key for key in keys if key not in NUISANCES)
