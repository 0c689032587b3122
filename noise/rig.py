"""The waveform rig as a sonar model that can only be sampled.

Its readings come from geometry and electronics, so that it can stand for the real world in tests of a policy or a
diagnosis: other models can be fitted to it only through recordings.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np

from acquisition import Ping, Reading, SettingError
from acquisition.arguments import checked
from acquisition.bench import Rig, Setup, Unit
from acquisition.bench.laboratory.air import Drift
from acquisition.bench.registers import METRES
from acquisition.limits import shown
from noise.law import SampleOnlyLaw, UniformSource

# full gain, and reflectors exactly at their nominal positions
SIMULATED = Setup(gain=31, placement_m=0.0, placement_deg=0.0, tilt_deg=0.0)


class RigLaw(SampleOnlyLaw):
    """Law of the readings of n pings that can only be sampled."""

    def __init__(self, model: RigModel, ping: Ping) -> None:
        super().__init__(ping.distance, model.resolution, model.max_range)
        self.model, self.ping = model, ping

    def _sample(self, rng: UniformSource) -> Reading:
        """Simulate every ping once, independently of the others.

        Raises:
            SettingError: `rng` is not a numpy Generator; the simulation needs more than uniform numbers.
        """
        if not isinstance(rng, np.random.Generator):
            raise SettingError(f"RigLaw.sample.rng: expected a numpy.random.Generator, got {shown(rng)}")
        rig = self.model.rig
        alone = replace(self.ping, run=np.arange(len(self.ping)))
        reading = rig.ping(alone, rng, _drift(self.model)).reading(rig.setup)
        return Reading(reading.range, reading.status)


@dataclass(frozen=True)
class RigModel:
    """A simulated unit in a simulated laboratory.

    Pings do not interfere, since the sonars of a simulator share one batch; the air temperature drifts with time.
    Covariates `temperature_c`, `humidity_pct`, `gain` and `range_mm` of a ping are used.

    Attributes:
        rig: unit and laboratory; by default the nominal unit at full gain with exactly placed reflectors.
        seed: seed of the drift of the air temperature.

    >>> law = RigModel().law(Ping.of(distance=[0.5, 2.0], reflectance=0.9))
    >>> law.sample(np.random.default_rng(0)).range.round(1)
    array([0.5, 2. ])
    """

    rig: Rig = field(default_factory=lambda: Rig(Unit.nominal(), SIMULATED))
    seed: int = 0
    remembers: bool = False

    @property
    def resolution(self) -> float:
        """Step of the register, m; a coarse timer may skip some steps."""
        return METRES[self.rig.setup.output]

    @property
    def max_range(self) -> float:
        """Maximum range set by the range register, m."""
        return float(self.rig.setup.listening * 345.0 / 2.0 + 1.0)

    @checked
    def law(self, ping: Ping, past: Reading | None = None) -> RigLaw:
        """Return the law of n pings."""
        return RigLaw(self, ping)


@lru_cache(maxsize=64)
def _drift(model: RigModel) -> Drift:
    return model.rig.draw_drift(np.random.default_rng(model.seed))
