"""Designs that discriminate between laws: the conditions under which no rival can be fitted to what is read.

A design is T-optimal (Atkinson and Fedorov 1975): it maximises the expected log-likelihood ratio per reading between
an explanation and a rival whose parameters are fitted to the same readings, so that it needs nothing from the old
recording. Rivals are added one by one where they fit the present design best, and a linear program weighs the
conditions. Each reading is that of a newly placed target: more readings of one visit share its offset and add little.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
import torch
from scipy.optimize import linprog, minimize
from torch import Tensor

from acquisition import Ping, Reading
from acquisition.arrays import Floats, Ints
from noise.effects import Conditions
from noise.effects.interping import DEFAULT_INTERVAL_S, INTERVAL
from noise.effects.medium import AIR_SCALE_SD, TEMPERATURE
from noise.fitting.batch import Batch
from noise.fitting.stack import Key, Stack
from noise.fitting.visit_effects import FLOOR, single_ping_law
from noise.physical import PhysicalLaw

CHECKS = 10  # times as many readings of a chosen design as of a candidate
DRAWS = 32  # readings of each candidate condition, one in each of as many equal parts of the law
STRETCH = 1.5  # factor by which proposed conditions may exceed the recorded ones: laws are guesses beyond
TURN = np.pi / 18.0  # rad; turn that is proposed although no angle was recorded
N_DISTANCES = 6  # candidate distances
ITERATIONS = 8  # of such a fit; another round continues where it matters
ROUNDS = 2  # rivals that are fitted to the design of one pair in each direction
SESSION_S = 60.0  # times of the readings are spread over a minute, so that no phase of a clock counts
MIN_WEIGHT = 1e-3  # share of the readings below which the linear program leaves a condition out
HAND = "hand_m"  # column of a hand in front of the sensor
TINY = 1e-300


@dataclass(frozen=True)
class Setting:
    """A setting of sensor or room other than the usual one.

    Attributes:
        words: as it follows "with".
        column, value: name and value of the setting in a table of conditions.
        shift: what it adds to parameters of every law.
        without: effects that it takes from every law.
        ping: what it does to the conditions.
    """

    words: str = ""
    column: str = ""
    value: float = 0.0
    shift: tuple[tuple[Key, float], ...] = ()
    without: tuple[str, ...] = ()
    ping: Callable[[Ping], Ping] = lambda ping: ping

    def stack(self, stack: Stack) -> Stack:
        """Return a law under this setting."""
        shifted = stack.at({key: stack.get(key) + change for key, change in self.shift})
        return replace(shifted, values={k: v for k, v in shifted.values.items() if k not in self.without})


@dataclass(frozen=True, eq=False)
class Candidates:
    """Candidate conditions, (n,), and the setting under which they are measured."""

    ping: Ping
    setting: Setting = field(default_factory=Setting)


@dataclass(frozen=True, eq=False)
class Rival:
    """A true explanation and a rival, some of whose parameters are fitted to the readings."""

    truth: Stack
    model: Stack
    free: tuple[Key, ...]


@dataclass(frozen=True, eq=False)
class Design:
    """Conditions with equally many visits each.

    Attributes:
        rows: rows of the candidates, (k,).
        nats: expected log-likelihood ratio per visit against the nearest rival.
        rivals: fitted rivals, m of them.
        ratios: expected log-likelihood ratios against each of them under each candidate condition, (m, n).
    """

    rows: Ints
    nats: float
    rivals: tuple[Rival, ...]
    ratios: Floats


@dataclass(frozen=True, eq=False)
class _Sample:
    """Readings that the truth gives under each of n candidate conditions, (n * DRAWS,)."""

    ping: Ping
    past: Reading
    reading: Reading
    setting: Setting
    truth: Floats

    def pick(self, condition: Ints) -> _Sample:
        rows = (condition[:, None] * DRAWS + np.arange(DRAWS)).ravel()
        return _Sample(self.ping[rows], self.past[rows], self.reading[rows], self.setting, self.truth[rows])

    def log_prob(self, stack: Stack) -> Floats:
        """Return log probabilities with a floor of arbitrary readings and silences, nats."""
        law = law_of(self.setting.stack(stack), self.ping, self.past)
        arbitrary = FLOOR * np.where(self.reading.echo, 1.0 / law.last_step, 1.0)
        return np.log((1.0 - 2.0 * FLOOR) * np.exp(law.log_prob(self.reading)) + arbitrary + TINY)

    @cached_property
    def conditions(self) -> Conditions:
        """Conditions and previous readings as tensors."""
        return Conditions.of(self.ping, self.past)

    def total(self, stack: Stack, keys: Sequence[Key], numbers: Tensor) -> Tensor:
        """Return the log-likelihood, nats, differentiable in the parameters at `keys`."""
        known = dict(self.setting.shift)
        shift = torch.tensor([known.get(key, 0.0) for key in keys], dtype=torch.float64)
        low, high = (torch.tensor(each, dtype=torch.float64) for each in _bounds(stack, keys))
        limited = torch.minimum(torch.maximum(numbers + shift, low), high)
        model, visits = self.setting.stack(stack).build(keys, limited)
        law = single_ping_law(model.law_of(self.conditions), visits, AIR_SCALE_SD)
        # without the floor, so that a law that is far from the readings still has a slope towards them
        return law.log_prob_tensor(self.reading).sum()


def _bounds(stack: Stack, keys: Sequence[Key]) -> tuple[list[float], list[float]]:
    """Return lower and upper bounds of parameters, null value included."""
    known = [stack.parameter(key) for key in keys]
    return [min(p.low, p.null) for p in known], [max(p.high, p.null) for p in known]


class _EqualParts:
    """One random number in each of `DRAWS` equal parts of [0, 1), for each condition."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.rng = rng

    def random(self, size: int | tuple[int, ...], /) -> Floats:
        u = (np.arange(DRAWS) + self.rng.random((int(np.prod(size)) // DRAWS, DRAWS))) / DRAWS
        return u.reshape(size)


def law_of(stack: Stack, ping: Ping, past: Reading | None = None) -> PhysicalLaw:
    """Return the law of pings that each face a newly placed target, in air that nobody measured."""
    model, visits = stack.build()
    return single_ping_law(model.law(ping, past), visits, AIR_SCALE_SD)


def candidates_of(batch: Batch, facing: bool = False) -> Ping:
    """Return conditions about the recorded ones: distances and reflectances, and turns of sensor, target or both.

    Args:
        batch: recorded pings.
        facing: whether only targets straight ahead are considered.
    """
    seen = batch.ping
    near, far = np.maximum([seen.distance.min() / STRETCH, seen.distance.max() * STRETCH], batch.resolution)
    distance = np.maximum([float(f"{d:.2g}") for d in np.geomspace(near, far, N_DISTANCES)], batch.resolution)
    most = [max(STRETCH * float(np.abs(each).max()), TURN) for each in (seen.angle, seen.incidence)]
    steps = (-1.0, -0.5, 0.5, 1.0)
    turns = [(0.0, 0.0)]
    if not facing:
        first, second = (np.minimum(each, np.pi / 3.0) for each in most)
        turns += [(s * first, 0.0) for s in steps] + [(0.0, s * second) for s in steps]
        turns += [(s * min(first, second), s * min(first, second)) for s in steps]
    shades = np.unique(np.quantile(seen.reflectance, (0.05, 0.95)))
    rows = np.array([(d, *turn, shade) for d in distance for turn in turns for shade in shades])
    logged = {name: float(np.median(value)) for name, value in seen.covariates.items()}
    logged[INTERVAL] = logged.get(INTERVAL, 0.0) or DEFAULT_INTERVAL_S
    angles = np.deg2rad(np.rint(np.rad2deg(rows[:, 1:3])))
    ping = Ping.of(rows[:, 0], angles[:, 0], angles[:, 1], rows[:, 3], 0.0)
    # a column of the user's may have the name of an argument
    return replace(ping, covariates={name: np.full(len(ping), value) for name, value in logged.items()})


def best_design(rivals: Sequence[Rival], tables: Sequence[Candidates], rng: np.random.Generator, rounds: int) -> Design:
    """Return the conditions whose readings no rival fits.

    Args:
        rivals: pairs to tell apart; all count alike, and the nearest decides.
        tables: candidate conditions; rows of the design count through all of them.
        rng: draws readings.
        rounds: times that each rival is fitted to the present design.
    """
    samples = [[_sample(rival.truth, table, rng) for table in tables] for rival in rivals]
    every = list(rivals)
    ratios = np.stack([_ratio(rival.model, parts) for rival, parts in zip(rivals, samples, strict=True)])
    designs = [weigh(ratios)]
    for _ in range(rounds):
        nearest = [_fitted(rival, tables, parts, designs[-1]) for rival, parts in zip(rivals, samples, strict=True)]
        more = [_ratio(rival.model, parts) for rival, parts in zip(nearest, samples, strict=True)]
        ratios = np.concatenate([ratios, more])
        every += nearest
        designs.append(weigh(ratios))
    return max((evaluated(rows, every, ratios) for rows in designs), key=lambda design: design.nats)


def checked(tables: Sequence[Candidates], design: Design, rng: np.random.Generator) -> Design:
    """Return a design with its nats from readings of its own: those that chose it favour it by chance."""
    means = design.ratios[:, design.rows].mean(axis=1)
    rival, nats = design.rivals[int(np.argmin(means))], []
    for part, rows in _by_table(tables, design.rows):
        table = tables[part]
        sample = _sample(rival.truth, replace(table, ping=table.ping[np.repeat(rows, CHECKS)]), rng)
        nats.append(_ratio(rival.model, [sample]))
    return replace(design, nats=float(np.concatenate(nats).mean()))


def _by_table(tables: Sequence[Candidates], rows: Ints) -> list[tuple[int, Ints]]:
    """Return the tables that a design uses, by index, with the rows in each."""
    ends = np.cumsum([len(table.ping) for table in tables])
    which = np.searchsorted(ends, rows, side="right")
    return [(int(k), rows[which == k] - ends[k] + len(tables[k].ping)) for k in np.unique(which)]


def weigh(ratios: Floats) -> Ints:
    """Return the rows of the conditions that maximise the least mean log-likelihood ratio over rivals, (m, n)."""
    m, n = ratios.shape
    cost = np.append(np.zeros(n), -1.0)
    above = np.concatenate([-ratios, np.ones((m, 1))], axis=1)
    one = np.append(np.ones(n), 0.0)[None]
    found = linprog(cost, above, np.zeros(m), one, [1.0], [*[(0.0, 1.0)] * n, (None, None)])
    weight: Floats = np.asarray(found.x)[:n]
    return np.flatnonzero(weight >= MIN_WEIGHT)


def evaluated(rows: Ints, rivals: Sequence[Rival], ratios: Floats) -> Design:
    """Return the design with equally many visits under each condition, against rivals, (m, n)."""
    return Design(rows, float(ratios[:, rows].mean(axis=1).min()), tuple(rivals), ratios)


def _sample(truth: Stack, table: Candidates, rng: np.random.Generator) -> _Sample:
    ping = table.setting.ping(table.ping[np.repeat(np.arange(len(table.ping)), DRAWS)])
    ping = replace(ping, time=ping.time + SESSION_S * rng.random(len(ping)))
    stack = table.setting.stack(truth)
    past = law_of(stack, ping).sample(rng)
    reading = law_of(stack, ping, past).sample(_EqualParts(rng))
    drawn = _Sample(ping, past, reading, table.setting, np.zeros(len(ping)))
    return replace(drawn, truth=drawn.log_prob(truth))


def _ratio(model: Stack, parts: Sequence[_Sample]) -> Floats:
    """Return mean log-likelihood ratios under each condition, nats, (n,)."""
    each = [(part.truth - part.log_prob(model)).reshape(-1, DRAWS).mean(axis=1) for part in parts]
    return np.concatenate(each)


def _fitted(rival: Rival, tables: Sequence[Candidates], parts: Sequence[_Sample], rows: Ints) -> Rival:
    """Return the rival with its free parameters fitted to the readings of a design."""
    if not rival.free:
        return rival
    chosen = [parts[k].pick(at) for k, at in _by_table(tables, rows)]
    known = [rival.model.parameter(key) for key in rival.free]
    low, width = np.array([p.low for p in known]), np.array([p.high - p.low for p in known])

    n = sum(len(part.ping) for part in chosen)

    def cost(u: Any) -> Any:
        numbers = torch.tensor(low + width * u, dtype=torch.float64, requires_grad=True)
        total = torch.stack([part.total(rival.model, rival.free, numbers) for part in chosen]).sum()
        if not total.requires_grad:  # stepwise parameters alone
            return -float(total) / n, np.zeros(len(u))
        (slope,) = torch.autograd.grad(total, numbers)
        return -float(total.detach()) / n, -np.nan_to_num(slope.numpy(), posinf=0.0, neginf=0.0) * width / n

    start = (np.array([rival.model.get(key) for key in rival.free]) - low) / width
    bounds = [(0.0, 1.0)] * len(known)
    options: Any = {"maxiter": ITERATIONS}
    start = np.clip(start, 0.0, 1.0)
    found = minimize(cost, start, jac=True, method="L-BFGS-B", bounds=bounds, options=options)
    return replace(rival, model=rival.model.put(rival.free, low + width * found.x))


def settings_of(stacks: Sequence[Stack], batch: Batch) -> list[Setting]:
    """Return the settings that may change a law of the given stacks."""
    names = {name for stack in stacks for name in stack.values}
    crosstalk = [name for name in names if name.endswith("_crosstalk")]
    loss = ("sensitivity", "loss_db")
    known = {
        Setting("6 dB less receiver gain", "gain_db", -6.0, ((loss, 6.0),)): True,
        Setting("6 dB more receiver gain", "gain_db", 6.0, ((loss, -6.0),)): True,
        Setting("a hand 0.15 m in front of the sensor", HAND, 0.15, ping=_covered): True,
        Setting("all other sensors switched off", "others_off", 1.0, without=tuple(crosstalk)): bool(crosstalk),
        Setting("5 ms more between pings", INTERVAL, 0.005, ping=_logged(INTERVAL, 0.005)): "previous_ping" in names,
        Setting("the sensor on for two hours", "time", 7200.0, ping=_later): "warm_up" in names,
        Setting("the room 10 °C warmer", TEMPERATURE, 10.0, ping=_logged(TEMPERATURE, 10.0)): TEMPERATURE
        in batch.ping.covariates,
    }
    return [setting for setting, applies in known.items() if applies]


def _logged(column: str, more: float) -> Callable[[Ping], Ping]:
    return lambda ping: replace(ping, covariates={**ping.covariates, column: ping.covariates[column] + more})


def _later(ping: Ping) -> Ping:
    return replace(ping, time=ping.time + 7200.0)


def _covered(ping: Ping) -> Ping:
    zero = np.zeros(len(ping))
    return replace(ping, distance=zero + 0.15, angle=zero, incidence=zero)
