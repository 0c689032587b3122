"""Faults on any model: SHORT, NOISE, CONSTANT and CALIBRATION of Sharma et al. (2010), which Esmi (2016) takes up.

`Faulty(model, faults)` is a `SonarModel` whatever the model is, physical or learned. At each ping at most one fault
strikes, each at its own rate and whatever struck before; else the model's own law holds. A fault changes what is
read, never whether the wire is alive: pings that the model leaves without an answer stay without one.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import ndtr

from acquisition import EchoStatus, ModelError, Ping, Reading, SettingError
from noise.law import EchoLaw, Floats
from noise.model import MAX_RANGE, Remembering, SonarModel, follow, listener


@dataclass(frozen=True)
class Fault(ABC):
    """What happens to a reading now and then.

    Attributes:
        rate: share of pings that it strikes, 0..1; 0 does nothing.
    """

    rate: float = 0.0

    def __post_init__(self) -> None:
        """Refuse what is no rate."""
        if not 0 <= self.rate <= 1:
            raise SettingError(f"{type(self).__name__}.rate must lie in [0, 1], got {self.rate:g}")

    @abstractmethod
    def law(self, law: EchoLaw, ping: Ping) -> EchoLaw:
        """Return the law of what is read where the fault strikes, from the law where none does."""


class ReplacedLaw(EchoLaw):
    """Echoes by a fault's own distribution; `echo_share` of pings have one, no answer is the model's."""

    def __init__(self, law: EchoLaw, echo_share: Floats) -> None:
        super().__init__(law.distance, law.resolution, law.max_range)
        self.echo_share, self._no_answer = echo_share, law.no_answer

    @property
    def no_answer(self) -> Floats:
        """P(the sensor does not answer), (n,)."""
        return self._no_answer


class ShortLaw(ReplacedLaw):
    """Uniform over (0, span] m."""

    def __init__(self, law: EchoLaw, span: float) -> None:
        super().__init__(law, 1.0 - law.no_answer)
        self.span = span

    def arrival(self, z: Floats) -> Floats:
        """Return P(an echo is registered at an exact range <= z)."""
        return self.echo_share * np.clip(np.asarray(z) / self.span, 0.0, 1.0)


class ScatteredLaw(ReplacedLaw):
    """Normal about the true distance, where the model hears an echo."""

    def __init__(self, law: EchoLaw, sigma: float) -> None:
        super().__init__(law, law.echo)
        self.sigma = sigma

    def arrival(self, z: Floats) -> Floats:
        """Return P(an echo is registered at an exact range <= z)."""
        return self.echo_share * ndtr((np.asarray(z) - self.distance) / self.sigma)

    def between(self, low: Floats, high: Floats) -> Floats:
        """Return P(an echo is registered at an exact range in (low, high]), exact in both tails."""
        below, above = (low - self.distance) / self.sigma, (high - self.distance) / self.sigma
        share = np.where(below > 0, ndtr(-below) - ndtr(-above), ndtr(above) - ndtr(below))
        return self.echo_share * share


class ConstantLaw(ReplacedLaw):
    """One step of the register, always."""

    def __init__(self, law: EchoLaw, value: float) -> None:
        super().__init__(law, 1.0 - law.no_answer)
        self.value = float(law.step(value)) * law.resolution

    def arrival(self, z: Floats) -> Floats:
        """Return P(an echo is registered at an exact range <= z)."""
        return self.echo_share * (np.asarray(z) >= self.value)


class CalibratedLaw(ReplacedLaw):
    """The model's exact ranges, scaled and moved before they are registered."""

    def __init__(self, law: EchoLaw, scale: float, offset: Floats) -> None:
        super().__init__(law, law.echo)
        self.inner, self.scale, self.offset = law, scale, offset

    def arrival(self, z: Floats) -> Floats:
        """Return P(an echo is registered at an exact range <= z)."""
        return self.inner.arrival((np.asarray(z) - self.offset) / self.scale)

    def between(self, low: Floats, high: Floats) -> Floats:
        """Return P(an echo is registered at an exact range in (low, high])."""
        return self.inner.between((low - self.offset) / self.scale, (high - self.offset) / self.scale)


def _positive(fault: Fault, name: str, unit: str = " m") -> None:
    value = getattr(fault, name)
    if not (math.isfinite(value) and value > 0):
        raise SettingError(f"{type(fault).__name__}.{name} must be > 0{unit}, got {value:g}{unit}")


@dataclass(frozen=True)
class Short(Fault):
    """SHORT: the reading is an arbitrary one, anywhere up to `span` m, whatever is in front of the sensor."""

    span: float = MAX_RANGE

    def __post_init__(self) -> None:
        """Refuse no span."""
        super().__post_init__()
        _positive(self, "span")

    def law(self, law: EchoLaw, ping: Ping) -> EchoLaw:
        """Return a uniform law."""
        return ShortLaw(law, self.span)


@dataclass(frozen=True)
class Noise(Fault):
    """NOISE: an echo scatters about the true distance with `sigma` m; silence stays silence."""

    sigma: float = 0.1

    def __post_init__(self) -> None:
        """Refuse no scatter."""
        super().__post_init__()
        _positive(self, "sigma")

    def law(self, law: EchoLaw, ping: Ping) -> EchoLaw:
        """Return a wide normal law."""
        return ScatteredLaw(law, self.sigma)


@dataclass(frozen=True)
class Constant(Fault):
    """CONSTANT: the reading is `value` m, rounded to the register's step, whatever is in front of the sensor."""

    value: float = 1.0

    def __post_init__(self) -> None:
        """Refuse no value."""
        super().__post_init__()
        _positive(self, "value")

    def law(self, law: EchoLaw, ping: Ping) -> EchoLaw:
        """Return certainty."""
        return ConstantLaw(law, self.value)


@dataclass(frozen=True)
class Calibration(Fault):
    """CALIBRATION: echoes read scale * range + offset + drift * time; at `rate` 1, all of them do.

    Attributes:
        scale: of the range, 1 for none.
        offset: added, m.
        drift: growth of the offset with the ping's time, m per s.
    """

    scale: float = 1.0
    offset: float = 0.0
    drift: float = 0.0

    def __post_init__(self) -> None:
        """Refuse a scale that is none."""
        super().__post_init__()
        _positive(self, "scale", "")
        if not (math.isfinite(self.offset) and math.isfinite(self.drift)):
            raise SettingError(f"Calibration needs finite offset and drift, got {self.offset:g} m, {self.drift:g} m/s")

    def law(self, law: EchoLaw, ping: Ping) -> EchoLaw:
        """Return the law moved and stretched."""
        return CalibratedLaw(law, self.scale, self.offset + self.drift * ping.time)


FAULTS: dict[str, type[Fault]] = {fault.__name__: fault for fault in (Short, Noise, Constant, Calibration)}


@runtime_checkable
class Weighty(Protocol):
    """A model that keeps weights beside its model.json."""

    def write_weights(self, folder: Path) -> None:
        """Write them into a folder."""
        ...


class FaultyLaw(EchoLaw):
    """A mixture over causes.

    Attributes:
        parts: the model's own law, then each fault's.
        rate: probability of each, (1 + faults,).
    """

    def __init__(self, parts: list[EchoLaw], rate: Floats) -> None:
        super().__init__(parts[0].distance, parts[0].resolution, parts[0].max_range)
        self.parts, self.rate = parts, rate

    def arrival(self, z: Floats) -> Floats:
        """Return P(an echo is registered at an exact range <= z)."""
        return np.sum([rate * part.arrival(z) for rate, part in self._likely], axis=0)

    def between(self, low: Floats, high: Floats) -> Floats:
        """Return P(an echo is registered at an exact range in (low, high])."""
        return np.sum([rate * part.between(low, high) for rate, part in self._likely], axis=0)

    @property
    def no_answer(self) -> Floats:
        """P(the sensor does not answer), (n,): the model's."""
        return self.parts[0].no_answer

    @property
    def _likely(self) -> list[tuple[float, EchoLaw]]:
        return [(float(rate), part) for rate, part in zip(self.rate, self.parts, strict=True) if rate > 0]

    def draw(self, rng: np.random.Generator) -> tuple[Reading, NDArray[np.int64]]:
        """Draw a reading for each ping and say why it is what it is.

        Returns:
            The readings, and for each the cause: 0 for none, k for the k-th fault, (n,).
        """
        cause = np.searchsorted(np.cumsum(self.rate)[:-1], rng.random(len(self)), side="right")
        drawn = [part.sample(rng) for _, part in self._likely]
        value, status = np.zeros(len(self)), np.full(len(self), EchoStatus.NO_ECHO, dtype=np.uint8)
        for k, reading in zip(np.flatnonzero(self.rate > 0), drawn, strict=True):
            struck = cause == k
            value[struck], status[struck] = reading.range[struck], reading.status[struck]
        return Reading(value, status), cause

    def sample(self, rng: np.random.Generator) -> Reading:
        """Draw a reading for each ping."""
        return self.draw(rng)[0]

    def cause_given(self, reading: Reading) -> Floats:
        """Return the posterior probability of each cause given what was read, (1 + faults, n); NaN nowhere.

        Where the law excludes a reading altogether, nothing was learned and the rates are returned.
        """
        joint = np.stack(
            [rate * np.exp(part.log_prob(reading)) for rate, part in zip(self.rate, self.parts, strict=True)]
        )
        total = joint.sum(axis=0)
        prior = np.broadcast_to(self.rate[:, None], joint.shape)
        return np.divide(joint, total, out=prior.copy(), where=total > 0)


class Faulty:
    """Any model with faults.

    Args:
        model: of the sonar without faults.
        faults: at most one strikes a ping, so their rates may not exceed 1 together.

    >>> from noise.model import IdealModel
    >>> law = Faulty(IdealModel(), [Constant(rate=0.25, value=1.0)]).law(Ping.of(distance=[2.0]))
    >>> law.credence()
    array([0.75])
    """

    def __init__(self, model: SonarModel, faults: Iterable[Fault]) -> None:
        self.model, self.faults = model, tuple(faults)
        total = math.fsum(fault.rate for fault in self.faults)
        if total > 1 + 1e-12:
            raise SettingError(f"Faulty: the rates of its faults sum to {total:g}, at most 1 is possible: lower some")
        self._rate = np.array([max(0.0, 1.0 - total), *(fault.rate for fault in self.faults)])

    @property
    def resolution(self) -> float:
        """Step of the register, m."""
        return self.model.resolution

    @property
    def remembers(self) -> bool:
        """Whether the model does; faults have no memory."""
        return self.model.remembers

    @property
    def causes(self) -> tuple[str, ...]:
        """Names of the causes by number, as `FaultyLaw.draw` counts them."""
        return ("none", *(type(fault).__name__.upper() for fault in self.faults))

    def law(self, ping: Ping, past: Reading | None = None, seats: NDArray[np.int64] | None = None) -> FaultyLaw:
        """Return the law of n pings, given the reading before each, of all sensors or of those on some seats."""
        model = self.model
        law = model.law(ping, past, seats) if isinstance(model, Remembering) else model.law(ping, past)
        return self._struck(law, ping)

    def _struck(self, law: EchoLaw, ping: Ping) -> FaultyLaw:
        return FaultyLaw([law, *(fault.law(law, ping) for fault in self.faults)], self._rate)

    def fresh(self) -> Faulty:
        """Return the same with a memory of its own, empty, where the model keeps one."""
        return Faulty(listener(self.model), self.faults)

    def reset(self, seats: ArrayLike | None = None) -> None:
        """Let the model forget everything, or what some sensors remember: their numbers, or a mask."""
        if isinstance(self.model, Remembering):
            self.model.reset(seats)

    def follow(self, ping: Ping, reading: Reading) -> FaultyLaw:
        """Return the law of every ping of a recording given all pings before it in its run, (n,)."""
        return self._struck(follow(self.model, ping, reading), ping)

    def to_dict(self) -> dict[str, Any]:
        """Return model and faults as plain data.

        Raises:
            ModelError: the model is of a kind that cannot be kept.
        """
        inner: Any = self.model
        if not hasattr(inner, "to_dict"):
            raise ModelError(f"Faulty: a {type(inner).__name__} cannot be saved; it has no to_dict()")
        faults = [{"fault": type(fault).__name__, **asdict(fault)} for fault in self.faults]
        return {"kind": "faulty", "model": inner.to_dict(), "faults": faults}

    def write_weights(self, folder: Path) -> None:
        """Write the model's weights, where it has any, into a folder."""
        if isinstance(self.model, Weighty):
            self.model.write_weights(folder)

    @classmethod
    def load(cls, folder: Path, data: dict[str, Any], load_kind: Callable[[Path, Any], SonarModel]) -> Faulty:
        """Read what was saved.

        Args:
            folder: that holds the weights, where there are any.
            data: its model.json.
            load_kind: reads the model within.

        Raises:
            ModelError: there is no such fault, or a value is not usable.
        """
        path = folder / "model.json"
        try:
            faults = [
                FAULTS[given["fault"]](**{k: v for k, v in given.items() if k != "fault"}) for given in data["faults"]
            ]
            return cls(load_kind(folder, data["model"]), faults)
        except (KeyError, TypeError, AttributeError) as error:
            raise ModelError(f"{path}: does not describe faults on a model ({error}); it may be damaged") from None
