"""What all effects share: parameters with null values, the stages at which they act, and the state they act on.

An effect is a map from `State` to `State`. Stages run in the order of `Stage`, the order in which the physics happens,
so a stack of effects means the same in whatever order it was written. With every parameter at its null value an
effect leaves the law alone. Everything is torch, float64, differentiable in the parameters.

Shapes: n pings; Q nodes of a latent level shared by all paths of one ping (Q = 1 without fading); J slips of a path.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from enum import IntEnum
from functools import cached_property
from typing import ClassVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from acquisition import EchoStatus, Ping, Reading, SettingError

MARGIN_DB = 60.0  # level of a flat wall at 1 m over the threshold in an ideal sonar; ours: high enough never to miss
DETECTION_WIDTH_DB = 1.5  # spread of the level at the threshold, physics note: log-normal level noise, sigma 1.5 dB
FLOOR_M = 1e-6  # least standard deviation of an arrival, m: far below any register's step


class Stage(IntEnum):
    """Where in the life of a ping an effect acts."""

    CONDITION = 0  # mounting: what the sensor faces, given what was written down
    PATHS = 1  # which ways the sound takes, and how strong each comes back
    MEDIUM = 2  # what the air does to every path
    DETECTOR = 3  # when, and whether, an arrival is registered
    REGISTER = 4  # clock, unit and gate
    SEQUENCE = 5  # link and memory: what replaces the reading


@dataclass(frozen=True)
class Parameter:
    """One number of an effect.

    Attributes:
        name: as the keyword of the effect's constructor.
        unit: as printed ("dB", "m", "1", "degC"); SI unless it says otherwise.
        null: value at which the effect does nothing.
        low: least plausible value.
        high: greatest plausible value.
        source: where formula and bounds come from; "ours" where they are ours.
        starts: values from which a fit should begin.
        covariate: the logged condition without which it means nothing; "" for none.
        span: how much the covariate must vary before the parameter can be told, in the covariate's unit.
    """

    name: str
    unit: str
    null: float
    low: float
    high: float
    source: str
    starts: tuple[float, ...] = ()
    covariate: str = ""
    span: float = 0.0

    def identifiable(self, covariates: Mapping[str, NDArray[np.float64]]) -> bool:
        """Return whether readings under these covariates, (n,) each, can say anything of the parameter."""
        if not self.covariate:
            return True
        return self.covariate in covariates and bool(np.ptp(covariates[self.covariate]) >= self.span)


@dataclass(frozen=True)
class Conditions:
    """A batch of pings as tensors, (n,) each; see `acquisition.Ping` for the meanings."""

    distance: Tensor
    angle: Tensor
    incidence: Tensor
    reflectance: Tensor
    time: Tensor
    run: Tensor
    past_range: Tensor
    past_status: Tensor
    covariates: Mapping[str, Tensor] = field(default_factory=dict)

    @classmethod
    def of(cls, ping: Ping, past: Reading | None = None) -> Conditions:
        """Convert arrays; without `past` nothing is known of the previous readings."""
        n = len(ping)
        tensor = torch.tensor  # copies: arrays out of a table may be read-only
        return cls(
            distance=tensor(ping.distance),
            angle=tensor(ping.angle),
            incidence=tensor(ping.incidence),
            reflectance=tensor(ping.reflectance),
            time=tensor(ping.time),
            run=tensor(ping.run),
            past_range=torch.zeros(n, dtype=torch.float64) if past is None else tensor(past.range),
            past_status=torch.full((n,), int(EchoStatus.NO_ANSWER)) if past is None else tensor(past.status).long(),
            covariates={name: tensor(value) for name, value in ping.covariates.items()},
        )


@dataclass(frozen=True)
class Path:
    """One way by which sound comes back.

    Attributes:
        name: "direct", "background", ...
        length: half the way that the sound travels, m, (n,).
        level_db: level over the threshold, dB, (Q, n).
        presence: probability that the path exists at all, (n,) or scalar.
        lag: how much later than its arrival it is registered, as range, m, (Q, n) or scalar.
        spread: standard deviation of the arrival, m, (n,) or scalar.
        slip_m: offsets of the path's repeated detection points, m, (J,).
        slip_weight: their probabilities, (J,).
        bearing: off the beam axis at which it leaves and comes back, rad, (n,) or scalar.
    """

    name: str
    length: Tensor
    level_db: Tensor
    presence: Tensor
    lag: Tensor
    spread: Tensor
    slip_m: Tensor
    slip_weight: Tensor
    bearing: Tensor

    def detection(self, width_db: Tensor) -> Tensor:
        """Return the probability that this path crosses the threshold, (Q, n)."""
        return self.presence * ndtr(self.level_db / width_db)

    def missing(self, width_db: Tensor) -> Tensor:
        """Return the probability that nothing of this path crosses the threshold, exact where that is rare, (Q, n)."""
        return (1.0 - self.presence) + self.presence * ndtr(-self.level_db / width_db)

    def lateness(self, z: Tensor) -> Tensor:
        """Return P(registered beyond z | detected)."""
        return self._over_slips(ndtr(-self._scores(z)))

    def between(self, low: Tensor, high: Tensor) -> Tensor:
        """Return P(registered in (low, high] | detected), exact far out in either tail."""
        return self._over_slips(_normal_between(self._scores(low), self._scores(high)))

    def _scores(self, z: Tensor) -> Tensor:
        """Return how many standard deviations a range lies beyond the arrival after each slip, (J, ..., n)."""
        beyond = z - self._arrival
        return (beyond - self.slip_m.reshape(-1, *[1] * beyond.ndim)) / self._sigma

    @cached_property
    def _arrival(self) -> Tensor:
        return self.length + self.lag

    @cached_property
    def _sigma(self) -> Tensor:
        return torch.sqrt(self.spread**2 + FLOOR_M**2)

    def _over_slips(self, value: Tensor) -> Tensor:
        """Return the mean over slips of (J, ..., n)."""
        return (self.slip_weight.reshape(-1, *[1] * (value.ndim - 1)) * value).sum(0)


def ndtr(score: Tensor) -> Tensor:
    """Return the normal cdf. `torch.special.ndtr` is (1 + erf) / 2: nothing is left of it below -8."""
    return 0.5 * torch.erfc(score * -math.sqrt(0.5))


def _normal_between(low: Tensor, high: Tensor) -> Tensor:
    """Return Phi(high) - Phi(low), taken on the side where both are small."""
    sign = torch.where(low + high > 0, -1.0, 1.0)
    return sign * (ndtr(sign * high) - ndtr(sign * low))


@dataclass(frozen=True)
class Atom:
    """A reading that replaces what the sonar would have said.

    Attributes:
        weight: probability that it does, (n,) or scalar.
        cdf: P(echo, register <= edge) for register edges in m, (..., n).
        no_echo: P(it says there is no echo), (n,) or scalar.
        no_answer: P(it says nothing), (n,) or scalar.
    """

    weight: Tensor
    cdf: Callable[[Tensor], Tensor]
    no_echo: Tensor
    no_answer: Tensor


@dataclass(frozen=True)
class Clutter:
    """False detections while the sensor listens.

    Attributes:
        per_metre: their rate while there is noise, 1/m.
        share: of pings in which there is.
        begins: exact range before which none is counted, m.
    """

    per_metre: Tensor
    share: Tensor
    begins: Tensor

    def spared(self, z: Tensor, deaf: Tensor | None) -> Tensor:
        """Return P(none before an exact range z) of a receiver that is deaf before some range, or never."""
        begins = self.begins if deaf is None else torch.maximum(self.begins, deaf)
        return 1.0 + self.share * torch.expm1(-self.per_metre * torch.clamp(z - begins, min=0.0))


@dataclass(frozen=True)
class State:
    """Everything that a physical law is made of; effects replace parts of it.

    Attributes:
        conditions: what the pings faced, after mounting effects.
        paths: the ways of the sound; the first is the direct one.
        log_weight: log weights of the latent level's nodes, (Q, 1).
        width_db: spread of the level at the threshold, dB.
        scale, offset: register = scale * exact range + offset (1 and m).
        gate: greatest exact range that is listened to, m.
        clutter: false detections; None without any.
        step: step to which the register rounds beyond its resolution, m; 0 for none.
        deaf: exact range before which arrivals are not registered, m; None hears from the start.
        atoms: replacements, applied in order.
    """

    conditions: Conditions
    paths: tuple[Path, ...]
    log_weight: Tensor
    width_db: Tensor
    scale: Tensor
    offset: Tensor
    gate: Tensor
    clutter: Clutter | None = None
    step: float = 0.0
    deaf: Tensor | None = None
    atoms: tuple[Atom, ...] = ()

    @property
    def direct(self) -> Path:
        """The path to the reflector and back."""
        return self.paths[0]

    def with_direct(self, path: Path) -> State:
        """Replace the direct path."""
        return replace(self, paths=(path, *self.paths[1:]))

    def facing(self, conditions: Conditions) -> State:
        """Change what the pings face, the direct path with it."""
        return replace(self, conditions=conditions, paths=(direct_path(conditions), *self.paths[1:]))

    def with_path(self, path: Path) -> State:
        """Add a path."""
        return replace(self, paths=(*self.paths, path))

    def map_paths(self, change: Callable[[Path], Path]) -> State:
        """Change every path alike."""
        return replace(self, paths=tuple(change(path) for path in self.paths))

    def with_atom(self, atom: Atom) -> State:
        """Add a replacement."""
        return replace(self, atoms=(*self.atoms, atom))


def number(value: float | list[float] | Tensor) -> Tensor:
    """Return a float64 tensor; tensors keep their graph."""
    return torch.as_tensor(value, dtype=torch.float64)


def wall_level_db(length: Tensor) -> Tensor:
    """Return the level of a flat wall over an ideal sonar's threshold, dB: amplitude falls as 1/(2d)."""
    return MARGIN_DB - 20.0 / math.log(10.0) * torch.log(torch.clamp(length, min=0.01))


def new_path(
    name: str, length: Tensor, level_db: Tensor, presence: float | Tensor = 1.0, bearing: float | Tensor = 0.0
) -> Path:
    """Return a path as an ideal sonar hears it: sharp, in time, without slips."""
    zero = number(0.0)
    slips = number([0.0]), number([1.0])
    return Path(name, length, torch.atleast_2d(level_db), number(presence), zero, zero, *slips, number(bearing))


def direct_path(conditions: Conditions) -> Path:
    """Return the way to the reflector and back: level of a flat wall, at the reflector's bearing."""
    distance = conditions.distance
    return new_path("direct", distance, wall_level_db(distance), bearing=conditions.angle)


NEAR, NEAR_M = 0.1, 0.05  # readings within this share of distance, and this much more, are the target's; ours


def reach(distance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return how far from a target's distance, m, an echo may lie and be its own, m."""
    return NEAR * distance + NEAR_M


@dataclass(frozen=True)
class Seen:
    """Readings that were heard, for guesses: arrays (n,) of distance, m, time, s, and range, m."""

    distance: NDArray[np.float64]
    time: NDArray[np.float64]
    range: NDArray[np.float64]

    @property
    def away(self) -> Seen:
        """Return those that are not the target's."""
        keep = np.abs(self.range - self.distance) > reach(self.distance)
        return Seen(self.distance[keep], self.time[keep], self.range[keep])

    @property
    def early(self) -> Seen:
        """Return those that came clearly before the target's."""
        keep = self.range < self.distance - reach(self.distance)
        return Seen(self.distance[keep], self.time[keep], self.range[keep])


class Effect(ABC):
    """One piece of physics with its parameters; subclasses state the class variables and `apply`."""

    name: ClassVar[str]
    stage: ClassVar[Stage]
    parameters: ClassVar[tuple[Parameter, ...]]
    summary: ClassVar[str]  # one line of plain English: what the effect is
    remembers: ClassVar[bool] = False  # whether it looks at the previous reading
    strikes: ClassVar[bool] = False  # whether it is plain in some cells or pings, and leaves all others alone
    by_ping: ClassVar[bool] = False  # whether it strikes single pings, whatever their cell
    coarsest_m: ClassVar[float] = math.inf  # a register of coarser steps cannot show it
    passes_for: ClassVar[tuple[str, ...]] = ()  # effects that it looks like while it is `hidden`

    def __init__(self, **values: float | Tensor) -> None:
        """Set parameters by name; those left out are at their null values.

        Raises:
            TypeError: no such parameter.
            SettingError: a value outside its bounds.
        """
        known = {p.name: p for p in self.parameters}
        for name, value in values.items():
            if name not in known:
                raise TypeError(f"{self.name} has no parameter {name!r}; it has {', '.join(known)}")
            _check_bounds(self.name, known[name], value)
        for p in self.parameters:
            setattr(self, p.name, number(values.get(p.name, p.null)))

    @abstractmethod
    def apply(self, state: State) -> State:
        """Return the state with this effect in it."""

    @classmethod
    def hidden(cls, seen: Seen) -> bool:
        """Tell whether readings are too few for what sets this effect apart from those it passes for."""
        return False

    @classmethod
    def guesses(cls, seen: Seen) -> list[dict[str, float]]:
        """Return parameter values at which a fit of given readings should begin besides its usual starts."""
        return []

    def statement(self) -> str:
        """Return one sentence of plain English with the numbers in it."""
        numbers = ", ".join(f"{p.name} {self.values[p.name]:.3g} {p.unit}" for p in self.parameters)
        return f"{self.summary} ({numbers})."

    @property
    def values(self) -> dict[str, float]:
        """The parameters as plain numbers."""
        return {p.name: float(getattr(self, p.name).detach()) for p in self.parameters}

    def __repr__(self) -> str:
        return f"{type(self).__name__}({', '.join(f'{k}={v:g}' for k, v in self.values.items())})"


def _check_bounds(effect: str, p: Parameter, value: float | Tensor) -> None:
    plain = float(value.detach()) if isinstance(value, Tensor) else float(value)
    slack = 1e-9 * (p.high - p.low)
    inside = p.low - slack <= plain <= p.high + slack
    if not (inside or plain == p.null):
        raise SettingError(f"{effect}.{p.name} must lie in [{p.low:g}, {p.high:g}] {p.unit}, got {plain:g} {p.unit}")
