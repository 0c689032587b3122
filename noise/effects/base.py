"""Effects: parameters with null values, the stages at which effects act, and their base class.

An effect is a map from `State` to `State`. Effects act in the order of `Stage`, the physical order, so that a stack of
effects does not depend on the order in which it is written. With every parameter at its null value an effect changes
nothing.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import ClassVar, Self

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from acquisition import SettingError
from acquisition.errors import UnknownFieldError
from acquisition.limits import Limit, check_number, near
from noise.effects.state import State, number

NEAR, NEAR_M = 0.1, 0.05  # tolerance of the target's own echoes: share of the distance, plus m; chosen here
BIN_M = 0.05  # within which lengths of paths are one; the scatter of a reading
MAX_MODES, MIN_IN_MODE = 3, 4  # of readings away from the target, and readings in one, where fits begin; chosen here


class Stage(IntEnum):
    """Stages of a ping at which effects act, in physical order."""

    CONDITION = 0  # mounting: the true condition, given the logged one
    PATHS = 1  # propagation paths and their levels
    MEDIUM = 2  # effect of the air on every path
    DETECTOR = 3  # detection and time of arrival
    REGISTER = 4  # clock, unit and gate
    SEQUENCE = 5  # link and memory: replaced readings


@dataclass(frozen=True)
class Parameter:
    """A parameter of an effect.

    Attributes:
        name: keyword of the effect's constructor.
        unit: printed unit ("dB", "m", "1", "degC").
        null: value at which the effect does nothing.
        low, high: bounds of plausible values.
        source: source of formula and bounds.
        starts: initial values of a fit.
        covariate: logged condition that the parameter requires; "" for none.
        span: smallest range of the covariate at which the parameter is identifiable, in the covariate's unit.
        typical: scale of the Cauchy prior of the difference from the null value, in `unit`; 0 for a flat prior.
        cycle: whether it is a period, s, of a change with time, which sampled readings resolve only within limits.
        decays: whether it is the time constant, s, of a change that dies away; what has not lost half of itself by the
            end of a recording is rather a constant.
        jumps: whether the likelihood jumps where it crosses a reading, as with the end of a range. Its derivative there
            says little, and readings bound it closer than they determine what changes smoothly.
        adds: whether two effects of these sizes act as one of their sum, nearly; what differs is then the difference.
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
    typical: float = 0.0
    cycle: bool = False
    decays: bool = False
    jumps: bool = False
    adds: bool = False

    def identifiable(self, covariates: Mapping[str, NDArray[np.float64]]) -> bool:
        """Return whether readings under these covariates, (n,) each, can identify the parameter."""
        if not self.covariate:
            return True
        return self.covariate in covariates and bool(np.ptp(covariates[self.covariate]) >= self.span)


def target_tolerance(distance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the largest range error, m, of an echo that is attributed to a target at the given distance, m."""
    return NEAR * distance + NEAR_M


@dataclass(frozen=True)
class EchoSample:
    """Echo readings from which initial values are estimated.

    Attributes:
        distance: of the target, m, (n,).
        time: s, (n,).
        range: reading, m, (n,).
        interval: time since the previous ping of the run, s, 0 for the first, (n,); None where it is unknown.
        past: reading before each in the run, m, nan where there was no echo, (n,); None where it is unknown.
        before: distance of the target when the previous ping was fired, m, (n,); None where it is unknown.
        grid_m: step on whose multiples all readings lie, m; 0 where it is unknown.
        silent: number of pings without an echo.
    """

    distance: NDArray[np.float64]
    time: NDArray[np.float64]
    range: NDArray[np.float64]
    interval: NDArray[np.float64] | None = None
    past: NDArray[np.float64] | None = None
    before: NDArray[np.float64] | None = None
    grid_m: float = 0.0
    silent: int = 0

    @property
    def off_target(self) -> EchoSample:
        """Echoes outside the tolerance about the target."""
        return self._where(np.abs(self.range - self.distance) > target_tolerance(self.distance))

    @property
    def late(self) -> EchoSample:
        """Echoes clearly behind the target's."""
        return self._where(self.range > self.distance + target_tolerance(self.distance))

    @property
    def early(self) -> EchoSample:
        """Echoes clearly before the target's."""
        return self._where(self.range < self.distance - target_tolerance(self.distance))

    def _where(self, rows: NDArray[np.bool_]) -> EchoSample:
        kept = (None if value is None else value[rows] for value in (self.interval, self.past, self.before))
        interval, past, before = kept
        own = self.distance[rows], self.time[rows], self.range[rows]
        return EchoSample(*own, interval, past, before, self.grid_m, self.silent)


def most_frequent(length: NDArray[np.float64]) -> float:
    """Return the median of the lengths in the fullest bin, m; 0 where all are nan."""
    found = modes(length, 1, 1)
    return float(np.median(found[0])) if found else 0.0


def modes(length: NDArray[np.float64], most: int = MAX_MODES, least: int = MIN_IN_MODE) -> list[NDArray[np.float64]]:
    """Return the lengths, m, in each of the fullest bins, the fullest first; nan is in none.

    Args:
        length: (n,).
        most: number of bins.
        least: lengths in a bin.
    """
    length = length[np.isfinite(length)]
    place = np.rint(length / BIN_M)
    value, count = np.unique(place, return_counts=True)
    fullest = np.argsort(-count, kind="stable")[:most]
    return [length[place == value[k]] for k in fullest if count[k] >= least]


class Effect(ABC):
    """A physical effect with its parameters; subclasses define the class variables and `apply`."""

    name: ClassVar[str]
    stage: ClassVar[Stage]
    parameters: ClassVar[tuple[Parameter, ...]]
    summary: ClassVar[str]  # one line without a full stop
    remembers: bool = False  # whether it depends on the previous reading
    needs_time: ClassVar[bool] = False  # whether it can be told only from logged times
    by_clock: ClassVar[bool] = False  # whether it follows the clock of the day and not what the sonar measures
    of_simulators: ClassVar[bool] = False  # whether simulators have it, and no sonar
    localised: ClassVar[bool] = False  # whether it changes some visits or pings clearly and leaves the others unchanged
    by_ping: ClassVar[bool] = False  # whether it affects single pings independently of their condition
    coarsest_step_m: ClassVar[float] = math.inf  # not observable with a register of coarser steps
    fixed_range: ClassVar[str] = ""  # the parameter that is a reading regardless of the target; "" for none
    confused_with: ClassVar[tuple[str, ...]] = ()  # effects that fit the same readings while it is `ambiguous`

    def __init__(self, **values: float | Tensor) -> None:
        """Set parameters by name; the others take their null values.

        Raises:
            UnknownFieldError: unknown parameter.
            SettingError: a value outside its bounds.
        """
        known = {p.name: p for p in self.parameters}
        for name, value in values.items():
            if name not in known:
                hint = near(name, known)
                raise UnknownFieldError(f"{self.name} has no parameter {name!r}; it has {', '.join(known)}{hint}")
            _check_bounds(self.name, known[name], value)
        self._set(values)

    @classmethod
    def unchecked(cls, values: Mapping[str, float | Tensor]) -> Self:
        """Return the effect with values that are known to lie within their bounds, as a fit has them."""
        out = cls.__new__(cls)
        out._set(values)
        return out

    def _set(self, values: Mapping[str, float | Tensor]) -> None:
        for p in self.parameters:
            setattr(self, p.name, number(values.get(p.name, p.null)))

    @abstractmethod
    def apply(self, state: State) -> State:
        """Return the state with this effect."""

    @classmethod
    def ambiguous(cls, echoes: EchoSample) -> bool:
        """Return whether the readings cannot distinguish this effect from those in `confused_with`."""
        return False

    @classmethod
    def guesses(cls, echoes: EchoSample) -> list[dict[str, float]]:
        """Return initial parameter values estimated from readings, in addition to the fixed starts."""
        return []

    def statement(self) -> str:
        """Return a sentence that describes the effect with its parameter values."""
        numbers = ", ".join(f"{p.name} {self.values[p.name]:.3g} {p.unit}" for p in self.parameters)
        return f"{self.summary} ({numbers})."

    @property
    def values(self) -> dict[str, float]:
        """Parameter values as plain numbers."""
        return {p.name: float(getattr(self, p.name).detach()) for p in self.parameters}

    def __repr__(self) -> str:
        return f"{type(self).__name__}({', '.join(f'{k}={v:g}' for k, v in self.values.items())})"


def _check_bounds(effect: str, p: Parameter, value: float | Tensor) -> None:
    if isinstance(value, Tensor) and value.numel() != 1:
        raise SettingError(f"{effect}.{p.name}: expected one number, got {value.numel()}")
    if not isinstance(value, Tensor):
        check_number(f"{effect}.{p.name}", value, Limit(unit=p.unit))
    plain = float(value.detach()) if isinstance(value, Tensor) else float(value)
    slack = 1e-9 * (p.high - p.low)
    inside = p.low - slack <= plain <= p.high + slack
    if not (inside or plain == p.null):
        raise SettingError(f"{effect}.{p.name} must lie in [{p.low:g}, {p.high:g}] {p.unit}, got {plain:g} {p.unit}")
