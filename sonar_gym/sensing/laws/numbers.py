"""Random numbers for several copies of a set of sonars, and the normal distribution, compiled.

A number is a function of a key and a counter (Salmon et al. 2011, "Parallel random numbers: as easy as 1, 2, 3"), with
the finaliser of splitmix64 (Steele, Lea and Flood 2014). So a copy has 16 bytes of state, and all copies are drawn in
one call; each draws the same numbers as if it were alone.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from acquisition.arrays import Floats, Ints
from sonar_gym.compiled import compiled

_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
# Rational approximations of the normal quantile, highest power first: in the middle and in two parts of the tails
# (Wichura 1988, algorithm AS 241, PPND16; relative error 1e-16)
_MIDDLE = np.array(
    [
        [2509.0809287301226727, 33430.575583588128105, 67265.770927008700853, 45921.953931549871457,
         13731.693765509461125, 1971.5909503065514427, 133.14166789178437745, 3.387132872796366608],
        [5226.495278852545925, 28729.085735721942674, 39307.89580009271061, 21213.794301586595867,
         5394.1960214247511077, 687.1870074920579083, 42.313330701600911252, 1.0],
    ]
)  # fmt: skip
_NEAR_TAIL = np.array(
    [
        [7.7454501427834140764e-4, 0.0227238449892691845833, 0.24178072517745061177, 1.27045825245236838258,
         3.64784832476320460504, 5.7694972214606914055, 4.6303378461565452959, 1.42343711074968357734],
        [1.05075007164441684324e-9, 5.475938084995344946e-4, 0.0151986665636164571966, 0.14810397642748007459,
         0.68976733498510000455, 1.6763848301838038494, 2.05319162663775882187, 1.0],
    ]
)  # fmt: skip
_FAR_TAIL = np.array(
    [
        [2.01033439929228813265e-7, 2.71155556874348757815e-5, 0.0012426609473880784386, 0.026532189526576123093,
         0.29656057182850489123, 1.7848265399172913358, 5.4637849111641143699, 6.6579046435011037772],
        [2.04426310338993978564e-15, 1.4215117583164458887e-7, 1.8463183175100546818e-5, 7.868691311456132591e-4,
         0.0148753612908506148525, 0.13692988092273580531, 0.59983220655588793769, 1.0],
    ]
)  # fmt: skip


@compiled
def mixed(value: np.uint64) -> np.uint64:
    """Return a well-mixed function of 64 bits."""
    value = (value ^ (value >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    value = (value ^ (value >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return value ^ (value >> np.uint64(31))


@compiled
def to_unit(value: np.uint64) -> float:
    """Return a number in (0, 1) from 64 bits."""
    return ((value >> np.uint64(12)) + 0.5) * (1.0 / 4503599627370496.0)


@compiled
def draw_uniform(lead: int, copies: Ints, counts: Ints, keys: Ints, counters: Ints) -> Floats:
    """Return uniform numbers, (lead, m), and advance the counters of the copies.

    Args:
        lead: numbers per column.
        copies: numbers of the copies, (r,).
        counts: number of columns of each of them, (r,).
        keys: key of each copy, (n,).
        counters: numbers drawn so far by each copy, (n,); updated.
    """
    out, end = np.empty((lead, counts.sum())), 0
    for k in range(copies.shape[0]):
        copy, count = copies[k], counts[k]
        base = np.uint64(keys[copy]) + np.uint64(counters[copy]) * _GOLDEN
        for row in range(lead):
            for i in range(count):
                out[row, end + i] = to_unit(mixed(base + np.uint64(row * count + i + 1) * _GOLDEN))
        counters[copy] += lead * count
        end += count
    return out


@compiled
def _ratio(table: Floats, x: float) -> float:
    above, below = 0.0, 0.0
    for k in range(table.shape[1]):
        above, below = above * x + table[0, k], below * x + table[1, k]
    return above / below


@compiled
def normal_quantile(p: float) -> float:
    """Return the quantile of the standard normal distribution at p; 0 and 1 count as the numbers next to them."""
    p = min(max(p, 1e-300), 1.0 - 1e-16)
    q = p - 0.5
    if abs(q) <= 0.425:
        return q * _ratio(_MIDDLE, 0.180625 - q * q)
    r = math.sqrt(-math.log(min(p, 1.0 - p)))
    tail = _ratio(_NEAR_TAIL, r - 1.6) if r <= 5.0 else _ratio(_FAR_TAIL, r - 5.0)
    return tail if q > 0.0 else -tail


@compiled
def normal_cdf(x: float) -> float:
    """Return the distribution function of the standard normal distribution."""
    return 0.5 * math.erfc(-x * math.sqrt(0.5))


class Streams:
    """Streams of random numbers of several copies of a set of sonars.

    Args:
        copies: number of copies; their streams begin at random.
        tag: separates these streams from others with the same seed.

    Attributes:
        keys, counters: state of each copy, (copies,).
    """

    def __init__(self, copies: int, tag: int) -> None:
        self.tag = tag
        self.keys = np.random.default_rng().integers(2**63, size=copies)
        self.counters = np.zeros(copies, dtype=np.int64)
        self._generators: dict[int, np.random.Generator] = {}

    def seed(self, seed: int, copy: int) -> None:
        """Restart the stream of one copy."""
        state = np.random.SeedSequence([seed, self.tag]).generate_state(1, np.uint64)
        self.keys[copy], self.counters[copy] = state.view(np.int64)[0], 0
        self._generators.pop(copy, None)

    def __getitem__(self, copy: int) -> np.random.Generator:
        """Return a generator of one copy, for what a `UniformSource` cannot draw."""
        if copy not in self._generators:
            self._generators[copy] = np.random.default_rng(self.keys[copy].view(np.uint64))
        return self._generators[copy]

    def of(self, copies: Ints, counts: Ints, columns: int) -> CopyStreams:
        """Return the source of numbers for some columns of some copies."""
        return CopyStreams(self, copies, counts, columns)


class CopyStreams:
    """The streams of several copies as one `UniformSource`: each column's numbers come from its copy's stream.

    A law with `uniform_per_ping` then gives each copy the same readings as if it were sampled alone.

    Args:
        streams: streams of all copies.
        copies: numbers of some of them, (r,).
        counts: number of columns of each of these, (r,).
        columns: number of all columns.
    """

    def __init__(self, streams: Streams, copies: Ints, counts: Ints, columns: int) -> None:
        self._streams, self._copies, self._counts, self._columns = streams, copies, counts, columns

    def random(self, size: int | tuple[int, ...], /) -> Floats:
        """Return uniform random numbers of shape `size`, whose last axis must be the columns."""
        shape, n = size if isinstance(size, tuple) else (size,), self._columns
        if not shape or shape[-1] != n:
            raise ValueError(f"a law asked for {shape} random numbers for {n} pings: expected (..., n)")
        lead = math.prod(shape[:-1])
        keys, counters = self._streams.keys, self._streams.counters
        return draw_uniform(lead, self._copies, self._counts, keys, counters).reshape(shape)

    def parts(self) -> Iterator[tuple[slice, np.random.Generator]]:
        """Yield the columns of each copy and its generator."""
        end = 0
        for copy, count in zip(self._copies.tolist(), self._counts.tolist(), strict=True):
            end += count
            if count:
                yield slice(end - count, end), self._streams[copy]
