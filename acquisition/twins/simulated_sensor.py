"""The simulated sonar behind every twin: the rig at the twin's time, and the clocks of twins."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquisition.bench import Rig
from acquisition.bench.laboratory.interference import ECHO_OVERLAP_S
from acquisition.bench.laboratory.setup import Bus, Output
from acquisition.ping import Ping

CONDITION = ("distance", "angle", "incidence", "reflectance", "time")
# the placement errors of a visit are drawn by `place`, not at every ping, and the twin's own wire has faults
ALIKE = ("placement_m", "placement_deg", "tilt_deg", "zero_m", "pivot_m")
PLACED: dict[str, Any] = {**dict.fromkeys(ALIKE, 0.0), "bus": Bus()}
REGISTERS = ("gain", "range_mm")  # covariates that the twin's registers replace


@dataclass
class TwinClock:
    """Simulated time, s, which only `sleep` advances."""

    now: float = 0.0

    def __call__(self) -> float:
        """Return the time, s."""
        return self.now

    def sleep(self, seconds: float) -> None:
        """Advance the time."""
        self.now += seconds


@dataclass
class SimulatedSensor:
    """A simulated sonar without a wire protocol.

    Attributes:
        rig: unit and laboratory; gain, range and output are set by the twin.
        rng: random generator.
        clock: time of the twin, s.
    """

    rig: Rig
    rng: np.random.Generator
    clock: TwinClock = field(default_factory=TwinClock)

    def __post_init__(self) -> None:
        """Draw the drift and place no reflector."""
        self._drift = self.rig.draw_drift(self.rng)
        self._previous: Ping | None = None
        self.place(Ping.of(distance=1.0, reflectance=0.0))

    def place(self, ping: Ping) -> None:
        """Place the reflector of one ping, with random placement errors of the rig's setup, until the next call."""
        placed = self.rig.place(ping[:1], self.rng)
        known = {name: value for name, value in placed.covariates.items() if name not in REGISTERS}
        self._placed = replace(placed, covariates=known)

    def fire(self, output: Output, gain: int = 31, range_register: int = 255) -> NDArray[np.uint16]:
        """Simulate a ping, including echoes of the previous one, and return the 17 echo registers."""
        setup = replace(self.rig.setup, gain=gain, range_register=range_register, output=output, **PLACED)
        ping = replace(self._placed, time=np.array([self.clock()]))
        pings = _joined(self._previous, ping) if self._previous is not None and self._recalls(self._previous) else ping
        self._previous = ping
        return Rig(self.rig.unit, setup).ping(pings, self.rng, self._drift).code[-1]

    def _recalls(self, previous: Ping) -> bool:
        """Return whether the previous ping matters to one fired now: its sound is still heard, or the unit smooths.

        Earlier ones are forgotten, so that a unit that averages several readings averages two.
        """
        unit = self.rig.unit
        heard = self.clock() - previous.time[0] < ECHO_OVERLAP_S
        return bool(heard or unit.averaging > 1 or unit.deadband > 0.0)


def _joined(first: Ping, second: Ping) -> Ping:
    """Return two single pings as one run."""
    both = {name: np.append(getattr(first, name), getattr(second, name)) for name in CONDITION}
    logged = {
        name: np.append(first.covariates[name], second.covariates[name])
        for name in first.covariates
        if name in second.covariates
    }
    return replace(Ping.of(**both), covariates=logged)
