"""Designs that discriminate between laws: the conditions under which no rival can be fitted to what is read.

A design is T-optimal (Atkinson and Fedorov 1975): it maximises the expected log-likelihood ratio per reading between
an explanation and a rival whose parameters are fitted to the same readings, so that it needs nothing from the old
recording. Rivals are added one by one where they fit the present design best, and a linear program weighs the
conditions. Each reading is that of a newly placed target: more readings of one visit share its offset and add little.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.optimize import linprog, minimize

from acquisition import Ping, Reading
from acquisition.arrays import Floats, Ints
from noise.effects.interping import DEFAULT_INTERVAL_S, INTERVAL
from noise.effects.medium import AIR_SCALE_SD, TEMPERATURE
from noise.fitting.batch import Batch
from noise.fitting.stack import Key, Stack
from noise.fitting.visit_effects import FLOOR, single_ping_law
from noise.physical import PhysicalLaw

DRAWS = 32  # readings of each candidate condition, one in each of as many equal parts of the law
STRETCH = 1.5  # factor by which proposed conditions may exceed the recorded ones: laws are guesses beyond
TURN = np.pi / 18.0  # rad; turn that is proposed although no angle was recorded
N_DISTANCES = 6  # candidate distances
ROUNDS = 5  # rivals that are fitted to the design of one pair in each direction
SESSION_S = 60.0  # times of the readings are spread over a minute, so that no phase of a clock counts
MIN_WEIGHT = 0.05  # share of the readings below which a condition is left out
TINY = 1e-300


@dataclass(frozen=True)
class Setting:
    """A setting of sensor or room other than the usual one.

    Attributes:
        words: as it follows "with".
        column, value: name and value of the setting in a table of conditions.
        stack: what it does to every law.
        ping: what it does to the conditions.
    """

    words: str = ""
    column: str = ""
    value: float = 0.0
    stack: Callable[[Stack], Stack] = lambda stack: stack
    ping: Callable[[Ping], Ping] = lambda ping: ping


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
    """Conditions with equally many visits: rows of candidates, (k,), and nats per visit against the nearest rival."""

    rows: Ints
    nats: float
    ratios: Floats  # against each fitted rival, under each candidate condition, (m, n)


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

    def log_prob(self, stack: Stack, floor: float = FLOOR) -> Floats:
        """Return log probabilities with a floor of arbitrary readings and silences, nats."""
        law = law_of(self.setting.stack(stack), self.ping, self.past)
        arbitrary = floor * np.where(self.reading.echo, 1.0 / law.last_step, 1.0)
        return np.log((1.0 - 2.0 * floor) * np.exp(law.log_prob(self.reading)) + arbitrary + TINY)


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
    distance = np.geomspace(seen.distance.min() / STRETCH, seen.distance.max() * STRETCH, N_DISTANCES)
    distance = np.maximum([float(f"{d:.2g}") for d in distance], batch.resolution)
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
    return Ping.of(rows[:, 0], angles[:, 0], angles[:, 1], rows[:, 3], 0.0, **logged)


def best_design(rivals: Sequence[Rival], tables: Sequence[Candidates], rng: np.random.Generator, rounds: int) -> Design:
    """Return the conditions whose readings no rival fits.

    Args:
        rivals: pairs to tell apart; all count alike, and the nearest decides.
        tables: candidate conditions; rows of the design count through all of them.
        rng: draws readings.
        rounds: times that each rival is fitted to the present design.
    """
    samples = [[_sample(rival.truth, table, rng) for table in tables] for rival in rivals]
    ratios = np.stack([_ratio(rival.model, parts) for rival, parts in zip(rivals, samples, strict=True)])
    designs = [weigh(ratios)]
    for _ in range(rounds):
        nearest = [_fitted(r, parts, designs[-1]) for r, parts in zip(rivals, samples, strict=True)]
        more = [_ratio(stack, parts) for stack, parts in zip(nearest, samples, strict=True)]
        ratios = np.concatenate([ratios, more])
        designs.append(weigh(ratios))
    return max((evaluated(rows, ratios) for rows in designs), key=lambda design: design.nats)


def weigh(ratios: Floats) -> Ints:
    """Return the rows of the conditions that maximise the least mean log-likelihood ratio over rivals, (m, n)."""
    m, n = ratios.shape
    cost = np.append(np.zeros(n), -1.0)
    above = np.concatenate([-ratios, np.ones((m, 1))], axis=1)
    one = np.append(np.ones(n), 0.0)[None]
    found = linprog(cost, above, np.zeros(m), one, [1.0], [*[(0.0, 1.0)] * n, (None, None)])
    return np.flatnonzero(found.x[:n] >= MIN_WEIGHT)


def evaluated(rows: Ints, ratios: Floats) -> Design:
    """Return the design with equally many visits under each condition, against rivals, (m, n)."""
    return Design(rows, float(ratios[:, rows].mean(axis=1).min()), ratios)


def _sample(truth: Stack, table: Candidates, rng: np.random.Generator) -> _Sample:
    ping = table.setting.ping(table.ping[np.repeat(np.arange(len(table.ping)), DRAWS)])
    ping = Ping(ping.distance, ping.angle, ping.incidence, ping.reflectance,
                ping.time + SESSION_S * rng.random(len(ping)), ping.run, ping.covariates)  # fmt: skip
    stack = table.setting.stack(truth)
    past = law_of(stack, ping).sample(rng)
    reading = law_of(stack, ping, past).sample(_EqualParts(rng))
    drawn = _Sample(ping, past, reading, table.setting, np.zeros(len(ping)))
    return _Sample(ping, past, reading, table.setting, drawn.log_prob(truth))


def _ratio(model: Stack, parts: Sequence[_Sample]) -> Floats:
    """Return mean log-likelihood ratios under each condition, nats, (n,)."""
    each = [(part.truth - part.log_prob(model)).reshape(-1, DRAWS).mean(axis=1) for part in parts]
    return np.concatenate(each)


def _fitted(rival: Rival, parts: Sequence[_Sample], rows: Ints) -> Stack:
    """Return the rival with its free parameters fitted to the readings of a design."""
    first = np.cumsum([0, *(len(part.reading) // DRAWS for part in parts)])
    chosen = [part.pick(rows[(rows >= a) & (rows < b)] - a) for part, a, b in zip(parts, first, first[1:], strict=False)]
    chosen = [part for part in chosen if len(part.reading)]
    known = [rival.model.parameter(key) for key in rival.free]
    low, width = np.array([p.low for p in known]), np.array([p.high - p.low for p in known])

    def stack(u: Floats) -> Stack:
        return rival.model.put(rival.free, low + width * u)

    def cost(u: Floats) -> float:
        # without the floor, so that a rival that is far from the readings still has a slope towards them
        return -float(np.mean(np.concatenate([part.log_prob(stack(u), 0.0) for part in chosen])))

    start = (np.array([rival.model.get(key) for key in rival.free]) - low) / width
    found = minimize(cost, np.clip(start, 0.0, 1.0), method="L-BFGS-B", bounds=[(0.0, 1.0)] * len(start), options={"maxiter": 15})
    return stack(found.x)


def settings_of(stacks: Sequence[Stack], batch: Batch) -> list[Setting]:
    """Return the settings that change a law of the given stacks."""
    names = {name for stack in stacks for name in stack.values}
    settings = [
        Setting("6 dB less receiver gain", "gain_db", -6.0, lambda s: _weaker(s, 6.0)),
        Setting("6 dB more receiver gain", "gain_db", 6.0, lambda s: _weaker(s, -6.0)),
        Setting("a hand 0.15 m in front of the sensor", "hand_m", 0.15, ping=lambda p: Ping.of(
            np.full(len(p), 0.15), 0.0, 0.0, p.reflectance, p.time, **p.covariates)),
    ]  # fmt: skip
    crosstalk = [name for name in names if name.endswith("_crosstalk")]
    if crosstalk:
        settings.append(Setting("all other sensors switched off", "others_off", 1.0, lambda s: _without(s, crosstalk)))
    if "previous_ping" in names:
        settings.append(Setting("5 ms more between pings", "interval_s", 0.005, _wait, lambda p: _logged(p, INTERVAL, 0.005)))
    if "warm_up" in names:
        settings.append(Setting("the sensor on for two hours", "time", 7200.0, ping=_later))
    if TEMPERATURE in batch.ping.covariates:
        settings.append(Setting("the room 10 degC warmer", TEMPERATURE, 10.0, ping=lambda p: _logged(p, TEMPERATURE, 10.0)))
    return settings


def _weaker(stack: Stack, loss_db: float) -> Stack:
    key = ("sensitivity", "loss_db")
    return stack.put([key], [stack.get(key) + loss_db])


def _without(stack: Stack, names: Sequence[str]) -> Stack:
    for name in names:
        stack = stack.without(name)
    return stack


def _wait(stack: Stack) -> Stack:
    """Return the law of bursts with a longer wait after each echo, where it has one."""
    key = ("previous_ping", "wait_m")
    return stack.put([key], [stack.get(key) + 0.86]) if stack.get(key) > 0 else stack


def _logged(ping: Ping, column: str, more: float) -> Ping:
    covariates = {**ping.covariates, column: ping.covariates[column] + more}
    return Ping(ping.distance, ping.angle, ping.incidence, ping.reflectance, ping.time, ping.run, covariates)


def _later(ping: Ping) -> Ping:
    return Ping(ping.distance, ping.angle, ping.incidence, ping.reflectance, ping.time + 7200.0, ping.run, ping.covariates)
