"""Settings of the sonar wrappers, and the prior over the conditions of a ping that follows from them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Annotated, Any, Literal

import numpy as np

from acquisition import Ping, SettingError
from acquisition.limits import Limit, check_number, check_settings, check_value, is_list
from sonar_gym.sensing.mounts import Layout, layout
from sonar_gym.sensing.sonar import BEARINGS_DEG, BINS
from sonar_gym.sensing.timing import Times

ConditionSetting = float | tuple[float, float] | str  # a constant, the limits of a uniform prior, or a key
ANGLE = Limit(-math.pi, math.pi, "rad")
CONDITION_LIMITS = {"incidence": ANGLE, "bearing": ANGLE, "reflectance": Limit(0.0, 1.0)}
CONDITION_NAMES = tuple(CONDITION_LIMITS)
TIMES = ("period_s", "phase_s", "latency_s")
TIME = Limit(0.0, 3600.0, "s")
PRIOR_ROUNDS = 15  # samples of the other conditions at each distance of the prior
DEFAULT_MAX_RANGE = 6.0  # m; range of an SRF08
DEFAULT_STEP_S = 0.1


def check_condition(name: str, given: Any) -> ConditionSetting:
    """Return a constant, a pair of limits or a key; raise SettingError for anything else."""
    if isinstance(given, str):
        return given
    limits = given if is_list(given) else (given, given)
    for number in limits:
        check_number(f"SonarObservation.{name}", number, CONDITION_LIMITS[name])
    if len(limits) != 2 or not limits[0] <= limits[1]:
        raise SettingError(f"SonarObservation.{name} must be a number, two limits low <= high, or a key, got {given!r}")
    pair = float(limits[0]), float(limits[1])
    return pair if is_list(given) else pair[0]


@dataclass(frozen=True)
class SonarSettings:
    """How sonars are attached to an environment.

    The fields are the arguments of `sonar_gym.SonarObservation`, where each is described.
    """

    key: str | None = None
    indices: Sequence[int] | None = None
    empty: float | None = None
    metres_per_unit: Annotated[float, Limit(0.0, 1e6, "m", open_low=True)] = 1.0
    max_range: Annotated[float, Limit(0.01, 1000.0, "m")] | None = None
    incidence: ConditionSetting = (0.0, 0.4)
    bearing: ConditionSetting = 0.0
    reflectance: ConditionSetting = (0.1, 0.9)
    sonar_layout: Layout | None = None
    keep: Literal["own", "all", "nothing"] = "own"
    step_s: Annotated[float, Limit(1e-4, 3600.0, "s")] | None = None
    period_s: float | Sequence[float] = 0.0
    phase_s: float | Sequence[float] = 0.0
    latency_s: float | Sequence[float] | None = None
    crosstalk: bool = True

    def __post_init__(self) -> None:
        """Raise SettingError for invalid values."""
        for name in CONDITION_NAMES:
            object.__setattr__(self, name, check_condition(name, getattr(self, name)))
        check_settings(self, lambda name: f"SonarObservation.{name}")
        if self.sonar_layout is not None:
            object.__setattr__(self, "sonar_layout", layout(self.sonar_layout))
        check_value("SonarObservation.indices", self.indices, tuple[int, ...] | None)
        for name in TIMES:
            given = getattr(self, name)
            for time in given if is_list(given) else (given,):
                if not (name == "latency_s" and time is None):
                    check_number(f"SonarObservation.{name}", time, TIME)

    @property
    def explicit(self) -> bool:
        """Whether the ranges of an observation are given, whatever the environment is."""
        return self.key is not None or self.indices is not None

    @property
    def timed(self) -> bool:
        """Whether any time is set."""
        return bool(np.any(self.period_s) or np.any(self.phase_s) or self.latency_s is not None)

    @property
    def times(self) -> Times:
        """Period, phase and latency, s."""
        return self.period_s, self.phase_s, self.latency_s


def given_settings(arguments: Mapping[str, object]) -> dict[str, object]:
    """Return those arguments of a call that are settings and differ from their defaults."""
    defaults = {field.name: field.default for field in fields(SonarSettings)}
    return {
        name: arguments[name]
        for name, default in defaults.items()
        if type(arguments[name]) is not type(default) or arguments[name] != default
    }


def prior_ping(conditions: Mapping[str, ConditionSetting], max_range: float) -> Ping:
    """Return a sample of the prior over what the sonars may face, for the credence given a reading.

    Distances are uniform up to `max_range`, m. A condition that comes from a key is unknown beforehand and gets a broad
    prior: angles within a cone of 55 deg, with bearing equal to incidence (faces parallel to that of the sensor).
    """
    rng, distance = np.random.default_rng(0), np.tile(np.linspace(0.01, max_range, 2 * BINS), PRIOR_ROUNDS)
    n = len(distance)
    angle = np.radians(rng.choice(BEARINGS_DEG, n))
    broad = {"incidence": angle, "bearing": angle, "reflectance": rng.uniform(0.1, 0.9, n)}
    value = {
        name: broad[name] if isinstance(c, str) else rng.uniform(*c, n) if isinstance(c, tuple) else np.full(n, c)
        for name, c in conditions.items()
    }
    return Ping.of(distance, value["bearing"], value["incidence"], value["reflectance"])


def default_step(base: Any) -> float:
    """Return the time between steps of an environment, s: its `dt`, as in MuJoCo environments, or 0.1 s."""
    dt = getattr(base, "dt", None)
    return float(dt) if isinstance(dt, (int, float)) and dt > 0.0 else DEFAULT_STEP_S
