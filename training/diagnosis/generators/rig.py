"""Family "rig": the waveform rig, with a random sensor, laboratory, register and survey."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from acquisition import Ping
from acquisition.arrays import Floats
from acquisition.bench import Ambient, Bus, Reverberation, Rig, Setup, Unit
from acquisition.bench.laboratory.air import Drift
from training.diagnosis.generators.world import Register, Rng, World


@dataclass(frozen=True)
class RigSonar:
    """The waveform rig behind the interface of the generators.

    Attributes:
        unit: the sensor.
        setup: the laboratory.
        drift: of the air, in standard deviations; None draws one for each recording.
    """

    unit: Unit
    setup: Setup
    drift: Drift | None = None

    def read(self, ping: Ping, rng: Rng) -> tuple[Ping, Floats]:
        """Return the pings and the ranges of the first echoes, m; without answer is without echo."""
        reading = Rig(self.unit, self.setup).ping(ping, rng, self.drift).reading(self.setup)
        return ping, reading.range

    def with_setup(self, **change: Any) -> RigSonar:
        """Return it in a laboratory with other settings."""
        return replace(self, setup=replace(self.setup, **change))

    def with_room(self, **change: Any) -> RigSonar:
        """Return it in a room with other surfaces."""
        return self.with_setup(room=replace(self.setup.room, **change))

    def with_unit(self, **change: Any) -> RigSonar:
        """Return it with other electronics."""
        return replace(self, unit=replace(self.unit, **change))


def draw_world(rng: Rng) -> World:
    """Return a random sensor in a random laboratory, with a random register."""
    serial = int(rng.integers(1, 2**31))
    reverberation = Reverberation(float(rng.uniform(-75.0, -60.0))) if rng.random() < 0.05 else None  # slow to compute
    setup = Setup.draw(
        serial + 1,
        gain=int(rng.integers(20, 31)),
        range_register=int(rng.integers(75, 141)),
        output="us",
        temperature_c=float(rng.uniform(15.0, 25.0)),
        humidity_pct=float(rng.uniform(15.0, 70.0)),
        scintillation_db=float(rng.uniform(0.2, 1.5)),
        drift_c=float(rng.uniform(0.02, 0.15)),  # what is not logged changes the null by less than 1 mm at 3 m
        placement_m=float(rng.uniform(0.0005, 0.005)),
        placement_deg=float(rng.uniform(0.1, 0.8)),
        tilt_deg=float(rng.uniform(0.1, 0.8)),
        reverberation=reverberation,
        ambient=Ambient(0.1, 3.0, float(rng.uniform(1.0, 3.0))) if rng.random() < 0.2 else None,
        bus=Bus(dropped=float(rng.uniform(0.0, 0.02))) if rng.random() < 0.3 else Bus(),
    )
    unit = replace(Unit.draw(serial), rounding="nearest", tick=1e-6)  # the register of the world is the coarse one
    if rng.random() < 0.15:
        unit = replace(unit, averaging=2)
    unanswered = float(rng.uniform(0.0, 0.01)) if rng.random() < 0.2 else 0.0
    return World(RigSonar(unit, setup), Register.draw(rng), unanswered=unanswered)


def another_day(world: World, rng: Rng) -> World:
    """Return the same sensor and laboratory on a day with another care of placement and other eddies of the air."""
    sonar = world.sonar.with_setup(
        placement_m=float(rng.uniform(0.001, 0.005)), flutter_tau_s=float(np.exp(rng.uniform(-0.7, 3.0)))
    )
    return replace(world, sonar=sonar)
