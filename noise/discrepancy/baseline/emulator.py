"""The emulator: a law that describes the readings of a simulation.

It is physics first: what every sonar has (an axis, a beam, a threshold, losses), then effects of the
catalogue by forward selection, each kept only if it improves visits that it was not fitted to, then a smooth
correction in the law's own coordinates. Physics extrapolates to other conditions, and the correction describes the
rest where there are readings.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import qmc

from acquisition.arrays import Floats
from noise.effects import CATALOGUE
from noise.effects.mounting import RayCone
from noise.fitting.batch import Batch
from noise.fitting.fit import Fit, Scales, highest, maximise
from noise.fitting.learn_smooth import learn_smooth
from noise.fitting.likelihood import log_likelihood, log_likelihoods
from noise.fitting.smooth import DETECTION, HEADS, MIRRORED, SHIFT
from noise.fitting.smooth_basis import single_log_prob
from noise.fitting.stack import JITTER, LEVEL_SD, NUISANCES, PLACEMENT, SHARED, SPREAD, VISITS, Key, Stack
from noise.fitting.starts import extra_modes, nuisance_starts, starting_points
from noise.physical import PhysicalModel

# where the fit of what every sonar has begins: a level at which reflectors 1 to 4 m away are near the threshold, and
# some readings lost whatever the level, without which rare silence of strong echoes would put the threshold near them
START: dict[Key, float] = {
    ("clock_scale", "error"): 0.0,
    ("zero_offset", "offset_m"): 0.0,
    ("sensitivity", "loss_db"): 38.0,
    ("specular_loss", "strength"): 0.8,
    ("beam_width", "ka"): 2.0,
    ("time_walk", "scale"): 0.5,
    ("reflectance_loss", "strength"): 0.5,
    ("dropped_reading", "probability"): 0.01,
}
# ranges of what decides who is heard; a fit ends at a maximum near its start, so the best of a design begins
HEARING: dict[Key, tuple[float, float]] = {
    ("sensitivity", "loss_db"): (20.0, 55.0),
    ("specular_loss", "strength"): (0.0, 2.0),
    ("beam_width", "ka"): (0.0, 8.0),
    ("reflectance_loss", "strength"): (0.0, 1.5),
}
# ranges of a simulator of rays, which hears whatever is in its field of view
CONE: dict[Key, tuple[float, float]] = {
    ("ray_cone", "half_deg"): (5.0, 45.0),
    ("ray_cone", "half_width_m"): (0.0, 0.5),
    ("ray_cone", "steepest_deg"): (20.0, 90.0),
}
NEARBY = 0.3  # share of these ranges
LOUD: dict[Key, float] = {
    ("sensitivity", "loss_db"): 0.0,
    ("specular_loss", "strength"): 0.0,
    ("beam_width", "ka"): 0.0,
    ("time_walk", "scale"): 0.0,
    ("reflectance_loss", "strength"): 0.0,
}
N_DESIGN = 32  # a power of two; evaluated at once
# centres of priors: units and placements differ by 3 to 6 dB, and targets are placed within 1 to 5 mm. Without them, a
# threshold that separates the few positions that are heard from those that are missed seems exact, and a wide scatter
# of a few positions explains any error of their mean
FAMILIAR: dict[Key, float] = {LEVEL_SD: 3.0, PLACEMENT: 0.003}
PHYSICS_PINGS, SCREEN_PINGS, SMOOTH_PINGS = 1200, 600, 2000  # readings of each step, which bound the time
BASINS, SHORT = 4, 20  # starts of each kind that are followed, and steps after which the best goes on
MAX_LAG_NATS = 50.0  # after these steps, from which a kind is not followed; of 24 simulations none led from there
DESIGN = 2  # starting points of a quasi-random design for each candidate effect
CANDIDATES, ROUNDS = 3, 4  # effects that are fitted in a round, and rounds
MIN_GAIN_NATS = 3.0  # of a fit: odds of 20 to 1
LEVEL = 0.05  # probability that an effect of the catalogue joins by chance
LIKELIEST = 2  # starts of the effect that joins
ITERATIONS = 40
CONDITION_INPUTS = ("log_distance", "angle", "incidence", "reflectance")
TURNED_INPUTS = ("log_distance", "angle", MIRRORED, "reflectance")
INTERVAL = "interval_s"  # logged with every recording; it describes the past, not the condition


def emulate(readings: Batch, rng: np.random.Generator) -> Stack:
    """Return the law and nuisance parameters that describe a simulation's readings.

    Args:
        readings: of the simulation.
        rng: chooses visits, starting points and centres.
    """
    physics = with_catalogue(base_physics(readings.thin(PHYSICS_PINGS), rng), readings, rng)
    return with_smooth(physics, readings, rng)


def with_smooth(stack: Stack, readings: Batch, rng: np.random.Generator) -> Stack:
    """Return a law with its smooth correction by condition, and the nuisance parameters fitted beside it.

    What the physics misses at a position looks like scatter of placements. A correction of detection and range alone
    may explain that, and leaves less scatter; it is learned with no more scatter of the level than is familiar, since
    under a wide one nothing is gained by knowing who is heard. One of all aspects is learned with the scatter as it is:
    the spread and the tails would otherwise describe what the range lacks. Of these laws and that without a correction
    the one is returned that predicts conditions best which its correction was not fitted to.
    """
    batch = learner_pings(readings)
    few = batch.thin(PHYSICS_PINGS)
    laws = [stack]
    familiar = stack.at({LEVEL_SD: min(stack.get(LEVEL_SD), FAMILIAR[LEVEL_SD])})
    for start, heads, free in ((familiar, (DETECTION, SHIFT), NUISANCES), (stack, HEADS, SHARED)):
        first = _corrected(start, batch, heads, rng)
        if first.left_out is not None:
            laws.append(maximise(first, free, few, ITERATIONS, MIN_GAIN_NATS).stack)
    return max(laws, key=lambda law: crossed_log_likelihood(law, batch))


def crossed_log_likelihood(law: Stack, batch: Batch) -> float:
    """Return the log-likelihood of readings, nats, each under the correction that was fitted without its condition."""
    crossed = law if law.left_out is None else law.by_part(law.left_out.of(batch))
    return float(log_likelihood(crossed, batch).sum())


def _corrected(stack: Stack, batch: Batch, heads: Sequence[str], rng: np.random.Generator) -> Stack:
    inputs = [(*names, *_logged(batch)) for names in condition_inputs(batch)]
    learned = learn_smooth(stack, batch, inputs, single_log_prob, rng, heads)
    return replace(learned.stack, left_out=learned.left_out)


def learner_pings(batch: Batch) -> Batch:
    """Return the readings that a smooth correction is fitted to."""
    return batch.thin(SMOOTH_PINGS)


def condition_inputs(batch: Batch) -> list[tuple[str, ...]]:
    """Return the sets of conditions that a correction may depend on: two where sonar and target are both turned."""
    both = bool(np.any((batch.ping.angle != 0.0) & (batch.ping.incidence != 0.0)))
    return [CONDITION_INPUTS, TURNED_INPUTS] if both else [CONDITION_INPUTS]


def _logged(batch: Batch) -> list[str]:
    return [name for name in batch.ping.covariates if name != INTERVAL]


def base_physics(batch: Batch, rng: np.random.Generator) -> Stack:
    """Return the law with what every sonar has: the best fit from several starts."""
    sonar = replace(Stack.of(PhysicalModel((), batch.resolution)), familiar=FAMILIAR)
    bare = [stack.at(START) for stack in nuisance_starts(sonar, batch)]
    few = batch.thin(SCREEN_PINGS)
    # from a law in which the target is never missed no small step leads to a reflector that answers wherever it is
    behind = [bare[0].at(each) for mode in extra_modes(batch) if mode > 0.0 for each in _reflectors(mode)]
    loud = [stack.at(LOUD) for stack in bare]
    groups = [loud, *(_designed([stack], HEARING, rng) for stack in bare)]
    groups += [_designed(behind, HEARING, rng)] if behind else []
    if np.ptp(batch.ping.angle) > 0.0 or np.ptp(batch.ping.incidence) > 0.0:
        groups += [_designed([loud[0], *(stack.at(LOUD) for stack in behind)], CONE, rng)]
    near = [_nearest(group, few) for group in groups]
    if RayCone.name in highest(near).stack.values:
        near[-1] = _other_cone(near[-1].stack, few, rng)
    best = highest(near).nats
    good = [fit.stack for fit in near if fit.nats > best - MAX_LAG_NATS]
    fits = [maximise(each, (*_free(each), *NUISANCES), batch, ITERATIONS, 0.5) for each in good]
    return max(fits, key=lambda fit: fit.nats + _prior(fit.stack, (bare[0], loud[0]), batch.n_visits)).stack


def _prior(stack: Stack, familiar: Sequence[Stack], n_visits: int) -> float:
    """Return the log prior of what every sonar has, nats: near one of some laws, and Schwarz's penalty of what differs.

    Where every target is heard, readings say nothing of levels, and any that fits would put a threshold somewhere.
    """
    n_free = sum(stack.get(key) != stack.parameter(key).null for key in _free(stack))
    near = max(stack.log_size_prior(each, [name for name, _ in START]) for each in familiar)
    return near - 0.5 * n_free * float(np.log(n_visits))


def _other_cone(stack: Stack, few: Batch, rng: np.random.Generator) -> Fit:
    """Return the best fit from fields of view nearby: every edge that crosses a position is a maximum apart."""
    ranges = {}
    for key, (low, high) in CONE.items():
        here, half = np.clip(stack.get(key), low, high), NEARBY * (high - low)
        ranges[key] = max(low, here - half), min(high, here + half)
    return _nearest(_designed([stack], ranges, rng), few)


def _nearest(stacks: Sequence[Stack], few: Batch) -> Fit:
    """Return the best of the likeliest stacks after a few steps: the likelihood of a start says little of its basin."""
    likeliest = np.argsort(-log_likelihoods(stacks, few), kind="stable")[:BASINS]
    starts, scales = [stacks[k] for k in likeliest], Scales()
    fits = (maximise(each, (*_free(each), *NUISANCES), few, SHORT, MIN_GAIN_NATS, scales) for each in starts)
    return highest(fits)


def _designed(
    stacks: Sequence[Stack], ranges: Mapping[Key, tuple[float, float]], rng: np.random.Generator
) -> list[Stack]:
    """Return stacks as they are, and with quasi-random values within ranges."""
    low, high = np.transpose(list(ranges.values()))
    points = qmc.scale(qmc.Sobol(len(ranges), rng=rng).random(N_DESIGN), low, high)
    return [*stacks, *(stack.put(list(ranges), point) for stack in stacks for point in points)]


def _reflectors(length_m: float) -> tuple[dict[Key, float], dict[Key, float]]:
    """Return a reflector so far behind the target, and one at a fixed range, both nearly always present."""
    behind, fixed = "background_reflector", "fixed_clutter"
    return (
        {(behind, "presence"): 0.9, (behind, "behind_m"): length_m, (behind, "loss_db"): 5.0},
        {(fixed, "presence"): 0.9, (fixed, "range_m"): length_m, (fixed, "spread_m"): 0.02},
    )


@dataclass(frozen=True)
class Candidate:
    """An effect with starting values, and its gain on readings.

    Attributes:
        name: effect id.
        stacks: the law with it, from the likeliest starts, best first.
        gain: of the best, nats.
    """

    name: str
    stacks: tuple[Stack, ...]
    gain: float


def with_catalogue(stack: Stack, readings: Batch, rng: np.random.Generator) -> Stack:
    """Return the law with every effect of the catalogue that improves unseen visits, by forward selection."""
    batch, few = readings.thin(PHYSICS_PINGS), readings.thin(SCREEN_PINGS)
    names = [name for name in CATALOGUE if _can_be_added(stack, name, batch)]
    for _ in range(ROUNDS):
        ranked = screened(stack, names, few, rng)
        halves = Halves.of(stack, few, rng)
        passed = [(c, gain) for c in ranked[:CANDIDATES] if (gain := halves.gain(c)) is not None]
        if not passed:
            break
        best = max(passed, key=lambda each: each[1])[0]
        free = (*_free(best.stacks[0]), *NUISANCES)
        stack = highest(maximise(start, free, batch, ITERATIONS, 0.5) for start in best.stacks).stack
        failed = {c.name for c in ranked[:CANDIDATES]} - {c.name for c, _ in passed}
        names = [c.name for c in ranked if c.name not in failed | {best.name}]
    return stack


def _can_be_added(stack: Stack, name: str, batch: Batch) -> bool:
    """Return whether an effect is absent, or lacks a parameter that a logged covariate identifies.

    What follows the clock of the day on which the simulation ran, such as a drift of its air, is no property of it: a
    survey in order of distance has the time stand for the distance, and another day has another drift.
    """
    if CATALOGUE[name].by_clock:
        return False
    covariates = (p for p in CATALOGUE[name].parameters if p.covariate)
    return name not in stack.values or any(p.identifiable(batch.ping.covariates) for p in covariates)


def screened(stack: Stack, names: Sequence[str], batch: Batch, rng: np.random.Generator) -> list[Candidate]:
    """Return the effects whose best starting point improves the likelihood, best first."""
    now, out = float(log_likelihood(stack, batch).sum()), []
    for name in names:
        starts = starting_points(stack, name, batch, rng, DESIGN)
        nats = log_likelihoods(starts, batch)
        best = np.argsort(-nats, kind="stable")[:LIKELIEST]
        out.append(Candidate(name, tuple(starts[k] for k in best), float(nats.max()) - now))
    good = (each for each in out if each.gain > 0.0 and not each.stacks[0].is_the_target(each.name, batch))
    return sorted(good, key=lambda each: -each.gain)


@dataclass(frozen=True, eq=False)
class Halves:
    """Visits in two halves, and the log-likelihood of each visit by the law fitted to the other half, nats."""

    parts: tuple[Batch, Batch]
    nats: tuple[Floats, Floats]

    @classmethod
    def of(cls, stack: Stack, batch: Batch, rng: np.random.Generator) -> Halves:
        """Divide the visits, and fit the spread of a law to each half."""
        half = rng.permutation(np.arange(batch.unit.max() + 1) % 2)[batch.unit]
        parts = batch.select(half == 0), batch.select(half == 1)
        return cls(parts, _crossed(stack, SPREAD, parts))

    def gain(self, candidate: Candidate) -> float | None:
        """Return the gain of an effect on unseen visits, nats; None where it is not clearly positive."""
        keys = [(candidate.name, p.name) for p in CATALOGUE[candidate.name].parameters]
        with_it = _crossed(candidate.stacks[0], (*keys, *SPREAD), self.parts)
        gain = np.concatenate(with_it) - np.concatenate(self.nats)
        # the exponential of a gain on unseen visits is an e-value; no single visit decides
        good = gain.sum() - gain.max() > np.log(len(CATALOGUE) / LEVEL)
        return float(gain.sum()) if good else None


def _crossed(stack: Stack, free: Sequence[Key], parts: tuple[Batch, Batch]) -> tuple[Floats, Floats]:
    """Return the log-likelihood of each visit of both halves by a law fitted to the other half, nats."""
    first, second = parts
    pairs = ((_fitted(stack, free, second), first), (_fitted(stack, free, first), second))
    nats = [part.visit_sums(log_likelihood(law, part)) for law, part in pairs]
    return nats[0], nats[1]


def _fitted(stack: Stack, free: Sequence[Key], batch: Batch) -> Stack:
    return maximise(stack, free, batch, ITERATIONS // 2, MIN_GAIN_NATS).stack


def _free(stack: Stack) -> list[Key]:
    """Return every parameter of the effects of a stack."""
    return [(name, p) for name, inner in stack.values.items() if name != VISITS for p in inner if name != JITTER]
