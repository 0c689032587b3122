"""Where a fit should begin: the catalogue's own starts, what the data show, and a quasi-random design."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
import torch
from scipy.stats import qmc

from noise.effects import Parameter, Seen
from noise.fitting.batch import Batch
from noise.fitting.stack import CELLS, JITTER, LINK, Key, Stack
from noise.law import Floats
from noise.statistics import robust_std

LEAST_SCATTER_M = 5e-4  # that a climb begins with; ours
LEAST_MOVE_M = 1e-3  # that a parameter must move the target's echo between its bounds to be put by its readings; ours


def extra_modes(batch: Batch, most: int = 3) -> list[float]:
    """Return lengths that explain clusters of readings away from the true distance, m: offsets, then fixed ranges."""
    echo = batch.reading.echo
    error = batch.error[echo]
    far = np.abs(error) > np.maximum(0.06, 0.05 * batch.ping.distance[echo])
    return [*_peaks(error[far], most), *_peaks(batch.reading.range[echo][far], most)]


def _peaks(value: Floats, most: int, bin_m: float = 0.05) -> list[float]:
    """Return the centres of the fullest bins of a sample, fullest first."""
    if len(value) < 4:
        return []
    place, count = np.unique(np.rint(value / bin_m), return_counts=True)
    fullest = np.argsort(-count, kind="stable")[:most]
    return [float(place[k] * bin_m) for k in fullest if count[k] >= 4]


def starting_points(
    stack: Stack, name: str, batch: Batch, rng: np.random.Generator, design: int = 8, whole: Batch | None = None
) -> list[Stack]:
    """Return stacks with an effect switched on in different ways.

    Starts of the catalogue, lengths where the data show extra modes, values that move the target's echo to where it was
    read, and a Sobol design over the bounds; the effect's present values are among them.

    Args:
        stack: to begin from; holds the effect at its present values or not at all.
        name: of the effect.
        batch: whose extra modes to use.
        rng: shifts the design.
        design: number of its points, a power of two.
        whole: readings that an effect's own guesses are made from; `batch` if not given.
    """
    every = stack.known[name].parameters
    stack = stack.put([(name, p.name) for p in every], [stack.get((name, p.name)) for p in every])
    logged = (whole or batch).ping.covariates
    keys = [(name, p.name) for p in every if p.identifiable(logged)]
    columns = [_candidates(stack.parameter(key), stack.get(key), extra_modes(batch)) for key in keys]
    first = [column[0] for column in columns]
    points = [[stack.get(key) for key in keys], first]
    for j, column in enumerate(columns):
        points += [[*first[:j], value, *first[j + 1 :]] for value in column[1:]]
    for row in dict.fromkeys((tuple(points[0]), tuple(first))):
        points += _on_slopes(stack.put(keys, row), keys, whole or batch)
    points += [[guess[key[1]] for key in keys] for guess in stack.known[name].guesses(seen_in(whole or batch))]
    sobol = qmc.Sobol(len(keys), rng=rng).random(design)
    points += [[spread(stack.parameter(k), u) for k, u in zip(keys, row, strict=True)] for row in sobol]
    return [stack.put(keys, point) for point in points]


def _on_slopes(stack: Stack, keys: Sequence[Key], batch: Batch) -> list[list[float]]:
    """Return values of the parameters with one of them moved to where the target's echo was read, each in turn."""
    here = [stack.get(key) for key in keys]
    moved = [(j, fitting_value(stack, key, batch)) for j, key in enumerate(keys)]
    return [[*here[:j], value, *here[j + 1 :]] for j, value in moved if value is not None]


def fitting_value(stack: Stack, key: Key, batch: Batch) -> float | None:
    """Return the value of a parameter at which the target's echo comes nearest to its readings, seen from here.

    Exact where the expected reading is linear in the parameter: the least sum of absolute errors, which a few strays do
    not turn, is at the median of error over slope, weighted by slope. None where the parameter moves no reading.
    """
    p, expected = stack.parameter(key), own_echo(stack, batch)
    rate, error = slope(stack, key, batch, expected), batch.reading.range - expected
    moves = batch.is_target(error) & (np.abs(rate) * (p.high - p.low) > LEAST_MOVE_M)
    if not moves.any():
        return None
    ratio, weight = error[moves] / rate[moves], np.abs(rate[moves])
    order = np.argsort(ratio)
    middle = np.searchsorted(np.cumsum(weight[order]), 0.5 * weight.sum())
    return float(stack.get(key) + ratio[order][middle])


def slope(stack: Stack, key: Key, batch: Batch, expected: Floats) -> Floats:
    """Return how much the target's echo moves with a parameter, m a unit, (n,), from where `own_echo` expects it."""
    p, here = stack.parameter(key), stack.get(key)
    step = 1e-3 * (p.high - p.low) * (1.0 if here < 0.5 * (p.low + p.high) else -1.0)
    return (own_echo(stack.put([key], [here + step]), batch) - expected) / step


def own_echo(stack: Stack, batch: Batch) -> Floats:
    """Return where the register puts the target's own echo, m, (n,)."""
    with torch.no_grad():
        state = stack.model.state(batch.conditions)
        place = state.scale * (state.direct.length + state.direct.lag) + state.offset
    return np.asarray(torch.atleast_2d(place).mean(0).expand(len(batch)).numpy())


def seen_in(batch: Batch) -> Seen:
    """Return the echoes of a batch as guesses see them."""
    echo = batch.reading.echo
    return Seen(batch.ping.distance[echo], batch.ping.time[echo], batch.reading.range[echo])


def _candidates(p: Parameter, present: float, modes: Sequence[float]) -> list[float]:
    lengths = [m for m in modes if p.unit == "m" and p.high - p.low > 0.3 and p.low <= m <= p.high]
    # alone the null is no beginning; beside others it is one of the ways in which an effect may be there
    starts = list(p.starts) if len(p.starts) > 1 else [s for s in p.starts if s != p.null] or [present]
    return list(dict.fromkeys([*starts, *lengths]))


def spread(p: Parameter, u: float) -> float:
    """Return a value between the bounds: evenly, in the logarithm where they span more than two decades."""
    if p.low > 0 and p.high / p.low > 100.0:
        return float(p.low * (p.high / p.low) ** u)
    if p.null in (p.low, p.high):
        return float(p.null + (p.high + p.low - 2.0 * p.null) * u**2)
    # small effects are likelier than large ones, and a sharp law sees no further than its own width
    v = 2.0 * u - 1.0
    return float(p.null + abs(v) ** 3 * ((p.high - p.null) if v > 0 else (p.low - p.null)))


def nuisance_start(stack: Stack, batch: Batch) -> Stack:
    """Return the stack with nuisances where a robust look at the errors puts them, wide enough to climb from."""
    echo = batch.reading.echo
    middle = np.zeros(len(batch)) if not echo.any() else stack.expected(batch)
    known = echo & (middle > 0)
    error = (batch.reading.range - middle)[known]
    robust = robust_std(error) if len(error) else 0.005
    size = float(np.clip(robust, max(0.002, batch.resolution / 4.0), 0.15))
    wide = {(JITTER, "sigma_m"): max(stack.get((JITTER, "sigma_m")), 0.7 * size), (CELLS, "placement_m"): 0.5 * size}
    shared = {(CELLS, "sharing"): 0.02, (CELLS, "carry"): 0.1, (CELLS, "kernel_m"): max(0.004, batch.resolution / 3.0)}
    shared[(CELLS, "hearing")] = 0.05
    shared[LINK] = 0.0 if batch.simulated_offset is None else 0.5
    start = {**wide, **shared}
    return stack.put(list(start), np.minimum(list(start.values()), 0.19))


def nuisance_starts(stack: Stack, batch: Batch) -> list[Stack]:
    """Return starts for cells that share little, for cells that repeat themselves, and what the stack says already."""
    loose = nuisance_start(stack, batch)
    tight = {(JITTER, "sigma_m"): 0.5 * loose.get((JITTER, "sigma_m")), (CELLS, "sharing"): 1.5, (CELLS, "carry"): 0.5}
    tight |= {(CELLS, "kernel_m"): max(0.001, batch.resolution / 3.0), (CELLS, "hearing"): 0.5}
    present = [stack] if CELLS in stack.values else []
    return [loose, loose.at(tight), *present]


def robust_scatter(batch: Batch) -> float:
    """Return the scatter of most readings about the middle of their stay, m, at least a fifth of a register's step."""
    away = from_middle(batch)
    usual = robust_std(away) if len(away) else batch.resolution
    return max(usual, 0.2 * batch.resolution, LEAST_SCATTER_M)


def from_middle(batch: Batch) -> Floats:
    """Return how far each echo lies from the median of its stay, m, (echoes,)."""
    error = pd.Series(batch.error[batch.reading.echo])
    return (error - error.groupby(batch.visit[batch.reading.echo]).transform("median")).to_numpy()
