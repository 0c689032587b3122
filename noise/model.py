"""Sonar models: maps from what a ping faced to the law of its reading. Those here need numpy and scipy alone."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import ndtr, ndtri

from acquisition import ModelError, Ping, Reading, SettingError, previous
from noise.law import CREDENCE_TOLERANCE, EchoLaw, Floats

MAX_RANGE = 11.008  # m; SRF08 with range register 255, Devantech product information


@runtime_checkable
class SonarModel(Protocol):
    """A map from pings to laws.

    Attributes:
        resolution: step of the register, m.
        remembers: whether the law depends on the previous reading.
    """

    @property
    def resolution(self) -> float:
        """Step of the register, m."""
        ...

    @property
    def remembers(self) -> bool:
        """Whether the law depends on the previous reading."""
        ...

    def law(self, ping: Ping, past: Reading | None = None) -> EchoLaw:
        """Return the law of n pings, given the reading before each (None: nothing is known of it)."""
        ...


class NormalLaw(EchoLaw):
    """One normal arrival per ping, with a chance of no echo; `sigma` 0 is certainty."""

    def __init__(
        self, ping: Ping, mean: Floats, sigma: Floats, miss: Floats, resolution: float, max_range: float
    ) -> None:
        super().__init__(ping.distance, resolution, max_range)
        self.mean, self.sigma, self.miss = mean, sigma, miss

    def arrival(self, z: Floats) -> Floats:
        """Return P(an echo is registered at an exact range <= z)."""
        return (1.0 - self.miss) * ndtr(self._score(z))

    def between(self, low: Floats, high: Floats) -> Floats:
        """Return P(an echo is registered at an exact range in (low, high]), exact in both tails."""
        below, above = self._score(low), self._score(high)
        upper = below > 0  # beyond the mean, what is left of the upper tail is the smaller number
        share = np.where(upper, ndtr(-below) - ndtr(-above), ndtr(above) - ndtr(below))
        return (1.0 - self.miss) * share

    def _score(self, z: Floats) -> Floats:
        certain = np.where(z >= self.mean, np.inf, -np.inf)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            return np.where(self.sigma > 0, (z - self.mean) / self.sigma, certain)

    @property
    def echo(self) -> Floats:
        """P(an echo is registered), (n,)."""
        return 1.0 - self.miss

    @property
    def no_answer(self) -> Floats:
        """P(the sensor does not answer): never."""
        return np.zeros(len(self))

    def sample(self, rng: np.random.Generator) -> Reading:
        """Draw a reading for each ping from one uniform number, in closed form: a simulator does so at every step."""
        u = rng.random(len(self))
        echo = u < 1.0 - self.miss
        step = self._invert(np.where(echo, u, 0.0))
        return Reading(np.where(echo, step * self.resolution, 0.0), echo.astype(np.uint8))

    def _invert(self, u: Floats) -> NDArray[np.int64]:
        """Return the smallest step whose cdf exceeds u."""
        # u is kept inside (0, 1 - miss): the ends stand at infinite distance even where sigma is 0
        share = np.minimum(np.maximum(u / np.maximum(1.0 - self.miss, 1e-300), 1e-300), 1.0 - 1e-16)
        nearest = np.ceil((self.mean + self.sigma * ndtri(share)) / self.resolution - 0.5)
        return np.minimum(np.maximum(nearest, 1), self.last_step).astype(np.int64)


class CertainLaw(NormalLaw):
    """A normal arrival without spread, which needs no normal numbers: `miss` is 0 or 1, nothing is left to chance."""

    def __init__(self, ping: Ping, miss: Floats, resolution: float, max_range: float) -> None:
        super().__init__(ping, ping.distance, np.zeros(len(ping)), miss, resolution, max_range)

    @property
    def _steps(self) -> Floats:
        """The register's step nearest to each distance, not yet a whole number's type."""
        return np.minimum(np.maximum(np.ceil(self.distance / self.resolution - 0.5), 1.0), self.last_step)

    def sample(self, rng: np.random.Generator) -> Reading:
        """Return what is read, for sure; no number is drawn."""
        echo = self.miss < 1.0
        return Reading(self._steps * (echo * self.resolution), echo.view(np.uint8))

    def credence(self, tolerance: float = CREDENCE_TOLERANCE) -> Floats:
        """Return 1 where the register's step lies within +-tolerance of the distance, else 0, (n,)."""
        off = np.abs(self._steps * self.resolution - self.distance)
        right = off <= tolerance * self.distance + 1e-9 * self.resolution
        return right * (1.0 - self.miss)


@dataclass(frozen=True)
class IdealModel:
    """A sonar that reads the true distance, always: what most simulators assume.

    Args:
        resolution: step of the register, m.
        max_range: farther reflectors give no echo, m.

    >>> import numpy as np
    >>> law = IdealModel().law(Ping.of(distance=[0.5, 2.0]))
    >>> law.sample(np.random.default_rng(0)).range
    array([0.5, 2. ])
    >>> law.credence()
    array([1., 1.])
    """

    resolution: float = 0.001
    max_range: float = MAX_RANGE
    remembers: bool = False

    def law(self, ping: Ping, past: Reading | None = None) -> EchoLaw:
        """Return the law of n pings: certainty."""
        miss = (ping.distance > self.max_range).astype(np.float64)
        return CertainLaw(ping, miss, self.resolution, self.max_range)

    def to_dict(self) -> dict[str, Any]:
        """Return the model as plain data."""
        return plain_numbers("ideal", self)

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> IdealModel:
        """Build a model from `to_dict`; see `GaussianModel.from_dict`."""
        return cls(**numbers_of("ideal", cls(), data))


@dataclass(frozen=True)
class GaussianModel:
    """True distance plus normal noise, the usual stand-in for a sonar.

    Args:
        sigma: standard deviation at zero distance, m.
        sigma_per_metre: its growth with distance, m per m.
        miss: probability of no echo.
        resolution: step of the register, m.
        max_range: farther reflectors give no echo, m.
    """

    sigma: float = 0.01
    sigma_per_metre: float = 0.005
    miss: float = 0.0
    resolution: float = 0.001
    max_range: float = MAX_RANGE
    remembers: bool = False

    def __post_init__(self) -> None:
        """Refuse what is no probability or no deviation."""
        if self.sigma < 0 or self.sigma_per_metre < 0:
            raise SettingError(f"GaussianModel.sigma must be >= 0 m, got {self.sigma:g} m")
        if not 0 <= self.miss <= 1:
            raise SettingError(f"GaussianModel.miss must lie in [0, 1], got {self.miss:g}")

    def law(self, ping: Ping, past: Reading | None = None) -> EchoLaw:
        """Return the law of n pings."""
        sigma = self.sigma + self.sigma_per_metre * ping.distance
        miss = np.where(ping.distance > self.max_range, 1.0, self.miss)
        return NormalLaw(ping, ping.distance, sigma, miss, self.resolution, self.max_range)

    def to_dict(self) -> dict[str, Any]:
        """Return the model as plain data."""
        return plain_numbers("gaussian", self)

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> GaussianModel:
        """Build a model from `to_dict`.

        Raises:
            ModelError: a parameter is missing or no number.
        """
        return cls(**numbers_of("gaussian", cls(), data))


def plain_numbers(kind: str, model: Any) -> dict[str, Any]:
    """Return a model that is a dataclass of numbers as plain data."""
    return {"kind": kind, **{name: value for name, value in asdict(model).items() if name != "remembers"}}


def numbers_of(kind: str, default: Any, data: dict[str, Any]) -> dict[str, Any]:
    """Return the numbers of such a model from plain data.

    Raises:
        ModelError: one is missing or no number.
    """
    try:
        return {name: float(data[name]) for name in asdict(default) if name != "remembers"}
    except (KeyError, TypeError, ValueError) as error:
        raise ModelError(f"{kind} model: cannot be built from its parameters ({error}); it may be damaged") from None


@runtime_checkable
class Remembering(SonarModel, Protocol):
    """A model that keeps a memory of each sensor's pings; it serves one set of sensors."""

    def law(self, ping: Ping, past: Reading | None = None, seats: NDArray[np.int64] | None = None) -> EchoLaw:
        """Return the law of n pings, given the reading before each, of all sensors or of those on some seats."""
        ...

    def fresh(self) -> Remembering:
        """Return the same model with a memory of its own, empty."""
        ...

    def reset(self, seats: ArrayLike | None = None) -> None:
        """Forget everything, or what some sensors remember: their numbers, or a mask."""
        ...

    def follow(self, ping: Ping, reading: Reading) -> EchoLaw:
        """Return the law of every ping of a recording given all pings before it in its run, (n,)."""
        ...


def listener(model: SonarModel) -> SonarModel:
    """Return a model for one set of sensors alone: one that keeps a memory is given another, empty one."""
    return model.fresh() if isinstance(model, Remembering) else model


def follow(model: SonarModel, ping: Ping, reading: Reading) -> EchoLaw:
    """Return the law of every ping of a recording given what its model remembers of those before it in its run, (n,).

    Args:
        model: of the sensor.
        ping: conditions, (n,), in the order in which they were faced.
        reading: what was read, (n,).
    """
    if isinstance(model, Remembering):
        return model.follow(ping, reading)
    return model.law(ping, previous(reading, ping.run)) if model.remembers else model.law(ping)


def simulate(model: SonarModel, ping: Ping, rng: np.random.Generator) -> Reading:
    """Draw a reading for every ping, in the order of each run where the model remembers.

    Args:
        model: whose laws to sample.
        ping: the conditions, (n,), in the order in which they were faced.
        rng: the only source of chance.
    """
    if not model.remembers:
        return model.law(ping).sample(rng)
    if isinstance(model, Remembering):
        return _simulate_all(model.fresh(), ping, rng)
    reading = Reading.of(np.zeros(len(ping)), np.full(len(ping), 2))
    value, status = reading.range.copy(), reading.status.copy()
    for k, rows in enumerate(steps(ping.run)):
        past = previous(Reading(value, status), ping.run)[rows] if k else None
        drawn = model.law(ping[rows], past).sample(rng)
        value[rows], status[rows] = drawn.range, drawn.status
    return Reading.of(value, status)


def _simulate_all(model: Remembering, ping: Ping, rng: np.random.Generator) -> Reading:
    """Draw with all runs side by side; a run that has ended fires its last ping on, and nobody listens."""
    value, status, past = np.zeros(len(ping)), np.zeros(len(ping), np.uint8), None
    number = np.unique(ping.run, return_inverse=True)[1]
    now = np.zeros(int(number.max(initial=-1)) + 1, dtype=np.int64)
    for rows in steps(ping.run):
        now[number[rows]] = rows
        past = model.law(ping[now], past).sample(rng)
        value[rows], status[rows] = past.range[number[rows]], past.status[number[rows]]
    return Reading.of(value, status)


def steps(run: NDArray[np.int64]) -> list[NDArray[np.int64]]:
    """Return for k = 0, 1, ... the rows that are k-th in their run.

    >>> [rows.tolist() for rows in steps(np.array([7, 3, 7, 7]))]
    [[0, 1], [2], [3]]
    """
    order = np.argsort(run, kind="stable")
    starts = np.r_[0, np.flatnonzero(np.diff(run[order])) + 1]
    rank = np.empty(len(run), dtype=np.int64)
    rank[order] = np.arange(len(run)) - np.repeat(starts, np.diff(np.r_[starts, len(run)]))
    by_rank = np.argsort(rank, kind="stable")
    return np.split(by_rank, np.cumsum(np.bincount(rank))[:-1]) if len(run) else []
