"""What every twin hears: the rig, at the twin's own time, of what is placed before it."""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquisition.bench import Rig
from acquisition.bench.setup import Output
from acquisition.ping import Ping

CONDITION = ("distance", "angle", "incidence", "reflectance", "time")
STILL: dict[str, Any] = {"placement_m": 0.0, "placement_deg": 0.0, "tilt_deg": 0.0, "zero_m": 0.0, "pivot_m": 0.0}


@dataclass
class TwinClock:
    """Time that passes only when somebody sleeps, s."""

    now: float = 0.0

    def __call__(self) -> float:
        """Return the time."""
        return self.now

    def sleep(self, seconds: float) -> None:
        """Let time pass."""
        self.now += seconds


@dataclass
class HostClock(TwinClock):
    """The host's own time, for twins behind a real port."""

    def __call__(self) -> float:
        """Return the time."""
        return time.monotonic()

    def sleep(self, seconds: float) -> None:
        """Let time pass."""
        time.sleep(seconds)


@dataclass
class Ear:
    """A simulated sonar without its wire.

    Attributes:
        rig: unit and laboratory; gain, range and output come from the twin instead.
        rng: all randomness.
        clock: the twin's time, s: a `HostClock` where bytes pass a real port.
    """

    rig: Rig
    rng: np.random.Generator
    clock: TwinClock = field(default_factory=TwinClock)

    def __post_init__(self) -> None:
        """Begin with nothing in front."""
        self._drift = self.rig.draw_drift(self.rng)
        self._before: Ping | None = None
        self.place(Ping.of(distance=1.0, reflectance=0.0))

    def place(self, ping: Ping) -> None:
        """Set up what one ping describes, with the scatter of the rig's setup, until the next call."""
        self._placed = self.rig.place(ping[:1], self.rng)

    def hear(self, output: Output, gain: int = 31, range_register: int = 255) -> NDArray[np.uint16]:
        """Fire, with the ping before still under way, and return 17 echo registers."""
        setup = replace(self.rig.setup, gain=gain, range_register=range_register, output=output, **STILL)
        this = replace(self._placed, time=np.array([self.clock()]))
        pings = this if self._before is None else _joined(self._before, this)
        self._before = this
        return Rig(self.rig.unit, setup).ping(pings, self.rng, self._drift).code[-1]


def _joined(first: Ping, second: Ping) -> Ping:
    """Return two single pings as one run."""
    both = {name: np.append(getattr(first, name), getattr(second, name)) for name in CONDITION}
    logged = {
        name: np.append(first.covariates[name], second.covariates[name])
        for name in first.covariates
        if name in second.covariates
    }
    return Ping.of(**both, **logged)
