"""The protocols of sonar models, simulation from a model, and two models that need only numpy and scipy."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Annotated, Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import ndtr, ndtri

from acquisition import ModelError, Ping, Reading, previous
from acquisition.arguments import checked
from acquisition.limits import Limit, Metres, PositiveMetres, Share, check_settings
from acquisition.ping import check_pairs
from noise.law import CREDENCE_TOLERANCE, EchoLaw, Floats, Tolerance, UniformSource
from noise.schema import Resolution

ORDER = "order_in_visit"  # column of the number of earlier pings under the same condition
MAX_RANGE = 11.008  # m; SRF08 with range register 255, Devantech product information


@runtime_checkable
class SonarModel(Protocol):
    """A map from the conditions of pings to the laws of their readings."""

    @property
    def resolution(self) -> float:
        """Step of the register, m."""
        ...

    @property
    def remembers(self) -> bool:
        """Whether the law depends on the previous reading."""
        ...

    def law(self, ping: Ping, past: Reading | None = None) -> EchoLaw:
        """Return the law of n pings, given the previous reading of each; None where it is unknown."""
        ...


class NormalLaw(EchoLaw):
    """Normal arrival time per ping, with a probability of no echo. `sigma` = 0 means no noise.

    Attributes:
        mean, sigma: mean and standard deviation of the exact range, m, (n,).
        miss: probability of no echo, (n,).
    """

    uniform_per_ping = True

    def __init__(
        self, ping: Ping, mean: Floats, sigma: Floats, miss: Floats, resolution: float, max_range: float
    ) -> None:
        super().__init__(ping.distance, resolution, max_range)
        self.mean, self.sigma, self.miss = mean, sigma, miss

    def _arrival(self, z: Floats) -> Floats:
        return (1.0 - self.miss) * ndtr(self._score(z))

    def _between(self, low: Floats, high: Floats) -> Floats:
        """Return P(an echo is registered at an exact range in (low, high]), exact in both tails."""
        below, above = self._score(low), self._score(high)
        upper = below > 0  # beyond the mean, the upper tail is the smaller number
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
        """P(the sensor does not answer): 0."""
        return np.zeros(len(self))

    def _sample(self, rng: UniformSource) -> Reading:
        """Draw a reading for each ping from one uniform number, in closed form for speed."""
        u = rng.random(len(self))
        echo = u < 1.0 - self.miss
        step = self._invert(np.where(echo, u, 0.0))
        return Reading(np.where(echo, self._range(step), 0.0), echo.astype(np.uint8))

    def _invert(self, u: Floats) -> NDArray[np.int64]:
        """Return the smallest step whose cdf exceeds u."""
        # u is limited to (0, 1 - miss): its ends map to infinite ranges, even where sigma is 0
        share = np.minimum(np.maximum(u / np.maximum(1.0 - self.miss, 1e-300), 1e-300), 1.0 - 1e-16)
        nearest = np.ceil((self.mean + self.sigma * ndtri(share) - self.origin) / self.resolution - 0.5)
        return np.minimum(np.maximum(nearest, 1), self.last_step).astype(np.int64)


class CertainLaw(NormalLaw):
    """A deterministic reading: the true distance, or no echo; `miss` is 0 or 1."""

    uniform_per_ping = True

    def __init__(self, ping: Ping, miss: Floats, resolution: float, max_range: float) -> None:
        super().__init__(ping, ping.distance, np.zeros(len(ping)), miss, resolution, max_range)

    @property
    def _steps(self) -> Floats:
        """Register step nearest to each distance, as floats."""
        return np.minimum(
            np.maximum(np.ceil((self.distance - self.origin) / self.resolution - 0.5), 1.0), self.last_step
        )

    def _sample(self, rng: UniformSource) -> Reading:
        """Return the readings; no random number is drawn."""
        echo = self.miss < 1.0
        return Reading(self._range(self._steps) * echo, echo.view(np.uint8))

    @checked
    def credence(self, tolerance: Tolerance = CREDENCE_TOLERANCE) -> Floats:
        """Return 1 where the register step lies within +-tolerance of the distance, else 0, (n,)."""
        off = np.abs(self._range(self._steps) - self.distance)
        right = off <= tolerance * self.distance + 1e-9 * self.resolution
        return right * (1.0 - self.miss)


@dataclass(frozen=True)
class IdealModel:
    """A sonar that always reads the true distance.

    Args:
        resolution: step of the register, m.
        max_range: range beyond which there is no echo, m.

    >>> import numpy as np
    >>> law = IdealModel().law(Ping.of(distance=[0.5, 2.0]))
    >>> law.sample(np.random.default_rng(0)).range
    array([0.5, 2. ])
    >>> law.credence()
    array([1., 1.])
    """

    resolution: Resolution = 0.001
    max_range: PositiveMetres = MAX_RANGE
    remembers: bool = False

    def __post_init__(self) -> None:
        """Raise SettingError for invalid values."""
        check_settings(self)

    @checked
    def law(self, ping: Ping, past: Reading | None = None) -> EchoLaw:
        """Return the deterministic law of n pings."""
        miss = (ping.distance > self.max_range).astype(np.float64)
        return CertainLaw(ping, miss, self.resolution, self.max_range)

    def to_dict(self) -> dict[str, object]:
        """Return the model as plain data."""
        return plain_numbers("ideal", self)

    @classmethod
    @checked
    def from_dict(cls, data: dict[str, object]) -> IdealModel:
        """Build a model from the output of `to_dict`."""
        return from_numbers("ideal", cls, data)


@dataclass(frozen=True)
class GaussianModel:
    """True distance plus normal noise.

    Args:
        sigma: standard deviation at zero distance, m.
        sigma_per_metre: growth of the standard deviation with distance, m per m.
        miss: probability of no echo.
        resolution: step of the register, m.
        max_range: range beyond which there is no echo, m.
    """

    sigma: Metres = 0.01
    sigma_per_metre: Annotated[float, Limit(0.0, 100.0, "m per m")] = 0.005
    miss: Share = 0.0
    resolution: Resolution = 0.001
    max_range: PositiveMetres = MAX_RANGE
    remembers: bool = False

    def __post_init__(self) -> None:
        """Raise SettingError for invalid values."""
        check_settings(self)

    @checked
    def law(self, ping: Ping, past: Reading | None = None) -> EchoLaw:
        """Return the law of n pings."""
        sigma = self.sigma + self.sigma_per_metre * ping.distance
        miss = np.where(ping.distance > self.max_range, 1.0, self.miss)
        return NormalLaw(ping, ping.distance, sigma, miss, self.resolution, self.max_range)

    def to_dict(self) -> dict[str, object]:
        """Return the model as plain data."""
        return plain_numbers("gaussian", self)

    @classmethod
    @checked
    def from_dict(cls, data: dict[str, object]) -> GaussianModel:
        """Build a model from the output of `to_dict`.

        Raises:
            ModelError: a parameter is missing or not a number.
        """
        return from_numbers("gaussian", cls, data)


def plain_numbers(kind: str, model: Any) -> dict[str, Any]:
    """Return a dataclass of numbers as plain data."""
    return {"kind": kind, **{name: value for name, value in asdict(model).items() if name != "remembers"}}


def from_numbers(kind: str, cls: Any, data: dict[str, Any]) -> Any:
    """Build a model from the output of `plain_numbers`.

    Raises:
        ModelError: a value is missing, not a number, or outside its limits.
    """
    try:
        return cls(**{name: float(data[name]) for name in asdict(cls()) if name != "remembers"})
    except (KeyError, TypeError, ValueError) as error:
        raise ModelError(f"{kind} model: cannot be built from its parameters ({error}); it may be damaged") from None


@runtime_checkable
class StatefulModel(SonarModel, Protocol):
    """A model with a state for each sensor of one set, updated at every ping."""

    def law(self, ping: Ping, past: Reading | None = None, sensors: NDArray[np.int64] | None = None) -> EchoLaw:
        """Return the law of n pings, given the previous reading of each.

        Args:
            ping: conditions, (n,).
            past: previous readings, (n,).
            sensors: index of each ping's sensor, (n,); all sensors in order by default.
        """
        ...

    def fresh(self) -> StatefulModel:
        """Return the same model with an empty state of its own."""
        ...

    def reset(self, sensors: ArrayLike | None = None) -> None:
        """Clear the state of all sensors, or of those given by index or mask."""
        ...

    @checked
    def follow(self, ping: Ping, reading: Reading) -> EchoLaw:
        """Return the law of every ping of a recording given all earlier pings of its run, (n,)."""
        ...


@checked
def listener(model: SonarModel) -> SonarModel:
    """Return a model for one set of sensors: a copy with an empty state of its own if the model is stateful."""
    return model.fresh() if isinstance(model, StatefulModel) else model


@checked
def follow(model: SonarModel, ping: Ping, reading: Reading) -> EchoLaw:
    """Return the law of every ping of a recording given the earlier pings of its run, (n,).

    Args:
        model: model of the sensor.
        ping: conditions, (n,), in chronological order.
        reading: readings, (n,).
    """
    check_pairs("follow.reading", ping, reading)
    if isinstance(model, StatefulModel):
        return model.follow(ping, reading)
    return model.law(ping, previous(reading, ping.run)) if model.remembers else model.law(ping)


@checked
def simulate(model: SonarModel, ping: Ping, rng: np.random.Generator) -> Reading:
    """Draw a reading for every ping, run by run in chronological order where the law depends on earlier readings.

    Args:
        model: model to sample from.
        ping: conditions, (n,), in chronological order.
        rng: random generator.
    """
    if not model.remembers:
        return model.law(ping).sample(rng)
    ping = with_order(ping)
    if isinstance(model, StatefulModel):
        return _simulate_all(model.fresh(), ping, rng)
    reading = Reading.of(np.zeros(len(ping)), np.full(len(ping), 2))
    value, status = reading.range.copy(), reading.status.copy()
    for k, rows in enumerate(steps(ping.run)):
        past = previous(Reading(value, status), ping.run)[rows] if k else None
        drawn = model.law(ping[rows], past).sample(rng)
        value[rows], status[rows] = drawn.range, drawn.status
    return Reading.of(value, status)


def with_order(ping: Ping) -> Ping:
    """Return pings with their order under one condition in the column `ORDER`, which a selection of them would lose."""
    return ping if ORDER in ping.covariates else replace(ping, covariates={**ping.covariates, ORDER: order_of(ping)})


def order_of(ping: Ping) -> NDArray[np.float64]:
    """Return the number of earlier pings under the same condition in an unbroken series, (n,).

    >>> order_of(Ping.of([1.0, 1.0, 1.0, 2.0, 1.0]))
    array([0., 1., 2., 0., 0.])
    """
    if ORDER in ping.covariates:
        return ping.covariates[ORDER]
    condition = np.stack([ping.distance, ping.angle, ping.incidence, ping.reflectance, ping.run])
    starts = np.any(np.diff(condition, axis=1, prepend=np.nan) != 0.0, axis=0)
    row = np.arange(len(ping), dtype=np.float64)
    return row - np.maximum.accumulate(np.where(starts, row, 0.0))


def _simulate_all(model: StatefulModel, ping: Ping, rng: np.random.Generator) -> Reading:
    """Draw all runs in parallel; a run that has ended repeats its last ping, and the result is discarded."""
    value, status, past = np.zeros(len(ping)), np.zeros(len(ping), np.uint8), None
    number = np.unique(ping.run, return_inverse=True)[1]
    now = np.zeros(int(number.max(initial=-1)) + 1, dtype=np.int64)
    for rows in steps(ping.run):
        now[number[rows]] = rows
        past = model.law(ping[now], past).sample(rng)
        value[rows], status[rows] = past.range[number[rows]], past.status[number[rows]]
    return Reading.of(value, status)


def steps(run: NDArray[np.int64]) -> list[NDArray[np.int64]]:
    """Return for k = 0, 1, ... the indices of the pings that are k-th in their run.

    >>> [rows.tolist() for rows in steps(np.array([7, 3, 7, 7]))]
    [[0, 1], [2], [3]]
    """
    order = np.argsort(run, kind="stable")
    starts = np.r_[0, np.flatnonzero(np.diff(run[order])) + 1]
    rank = np.empty(len(run), dtype=np.int64)
    rank[order] = np.arange(len(run)) - np.repeat(starts, np.diff(np.r_[starts, len(run)]))
    by_rank = np.argsort(rank, kind="stable")
    return np.split(by_rank, np.cumsum(np.bincount(rank))[:-1]) if len(run) else []
