"""Starting points of fits: values of the catalogue, values suggested by the data, and a quasi-random design."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
import torch
from scipy.stats import qmc

from acquisition.arrays import Floats
from acquisition.ping import RANGE_RATE
from noise.effects import EchoSample, Effect, Parameter, Stage
from noise.effects.base import modes
from noise.effects.interping import INTERVAL
from noise.fitting.batch import Batch
from noise.fitting.stack import JITTER, LEVEL_SD, SIMULATION_CORRELATION, VISITS, Key, Stack
from noise.statistics import robust_std

WEAK_DB, STRONG_DB = 1.0, 4.0  # scatter of the level of visits where fits begin
MIN_SCATTER_M = 5e-4  # of a starting point; chosen here
# changes of a parameter that a law has: of a probability, by factors, or a share of the bounds' width
NEAR_FACTORS, NEAR_SHARE = (1.3, 3.0), 0.05
MIN_SHIFT_M = 1e-3  # of the target's echo between the bounds of a parameter that is estimated from it; chosen here


def extra_modes(batch: Batch) -> list[float]:
    """Return lengths, m, that explain clusters of readings far from the true distance: offsets, then fixed ranges."""
    echo = batch.reading.echo
    error = batch.error[echo]
    far = np.abs(error) > np.maximum(0.06, 0.05 * batch.ping.distance[echo])
    lengths = (error[far], batch.reading.range[echo][far])
    return [float(np.median(each)) for length in lengths for each in modes(length)]


def starting_points(
    stack: Stack, name: str, batch: Batch, rng: np.random.Generator, design: int = 8, whole: Batch | None = None
) -> list[Stack]:
    """Return stacks with different parameter values of one effect.

    These are the present values, values near them if the law has the effect, the starting values of the catalogue,
    lengths of extra modes of the data, values that fit the target's echo, the effect's own guesses, and a Sobol design
    over the bounds.

    Args:
        stack: stack with or without the effect.
        name: effect id.
        batch: readings for the extra modes.
        rng: scrambles the Sobol design.
        design: number of points of the Sobol design, a power of two.
        whole: readings for the other estimates; `batch` by default.
    """
    every, has_it = [stack.parameter((name, p.name)) for p in stack.known[name].parameters], name in stack.values
    stack = stack.put([(name, p.name) for p in every], [stack.get((name, p.name)) for p in every])
    logged = (whole or batch).ping.covariates
    keys = [(name, p.name) for p in every if p.low < p.high and p.identifiable(logged)]
    lengths = extra_modes(batch)
    columns = [_candidates(stack.parameter(key), stack.get(key), lengths) for key in keys]
    first = [column[0] for column in columns]
    points = [[stack.get(key) for key in keys], first]
    for j, column in enumerate(columns):
        points += [[*first[:j], value, *first[j + 1 :]] for value in column[1:]]
    if has_it:
        points += _near(stack, keys)
    for row in dict.fromkeys((tuple(points[0]), tuple(first))):
        points += _one_at_a_time(stack.put(keys, row), keys, whole or batch)
    points += [[guess[key[1]] for key in keys] for guess in guesses_of(stack.known[name], whole or batch)]
    sobol = qmc.Sobol(len(keys), rng=rng).random(design)
    points += [[between_bounds(stack.parameter(k), u) for k, u in zip(keys, row, strict=True)] for row in sobol]
    return [stack.put(keys, point) for point in points]


def _near(stack: Stack, keys: Sequence[Key]) -> list[list[float]]:
    """Return the parameter values with each one in turn a little less and a little more than it is."""
    here, out = [stack.get(key) for key in keys], []
    for j, key in enumerate(keys):
        p, step = stack.parameter(key), NEAR_SHARE * (stack.parameter(key).high - stack.parameter(key).low)
        one_sided = p.null in (p.low, p.high) and p.null == 0.0
        factors = (factor for each in NEAR_FACTORS for factor in (1.0 / each, each))
        moved = [here[j] * factor for factor in factors] if one_sided else [here[j] - step, here[j] + step]
        out += [[*here[:j], value, *here[j + 1 :]] for value in moved if p.low < value < p.high]
    return out


def guesses_of(effect: type[Effect], batch: Batch) -> list[dict[str, float]]:
    """Return the initial values that an effect estimates from readings; they are computed once for each batch."""
    if effect.name not in batch.guesses:
        batch.guesses[effect.name] = effect.guesses(echoes_of(batch))
    return batch.guesses[effect.name]


def _one_at_a_time(stack: Stack, keys: Sequence[Key], batch: Batch) -> list[list[float]]:
    """Return the parameter values with each one in turn fitted to the target's echo."""
    if not keys or stack.known[keys[0][0]].stage == Stage.SEQUENCE:  # it acts after the echo was timed
        return []
    here, expected = [stack.get(key) for key in keys], target_echo(stack, batch)
    moved = [(j, fitting_value(stack, key, batch, expected)) for j, key in enumerate(keys)]
    return [[*here[:j], value, *here[j + 1 :]] for j, value in moved if value is not None]


def fitting_value(stack: Stack, key: Key, batch: Batch, expected: Floats) -> float | None:
    """Return the least-absolute-error value of a parameter, from a linear model of the target's echo.

    It is the median of error / slope weighted by |slope|, which outliers hardly affect. None if the parameter does not
    shift the echo, `expected`, m, (n,).
    """
    p, rate, error = stack.parameter(key), slope(stack, key, batch, expected), batch.reading.range - expected
    moves = batch.is_target(error) & (np.abs(rate) * (p.high - p.low) > MIN_SHIFT_M)
    if not moves.any():
        return None
    ratio, weight = error[moves] / rate[moves], np.abs(rate[moves])
    order = np.argsort(ratio)
    middle = np.searchsorted(np.cumsum(weight[order]), 0.5 * weight.sum())
    return float(stack.get(key) + ratio[order][middle])


def slope(stack: Stack, key: Key, batch: Batch, expected: Floats) -> Floats:
    """Return the derivative of the target's echo, `expected`, with respect to a parameter, m per unit, (n,)."""
    p, here = stack.parameter(key), stack.get(key)
    step = 1e-3 * (p.high - p.low) * (1.0 if here < 0.5 * (p.low + p.high) else -1.0)
    return (target_echo(stack.put([key], [here + step]), batch) - expected) / step


def target_echo(stack: Stack, batch: Batch) -> Floats:
    """Return the reading of the target's echo without noise, m, (n,)."""
    with torch.no_grad():
        state = stack.model.state(batch.conditions)
        place = state.scale * (state.direct.length + state.direct.lag) + state.offset
    return np.asarray(torch.atleast_2d(place).mean(0).expand(len(batch)).numpy())


def echoes_of(batch: Batch) -> EchoSample:
    """Return the echoes of a batch in the form that `Effect.guesses` expects."""
    echo = batch.reading.echo
    ping = batch.ping[echo]
    known = ping.covariates.get(INTERVAL)
    past = np.where(batch.past.echo, batch.past.range, np.nan)[echo]
    before = ping.distance if known is None else ping.distance - known * ping.covariates.get(RANGE_RATE, 0.0)
    range_, silent = batch.reading.range[echo], int(np.sum(~echo))
    return EchoSample(ping.distance, ping.time, range_, known, past, before, batch.grid_m, silent)


def _candidates(p: Parameter, present: float, extra: Sequence[float]) -> list[float]:
    lengths = [m for m in extra if p.unit == "m" and p.high - p.low > 0.3 and p.low <= m <= p.high]
    # a null value is a starting point only beside others
    starts = list(p.starts) if len(p.starts) > 1 else [s for s in p.starts if s != p.null] or [present]
    return list(dict.fromkeys([*starts, *lengths]))


def between_bounds(p: Parameter, u: float) -> float:
    """Return the value at u, 0..1, between the bounds; logarithmic where they span more than two decades."""
    if p.low > 0 and p.high / p.low > 100.0:
        return float(p.low * (p.high / p.low) ** u)
    if p.null in (p.low, p.high):
        return float(p.null + (p.high + p.low - 2.0 * p.null) * u**2)
    # dense around the null value: small effects are likelier, and the likelihood of a narrow law is flat far away
    v = 2.0 * u - 1.0
    return float(p.null + abs(v) ** 3 * ((p.high - p.null) if v > 0 else (p.low - p.null)))


def nuisance_start(stack: Stack, batch: Batch) -> Stack:
    """Return the stack with nuisance parameters from robust statistics of the errors, on the wide side."""
    echo = batch.reading.echo
    middle = np.zeros(len(batch)) if not echo.any() else stack.expected(batch)
    known = echo & (middle > 0)
    error = (batch.reading.range - middle)[known]
    robust = robust_std(error) if len(error) else 0.005
    size = float(np.clip(robust, max(0.002, batch.resolution / 4.0), 0.15))
    wide = {(JITTER, "sigma_m"): max(stack.get((JITTER, "sigma_m")), 0.7 * size), (VISITS, "placement_m"): 0.5 * size}
    shared = {(VISITS, "urn_weight"): 0.02, (VISITS, "ping_correlation"): 0.1}
    shared[(VISITS, "urn_width_m")] = max(0.004, batch.resolution / 3.0)
    shared[SIMULATION_CORRELATION] = 0.0 if batch.simulated_offset is None else 0.5
    start = {**wide, **shared}
    level = stack.get(LEVEL_SD) if VISITS in stack.values else WEAK_DB
    return stack.put(list(start), np.minimum(list(start.values()), 0.19)).put([LEVEL_SD], [level])


def nuisance_starts(stack: Stack, batch: Batch) -> list[Stack]:
    """Return starts with weak and strong dependence within visits, and the present values if there are any."""
    weak = nuisance_start(stack, batch)
    strong = {(JITTER, "sigma_m"): 0.5 * weak.get((JITTER, "sigma_m"))}
    if VISITS not in stack.values:
        strong[LEVEL_SD] = STRONG_DB
    strong |= {(VISITS, "urn_weight"): 1.5, (VISITS, "urn_width_m"): max(0.001, batch.resolution / 3.0)}
    strong[(VISITS, "ping_correlation")] = 0.5
    present = [stack] if VISITS in stack.values else []
    return [weak, weak.at(strong), *present]


def robust_scatter(batch: Batch) -> float:
    """Return the robust scatter of echoes about the median of their visit, m, at least a fifth of the resolution."""
    deviation = deviation_from_median(batch)
    scatter = robust_std(deviation) if len(deviation) else batch.resolution
    return max(scatter, 0.2 * batch.resolution, MIN_SCATTER_M)


def deviation_from_median(batch: Batch) -> Floats:
    """Return the deviation of each echo from the median of its visit, m, (echoes,)."""
    error = pd.Series(batch.error[batch.reading.echo])
    return (error - error.groupby(batch.visit[batch.reading.echo]).transform("median")).to_numpy()
