"""Family "rig": the waveform rig, with a random sensor, laboratory, register and survey."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from acquisition import Ping
from acquisition.arrays import Floats
from acquisition.bench import Ambient, Bus, Neighbour, Post, Reverberation, Rig, Scatterer, Setup, Unit
from acquisition.bench.laboratory.air import Drift
from training.diagnosis.generators.surveys import TEMPERATURE, drawn_surveys
from training.diagnosis.generators.world import (
    FULL_SCALE_M,
    LINK_CAUSES,
    Cause,
    Family,
    Planted,
    Register,
    Rng,
    World,
    sign,
)

ZERO_C = 273.15
ASSUMED_C = 22.766  # degC at which sound travels 1 cm and back in 58 us, the constant of the firmware
ALARM_FACTOR = 2.0  # of the receiver's noise, from which it crosses the threshold now and then
FAST_S = (0.066, 0.085)  # s between pings at which a far echo of the previous ping is received


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


Change = Callable[[RigSonar, float, Rng], RigSonar]
Truth = Callable[[RigSonar, RigSonar], float]


def _unchanged(sonar: RigSonar, size: float, rng: Rng) -> RigSonar:
    return sonar


@dataclass(frozen=True)
class _Plant:
    """Plants a change of the rig, perhaps after another one that also holds in the simulation."""

    change: Change
    before: Change = _unchanged
    truth: Truth | None = None
    region: Callable[[RigSonar], dict[str, tuple[float, float]]] = field(default=lambda sonar: {})

    def __call__(self, world: World, size: float, rng: Rng) -> Planted:
        simulated = self.before(world.sonar, size, rng)
        real = self.change(simulated, size, rng)
        value = None if self.truth is None else self.truth(simulated, real)
        return Planted(replace(world, sonar=simulated), replace(world, sonar=real), value, self.region(real))


def draw_world(rng: Rng) -> World:
    """Return a random sensor in a random laboratory, with a random register."""
    serial = int(rng.integers(1, 2**31))
    reverberation = Reverberation(float(rng.uniform(-75.0, -60.0))) if rng.random() < 0.2 else None
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


def _temperature(simulated: RigSonar, real: RigSonar) -> float:
    ratio = (ZERO_C + real.setup.temperature_c) / (ZERO_C + simulated.setup.temperature_c)
    return (ZERO_C + ASSUMED_C) * ratio - ZERO_C


def _drifting(sonar: RigSonar, size: float, rng: Rng) -> RigSonar:
    tau = float(rng.uniform(1500.0, 5000.0))
    return replace(sonar.with_setup(drift_c=4.0 * size, drift_tau_s=tau), drift=Drift.draw(1.0, tau, rng))


def _scatterer(sonar: RigSonar, size: float, rng: Rng) -> RigSonar:
    place = (float(rng.uniform(0.6, 1.8)), 0.12, 0.0)
    return sonar.with_room(clutter=(Scatterer(place, -24.0 + 6.0 * size),))


def _clutter_m(sonar: RigSonar) -> float:
    return float(np.linalg.norm(sonar.setup.room.clutter[0].position_m))


def _post_m(simulated: RigSonar, real: RigSonar) -> float:
    return real.setup.post.behind if real.setup.post else 0.0


def _gate_m(sonar: RigSonar) -> float:
    return 0.043 * (sonar.setup.range_register + 1)


def _neighbour(slowest_s: float, fastest_s: float, synchronous: bool) -> Change:
    def change(sonar: RigSonar, size: float, rng: Rng) -> RigSonar:
        late = float(rng.uniform(0.006, 0.012)) if synchronous else 0.0
        period = float(rng.uniform(fastest_s, slowest_s))
        return sonar.with_setup(neighbour=Neighbour(period, late, 1.5, 10.0, 10.0 * size - 18.0))

    return change


CAUSES = (
    Cause(
        "sound_speed",
        _Plant(
            lambda s, k, r: s.with_setup(temperature_c=s.setup.temperature_c + sign(r) * 9.0 * k), truth=_temperature
        ),
        ("bias",),
        ("clock_scale",),
        "temperature_c",
        hides=(TEMPERATURE,),
    ),
    Cause(
        "clock_scale",
        _Plant(
            lambda s, k, r: s.with_unit(clock_error=s.unit.clock_error + sign(r) * 0.016 * k),
            truth=lambda a, b: (1.0 + b.unit.clock_error) / (1.0 + a.unit.clock_error) - 1.0,
        ),
        ("bias",),
        ("sound_speed",),
        "error",
    ),
    Cause(
        "zero_offset",
        _Plant(
            lambda s, k, r: s.with_setup(zero_m=s.setup.zero_m + sign(r) * 0.012 * k),
            truth=lambda a, b: b.setup.zero_m - a.setup.zero_m,
        ),
        ("bias",),
        parameter="offset_m",
    ),
    Cause("thermal_drift", _Plant(_drifting), ("bias", "memory", "spread"), hides=(TEMPERATURE,), needs=("time_s",)),
    Cause(
        "air_absorption",
        _Plant(
            lambda s, k, r: s.with_setup(extra_absorption_db=s.setup.extra_absorption_db + 0.8 * k),
            truth=lambda a, b: b.setup.extra_absorption_db - a.setup.extra_absorption_db,
        ),
        ("detection", "bias"),
        ("sensitivity",),
        "alpha_db_per_m",
    ),
    Cause(
        "scintillation",
        _Plant(lambda s, k, r: s.with_setup(scintillation_db=s.setup.scintillation_db + 4.0 * k)),
        ("detection", "spread"),
    ),
    Cause(
        "beam_width",
        _Plant(lambda s, k, r: s.with_unit(radius=s.unit.radius * (1.0 + 0.7 * k))),
        ("detection", "bias"),
        survey={"angle_deg": tuple(np.arange(-40.0, 41.0, 5.0))},
    ),
    Cause(
        "boresight",
        _Plant(
            lambda s, k, r: s.with_unit(yaw=s.unit.yaw + np.deg2rad(sign(r) * 7.0 * k)),
            truth=lambda a, b: float(np.rad2deg(b.unit.yaw - a.unit.yaw)),
        ),
        ("detection", "bias"),
        parameter="yaw_deg",
        survey={"angle_deg": tuple(np.arange(-40.0, 41.0, 5.0))},
    ),
    Cause(
        "pivot_offset",
        _Plant(lambda s, k, r: s.with_setup(pivot_m=s.setup.pivot_m + sign(r) * 0.12 * k)),
        ("bias", "detection"),
        needs=("incidence_deg",),
        survey={"incidence": "free"},
    ),
    Cause(
        "background_reflector",
        _Plant(
            lambda s, k, r: s.with_setup(post=Post(0.03 * k, float(r.uniform(0.18, 0.45)))),
            lambda s, k, r: s.with_setup(post=None),
            _post_m,
        ),
        ("late", "detection", "skew"),
        parameter="behind_m",
    ),
    Cause(
        "fixed_clutter",
        _Plant(
            _scatterer, truth=lambda a, b: _clutter_m(b), region=lambda s: {"distance": (_clutter_m(s), FULL_SCALE_M)}
        ),
        ("early", "bias", "detection", "coincidence"),
        parameter="range_m",
    ),
    Cause(
        "multipath",
        _Plant(lambda s, k, r: s.with_room(height=0.30 / np.sqrt(k), floor_factor=0.95)),
        ("late", "detection", "bias", "skew"),
        ("fixed_clutter",),
    ),
    Cause(
        "sensitivity",
        _Plant(
            lambda s, k, r: s.with_unit(sensitivity_db=s.unit.sensitivity_db - 10.0 * k),
            truth=lambda a, b: a.unit.sensitivity_db - b.unit.sensitivity_db,
        ),
        ("detection", "bias"),
        parameter="loss_db",
    ),
    Cause(
        "ring_down",
        _Plant(
            lambda s, k, r: s.with_unit(leak_db=-24.0 + 6.0 * k, blanking=150e-6),
            lambda s, k, r: s.with_unit(q_tx=58.0, q_rx=58.0),
        ),
        ("early", "bias", "detection"),
        ("fixed_clutter",),
    ),
    Cause(
        "false_alarm",
        _Plant(lambda s, k, r: s.with_setup(ambient=Ambient(0.3, 5.0, ALARM_FACTOR + 1.6 * k))),
        ("early", "skew", "detection"),
    ),
    Cause(
        "range_gate",
        _Plant(
            lambda s, k, r: s.with_setup(range_register=round(70 - 25 * min(k, 2.0))),
            truth=lambda a, b: _gate_m(b),
            region=lambda s: {"distance": (_gate_m(s), FULL_SCALE_M)},
        ),
        ("detection",),
        parameter="listen_m",
        survey={"distance_m": (0.3, 4.0)},
    ),
    Cause(
        "warm_up",
        _Plant(
            lambda s, k, r: s.with_unit(cold_s=sign(r) * 90e-6 * k, warm_up_tau_s=float(r.uniform(150.0, 600.0))),
            truth=lambda a, b: b.unit.warm_up_tau_s,
        ),
        ("bias", "memory", "spread"),
        parameter="tau_s",
        needs=("time_s",),
    ),
    Cause(
        "previous_ping",
        _Plant(
            lambda s, k, r: s.with_room(wall=float(r.uniform(11.6, 13.5)), wall_factor=min(1.0, 0.6 * k)),
            lambda s, k, r: s.with_room(wall=None),
            lambda a, b: b.setup.room.wall or 0.0,
        ),
        ("early", "bias", "detection"),
        parameter="far_m",
        needs=("time_s",),
        survey={"interval_s": FAST_S},
    ),
    Cause(
        "synchronous_crosstalk",
        _Plant(_neighbour(0.1, 0.1, True)),
        ("early", "bias", "detection"),
        ("fixed_clutter",),
        survey={"interval_s": (0.1, 0.1)},
    ),
    Cause(
        "asynchronous_crosstalk",
        _Plant(_neighbour(0.35, 0.11, False), truth=lambda a, b: b.setup.neighbours[0].period_s),
        ("early", "bias", "detection", "skew"),
        parameter="period_s",
        needs=("time_s",),
    ),
    *LINK_CAUSES,
)
FAMILY = Family(draw_world, drawn_surveys, CAUSES, another_day)
