"""Maximum-likelihood estimates of the parameters of a stack of effects, with visit effects as nuisance parameters.

`maximise` maximises the prequential likelihood of `noise.fitting.visit_effects` over free parameters of a `Stack` by
L-BFGS-B, in coordinates scaled by the curvature; `noise.fitting.starts` provides starting points.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.optimize import minimize
from torch import Tensor

from acquisition import Recording
from acquisition.arrays import Floats
from noise.fitting.batch import Batch
from noise.fitting.likelihood import at_each, likeliest
from noise.fitting.stack import JITTER, NUISANCES, SIMULATION_CORRELATION, SPREAD, STEPWISE, VISITS, Key, Stack
from noise.fitting.starts import nuisance_start
from noise.fitting.visit_effects import VisitEffects, law_of, log_prob
from noise.physical import PhysicalModel

# all values chosen here
TOLERANCE = 1e-7  # relative, of the log-likelihood, above rounding: about 0.002 nats in 20,000
STEP_SHARE = 0.02  # a local fit ends at a step that gains less than this share of `min_gain`
MAX_LAST_STEP = 0.05  # nats; no local fit ends at a step that gains more
MIN_RESTART_GAIN = 0.05  # nats that a local fit must gain for another to follow
RESTARTS = 4
STALLED_ITERATIONS = 2  # a local fit with so few iterations may have stopped at a discontinuity instead of an optimum
MIN_PREDICTED_GAIN = 1.0  # nats that a Newton step must predict for a discontinuity to be considered
PROBE_STEP = 0.03  # of a parameter's scale: a step over which the gradient is constant
COARSE_GAIN = 1.0  # nats; with a larger `min_gain`, fits only rank candidates and the scale is not measured again
CURVATURE_CHANGE = (1e-4, 1e4)  # limits of the change of curvature during one local fit
PROBABILITY_FACTORS = (1.0, 0.3, 0.1, 0.03)  # from a share of the new readings of a visit to a share of all pings
MIN_URN_WEIGHT = 0.2  # above this, the readings of a visit repeat each other

Scales = dict[Key, float]


@dataclass(frozen=True)
class Fit:
    """A maximum of the likelihood.

    Attributes:
        stack: parameters at the maximum.
        free: free parameters.
        nats: log-likelihood at the maximum, with the prior of the nuisance parameters.
    """

    stack: Stack
    free: tuple[Key, ...]
    nats: float


class Objective:
    """Negative log posterior and its gradient with respect to the free parameters."""

    def __init__(self, stack: Stack, free: Sequence[Key], batch: Batch) -> None:
        self.stack, self.free, self.batch = stack, tuple(free), batch
        self._known: dict[bytes, tuple[float, Floats]] = {}

    def __call__(self, x: Floats) -> tuple[float, Floats]:
        """Return value and gradient at parameter values x, (p,); a fit returns to points that it has been at."""
        key = x.tobytes()
        if key not in self._known:
            self._known[key] = self._evaluate(x)
        return self._known[key]

    def _evaluate(self, x: Floats) -> tuple[float, Floats]:
        numbers = torch.tensor(x, dtype=torch.float64, requires_grad=True)
        total = self._total(numbers)
        return float(total.detach()), _gradient(total, numbers)

    def _total(self, numbers: Tensor, exact: bool = False) -> Tensor:
        model, visits = self.stack.build(self.free, numbers)
        total = -log_prob(law_of(model, self.batch), visits, self.batch, exact).sum()
        return total - self.stack.log_prior(self.free, numbers)

    def gradients(self, points: Floats) -> Floats:
        """Return the gradient at each of k points, (k, p); all at once where the law is continuous in them.

        The exact form of the likelihood differs by rounding, so that gradients are to be compared among themselves.
        """
        if any(key[1] in STEPWISE for key in self.free):
            return np.stack([self(x)[1] for x in points])
        numbers = torch.tensor(points, dtype=torch.float64, requires_grad=True)
        return _gradient(torch.vmap(lambda x: self._total(x, exact=True))(numbers).sum(), numbers)

    def is_flat(self, x: Floats) -> bool:
        """Return whether no parameter has a descent direction within its bounds."""
        low, high = self.bounds()
        down = -self(x)[1]
        return not np.any(((down > 0) & (x < high)) | ((down < 0) & (x > low)))

    def predicted_gain(self, x: Floats, scale: Floats) -> float:
        """Return the gain of a Newton step in each parameter separately, within its bounds, nats."""
        low, high = self.bounds()
        slope = self(x)[1]
        step = np.clip(x - slope * scale**2, low, high) - x
        return float(np.sum(-slope * step - 0.5 * (step / scale) ** 2))

    def at_discontinuity(self, x: Floats, scale: Floats) -> NDArray[np.bool_]:
        """Return for which parameters a small step along the gradient makes the likelihood worse, (p,).

        Example: the span of a uniform law that ends at the farthest reading it explains.
        """
        low, high = self.bounds()
        best, slope = self(x)
        out = np.zeros(len(x), dtype=bool)
        for j in np.flatnonzero(slope):
            moved = x.copy()
            moved[j] = np.clip(x[j] - np.sign(slope[j]) * PROBE_STEP * scale[j], low[j], high[j])
            out[j] = self(moved)[0] > best
        return out

    def bounds(self) -> tuple[Floats, Floats]:
        """Return lower and upper bounds, null value included, (p,) each."""
        known = [self.stack.parameter(key) for key in self.free]
        low = np.array([min(p.low, p.null) for p in known])
        return low, np.array([max(p.high, p.null) for p in known])

    def unit_nats(self, points: Floats) -> Floats:
        """Return the log-likelihood of each independent unit at each of k points, (k, p), nats, (k, units)."""

        def nats(model: PhysicalModel, visits: VisitEffects) -> Tensor:
            return log_prob(law_of(model, self.batch), visits, self.batch, exact=True)

        return np.stack([self.batch.unit_sums(each) for each in at_each(self.stack, self.free, points, nats)])

    def scale(self, x: Floats, known: Scales | None = None) -> Floats:
        """Return the step in each parameter that costs about half a nat, from finite differences of the gradient.

        Args:
            x: parameter values, (p,).
            known: scales of parameters that are known already.
        """
        low, high = self.bounds()
        width = high - low
        out = np.array([(known or {}).get(key, np.nan) for key in self.free])
        unknown = np.flatnonzero(np.isnan(out))
        if len(unknown):
            step = np.where(x < low + 0.5 * width, 1e-4, -1e-4)[unknown] * width[unknown]
            moved = np.tile(x, (len(unknown) + 1, 1))
            moved[np.arange(len(unknown)) + 1, unknown] += step
            base, *slopes = self.gradients(moved)
            change = np.abs(np.array([slope[j] - base[j] for slope, j in zip(slopes, unknown, strict=True)]))
            curvature = np.maximum(change / np.abs(step), 0.1 * np.abs(base[unknown]) / width[unknown])
            out[unknown] = 1.0 / np.sqrt(np.maximum(curvature, 1e-300))
        return _limit(out, width)


def _gradient(total: Tensor, numbers: Tensor) -> Floats:
    """Return the derivatives of a value, 0 where it has none: stepwise effects, such as rounding, have no gradient.

    One that is no number is a defect of a law. The fit goes on as if it were 0, but the warning does not let it pass.
    """
    if not total.requires_grad:
        return np.zeros(numbers.shape)
    (slope,) = torch.autograd.grad(total, numbers, allow_unused=True)
    gradient = np.zeros(numbers.shape) if slope is None else slope.numpy()
    if np.isfinite(gradient).all():
        return np.asarray(gradient)
    warnings.warn("a law of the fit has a derivative that is no number; please report it", RuntimeWarning, stacklevel=2)
    return np.nan_to_num(gradient, nan=0.0, posinf=0.0, neginf=0.0)


def maximise(
    stack: Stack,
    free: Sequence[Key],
    batch: Batch,
    iterations: int = 60,
    min_gain: float = MIN_RESTART_GAIN,
    scales: Scales | None = None,
) -> Fit:
    """Return the local maximum reached from a stack, which is never worse than the start.

    Args:
        stack: starting point, and the values of the fixed parameters.
        free: free parameters.
        batch: readings.
        iterations: limit of L-BFGS-B iterations over all local fits.
        min_gain: nats that a local fit must gain for another to follow.
        scales: scales of nuisance parameters from an earlier fit to the same readings; updated in place.
    """
    free = [key for key in free if key != SIMULATION_CORRELATION or batch.simulated_offset is not None]
    objective = Objective(stack, free, batch)
    x = np.array([stack.get(key) for key in free])
    best = objective(x)[0]
    left = iterations
    scale: Floats | None = None
    fixed = np.zeros(len(x), dtype=bool)
    # curvatures change by orders of magnitude during a fit, so the scale is measured again after every local fit
    for attempt in range(RESTARTS):
        if objective.is_flat(x):
            break
        if scale is None or min_gain < COARSE_GAIN:
            scale = objective.scale(x, scales if attempt == 0 else None)
        if scales is not None:
            scales.update({key: value for key, value in zip(free, scale, strict=True) if key in NUISANCES})
        end = _local_fit(objective, x, scale, max(left, 1), min(STEP_SHARE * min_gain, MAX_LAST_STEP), fixed)
        gain, left = best - end.value, left - end.iterations
        if gain > 0:
            x, best = end.x, end.value
        if left <= 0:
            break
        if gain < min_gain:
            stalled = not fixed.any() and end.iterations <= STALLED_ITERATIONS
            if not stalled or objective.predicted_gain(x, scale) < max(MIN_PREDICTED_GAIN, min_gain):
                break
            fixed = objective.at_discontinuity(x, scale)
            if fixed.all() or not fixed.any():
                break
        scale = end.scale
    return Fit(stack.put(free, x), tuple(free), -best)


@dataclass(frozen=True)
class _Optimum:
    """Result of a local fit: parameters, negative log-likelihood, iterations, and scales at the end."""

    x: Floats
    value: float
    iterations: int
    scale: Floats


def _local_fit(
    objective: Objective, x0: Floats, scale: Floats, iterations: int, min_step: float, fixed: NDArray[np.bool_]
) -> _Optimum:
    """Minimise the objective from x0 until a step gains less than `min_step` nats."""
    start = objective(x0)[0]
    low, high = objective.bounds()
    width = high - low
    low, high = np.where(fixed, x0, low), np.where(fixed, x0, high)

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
            "ftol": max(TOLERANCE, min_step / max(abs(start), 1.0)),
            "gtol": 1e-2,
            "maxcor": 12,
        },
    )
    x = np.clip(x0 + result.x * scale, low, high)
    change = np.sqrt(np.clip(np.diag(result.hess_inv @ np.eye(len(x))), *CURVATURE_CHANGE))
    return _Optimum(x, float(result.fun), int(result.nit), _limit(scale * change, width))


def _limit(scale: Floats, width: Floats) -> Floats:
    """Return scales limited to between the rounding error and a quarter of the bounds."""
    return np.clip(scale, 1e-6 * width, 0.25 * width)


def refit_without_urn(joint: Fit, keys: Sequence[Key], batch: Batch) -> Fit:
    """Return a fit without the urn where readings of a visit repeat each other; else the given fit.

    The urn explains repeated readings and leaves the new ones to the law. Outliers are more frequent among the new
    readings, so their probability is overestimated; without the urn every reading counts once, and standard errors must
    be computed over visits (`covariance` does). Effects on whole visits are not refitted: without the urn, a few
    deviating visits would dominate them.

    Args:
        joint: fit with the urn.
        keys: parameters of effects; those of effects on single pings are refitted together with the spread.
        batch: readings of the fit.
    """
    keys = [key for key in keys if joint.stack.known[key[0]].by_ping]
    if not keys or joint.stack.get((VISITS, "urn_weight")) < MIN_URN_WEIGHT:
        return joint
    no_urn = joint.stack.put([(VISITS, "urn_weight"), (VISITS, "ping_correlation")], [0.0, 0.0])
    spread = 0.7 * max(joint.stack.get((JITTER, "sigma_m")), joint.stack.get((VISITS, "placement_m")))
    # a second start: the gradient vanishes where visits do not scatter
    wide = no_urn.put([(JITTER, "sigma_m"), (VISITS, "placement_m")], [spread, spread])
    # the spread is fitted first: otherwise the first step may set a probability to zero, where the gradient vanishes
    starts = [maximise(stack, SPREAD, batch, 40).stack for stack in (no_urn, wide)]
    best = best_of([_likeliest_probability(stack, keys, batch) for stack in starts], (*keys, *SPREAD), batch, 80)
    if not _vanished(best.stack, keys):
        return best
    # a wider spread explains a few outliers as well: the spread of the joint fit is retained
    same_spread = maximise(_likeliest_probability(no_urn, keys, batch), keys, batch, 40)
    return joint if _vanished(same_spread.stack, keys) else same_spread


def _likeliest_probability(stack: Stack, keys: Sequence[Key], batch: Batch) -> Stack:
    """Return the stack with the probabilities of its effects multiplied by the likeliest of `PROBABILITY_FACTORS`."""
    probabilities = _probabilities(stack, keys)
    scaled = [stack.put(probabilities, [f * stack.get(key) for key in probabilities]) for f in PROBABILITY_FACTORS]
    return likeliest(scaled, batch)


def _probabilities(stack: Stack, keys: Sequence[Key]) -> list[Key]:
    """Return the probability parameter of each effect, which is its first."""
    return [(name, stack.known[name].parameters[0].name) for name in dict.fromkeys(key[0] for key in keys)]


def _vanished(stack: Stack, keys: Sequence[Key]) -> bool:
    """Return whether the probability of an effect is at its null value."""
    return any(stack.get(key) == stack.parameter(key).null for key in _probabilities(stack, keys))


def best_of(stacks: Sequence[Stack], free: Sequence[Key], batch: Batch, iterations: int = 60) -> Fit:
    """Return the best of several local fits."""
    return highest(maximise(stack, free, batch, iterations) for stack in stacks)


def highest(fits: Iterable[Fit]) -> Fit:
    """Return the fit with the highest likelihood, the first one if several are equal."""
    return max(fits, key=lambda fit: fit.nats)


def fit(
    model: PhysicalModel,
    recording: Recording,
    free: Sequence[Key] | None = None,
    nuisances: bool = True,
    iterations: int = 200,
) -> Fit:
    """Fit a physical model and its visit effects to a recording by maximum likelihood.

    Args:
        model: starting point.
        recording: readings.
        free: free (effect, parameter) pairs; by default, all parameters of the model.
        nuisances: whether spread and visit effects are free too.
        iterations: limit.

    >>> import numpy as np
    >>> from acquisition import Ping
    >>> from noise.effects import CATALOGUE
    >>> warm = PhysicalModel([CATALOGUE["clock_scale"](error=0.01), CATALOGUE["travel_time_jitter"](sigma_m=0.004)])
    >>> ping = Ping.of(distance=np.repeat(np.linspace(0.3, 3.0, 30), 5))
    >>> recording = Recording.of(ping, warm.law(ping).sample(np.random.default_rng(1)))
    >>> found = fit(PhysicalModel([CATALOGUE["clock_scale"]()]), recording)
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
    """Return the covariance of the free parameters, robust to dependence within visits, (p, p).

    Huber's sandwich estimator clustered by visit, or by run of a robot, at least the inverse curvature. Rows and
    columns of a parameter at a bound are zero, and so are those of one in which the likelihood jumps: readings bound it
    so closely that the others are known as if it were. A wide normal prior (half the bounds) keeps unidentified
    parameters finite.
    """
    objective = Objective(fitted.stack, fitted.free, batch)
    x = np.array([fitted.stack.get(key) for key in fitted.free])
    low, high = objective.bounds()
    smooth = np.array([not fitted.stack.parameter(key).jumps for key in fitted.free])
    inside = np.flatnonzero(smooth & (x > low + 1e-6 * (high - low)) & (x < high - 1e-6 * (high - low)))
    out = np.zeros((len(x), len(x)))
    if len(inside):
        out[np.ix_(inside, inside)] = _sandwich(objective, x, inside, objective.scale(x))
    return out


def _sandwich(objective: Objective, x: Floats, inside: NDArray[np.int64], scale: Floats) -> NDArray[np.float64]:
    """Return the robust covariance of the parameters at `inside`."""
    low, high = objective.bounds()
    step = np.minimum(0.5 * scale, 0.5 * np.minimum(x - low, high - x))[inside]
    moves = step[:, None] * np.eye(len(x))[inside]
    unit = (scale[inside] / (2.0 * step))[:, None]
    slopes = objective.gradients(x + moves) - objective.gradients(x - moves)
    curvature = slopes[:, inside] * unit * scale[inside]
    prior = np.diag((scale / (0.5 * (high - low)))[inside] ** 2)
    eigenvalue, vector = np.linalg.eigh((curvature + curvature.T) / 2.0 + prior)
    inverse = (vector / np.maximum(eigenvalue, 0.02)) @ vector.T
    by_unit = ((objective.unit_nats(x + moves) - objective.unit_nats(x - moves)) * unit).T
    n_units, p = by_unit.shape
    robust = inverse @ (by_unit.T @ by_unit) @ inverse * n_units / max(n_units - p, 1)
    robust += np.diag(np.maximum(np.diag(inverse) - np.diag(robust), 0.0))
    return robust * np.outer(scale[inside], scale[inside])
