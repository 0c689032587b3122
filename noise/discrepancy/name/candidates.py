"""Candidate effects of a recording: those that its sampling can show, and where a fit of each starts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from acquisition.arrays import Floats
from noise.discrepancy.name.hypothesis import may_lead
from noise.discrepancy.thresholds import EXPLAINED_SHARE
from noise.effects import CATALOGUE, Effect, Parameter
from noise.fitting.batch import Batch
from noise.fitting.fit import Fit
from noise.fitting.likelihood import log_likelihood, log_likelihoods
from noise.fitting.stack import JITTER, SPREAD, STEPWISE, Key, Stack
from noise.fitting.starts import guesses_of, nuisance_start, robust_scatter, starting_points

AT_BOUND = 1e-3  # share of the width of the bounds within which a parameter counts as at its bound
INSIDE, NEEDED = 0.1, 3.0  # share of that width, and nats that a value so far inside loses where a bound is needed
CLOSE = 3.0  # nats between starts that a few readings cannot tell apart
NARROWER = 0.7  # ratio of two scatters from which fits begin with both
DESIGN = 8  # quasi-random starting points of an effect, a power of two
WIDTH = "spread_m"  # of the echoes of another reflector

Starts = tuple[float, list[Stack]]  # log-likelihood of the best start of an effect, and its starts, the best first


def shows(effect: type[Effect], batch: Batch) -> bool:
    """Return whether the sampling of a recording shows an effect at all."""
    fine = batch.grid_m <= effect.coarsest_step_m
    brief = any(p.decays and longest_constant(batch) <= p.low for p in effect.parameters)
    return (batch.timed or not effect.needs_time) and fine and not brief and not effect.of_simulators


def sampled_bounds(batch: Batch) -> dict[Key, Parameter]:
    """Return the periods and time constants of the catalogue with the bounds that a recording resolves.

    A period below twice the sampling interval cannot be told from a longer one (Nyquist), and one above half the
    recording cannot be told from a trend. Where the sampling resolves no period, it keeps its null value. A time
    constant is limited by `longest_constant`.
    """
    low, high = resolved_periods(batch)
    every = [(name, p) for name, effect in CATALOGUE.items() for p in effect.parameters]
    periods = {(name, p.name): _limited(p, low, high) for name, p in every if p.cycle}
    return periods | {(name, p.name): _limited(p, p.low, longest_constant(batch)) for name, p in every if p.decays}


def _limited(p: Parameter, low: float, high: float) -> Parameter:
    low, high = max(p.low, low), min(p.high, high)
    if low >= high:
        return replace(p, low=p.null, high=p.null, starts=(p.null,))
    middle = float(np.sqrt(low * high))
    starts = tuple(start for start in p.starts if low < start < high) or (middle,)
    return replace(p, low=low, high=high, null=float(np.clip(p.null, low, high)), starts=starts)


def resolved_periods(batch: Batch) -> tuple[float, float]:
    """Return the shortest and longest period, s, that the times of a batch resolve."""
    step = np.diff(np.sort(batch.ping.time))
    step = step[step > 0]
    if not len(step):
        return np.inf, 0.0
    return 2.0 * float(np.median(step)), 0.5 * float(np.ptp(batch.ping.time))


def longest_constant(batch: Batch) -> float:
    """Return the time constant, s, of a change of which half has died away at the end of a batch."""
    return float(np.ptp(batch.ping.time)) / float(np.log(2.0))


def candidate_names(base: Stack, batch: Batch, without: Sequence[str]) -> tuple[str, ...]:
    """Return the effects that may differ; the scatter of single pings is judged apart, since every fit frees it."""
    shown = (name for name, effect in CATALOGUE.items() if shows(effect, batch))
    return tuple(n for n in shown if n != JITTER and n not in without and keys_of(base, n, batch))


def with_sampled_bounds(base: Stack, batch: Batch) -> Stack:
    """Return the stack in which periods have the bounds that a batch resolves."""
    return replace(base, bounds={**base.bounds, **sampled_bounds(batch)})


def keys_of(base: Stack, name: str, batch: Batch) -> tuple[Key, ...]:
    """Return the parameters of an effect that the recording can identify."""
    every = [base.parameter((name, p.name)) for p in base.known[name].parameters]
    return tuple((name, p.name) for p in every if p.low < p.high and p.identifiable(batch.ping.covariates))


def starts_of_each(
    names: Sequence[str], stack: Stack, common: Stack, grid: Batch, whole: Batch, rng: np.random.Generator
) -> dict[str, Starts]:
    """Return the starts of each of some effects; see `starts_of` and `scatters_of`."""
    scatters = scatters_of(stack, common, whole)
    return {name: starts_of(stack, scatters, name, grid, whole, rng) for name in names}


def starts_of(
    stack: Stack, scatters: Sequence[Stack], name: str, grid: Batch, whole: Batch, rng: np.random.Generator
) -> Starts:
    """Return the log-likelihood of the best start of an effect, and starts that are worth a fit, the best first.

    These are the best with each scatter, since what a law without the effect gets wrong stretches its scatter and no
    local fit leads back from there, the second best where a few readings cannot tell it from the best, and what the
    effect itself estimates from the readings: until it is fitted, the scatter may describe the readings as well.

    Args:
        stack: without the effect.
        scatters: the same with other scatters, of `scatters_of`.
        name: effect id.
        grid: readings for the extra modes and the log-likelihood.
        whole: readings for the other estimates.
        rng: scrambles the design.
    """
    points = starting_points(stack, name, grid, rng, DESIGN, whole)
    keys = keys_of(stack, name, whole)
    values = [{key: point.get(key) for key in keys} for point in points]
    starts = [*points, *(other.at(value) for other in scatters for value in values)]
    nats = log_likelihoods(starts, grid)
    order = np.argsort(-nats, kind="stable")
    group = order // len(points)
    first = [int(np.argmax(group == k)) for k in range(len(scatters) + 1)]
    second = [1] if nats[order[1]] > nats[order[0]] - CLOSE else []
    guesses = [stack.at({key: guess[key[1]] for key in keys}) for guess in guesses_of(stack.known[name], whole)]
    estimates = [{key: guess.get(key) for key in keys} for guess in guesses]
    estimated = [k for k, row in enumerate(order) if row < len(points) and values[row] in estimates]
    return float(nats[order[0]]), [starts[order[k]] for k in sorted({*first, *second, *estimated})]


def scatters_of(stack: Stack, common: Stack, batch: Batch) -> list[Stack]:
    """Return the stack with the scatter of the simulation and with that of most readings, where either is narrower."""
    alike = stack.put(SPREAD, [common.get(key) for key in SPREAD])
    others = (alike, narrowed(stack, batch))
    return [each for each in others if any(each.get(key) < NARROWER * stack.get(key) for key in SPREAD)]


def gains_of(points: Mapping[str, Starts], stack: Stack, screen: Batch) -> dict[str, Floats]:
    """Return what the best starts of effects gain on each visit over a stack, nats, the greatest gain first.

    Args:
        points: log-likelihood of the best start of each effect, and its starts, the best first.
        stack: without the effects.
        screen: readings.
    """
    nats = screen.unit_sums(log_likelihood(stack, screen))
    order = sorted(points, key=lambda name: -points[name][0])
    return {name: screen.unit_sums(log_likelihood(points[name][1][0], screen)) - nats for name in order}


def leading(names: Sequence[str], fits: Mapping[str, Fit], screen: Batch, least_gain: float) -> list[str]:
    """Return the effects that may lead on other visits, of those sorted by their fit to a screen."""
    nats = {name: screen.unit_sums(log_likelihood(fits[name].stack, screen)) for name in names}
    behind = {name: nats[names[0]] - nats[name] for name in names}
    return [name for name in names if may_lead(behind[name].sum(), behind[name], least_gain)]


def narrowed(stack: Stack, batch: Batch) -> Stack:
    """Return the stack with the scatter of most readings about the median of their visit."""
    return nuisance_start(stack, batch).put([(JITTER, "sigma_m")], [robust_scatter(batch)])


def explains_nothing(stack: Stack, base: Stack, name: str, batch: Batch) -> bool:
    """Return whether an effect does not explain its gain inside its bounds, or is no other than the target."""
    if stack.is_the_target(name, batch):
        return True
    beyond = gained_at_bounds(stack, base, name, batch)
    return beyond > 0.0 and beyond > (1.0 - EXPLAINED_SHARE) * _gain(stack, base, name, batch)


def log_prior(stack: Stack, base: Stack, effects: Sequence[str], batch: Batch) -> float:
    """Return the log prior of sizes and nuisance parameters, less what effects gain only at bounds, nats."""
    beyond = sum(gained_at_bounds(stack, base, name, batch) for name in effects)
    return stack.log_size_prior(base, effects) + stack.log_nuisance_prior() - beyond


def gained_at_bounds(stack: Stack, base: Stack, name: str, batch: Batch) -> float:
    """Return what an effect gains only with parameters at bounds, nats: its source allows no more of them.

    It is what is lost with such a parameter further inside. The null and the value of the base are no bounds in this
    sense, nor are the ends of a share, 0 and 1, nor is a width within one step of the register, which is none at all.
    Stepwise parameters have no derivative and stay at their starts. A parameter that the readings do not tell, such as
    the level of what is heard anyway, may end at a bound without needing it.
    """
    out = 0.0
    for key in keys_of(stack, name, batch):
        p, value = stack.parameter(key), stack.get(key)
        if p.name in STEPWISE or (p.low, p.high) == (0.0, 1.0) or (p.name == WIDTH and value <= batch.resolution):
            continue
        slack = AT_BOUND * (p.high - p.low)
        moved = abs(value - p.null) > slack and abs(value - base.get(key)) > slack
        if moved and (value <= p.low + slack or value >= p.high - slack):
            lost = _lost_inside(stack, key, batch)
            out += lost if lost > NEEDED else 0.0
    return out


def as_in(stack: Stack, base: Stack, name: str) -> Stack:
    """Return a stack with an effect as it is in the base."""
    if name not in base.values:
        return stack.without(name)
    return stack.at({(name, p.name): base.get((name, p.name)) for p in stack.known[name].parameters})


def _lost_inside(stack: Stack, key: Key, batch: Batch) -> float:
    """Return the log-likelihood, nats, that is lost with a parameter at a bound moved further inside."""
    p, value = stack.parameter(key), stack.get(key)
    inside = value + INSIDE * (p.high - p.low) * (1.0 if value < 0.5 * (p.low + p.high) else -1.0)
    return _nats(stack, batch) - _nats(stack.at({key: inside}), batch)


def _gain(stack: Stack, base: Stack, name: str, batch: Batch) -> float:
    """Return the log-likelihood, nats, that a stack gains over the base and over itself without an effect."""
    without = base, as_in(stack, base, name)
    return _nats(stack, batch) - max(_nats(law, batch) for law in without)


def _nats(stack: Stack, batch: Batch) -> float:
    return float(log_likelihood(stack, batch).sum())
