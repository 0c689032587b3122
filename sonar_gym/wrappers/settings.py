"""How sonars listen to an environment that is not made for them: settings, and the prior that they make."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from acquisition import Ping, SettingError
from sonar_gym.sensing.mounts import Layout
from sonar_gym.sensing.sonar import BEARINGS_DEG, BINS
from sonar_gym.sensing.timing import Times

Condition = float | tuple[float, float] | str  # the same for all, the limits of a uniform prior, or a key
CONDITIONS = ("incidence", "bearing", "reflectance")
PRIOR_ROUNDS = 15  # samples of the other conditions for each distance of the prior
USUAL_RANGE, USUAL_STEP_S = 6.0, 0.1  # m, what an SRF08 is good for; s
KEEP = ("own", "all", "nothing")  # of an observation on the road


def check_condition(name: str, given: Any) -> Condition:
    """Return a number, a pair of limits or a key, or say what is wrong."""
    if isinstance(given, str):
        return given
    pair = tuple(float(x) for x in given) if isinstance(given, Sequence) else (float(given), float(given))
    if len(pair) != 2 or not pair[0] <= pair[1] or not np.all(np.isfinite(pair)):
        raise SettingError(f"SonarObservation.{name} must be a number, two limits low <= high, or a key, got {given!r}")
    return pair if isinstance(given, Sequence) else pair[0]


@dataclass(frozen=True)
class Hearing:
    """How sonars listen to an environment.

    Attributes:
        key: of the ranges in a `Dict`.
        indices: of the ranges in the flattened array; all of it by default.
        empty: what the observation puts where nothing is in reach, -1 for MuJoCo's rangefinders; a number at or beyond
            the maximum range, and infinity, are that anyway.
        metres_per_unit: m of the sonar for 1 in the observation, or for 1 m of a road.
        max_range: the sonars' greatest range, m; what lies there or beyond is an empty cone. None: 3.01 m in the
            parking street, 6 m elsewhere.
        incidence: between beam and surface normal, rad: a number, a pair (uniform, drawn anew every step), or a key of
            the observation or of `info`.
        bearing: of the reflector off the beam axis, rad; likewise.
        reflectance: of the reflector; likewise, but a pair is drawn once an episode for each sonar.
        sonar_layout: on a road, mounts about the vehicle's centre, or mappings of their fields; where those have times,
            theirs count. None: eight, four to a bumper.
        keep: of a road's observation: "own" (what tells of the vehicle alone), "all" or "nothing".
        step_s: from observation to observation, s. None: what the environment says, else 0.1 s.
        period_s: from ping to ping, s, one number or one for each sonar; 0 for a ping at every observation.
        phase_s: time of the first ping, s, likewise.
        latency_s: from a ping to its reading, s, likewise.
    """

    key: str | None = None
    indices: Sequence[int] | None = None
    empty: float | None = None
    metres_per_unit: float = 1.0
    max_range: float | None = None
    incidence: Condition = (0.0, 0.4)
    bearing: Condition = 0.0
    reflectance: Condition = (0.1, 0.9)
    sonar_layout: Layout | None = None
    keep: str = "own"
    step_s: float | None = None
    period_s: float | Sequence[float] = 0.0
    phase_s: float | Sequence[float] = 0.0
    latency_s: float | Sequence[float] = 0.0

    def __post_init__(self) -> None:
        """Refuse what cannot be."""
        for name in CONDITIONS:
            object.__setattr__(self, name, check_condition(name, getattr(self, name)))
        for name, unit in (("metres_per_unit", "m"), ("max_range", "m"), ("step_s", "s")):
            value = getattr(self, name)
            if value is not None and not value > 0.0:
                raise SettingError(f"SonarObservation.{name} must be > 0 {unit}, got {value:g} {unit}")
        if self.keep not in KEEP:
            raise SettingError(f"SonarObservation.keep must be one of {', '.join(KEEP)}, got {self.keep!r}")

    @property
    def times(self) -> Times:
        """Period, phase and latency, s."""
        return self.period_s, self.phase_s, self.latency_s


def prior_ping(conditions: Mapping[str, Condition], max_range: float) -> Ping:
    """Return a sample of what the sonars may face: what the wrapper is told of it, and broad where it is not.

    Distances are equally likely up to `max_range` m. A condition that comes from a key is taken to be one of those a
    cone of 55 deg; bearing and incidence alike, as of faces parallel to the sensor's.
    """
    rng, distance = np.random.default_rng(0), np.tile(np.linspace(0.01, max_range, 2 * BINS), PRIOR_ROUNDS)
    n = len(distance)
    angle = np.radians(rng.choice(BEARINGS_DEG, n))
    broad = {"incidence": angle, "bearing": angle, "reflectance": rng.uniform(0.1, 0.9, n)}
    told = {
        name: broad[name] if isinstance(c, str) else rng.uniform(*c, n) if isinstance(c, tuple) else np.full(n, c)
        for name, c in conditions.items()
    }
    return Ping.of(distance, told["bearing"], told["incidence"], told["reflectance"])


def usual_step(base: Any) -> float:
    """Return the time between steps of an environment, s: its `dt`, as of MuJoCo's, or 0.1 s."""
    told = getattr(base, "dt", None)
    return float(told) if isinstance(told, (int, float)) and told > 0.0 else USUAL_STEP_S
