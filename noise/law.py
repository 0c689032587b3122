"""The law of a ping: the probability of each reading, on the grid of values that the sensor can report.

A law is defined by its arrival function `arrival(z)`, the probability that an echo is registered at an exact range
<= z. The register holds whole steps of the resolution q: step j covers exact ranges in ((j - 1/2) q, (j + 1/2) q]; the
first step also covers everything below, the last step everything above, and a register of 0 means no echo. The
remaining probability is divided between no echo and no answer, so that all outcomes sum to one. Readings to which a
constant was added after rounding lie on a shifted grid: `origin` is then the range that stands for step 0.
"""

from __future__ import annotations

import random
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Annotated, Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from acquisition import EchoStatus, Reading, SettingError
from acquisition.arguments import checked
from acquisition.arrays import Bits, Floats, Ints
from acquisition.errors import SampleOnlyError
from acquisition.limits import Limit, as_numbers, shown
from acquisition.ping import CREDENCE_TOLERANCE, check_pairs

Tolerance = Annotated[float, Limit(0.0, 10.0)]
MAX_N_WIDE = 64  # pings; up to this number the inverse is searched in many parts at once


class UniformSource(Protocol):
    """A source of independent uniform random numbers in [0, 1), such as `numpy.random.Generator`."""

    def random(self, size: int | tuple[int, ...], /) -> Floats:
        """Return uniform random numbers of the given shape."""
        ...


@dataclass(frozen=True)
class GivenNumbers:
    """A source that returns the same uniform numbers again, so that readings of two laws can be compared.

    Attributes:
        value: numbers, (n,).
    """

    value: Floats

    def random(self, size: int | tuple[int, ...], /) -> Floats:
        """Return the numbers."""
        return np.broadcast_to(self.value, size if isinstance(size, tuple) else (size,))


class ExtrapolationWarning(UserWarning):
    """A learned law was asked about conditions outside its training data, or about a quantity that it does not know."""


class EchoLaw(ABC):
    """Law of the readings of n pings.

    A subclass defines `_arrival`, and may define `_between` and `_sample`: `arrival`, `between` and `sample` without
    the checks of their arguments. Laws call these of each other.

    Attributes:
        distance: true distances, m, (n,).
        resolution: step of the register, m.
        max_range: range of the register's last step, m.
        origin: range of step 0, m, in (-`resolution`, 0].
        has_probabilities: whether probabilities are available; False if the law can only be sampled.
        uniform_per_ping: whether `sample(rng)` takes all its randomness as `rng.random((..., n))` calls with one column
            a ping, so that copies with different generators can be sampled in one batch. A subclass that overrides
            `_sample` must declare it again; otherwise it is False.
    """

    origin: float = 0.0
    has_probabilities: bool = True
    uniform_per_ping: bool = True

    def __init_subclass__(cls) -> None:
        """Reset `uniform_per_ping` of a subclass whose `_sample` has no declaration."""
        super().__init_subclass__()
        if "_sample" in vars(cls) and "uniform_per_ping" not in vars(cls):
            cls.uniform_per_ping = False

    def __init__(self, distance: Floats, resolution: float, max_range: float) -> None:
        self.distance = distance
        self.resolution = resolution
        self.max_range = max_range

    def arrival(self, z: ArrayLike) -> Floats:
        """Return P(an echo is registered at an exact range <= z), for z in m, (n,) or (m, n); +inf is allowed."""
        return self._arrival(self._per_ping("arrival.z", z))

    @abstractmethod
    def _arrival(self, z: Floats) -> Floats: ...

    def between(self, low: ArrayLike, high: ArrayLike) -> Floats:
        """Return P(an echo is registered at an exact range in (low, high]); subclasses may have exact tails."""
        return self._between(self._per_ping("between.low", low), self._per_ping("between.high", high))

    def _between(self, low: Floats, high: Floats) -> Floats:
        return np.maximum(self._arrival(high) - self._arrival(low), 0.0)

    @property
    @abstractmethod
    def no_answer(self) -> Floats:
        """P(the sensor does not answer), (n,)."""

    @property
    def extrapolates(self) -> Bits:
        """Whether the law was not trained with the conditions of each ping, (n,); False for laws that state physics."""
        return np.zeros(len(self), dtype=bool)

    def _per_ping(self, name: str, value: Any) -> Floats:
        """Return an argument as numbers with the pings along the last axis, (n,) or (..., n)."""
        number, n = self._numbers(name, value), len(self)
        if number.shape[-1:] not in ((), (1,), (n,)):
            raise SettingError(
                f"{type(self).__name__}.{name} has shape {number.shape}, expected {(n,)} or (..., {n}): one per ping"
            )
        return number if number.shape[-1:] == (n,) else np.broadcast_to(number, (*number.shape[:-1], n)).copy()

    def _numbers(self, name: str, value: Any) -> Floats:
        number = as_numbers(f"{type(self).__name__}.{name}", value)
        if np.isnan(number).any():
            raise SettingError(f"{type(self).__name__}.{name}: expected numbers, got {shown(value)} with a NaN")
        return number

    def __len__(self) -> int:
        """Return the number of pings."""
        return len(self.distance)

    @property
    def last_step(self) -> int:
        """Number of the register's last step."""
        return max(1, round(self.max_range / self.resolution))

    @property
    def echo(self) -> Floats:
        """P(an echo is registered), (n,)."""
        return self._arrival(np.full(len(self), np.inf))

    @property
    def no_echo(self) -> Floats:
        """P(the sensor answers that there is no echo), (n,)."""
        return np.clip(1.0 - self.echo - self.no_answer, 0.0, 1.0)

    def step(self, range_: ArrayLike) -> Ints:
        """Return the register step nearest to a range in m, 1 to `last_step`."""
        nearest = np.rint((self._numbers("step.range_", range_) - self.origin) / self.resolution)
        return np.clip(nearest, 1, self.last_step).astype(np.int64)

    def cdf_step(self, step: ArrayLike) -> Floats:
        """Return P(echo and register <= step), (n,) or (m, n); 0 for steps below 1."""
        return self._cdf_step(self._per_ping("cdf_step.step", step))

    def _cdf_step(self, step: Floats | Ints) -> Floats:
        return np.where(step < 1, 0.0, self._arrival(self._edge(step)))

    def edge(self, step: ArrayLike) -> Floats:
        """Return the upper edge of a step as exact range, m; -inf below the first step, +inf from the last step on."""
        return self._edge(self._per_ping("edge.step", step))

    def _edge(self, step: Floats | Ints) -> Floats:
        inside = (step + 0.5) * self.resolution + self.origin
        return np.where(step < 1, -np.inf, np.where(step >= self.last_step, np.inf, inside))

    def cdf(self, range_: ArrayLike) -> Floats:
        """Return P(echo and reading <= range), for range in m, (n,) or (m, n)."""
        return self._cdf_step(np.floor((self._per_ping("cdf.range_", range_) - self.origin) / self.resolution + 1e-9))

    @checked
    def log_prob(self, reading: Reading) -> Floats:
        """Return the log probability of each reading, nats, (n,); -inf for impossible readings."""
        check_pairs(f"{type(self).__name__}.log_prob.reading", self, reading)
        step = self.step(reading.range)
        with np.errstate(divide="ignore"):
            echo = np.log(self._between(self._edge(step - 1), self._edge(step)))
            table = np.stack([np.log(self.no_echo), echo, np.log(self.no_answer)])
        return np.take_along_axis(table, reading.status[None].astype(np.int64), axis=0)[0]

    def sample(self, rng: UniformSource) -> Reading:
        """Draw a reading for each ping."""
        gives_arrays = callable(getattr(rng, "random", None)) and not isinstance(rng, type | random.Random)
        if not gives_arrays:
            raise SettingError(
                f"{type(self).__name__}.sample.rng: expected a generator, such as numpy.random.default_rng(0), "
                f"got {shown(rng)}"
            )
        return self._sample(rng)

    def _sample(self, rng: UniformSource) -> Reading:
        """Draw by inversion of the law on its grid, from one uniform number a ping."""
        u, p_echo = rng.random(len(self)), self.echo
        return self._reading(u, p_echo, np.minimum(u, p_echo))

    def _reading(self, u: Floats, p_echo: Floats, place: Floats) -> Reading:
        """Return the readings of which u decides on the outcome, and a place in 0..`p_echo` on the step, (n,) each."""
        step = self._invert(place)
        status = np.where(u < p_echo, EchoStatus.ECHO, EchoStatus.NO_ECHO)
        status = np.where(u >= 1.0 - self.no_answer, EchoStatus.NO_ANSWER, status)
        return Reading.of(np.where(status == EchoStatus.ECHO, self._range(step), 0.0), status)

    def _range(self, step: Floats | Ints) -> Floats:
        """Return the reading of a step, m."""
        return np.asarray(step * self.resolution + self.origin)

    def _invert(self, u: Floats) -> Ints:
        """Return the smallest step whose cdf exceeds u, (n,) or (m, n), by repeated division into equal parts."""
        shape = np.broadcast_shapes(np.shape(u), (len(self),))
        low, high = np.zeros(shape, dtype=np.int64), np.full(shape, self.last_step)
        # for few pings the overhead of a numpy call dominates, so the search takes many parts in few calls
        parts = 128 if len(shape) == 1 and len(self) <= MAX_N_WIDE else 2
        share = np.arange(1, parts).reshape(-1, *[1] * len(shape))
        while np.any(high - low > 1):
            cuts = np.concatenate([low[None], low + (high - low) * share // parts, high[None]])
            below = np.sum(self._cdf_rows(cuts[1:-1]) <= u, axis=0)[None]
            low = np.take_along_axis(cuts, below, axis=0)[0]
            high = np.take_along_axis(cuts, below + 1, axis=0)[0]
        return high

    def _cdf_rows(self, step: Ints) -> Floats:
        """Return `cdf_step` for any number of leading axes, (..., n)."""
        return self._cdf_step(step.reshape(-1, len(self))).reshape(step.shape)

    @checked
    def credence(self, tolerance: Tolerance = CREDENCE_TOLERANCE) -> Floats:
        """Return P(an echo reads within +-tolerance of the true distance), (n,): credence given the condition."""
        below, upto = self._cdf_step(np.stack(self._right_steps(tolerance)))
        return np.minimum(np.maximum(upto - below, 0.0), 1.0)

    def _right_steps(self, tolerance: float) -> tuple[Ints, Ints]:
        """Return the steps below the first and up to the last within +-tolerance of the true distance, (n,) each."""
        low = np.ceil(((1 - tolerance) * self.distance - self.origin) / self.resolution - 1e-9).astype(np.int64)
        high = np.floor(((1 + tolerance) * self.distance - self.origin) / self.resolution + 1e-9).astype(np.int64)
        return low - 1, high

    def quantile(self, p: ArrayLike) -> Floats:
        """Return the p-quantile of the *echoes*, m, (n,); 0 where no echo is possible."""
        echo, share = self.echo, self._per_ping("quantile.p", p)
        if not np.all((share >= 0.0) & (share <= 1.0)):
            raise SettingError(f"{type(self).__name__}.quantile.p: expected numbers from 0 to 1, got {shown(p)}")
        return np.where(echo > 0, self._range(self._invert(share * echo * (1 - 1e-12))), 0.0)


class SampleOnlyLaw(EchoLaw):
    """A law that can only be sampled; a subclass defines `_sample`."""

    has_probabilities = False

    def _arrival(self, z: Floats) -> Floats:
        """Raise SampleOnlyError: there are no probabilities."""
        raise SampleOnlyError(f"{type(self).__name__} has no probabilities: draw readings with `sample(rng)`")

    @property
    def no_answer(self) -> Floats:
        """Raise SampleOnlyError, as `arrival` does."""
        return self._arrival(self.distance)
