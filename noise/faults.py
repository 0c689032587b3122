"""Faults on any model: SHORT, NOISE, CONSTANT and CALIBRATION of Sharma et al. (2010), used by Esmi (2016).

`Faulty(model, faults)` is a `SonarModel` for any model, physical or learned. At each ping at most one fault occurs,
each at its own rate and independently of earlier pings; otherwise the model's own law holds. A fault changes the
reading, but not whether the sensor answers: pings without an answer remain without one.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import ndtr

from acquisition import EchoStatus, ModelError, Ping, Reading, SettingError
from acquisition.arguments import checked
from acquisition.limits import Limit, PositiveMetres, Share, check_settings
from noise.law import EchoLaw, Floats, UniformSource
from noise.learned.persistence import Persistence
from noise.model import MAX_RANGE, SonarModel, StatefulModel, follow, listener


@dataclass(frozen=True)
class Fault(ABC):
    """A random error of single readings.

    Attributes:
        rate: probability that a ping is affected, 0..1.
    """

    rate: Share = 0.0

    def __post_init__(self) -> None:
        """Raise SettingError for invalid values."""
        check_settings(self)

    @abstractmethod
    def law(self, law: EchoLaw, ping: Ping) -> EchoLaw:
        """Return the law of affected pings, given the law without the fault."""


class ReplacedLaw(EchoLaw):
    """A fault's own distribution of echoes, with probability `echo_share`; P(no answer) is that of the model."""

    def __init__(self, law: EchoLaw, echo_share: Floats) -> None:
        super().__init__(law.distance, law.resolution, law.max_range)
        self.echo_share, self._no_answer = echo_share, law.no_answer

    @property
    def no_answer(self) -> Floats:
        """P(the sensor does not answer), (n,)."""
        return self._no_answer


class ShortLaw(ReplacedLaw):
    """Uniform readings over (0, span] m."""

    def __init__(self, law: EchoLaw, span: float) -> None:
        super().__init__(law, 1.0 - law.no_answer)
        self.span = span

    def _arrival(self, z: Floats) -> Floats:
        return self.echo_share * np.clip(np.asarray(z) / self.span, 0.0, 1.0)


class ScatteredLaw(ReplacedLaw):
    """Normal readings about the true distance, with the model's probability of an echo."""

    def __init__(self, law: EchoLaw, sigma: float) -> None:
        super().__init__(law, law.echo)
        self.sigma = sigma

    def _arrival(self, z: Floats) -> Floats:
        return self.echo_share * ndtr((np.asarray(z) - self.distance) / self.sigma)

    def _between(self, low: Floats, high: Floats) -> Floats:
        """Return P(an echo is registered at an exact range in (low, high]), exact in both tails."""
        below, above = (low - self.distance) / self.sigma, (high - self.distance) / self.sigma
        share = np.where(below > 0, ndtr(-below) - ndtr(-above), ndtr(above) - ndtr(below))
        return self.echo_share * share


class ConstantLaw(ReplacedLaw):
    """A constant reading on the register."""

    def __init__(self, law: EchoLaw, value: float) -> None:
        super().__init__(law, 1.0 - law.no_answer)
        self.value = float(law.step(value)) * law.resolution

    def _arrival(self, z: Floats) -> Floats:
        return self.echo_share * (np.asarray(z) >= self.value)


class CalibratedLaw(ReplacedLaw):
    """The model's exact ranges, scaled and shifted before they are registered."""

    def __init__(self, law: EchoLaw, scale: float, offset: Floats) -> None:
        super().__init__(law, law.echo)
        self.inner, self.scale, self.offset = law, scale, offset

    def _arrival(self, z: Floats) -> Floats:
        return self.inner._arrival((np.asarray(z) - self.offset) / self.scale)

    def _between(self, low: Floats, high: Floats) -> Floats:
        return self.inner._between((low - self.offset) / self.scale, (high - self.offset) / self.scale)


@dataclass(frozen=True)
class Short(Fault):
    """SHORT: the reading is uniform up to `span` m, regardless of the target."""

    span: PositiveMetres = MAX_RANGE

    def law(self, law: EchoLaw, ping: Ping) -> EchoLaw:
        """Return a uniform law."""
        return ShortLaw(law, self.span)


@dataclass(frozen=True)
class Noise(Fault):
    """NOISE: echoes have normal errors of standard deviation `sigma` m; pings without an echo are unchanged."""

    sigma: PositiveMetres = 0.1

    def law(self, law: EchoLaw, ping: Ping) -> EchoLaw:
        """Return a wide normal law."""
        return ScatteredLaw(law, self.sigma)


@dataclass(frozen=True)
class Constant(Fault):
    """CONSTANT: the reading is `value` m, rounded to the register, regardless of the target."""

    value: PositiveMetres = 1.0

    def law(self, law: EchoLaw, ping: Ping) -> EchoLaw:
        """Return the law of a constant reading."""
        return ConstantLaw(law, self.value)


@dataclass(frozen=True)
class Calibration(Fault):
    """CALIBRATION: echoes read scale * range + offset + drift * time.

    Attributes:
        scale: factor on the range.
        offset: offset added to the range, m.
        drift: change of the offset with the time of the ping, m/s.
    """

    scale: Annotated[float, Limit(0.0, 1000.0, open_low=True)] = 1.0
    offset: Annotated[float, Limit(-1000.0, 1000.0, "m")] = 0.0
    drift: Annotated[float, Limit(-1000.0, 1000.0, "m/s")] = 0.0

    def law(self, law: EchoLaw, ping: Ping) -> EchoLaw:
        """Return the scaled and shifted law."""
        return CalibratedLaw(law, self.scale, self.offset + self.drift * ping.time)


FAULTS: dict[str, type[Fault]] = {fault.__name__: fault for fault in (Short, Noise, Constant, Calibration)}


@runtime_checkable
class HasWeights(Protocol):
    """A model with weights in a file beside model.json."""

    def write_weights(self, folder: Path) -> None:
        """Write the weights into a folder."""
        ...


class FaultyLaw(EchoLaw):
    """A mixture of the model's law and those of its faults.

    Attributes:
        parts: the model's own law, then that of each fault.
        rate: probability of each part, (1 + faults,).
        uniform_per_ping: whether all parts have this property.
    """

    def __init__(self, parts: list[EchoLaw], rate: Floats) -> None:
        super().__init__(parts[0].distance, parts[0].resolution, parts[0].max_range)
        self.parts, self.rate = parts, rate
        self.uniform_per_ping = all(part.uniform_per_ping for part in parts)

    def _arrival(self, z: Floats) -> Floats:
        return np.sum([rate * part._arrival(z) for rate, part in self._likely], axis=0)

    def _between(self, low: Floats, high: Floats) -> Floats:
        return np.sum([rate * part._between(low, high) for rate, part in self._likely], axis=0)

    @property
    def no_answer(self) -> Floats:
        """P(the sensor does not answer), (n,): that of the model."""
        return self.parts[0].no_answer

    @property
    def extrapolates(self) -> NDArray[np.bool_]:
        """Whether the model's law extrapolates, (n,)."""
        return self.parts[0].extrapolates

    @property
    def _likely(self) -> list[tuple[float, EchoLaw]]:
        return [(float(rate), part) for rate, part in zip(self.rate, self.parts, strict=True) if rate > 0]

    def draw(self, rng: UniformSource) -> tuple[Reading, NDArray[np.int64]]:
        """Draw a reading and its cause for each ping.

        Returns:
            The readings, and the cause of each: 0 for no fault, k for the k-th fault, (n,).
        """
        cause = np.searchsorted(np.cumsum(self.rate)[:-1], rng.random(len(self)), side="right")
        drawn = [part._sample(rng) for _, part in self._likely]
        value, status = np.zeros(len(self)), np.full(len(self), EchoStatus.NO_ECHO, dtype=np.uint8)
        for k, reading in zip(np.flatnonzero(self.rate > 0), drawn, strict=True):
            affected = cause == k
            value[affected], status[affected] = reading.range[affected], reading.status[affected]
        return Reading(value, status), cause

    def _sample(self, rng: UniformSource) -> Reading:
        return self.draw(rng)[0]

    def cause_given(self, reading: Reading) -> Floats:
        """Return the posterior probability of each cause given the readings, (1 + faults, n).

        For impossible readings the prior rates are returned.
        """
        joint = np.stack(
            [rate * np.exp(part.log_prob(reading)) for rate, part in zip(self.rate, self.parts, strict=True)]
        )
        total = joint.sum(axis=0)
        prior = np.broadcast_to(self.rate[:, None], joint.shape)
        return np.divide(joint, total, out=prior.copy(), where=total > 0)


class Faulty:
    """A model with faults.

    Args:
        model: model of the sonar without faults.
        faults: faults, of which at most one affects a ping; the sum of their rates is at most 1.

    >>> from noise.model import IdealModel
    >>> law = Faulty(IdealModel(), [Constant(rate=0.25, value=1.0)]).law(Ping.of(distance=[2.0]))
    >>> law.credence()
    array([0.75])
    """

    @checked
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
        """Whether the law of the model depends on the previous reading; faults are independent."""
        return self.model.remembers

    @property
    def persistence(self) -> Persistence | None:
        """The part of the model's spread that persists; faults are drawn anew at every ping."""
        return getattr(self.model, "persistence", None)

    @property
    def causes(self) -> tuple[str, ...]:
        """Names of the causes, indexed as in `FaultyLaw.draw`."""
        return ("none", *(type(fault).__name__.upper() for fault in self.faults))

    @checked
    def law(self, ping: Ping, past: Reading | None = None, sensors: NDArray[np.int64] | None = None) -> FaultyLaw:
        """Return the law of n pings, given the previous reading of each; see `StatefulModel.law`."""
        model = self.model
        law = model.law(ping, past, sensors) if isinstance(model, StatefulModel) else model.law(ping, past)
        return self._with_faults(law, ping)

    def _with_faults(self, law: EchoLaw, ping: Ping) -> FaultyLaw:
        return FaultyLaw([law, *(fault.law(law, ping) for fault in self.faults)], self._rate)

    def fresh(self) -> Faulty:
        """Return a copy with an empty state of its own if the model is stateful."""
        return Faulty(listener(self.model), self.faults)

    def reset(self, sensors: ArrayLike | None = None) -> None:
        """Clear the state of all sensors, or of those given by index or mask."""
        if isinstance(self.model, StatefulModel):
            self.model.reset(sensors)

    @checked
    def follow(self, ping: Ping, reading: Reading) -> FaultyLaw:
        """Return the law of every ping of a recording given all earlier pings of its run, (n,)."""
        return self._with_faults(follow(self.model, ping, reading), ping)

    def to_dict(self) -> dict[str, object]:
        """Return model and faults as plain data.

        Raises:
            ModelError: the model cannot be saved.
        """
        inner: Any = self.model
        if not hasattr(inner, "to_dict"):
            raise ModelError(f"Faulty: a {type(inner).__name__} cannot be saved; it has no to_dict()")
        faults = [{"fault": type(fault).__name__, **asdict(fault)} for fault in self.faults]
        return {"kind": "faulty", "model": inner.to_dict(), "faults": faults}

    @checked
    def write_weights(self, folder: Path) -> None:
        """Write the weights of the model, if any, into a folder."""
        if isinstance(self.model, HasWeights):
            self.model.write_weights(folder)

    @classmethod
    @checked
    def load(cls, folder: Path, data: dict[str, object], load_kind: Callable[[Path, object], SonarModel]) -> Faulty:
        """Load a saved model with faults.

        Args:
            folder: folder of the model, with the weights if there are any.
            data: contents of model.json.
            load_kind: function that loads the model without faults.

        Raises:
            ModelError: a fault is unknown or a value is invalid.
        """
        path, content = folder / "model.json", dict[str, Any](data)
        try:
            faults = [
                FAULTS[given["fault"]](**{k: v for k, v in given.items() if k != "fault"})
                for given in content["faults"]
            ]
            return cls(load_kind(folder, content["model"]), faults)
        except (KeyError, TypeError, AttributeError) as error:
            raise ModelError(f"{path}: does not describe faults on a model ({error}); it may be damaged") from None
