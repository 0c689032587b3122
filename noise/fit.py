"""Maximum likelihood of the parameters of a stack of effects, with what cells share as a nuisance.

A `Stack` is plain numbers: effect id -> parameter -> value. `maximise` frees some of them and climbs the prequential
likelihood of `noise.cells` by L-BFGS-B in coordinates scaled by the curvature, from the starting points it is given;
`starting_points` makes those from the catalogue's own starts, the data's extra modes and a quasi-random design.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.stats import qmc
from torch import Tensor

from acquisition import Recording
from noise.cells import Batch, CellNuisance, law_of, log_prob
from noise.effects import CATALOGUE, Effect, Parameter, Seen
from noise.law import Floats
from noise.physical import PhysicalModel

Values = dict[str, dict[str, float]]
Key = tuple[str, str]
CELLS = "cells"
JITTER = "travel_time_jitter"
SPREAD = ((JITTER, "sigma_m"), (JITTER, "per_metre"), (CELLS, "placement_m"))
LINK = (CELLS, "link")
SHARED = ((CELLS, "carry"), (CELLS, "sharing"), (CELLS, "kernel_m"), LINK)
NUISANCES: tuple[Key, ...] = (*SPREAD, *SHARED)
TOLERANCE = 1e-7  # of the log likelihood, relative: about 0.002 nats in 20,000
ENOUGH = 0.05  # nats that a restart must gain for another to follow
RESTARTS = 4
MUCH_SHARED = 0.2  # weight of an earlier reading against the law, beyond which cells repeat themselves; ours
PRIOR_SHARE = 0.125  # standard deviation of what has no cause, as a share of its bounds; ours


@dataclass(frozen=True)
class Stack:
    """A physical model and its nuisances as numbers.

    Attributes:
        values: effect id -> parameter -> value; "cells" holds the nuisances of `CellNuisance`.
        resolution, max_range: of the register, m.
        extra: effects that are known beyond the catalogue (the flexible part of an emulator), by id.
    """

    values: Values
    resolution: float = 0.001
    max_range: float = 11.008
    extra: Mapping[str, type[Effect]] = field(default_factory=dict)

    @classmethod
    def of(cls, model: PhysicalModel) -> Stack:
        """Take the numbers out of a model."""
        extra = {effect.name: type(effect) for effect in model.effects if effect.name not in CATALOGUE}
        values = {effect.name: effect.values for effect in model.effects}
        return cls(values, model.resolution, model.max_range, extra)

    @cached_property
    def known(self) -> dict[str, type[Effect]]:
        """Every effect that the stack may hold, by id."""
        return {**CATALOGUE, **self.extra, CELLS: CellNuisance}

    def parameter(self, key: Key) -> Parameter:
        """Return what is known of a parameter."""
        return next(p for p in self.known[key[0]].parameters if p.name == key[1])

    def get(self, key: Key) -> float:
        """Return a parameter's value; its null value where the effect is absent."""
        return self.values.get(key[0], {}).get(key[1], self.parameter(key).null)

    def put(self, keys: Sequence[Key], numbers: Iterable[float]) -> Stack:
        """Return the stack with some parameters at other values, clipped to their bounds."""
        values = {name: dict(inner) for name, inner in self.values.items()}
        for key, number in zip(keys, numbers, strict=True):
            p = self.parameter(key)
            values.setdefault(key[0], {})[key[1]] = float(np.clip(number, min(p.low, p.null), max(p.high, p.null)))
        return replace(self, values=values)

    def without(self, name: str) -> Stack:
        """Return the stack without an effect."""
        return replace(self, values={k: v for k, v in self.values.items() if k != name})

    def build(self, keys: Sequence[Key] = (), numbers: Tensor | None = None) -> tuple[PhysicalModel, CellNuisance]:
        """Return model and nuisances; the parameters at `keys` are taken from a tensor, so gradients flow."""
        values: dict[str, dict[str, float | Tensor]] = {name: dict(v) for name, v in self.values.items()}
        for k, key in enumerate(keys):
            assert numbers is not None
            values.setdefault(key[0], {})[key[1]] = numbers[k]
        cells = CellNuisance(**values.pop(CELLS, {}))
        effects = [self.known[name](**inner) for name, inner in values.items()]
        return PhysicalModel(effects, self.resolution, self.max_range), cells

    @property
    def model(self) -> PhysicalModel:
        """The model alone."""
        return self.build()[0]


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

    def __call__(self, x: Floats) -> tuple[float, Floats]:
        """Return value and gradient at physical parameter values x, (p,)."""
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

    def bounds(self) -> tuple[Floats, Floats]:
        """Return least and greatest values, null included, (p,) each."""
        known = [self.stack.parameter(key) for key in self.free]
        low = np.array([min(p.low, p.null) for p in known])
        return low, np.array([max(p.high, p.null) for p in known])

    def blocks(self, x: Floats) -> Floats:
        """Return the log likelihood of each block at x, nats."""
        return self.batch.per_block(log_likelihood(self.stack.put(self.free, x), self.batch))

    def scale(self, x: Floats) -> Floats:
        """Return the step in each parameter that costs about half a nat, from finite differences of the gradient."""
        low, high = self.bounds()
        width = high - low
        base = self(x)[1]
        out = np.empty(len(x))
        for j in range(len(x)):
            step = 1e-4 * width[j] if x[j] < low[j] + 0.5 * width[j] else -1e-4 * width[j]
            moved = x.copy()
            moved[j] += step
            gradient = self(moved)[1][j]
            curvature = max(abs(gradient - base[j]) / abs(step), 0.1 * abs(base[j]) / width[j])
            out[j] = np.clip(1.0 / np.sqrt(max(curvature, 1e-300)), 1e-6 * width[j], 0.25 * width[j])
        return out


def maximise(stack: Stack, free: Sequence[Key], batch: Batch, iterations: int = 60, enough: float = ENOUGH) -> Fit:
    """Climb from where the stack is; never returns less than it started from.

    Args:
        stack: start, and the values of what is not free.
        free: parameters to move.
        batch: readings.
        iterations: of L-BFGS-B, shared by its restarts.
        enough: nats that a climb must gain for another to follow it.
    """
    free = [key for key in free if key != LINK or batch.twin is not None]
    objective = _Objective(stack, free, batch)
    x = np.array([stack.get(key) for key in free])
    best = objective(x)[0]
    left = iterations
    # curvatures change by orders of magnitude on the way up, so the scale is measured again after every climb
    for _ in range(RESTARTS):
        result_x, result, used = _climb(objective, x, max(left, 1))
        gain, left = best - result, left - used
        if gain > 0:
            x, best = result_x, result
        if gain < enough or left <= 0:
            break
    return Fit(stack.put(free, x), tuple(free), -best)


def _climb(objective: _Objective, x0: Floats, iterations: int) -> tuple[Floats, float, int]:
    """Return the end of one climb, minus the log likelihood there, and the iterations that it took."""
    scale = objective.scale(x0)
    low, high = objective.bounds()

    def scaled(y: Floats) -> tuple[float, Floats]:
        value, gradient = objective(np.clip(x0 + y * scale, low, high))
        return (value, gradient * scale) if np.isfinite(value) else (1e15, np.zeros_like(y))

    result = minimize(
        scaled,
        np.zeros(len(x0)),
        jac=True,
        method="L-BFGS-B",
        bounds=list(zip((low - x0) / scale, (high - x0) / scale, strict=True)),
        options={"maxiter": iterations, "ftol": TOLERANCE, "gtol": 1e-2, "maxcor": 12},
    )
    return np.clip(x0 + result.x * scale, low, high), float(result.fun), int(result.nit)


def each_counted(joint: Fit, keys: Sequence[Key], batch: Batch) -> Fit:
    """Return a fit in which every reading counts, where cells repeat themselves; the given one where they do not.

    The urn answers for what a cell repeats and leaves to the law what is new, which strays are more often: their share
    would come out too high. Here the urn is off, and errors must be taken over blocks (`covariance` does).

    Args:
        joint: a fit with the urn.
        keys: parameters to move besides the spread.
        batch: it was fitted to.
    """
    # what looks at the reading before is told apart from a cell that repeats itself by the urn alone
    keys = [key for key in keys if not joint.stack.known[key[0]].remembers]
    if not keys or joint.stack.get((CELLS, "sharing")) < MUCH_SHARED:
        return joint
    alone = joint.stack.put([(CELLS, "sharing"), (CELLS, "carry")], [0.0, 0.0])
    return maximise(alone, (*keys, *SPREAD), batch, 80)


def best_of(stacks: Sequence[Stack], free: Sequence[Key], batch: Batch, iterations: int = 60) -> Fit:
    """Return the best of several climbs."""
    return max((maximise(stack, free, batch, iterations) for stack in stacks), key=lambda fit: fit.nats)


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

    Starts of the catalogue, lengths where the data show extra modes, and a Sobol design over the bounds; the effect's
    present values are among them.

    Args:
        stack: to begin from; holds the effect at its present values or not at all.
        name: of the effect.
        batch: whose extra modes to use.
        rng: shifts the design.
        design: number of its points, a power of two.
        whole: readings that an effect's own guesses are made from; `batch` if not given.
    """
    keys = [(name, p.name) for p in stack.known[name].parameters]
    columns = [_candidates(stack.parameter(key), stack.get(key), extra_modes(batch)) for key in keys]
    first = [column[0] for column in columns]
    points = [[stack.get(key) for key in keys], first]
    for j, column in enumerate(columns):
        points += [[*first[:j], value, *first[j + 1 :]] for value in column[1:]]
    points += [[guess[key[1]] for key in keys] for guess in stack.known[name].guesses(_seen(whole or batch))]
    sobol = qmc.Sobol(len(keys), rng=rng).random(design)
    points += [[_spread(stack.parameter(k), u) for k, u in zip(keys, row, strict=True)] for row in sobol]
    return [stack.put(keys, point) for point in points]


def _seen(batch: Batch) -> Seen:
    echo = batch.reading.echo
    return Seen(batch.ping.distance[echo], batch.ping.time[echo], batch.reading.range[echo])


def _candidates(p: Parameter, present: float, modes: Sequence[float]) -> list[float]:
    lengths = [m for m in modes if p.unit == "m" and p.high - p.low > 0.3 and p.low <= m <= p.high]
    starts = [s for s in p.starts if s != p.null] or [present]
    return list(dict.fromkeys([*starts, *lengths]))


def _spread(p: Parameter, u: float) -> float:
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
    middle = np.zeros(len(batch)) if not echo.any() else stack.model.law(batch.ping, batch.past).quantile(0.5)
    known = echo & (middle > 0)
    error = np.abs(batch.reading.range - middle)[known]
    robust = 1.4826 * float(np.median(error)) if len(error) else 0.005
    size = float(np.clip(robust, max(0.002, batch.resolution / 4.0), 0.15))
    wide = {(JITTER, "sigma_m"): max(stack.get((JITTER, "sigma_m")), 0.7 * size), (CELLS, "placement_m"): 0.5 * size}
    shared = {(CELLS, "sharing"): 0.02, (CELLS, "carry"): 0.1, (CELLS, "kernel_m"): max(0.004, batch.resolution / 3.0)}
    shared[LINK] = 0.0 if batch.twin is None else 0.5
    start = {**wide, **shared}
    return stack.put(list(start), np.minimum(list(start.values()), 0.19))


def nuisance_starts(stack: Stack, batch: Batch) -> list[Stack]:
    """Return starts for cells that share little, for cells that repeat themselves, and what the stack says already."""
    loose = nuisance_start(stack, batch)
    tight = {(JITTER, "sigma_m"): 0.5 * loose.get((JITTER, "sigma_m")), (CELLS, "sharing"): 1.5, (CELLS, "carry"): 0.5}
    tight[(CELLS, "kernel_m")] = max(0.001, batch.resolution / 3.0)
    present = [stack] if CELLS in stack.values else []
    return [loose, loose.put(list(tight), list(tight.values())), *present]


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
        above, below = (objective.blocks(x + sign * step) for sign in (1, -1))
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
