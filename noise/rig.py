"""The waveform rig as a sonar model: what it says comes from geometry and electronics, and there is no law to look up.

For worlds that stand for the real one: a policy or a diagnosis meets readings that no law was fitted to, except through
recordings.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np

from acquisition import Ping, Reading
from acquisition.bench import Rig, Setup, Unit
from acquisition.bench.acoustics.air import Drift
from acquisition.bench.registers import METRES
from acquisition.errors import SampleOnlyError
from noise.law import EchoLaw, Floats

# full gain, and reflectors that stand where the simulator has them
SIMULATED = Setup(gain=31, placement_m=0.0, placement_deg=0.0, tilt_deg=0.0)


class RigLaw(EchoLaw):
    """What n pings would read, to be drawn from and nothing else."""

    has_probabilities = False

    def __init__(self, model: RigModel, ping: Ping) -> None:
        super().__init__(ping.distance, model.resolution, model.max_range)
        self.model, self.ping = model, ping

    def arrival(self, z: Floats) -> Floats:
        """Refuse: no probabilities are known.

        Raises:
            SampleOnlyError: always.
        """
        raise SampleOnlyError("the rig fires pings and knows no probabilities: draw readings with `sample(rng)`")

    @property
    def no_answer(self) -> Floats:
        """Refuse as `arrival` does."""
        return self.arrival(self.distance)

    def sample(self, rng: np.random.Generator) -> Reading:
        """Fire every ping once, each as if it were the only one."""
        rig = self.model.rig
        alone = replace(self.ping, run=np.arange(len(self.ping)))
        reading = rig.ping(alone, rng, _drift(self.model)).reading(rig.setup)
        return Reading(reading.range, reading.status)


@dataclass(frozen=True)
class RigModel:
    """A unit in a laboratory, fired at whatever stands before it.

    Pings do not hear each other, since a simulator's sonars are many; the air wanders with the pings' times.

    Attributes:
        rig: unit and laboratory; the nominal unit at full gain, where reflectors stand just where they should.
        seed: of the air's wandering.

    >>> law = RigModel().law(Ping.of(distance=[0.5, 2.0], reflectance=0.9))
    >>> law.sample(np.random.default_rng(0)).range.round(1)
    array([0.5, 2. ])
    """

    rig: Rig = field(default_factory=lambda: Rig(Unit.nominal(), SIMULATED))
    seed: int = 0
    remembers: bool = False

    @property
    def resolution(self) -> float:
        """Step of the register, m; a sensor with a coarse timer leaves some steps out."""
        return METRES[self.rig.setup.output]

    @property
    def max_range(self) -> float:
        """Farthest that the range register lets through, m."""
        return float(self.rig.setup.listening * 345.0 / 2.0 + 1.0)

    def law(self, ping: Ping, past: Reading | None = None) -> RigLaw:
        """Return what n pings would read."""
        return RigLaw(self, ping)


@lru_cache(maxsize=64)
def _drift(model: RigModel) -> Drift:
    return model.rig.draw_drift(np.random.default_rng(model.seed))
