"""Grammar of unmodelled faults: a random aspect changes as a random function of random inputs.

    fault    = change [change]
    change   = aspect x strength x function
    function = shape of an input, or the product of the shapes of two or three inputs
    input    = any of distance, angle, incidence, reflectance, time, interval, covariates, previous reading, place in
               the visit
    shape    = bump | wave | edge | box | stairs

Every fault is an operator on readings, so that it can be planted behind every sonar. What is a constant or linear in
distance or time is subtracted from a bias: an offset, a scale and a drift are in the catalogue.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from acquisition import Ping
from acquisition.arrays import Floats
from acquisition.ping import interval
from training.diagnosis.generators.world import Operator, Rng, shifted, starts_run, visits

Shape = Callable[[Floats], Floats]  # from an input scaled to 0..1 in the recording to a value from 0 to 1
PREVIOUS, PLACE, INTERVAL = "previous reading", "place in the visit", "interval"
MEMORY = (PREVIOUS, PLACE)
# change at size 1, in m or as a share of the readings
AT_ONE = {
    "bias": 0.03,
    "spread": 0.04,
    "skew": 0.05,
    "loss": 0.4,
    "early": 0.25,
    "late": 0.25,
    "hold": 0.5,
    "steps": 0.06,
}
MAX_SHARE = 0.9
COLLINEAR = 0.2  # ratio of singular values below which columns of unit variance are taken for one
MIN_CONTRAST = 0.15  # standard deviation of a function over the pings, which lies between 0 and 1


def inputs(ping: Ping, value: Floats) -> dict[str, Floats]:
    """Return everything that a fault may depend on, by name, (n,) each."""
    visit, first = visits(ping), starts_run(ping)
    start = np.searchsorted(visit, visit)
    conditions = {name: getattr(ping, name) for name in ("distance", "angle", "incidence", "reflectance", "time")}
    memory = {
        INTERVAL: np.minimum(interval(ping.time, ping.run), 1.0),
        PREVIOUS: np.where(first, 0.0, np.roll(value, 1)),
        PLACE: np.log1p(np.arange(len(visit)) - start),
    }
    return {**conditions, **ping.covariates, **memory}


@dataclass(frozen=True)
class Function:
    """Product of shapes of inputs.

    Attributes:
        names: of the inputs.
        scales: lowest value and range of each in the recording for which the fault was drawn.
        shapes: of each input.
        words: plain description.
    """

    names: tuple[str, ...]
    scales: tuple[tuple[float, float], ...]
    shapes: tuple[Shape, ...]
    words: str

    def __call__(self, given: dict[str, Floats]) -> Floats:
        """Return its value for each ping, 0 to 1, (n,)."""
        factors = (
            shape((given[name] - low) / width)
            for name, (low, width), shape in zip(self.names, self.scales, self.shapes, strict=True)
        )
        return np.asarray(np.prod(np.stack(list(factors)), axis=0))


def _bump(rng: Rng) -> Shape:
    centre, width = rng.uniform(0.1, 0.9), rng.uniform(0.08, 0.3)
    return lambda u: np.exp(-0.5 * ((u - centre) / width) ** 2)


def _wave(rng: Rng) -> Shape:
    cycles, phase = rng.uniform(0.8, 4.0), rng.uniform(0.0, 2.0 * np.pi)
    return lambda u: 0.5 + 0.5 * np.sin(2.0 * np.pi * cycles * u + phase)


def _edge(rng: Rng) -> Shape:
    centre, width = rng.uniform(0.25, 0.75), rng.choice([-1.0, 1.0]) * rng.uniform(0.01, 0.1)
    return lambda u: 0.5 + 0.5 * np.tanh((u - centre) / width)


def _box(rng: Rng) -> Shape:
    low, width = rng.uniform(0.0, 0.7), rng.uniform(0.15, 0.5)
    return lambda u: ((u >= low) & (u <= low + width)).astype(np.float64)


def _stairs(rng: Rng) -> Shape:
    level = rng.uniform(0.0, 1.0, int(rng.integers(3, 7)))
    level[rng.integers(len(level))] = 1.0
    return lambda u: level[np.clip((u * len(level)).astype(np.int64), 0, len(level) - 1)]


SHAPES = {"bump": _bump, "wave": _wave, "edge": _edge, "box": _box, "stairs": _stairs}


def draw_function(given: dict[str, Floats], rng: Rng, tries: int = 50) -> Function:
    """Draw a function that varies over the pings from which the inputs come.

    Args:
        given: the inputs of the recording, (n,) each.
        rng: source of all randomness.
        tries: candidates, of which the first with enough contrast, else the one with the most, is returned.
    """
    varied = [name for name, x in given.items() if np.ptp(x) > 1e-9]
    best: tuple[float, Function] | None = None
    for _ in range(tries):
        count = min(len(varied), int(rng.choice([1, 2, 3], p=[0.5, 0.35, 0.15])))
        candidate = _function([str(name) for name in rng.choice(varied, count, replace=False)], given, rng)
        contrast = float(np.std(candidate(given)))
        if best is None or contrast > best[0]:
            best = contrast, candidate
        if contrast >= MIN_CONTRAST:
            break
    assert best is not None
    return best[1]


def _function(names: list[str], given: dict[str, Floats], rng: Rng) -> Function:
    kinds = [str(kind) for kind in rng.choice(list(SHAPES), len(names))]
    scales = tuple((float(given[n].min()), float(max(np.ptp(given[n]), 1e-9))) for n in names)
    words = " times ".join(f"a {kind} of the {name}" for kind, name in zip(kinds, names, strict=True))
    return Function(tuple(names), scales, tuple(SHAPES[kind](rng) for kind in kinds), words)


def _bias(function: Function, amount: float, ping: Ping) -> Operator:
    """Return a bias from which offset, scale and drift, fitted over the recording's pings, are subtracted.

    In a survey in order of distance, distance and time are one: then each has half of the line, since two great weights
    that cancel would not do so in a survey in another order.
    """
    columns = (ping.distance, ping.time)
    middle, width = np.mean(columns, axis=1), np.maximum(np.std(columns, axis=1), 1e-9)

    def basis(p: Ping) -> Floats:
        return np.c_[np.ones(len(p)), (np.stack([p.distance, p.time], axis=1) - middle) / width]

    weight = np.linalg.lstsq(basis(ping), function(inputs(ping, ping.distance)), rcond=COLLINEAR)[0]

    def operator(value: Floats, p: Ping, rng: Rng) -> Floats:
        return shifted(value, 2.0 * amount * (function(inputs(p, value)) - basis(p) @ weight))

    return operator


def _scatter(function: Function, amount: float, skewed: bool) -> Operator:
    def operator(value: Floats, ping: Ping, rng: Rng) -> Floats:
        error = rng.exponential(size=len(value)) - 1.0 if skewed else rng.standard_normal(len(value))
        return shifted(value, amount * function(inputs(ping, value)) * error)

    return operator


def _replaced(function: Function, amount: float, by: Callable[[Floats, Rng], Floats]) -> Operator:
    def operator(value: Floats, ping: Ping, rng: Rng) -> Floats:
        hit = rng.random(len(value)) < min(amount, MAX_SHARE) * function(inputs(ping, value))
        return np.where(hit & (value > 0.0), by(value, rng), value)

    return operator


def _held(function: Function, amount: float) -> Operator:
    def operator(value: Floats, ping: Ping, rng: Rng) -> Floats:
        hit = rng.random(len(value)) < min(amount, MAX_SHARE) * function(inputs(ping, value))
        return value[np.maximum.accumulate(np.where(hit & ~starts_run(ping), -1, np.arange(len(value))))]

    return operator


def _steps(function: Function, amount: float) -> Operator:
    def operator(value: Floats, ping: Ping, rng: Rng) -> Floats:
        coarse = function(inputs(ping, value)) > 0.5
        return np.where(coarse & (value > 0.0), np.maximum(np.rint(value / amount), 1.0) * amount, value)

    return operator


def _operator(aspect: str, function: Function, amount: float, ping: Ping, rng: Rng) -> Operator:
    short, long = np.sort(rng.uniform(0.3, 0.95, 2)), np.sort(rng.uniform(1.05, 1.6, 2))
    makers: dict[str, Callable[[], Operator]] = {
        "bias": lambda: _bias(function, amount * rng.choice([-1.0, 1.0]), ping),
        "spread": lambda: _scatter(function, amount, skewed=False),
        "skew": lambda: _scatter(function, amount * rng.choice([-1.0, 1.0]), skewed=True),
        "loss": lambda: _replaced(function, amount, lambda v, r: np.zeros(len(v))),
        "early": lambda: _replaced(function, amount, lambda v, r: v * r.uniform(short[0], short[1], len(v))),
        "late": lambda: _replaced(function, amount, lambda v, r: v * r.uniform(long[0], long[1], len(v))),
        "hold": lambda: _held(function, amount),
        "steps": lambda: _steps(function, amount),
    }
    return makers[aspect]()


def draw_fault(ping: Ping, rng: Rng, size: float, without: tuple[str, ...] = ()) -> tuple[tuple[Operator, ...], str]:
    """Draw an unmodelled fault of one or two changes.

    Args:
        ping: of the recording, (n,): faults depend on what varies in it.
        rng: source of all randomness.
        size: strength relative to one that is plain to see.
        without: inputs that it does not depend on.

    Returns:
        Operators on readings, and a plain description.
    """
    count = 1 if rng.random() < 0.7 else 2
    operators, words = [], []
    given = {name: value for name, value in inputs(ping, ping.distance).items() if name not in without}
    for aspect in rng.choice(list(AT_ONE), count, replace=False):
        function = draw_function(given, rng)
        amount = AT_ONE[str(aspect)] * size
        operators.append(_operator(str(aspect), function, amount, ping, rng))
        words.append(f"{aspect} of {amount:.3g} as {function.words}")
    return tuple(operators), "; ".join(words)
