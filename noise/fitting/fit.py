"""Maximum likelihood of the parameters of a stack of effects, with what cells share as a nuisance.

`maximise` frees some parameters of a `Stack` and climbs the prequential likelihood of `noise.fitting.visit_effects` by L-BFGS-B in
coordinates scaled by the curvature, from the starting points it is given (`noise.fitting.starts` makes them).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.optimize import minimize
from torch import Tensor

from acquisition import Recording
from noise.fitting.batch import Batch
from noise.fitting.stack import CELLS, JITTER, LINK, NUISANCES, SPREAD, Key, Stack
from noise.fitting.starts import nuisance_start
from noise.fitting.visit_effects import law_of, log_prob
from noise.law import Floats
from noise.physical import PhysicalModel

TOLERANCE = 1e-7  # of the log likelihood, relative, where rounding ends: about 0.002 nats in 20,000
STEP_SHARE = 0.02  # of what a climb must gain: a step that gains less ends it
ROUGHEST = 0.05  # nats; no climb ends at a step that gains more
ENOUGH = 0.05  # nats that a restart must gain for another to follow
RESTARTS = 4
HASTY = 2  # iterations, in which a climb that slopes promise more has met an edge and no summit; ours
PROMISED = 1.0  # nats; ours
SLIGHT = 0.03  # of a scale: a step by which no slope changes; ours
RANKING = 1.0  # nats; a climb that need not gain more only ranks, and goes on with the scale that it met; ours
CHANGE = (1e-4, 1e4)  # of curvature in one climb that is believed; ours
REPEATED = (1.0, 0.3, 0.1, 0.03)  # of the share of what is new in a cell: the share of all its pings; ours
MUCH_SHARED = 0.2  # weight of an earlier reading against the law, beyond which cells repeat themselves; ours
PRIOR_SHARE = 0.125  # standard deviation of what has no cause, as a share of its bounds; ours

Scales = dict[Key, float]


def log_likelihood(stack: Stack, batch: Batch) -> Floats:
    """Return the prequential log probability of each reading, nats, (n,)."""
    with torch.no_grad():
        model, cells = stack.build()
        return log_prob(law_of(model, batch), cells, batch).numpy()


@dataclass(frozen=True)
class Fit:
    """A maximum of the likelihood.

    Attributes:
        stack: with the best values.
        free: what was free.
        nats: log likelihood there.
    """

    stack: Stack
    free: tuple[Key, ...]
    nats: float


class _Objective:
    """Minus the log likelihood and its gradient in the free parameters."""

    def __init__(self, stack: Stack, free: Sequence[Key], batch: Batch) -> None:
        self.stack, self.free, self.batch = stack, tuple(free), batch
        self._last: tuple[bytes, tuple[float, Floats]] | None = None

    def __call__(self, x: Floats) -> tuple[float, Floats]:
        """Return value and gradient at physical parameter values x, (p,); the last point asked is remembered."""
        asked = x.tobytes()
        if self._last is None or self._last[0] != asked:
            self._last = asked, self._at(x)
        return self._last[1]

    def _at(self, x: Floats) -> tuple[float, Floats]:
        numbers = torch.tensor(x, dtype=torch.float64, requires_grad=True)
        model, cells = self.stack.build(self.free, numbers)
        total = -log_prob(law_of(model, self.batch), cells, self.batch).sum() + self._prior(numbers)
        if not total.requires_grad:  # a stepwise effect alone, such as rounding, has no slope anywhere
            return float(total), np.zeros(len(x))
        (gradient,) = torch.autograd.grad(total, numbers, allow_unused=True)
        gradient = torch.zeros_like(numbers) if gradient is None else gradient
        return float(total.detach()), np.nan_to_num(gradient.numpy(), nan=0.0, posinf=0.0, neginf=0.0)

    def _prior(self, numbers: Tensor) -> Tensor:
        """Return minus the log prior: normal around the null for what has no cause, flat for everything else."""
        total = numbers.new_zeros(())
        for number, key in zip(numbers, self.free, strict=True):
            if key[0] in self.stack.extra:
                p = self.stack.parameter(key)
                total = total + 0.5 * ((number - p.null) / (PRIOR_SHARE * (p.high - p.low))) ** 2
        return total

    def is_flat(self, x: Floats) -> bool:
        """Tell whether no parameter has a slope to climb that leads inside its bounds."""
        low, high = self.bounds()
        down = -self(x)[1]
        return not np.any(((down > 0) & (x < high)) | ((down < 0) & (x > low)))

    def promise(self, x: Floats, scale: Floats) -> float:
        """Return what a Newton step in each parameter by itself would gain, as far as its bounds let it, nats."""
        low, high = self.bounds()
        slope = self(x)[1]
        step = np.clip(x - slope * scale**2, low, high) - x
        return float(np.sum(-slope * step - 0.5 * (step / scale) ** 2))

    def at_an_edge(self, x: Floats, scale: Floats) -> NDArray[np.bool_]:
        """Tell which parameters lose by a slight step that their slopes call a gain, (p,).

        The span of a uniform law ends at the farthest reading that it explains: no slope leads across.
        """
        low, high = self.bounds()
        best, slope = self(x)
        out = np.zeros(len(x), dtype=bool)
        for j in np.flatnonzero(slope):
            moved = x.copy()
            moved[j] = np.clip(x[j] - np.sign(slope[j]) * SLIGHT * scale[j], low[j], high[j])
            out[j] = self(moved)[0] > best
        return out

    def bounds(self) -> tuple[Floats, Floats]:
        """Return least and greatest values, null included, (p,) each."""
        known = [self.stack.parameter(key) for key in self.free]
        low = np.array([min(p.low, p.null) for p in known])
        return low, np.array([max(p.high, p.null) for p in known])

    def visit_nats(self, x: Floats) -> Floats:
        """Return the log likelihood of each block at x, nats."""
        return self.batch.visit_sums(log_likelihood(self.stack.put(self.free, x), self.batch))

    def scale(self, x: Floats, known: Scales | None = None) -> Floats:
        """Return the step in each parameter that costs about half a nat, from finite differences of the gradient.

        Args:
            x: where.
            known: scales of parameters that need not be measured again.
        """
        low, high = self.bounds()
        width = high - low
        out = np.array([(known or {}).get(key, np.nan) for key in self.free])
        unknown = np.flatnonzero(np.isnan(out))
        base = self(x)[1] if len(unknown) else out
        for j in unknown:
            step = 1e-4 * width[j] if x[j] < low[j] + 0.5 * width[j] else -1e-4 * width[j]
            moved = x.copy()
            moved[j] += step
            gradient = self(moved)[1][j]
            curvature = max(abs(gradient - base[j]) / abs(step), 0.1 * abs(base[j]) / width[j])
            out[j] = 1.0 / np.sqrt(max(curvature, 1e-300))
        return _between(out, width)


def maximise(
    stack: Stack,
    free: Sequence[Key],
    batch: Batch,
    iterations: int = 60,
    enough: float = ENOUGH,
    scales: Scales | None = None,
) -> Fit:
    """Climb from where the stack is; never returns less than it started from.

    Args:
        stack: start, and the values of what is not free.
        free: parameters to move.
        batch: readings.
        iterations: of L-BFGS-B, shared by its restarts.
        enough: nats that a climb must gain for another to follow it.
        scales: of nuisances, as an earlier fit to the same readings measured them; what is measured here is added.
    """
    free = [key for key in free if key != LINK or batch.simulated_offset is not None]
    objective = _Objective(stack, free, batch)
    x = np.array([stack.get(key) for key in free])
    best = objective(x)[0]
    left = iterations
    scale: Floats | None = None
    held = np.zeros(len(x), dtype=bool)
    # curvatures change by orders of magnitude on the way up, so the scale is measured again after every climb
    for attempt in range(RESTARTS):
        if objective.is_flat(x):
            break
        if scale is None or enough < RANKING:
            scale = objective.scale(x, scales if attempt == 0 else None)
        if scales is not None:
            scales.update({key: value for key, value in zip(free, scale, strict=True) if key in NUISANCES})
        end = _climb(objective, x, scale, max(left, 1), min(STEP_SHARE * enough, ROUGHEST), held)
        gain, left = best - end.value, left - end.iterations
        if gain > 0:
            x, best = end.x, end.value
        if left <= 0:
            break
        if gain < enough:
            hasty = not held.any() and end.iterations <= HASTY
            if not hasty or objective.promise(x, scale) < max(PROMISED, enough):
                break
            held = objective.at_an_edge(x, scale)
            if held.all() or not held.any():
                break
        scale = end.scale
    return Fit(stack.put(free, x), tuple(free), -best)


@dataclass(frozen=True)
class _End:
    """Where a climb ended: minus the log likelihood there, iterations, and the scales as the climb met them."""

    x: Floats
    value: float
    iterations: int
    scale: Floats


def _climb(
    objective: _Objective, x0: Floats, scale: Floats, iterations: int, least: float, held: NDArray[np.bool_]
) -> _End:
    """Climb; a step of `least` nats ends it, and what is held stays where it is."""
    start = objective(x0)[0]
    low, high = objective.bounds()
    width = high - low
    low, high = np.where(held, x0, low), np.where(held, x0, high)

    def scaled(y: Floats) -> tuple[float, Floats]:
        value, gradient = objective(np.clip(x0 + y * scale, low, high))
        return (value, gradient * scale) if np.isfinite(value) else (1e15, np.zeros_like(y))

    result = minimize(
        scaled,
        np.zeros(len(x0)),
        jac=True,
        method="L-BFGS-B",
        bounds=list(zip((low - x0) / scale, (high - x0) / scale, strict=True)),
        options={
            "maxiter": iterations,
            "ftol": max(TOLERANCE, least / max(abs(start), 1.0)),
            "gtol": 1e-2,
            "maxcor": 12,
        },
    )
    x = np.clip(x0 + result.x * scale, low, high)
    change = np.sqrt(np.clip(np.diag(result.hess_inv @ np.eye(len(x))), *CHANGE))
    return _End(x, float(result.fun), int(result.nit), _between(scale * change, width))


def _between(scale: Floats, width: Floats) -> Floats:
    """Return steps that are neither lost in rounding nor wider than a quarter of the bounds."""
    return np.clip(scale, 1e-6 * width, 0.25 * width)


def each_counted(joint: Fit, keys: Sequence[Key], batch: Batch) -> Fit:
    """Return a fit in which every reading counts, where cells repeat themselves; the given one where they do not.

    The urn answers for what a cell repeats and leaves to the law what is new, which strays are more often: their share
    would come out too high. Here the urn is off, and errors must be taken over blocks (`covariance` does). What moves
    whole cells is left as it is: with the urn off, a few cells that stand apart would drag it along.

    Args:
        joint: a fit with the urn.
        keys: parameters of effects; those that strike single pings are moved, and the spread.
        batch: it was fitted to.
    """
    keys = [key for key in keys if joint.stack.known[key[0]].by_ping]
    if not keys or joint.stack.get((CELLS, "sharing")) < MUCH_SHARED:
        return joint
    alone = joint.stack.put([(CELLS, "sharing"), (CELLS, "carry")], [0.0, 0.0])
    spread = 0.7 * max(joint.stack.get((JITTER, "sigma_m")), joint.stack.get((CELLS, "placement_m")))
    # from no scatter of cells at all no climb leads away: its slope is zero there
    loose = alone.put([(JITTER, "sigma_m"), (CELLS, "placement_m")], [spread, spread])
    # with a spread that does not fit, the first step of a climb may throw a share to zero, from where none leads back
    fitting = [maximise(stack, SPREAD, batch, 40).stack for stack in (alone, loose)]
    best = best_of([_rarer(stack, keys, batch) for stack in fitting], (*keys, *SPREAD), batch, 80)
    if not _lost(best.stack, keys):
        return best
    # a few strays are explained by cells that scatter more as well: then the scatter is left as the urn has it
    held = maximise(_rarer(alone, keys, batch), keys, batch, 40)
    return joint if _lost(held.stack, keys) else held


def _rarer(stack: Stack, keys: Sequence[Key], batch: Batch) -> Stack:
    """Return a stack whose effects strike as often as is likeliest of some shares: the urn's are of what is new."""
    shares = _shares(stack, keys)
    tries = [stack.put(shares, [part * stack.get(key) for key in shares]) for part in REPEATED]
    return max(tries, key=lambda each: float(log_likelihood(each, batch).sum()))


def _shares(stack: Stack, keys: Sequence[Key]) -> list[Key]:
    """Return the parameters that say how often effects strike: the first of each."""
    return [(name, stack.known[name].parameters[0].name) for name in dict.fromkeys(key[0] for key in keys)]


def _lost(stack: Stack, keys: Sequence[Key]) -> bool:
    """Tell whether an effect that had been found has come to nothing."""
    return any(stack.get(key) == stack.parameter(key).null for key in _shares(stack, keys))


def best_of(stacks: Sequence[Stack], free: Sequence[Key], batch: Batch, iterations: int = 60) -> Fit:
    """Return the best of several climbs."""
    return highest(maximise(stack, free, batch, iterations) for stack in stacks)


def highest(fits: Iterable[Fit]) -> Fit:
    """Return the fit of the highest likelihood, the first of equals."""
    return max(fits, key=lambda fit: fit.nats)


def fit(
    model: PhysicalModel,
    recording: Recording,
    free: Sequence[Key] | None = None,
    nuisances: bool = True,
    iterations: int = 200,
) -> Fit:
    """Fit a physical model to a recording by maximum likelihood, cells' shared offsets included.

    Args:
        model: where to start.
        recording: to explain.
        free: (effect, parameter) pairs to move; all of the model's own by default.
        nuisances: whether spread and what cells share are free as well.
        iterations: at most.

    >>> import numpy as np
    >>> from acquisition import Ping
    >>> from noise.effects import CATALOGUE
    >>> warm = PhysicalModel([CATALOGUE["clock_scale"](error=0.01), CATALOGUE["travel_time_jitter"](sigma_m=0.004)])
    >>> ping = Ping.of(distance=np.repeat(np.linspace(0.3, 3.0, 30), 5))
    >>> heard = Recording.of(ping, warm.law(ping).sample(np.random.default_rng(1)))
    >>> found = fit(PhysicalModel([CATALOGUE["clock_scale"]()]), heard)
    >>> abs(found.stack.get(("clock_scale", "error")) - 0.01) < 0.001
    True
    """
    batch = Batch.of(recording)
    stack = Stack.of(model)
    own = [(name, parameter) for name, inner in stack.values.items() for parameter in inner]
    chosen = list(own if free is None else free)
    if nuisances:
        stack = nuisance_start(stack, batch)
        chosen = list(dict.fromkeys([*chosen, *NUISANCES]))
    return maximise(stack, chosen, batch, iterations)


def covariance(fitted: Fit, batch: Batch) -> NDArray[np.float64]:
    """Return the covariance of the free parameters, robust to what blocks share, (p, p).

    Huber's sandwich over blocks, and not below the inverse curvature. A parameter on one of its bounds is held there:
    its rows and columns are zero. A wide normal prior (half the bounds) keeps what the data do not tell finite.
    """
    objective = _Objective(fitted.stack, fitted.free, batch)
    x = np.array([fitted.stack.get(key) for key in fitted.free])
    low, high = objective.bounds()
    inside = np.flatnonzero((x > low + 1e-6 * (high - low)) & (x < high - 1e-6 * (high - low)))
    out = np.zeros((len(x), len(x)))
    if len(inside):
        out[np.ix_(inside, inside)] = _sandwich(objective, x, inside, objective.scale(x))
    return out


def _sandwich(objective: _Objective, x: Floats, inside: NDArray[np.int64], scale: Floats) -> NDArray[np.float64]:
    """Return the robust covariance of the parameters at `inside`."""
    low, high = objective.bounds()
    curvature, score = [], []
    for j in inside:
        step = np.zeros_like(x)
        step[j] = min(0.5 * scale[j], 0.5 * (x[j] - low[j]), 0.5 * (high[j] - x[j]))
        difference = objective(x + step)[1] - objective(x - step)[1]
        curvature.append(difference[inside] / (2.0 * step[j]) * scale[j] * scale[inside])
        above, below = (objective.visit_nats(x + sign * step) for sign in (1, -1))
        score.append((above - below) / (2.0 * step[j]) * scale[j])
    prior = np.diag((scale / (0.5 * (high - low)))[inside] ** 2)
    matrix = (np.stack(curvature) + np.stack(curvature).T) / 2.0 + prior
    eigenvalue, vector = np.linalg.eigh(matrix)
    inverse = (vector / np.maximum(eigenvalue, 0.02)) @ vector.T
    by_block = np.stack(score, axis=1)
    blocks, p = by_block.shape
    robust = inverse @ (by_block.T @ by_block) @ inverse * blocks / max(blocks - p, 1)
    robust += np.diag(np.maximum(np.diag(inverse) - np.diag(robust), 0.0))
    return robust * np.outer(scale[inside], scale[inside])
