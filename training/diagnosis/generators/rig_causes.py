"""Causes of the family "rig", and the family itself."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from acquisition import Ping
from acquisition.bench import Ambient, Neighbour, Post, Scatterer
from acquisition.bench.laboratory.air import Drift
from acquisition.ping import TEMPERATURE
from training.diagnosis.generators.rig import RigSonar, another_day, draw_world
from training.diagnosis.generators.surveys import WIDE, drawn_surveys
from training.diagnosis.generators.world import FULL_SCALE_M, LINK_CAUSES, Cause, Family, Planted, Rng, World, sign

ZERO_C = 273.15
ASSUMED_C = 22.766  # degC at which sound travels 1 cm and back in 58 us, the constant of the firmware
ALARM_FACTOR = 2.0  # of the receiver's noise, from which it crosses the threshold now and then
FAST_S = (0.032, 0.036)  # s between pings: a wall at 6.3 to 7.5 m is received in the next ping

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


def _temperature(simulated: RigSonar, real: RigSonar) -> float:
    ratio = (ZERO_C + real.setup.temperature_c) / (ZERO_C + simulated.setup.temperature_c)
    return (ZERO_C + ASSUMED_C) * ratio - ZERO_C


def _drifting(sonar: RigSonar, size: float, rng: Rng) -> RigSonar:
    tau = float(rng.uniform(1500.0, 5000.0))
    return replace(sonar.with_setup(drift_c=4.0 * size, drift_tau_s=tau), drift=Drift.draw(1.0, tau, rng))


def _scatterer(sonar: RigSonar, size: float, rng: Rng) -> RigSonar:
    place = (float(rng.uniform(0.6, 1.8)), 0.12, 0.0)
    return sonar.with_room(clutter=(Scatterer(place, -24.0 + 6.0 * size),))


def _ringing(sonar: RigSonar, size: float, rng: Rng) -> RigSonar:
    """Return a sonar whose direct sound is so strong that its ring-down is read in about three of ten pings at size 1.

    The level is found by bisection, since the share rises from none to all within 2 dB.
    """
    pilot = Ping.of(np.full(40, 1.0), reflectance=0.9, time=0.1 * np.arange(40))
    low, high = -45.0, 10.0
    for _ in range(9):
        middle = 0.5 * (low + high)
        value = sonar.with_unit(leak_db=middle, blanking=150e-6).read(pilot, rng)[1]
        enough = np.mean((value > 0.0) & (value < 0.5)) >= min(0.9, 0.3 * size)
        low, high = (low, middle) if enough else (middle, high)
    return sonar.with_unit(leak_db=high, blanking=150e-6)


def _fast(sonar: RigSonar, size: float, rng: Rng) -> RigSonar:
    """Return a sonar that listens for 4 m, with a gain at which it receives a wall at 7 m, and without the wall."""
    sensitive = sonar.with_unit(sensitivity_db=max(12.0, sonar.unit.sensitivity_db))
    return sensitive.with_room(wall=None).with_setup(gain=31, range_register=92)


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
        _Plant(lambda s, k, r: s.with_setup(scintillation_db=min(8.0, s.setup.scintillation_db + 5.0 * k))),
        ("detection", "spread"),
    ),
    Cause(
        "beam_width",
        _Plant(lambda s, k, r: s.with_unit(radius=s.unit.radius * (1.0 + 0.7 * k))),
        ("detection", "bias"),
        survey=WIDE,
    ),
    Cause(
        "boresight",
        _Plant(
            lambda s, k, r: s.with_unit(yaw=s.unit.yaw + np.deg2rad(sign(r) * 7.0 * k)),
            truth=lambda a, b: float(np.rad2deg(b.unit.yaw - a.unit.yaw)),
        ),
        ("detection", "bias"),
        parameter="yaw_deg",
        survey=WIDE,
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
            lambda s, k, r: s.with_setup(post=Post(0.06 * k, float(r.uniform(0.18, 0.45)))),
            lambda s, k, r: s.with_setup(post=None),
            _post_m,
        ),
        ("late", "detection", "skew"),
        parameter="behind_m",
        survey={**WIDE, "incidence": "free"},
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
            _ringing,
            lambda s, k, r: s.with_unit(q_tx=58.0, q_rx=58.0, leak_db=-60.0, blanking=500e-6),
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
            lambda s, k, r: s.with_room(wall=float(r.uniform(6.3, 7.5)), wall_factor=min(1.0, 0.8 * k)),
            _fast,
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
