"""Causes concealed in development trials: changes of a sensor or laboratory, and the effects accepted as right."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from acquisition.bench import Ambient, Neighbour, Post, Rig, Scatterer

Change = Callable[[Rig, float, np.random.Generator], Rig]


@dataclass(frozen=True)
class Cause:
    """One concealed cause.

    Attributes:
        name: effect id, or name of a fault outside the catalogue.
        accepted: effect ids that count as right; empty for a fault outside the catalogue ("unknown" is right).
        change: returns the rig with the cause, given its size (1 is clearly visible) and a generator.
        before: returns the rig of the simulation, if the default rig has the cause already.
        interval_s: range of the ping interval, s.
        turned: whether reflectors are parallel to the sensor's face.
    """

    name: str
    accepted: tuple[str, ...]
    change: Change
    before: Callable[[Rig], Rig] = lambda rig: rig
    interval_s: tuple[float, float] = (0.1, 0.1)
    turned: bool = False


def setup(**change: Callable[[float, np.random.Generator], object]) -> Change:
    """Return a change of the laboratory's settings."""
    return lambda rig, size, rng: replace(
        rig, setup=replace(rig.setup, **{key: value(size, rng) for key, value in change.items()})
    )


def unit(**change: Callable[[float, np.random.Generator], object]) -> Change:
    """Return a change of the electronics."""
    return lambda rig, size, rng: replace(
        rig, unit=replace(rig.unit, **{key: value(size, rng) for key, value in change.items()})
    )


def bus(name: str, rate: float) -> Change:
    """Return a fault of the bus."""
    return lambda rig, size, rng: replace(
        rig, setup=replace(rig.setup, bus=replace(rig.setup.bus, **{name: min(0.5, rate * size)}))
    )


def room(**change: Callable[[float, np.random.Generator], object]) -> Change:
    """Return a change of the room."""
    return lambda rig, size, rng: replace(
        rig, setup=replace(rig.setup, room=replace(rig.setup.room, **{k: v(size, rng) for k, v in change.items()}))
    )


def random_sign(rng: np.random.Generator) -> float:
    """Return a random sign."""
    return float(rng.choice([-1.0, 1.0]))


def _weaker(rig: Rig, size: float, rng: np.random.Generator) -> Rig:
    return replace(rig, unit=replace(rig.unit, sensitivity_db=rig.unit.sensitivity_db - 12.0 * size))


def _louder_leak(rig: Rig, size: float, rng: np.random.Generator) -> Rig:
    return replace(rig, unit=replace(rig.unit, leak_db=-26.0 + 6.0 * size, blanking=150e-6, q_tx=58.0, q_rx=58.0))


def _no_post(rig: Rig) -> Rig:
    return replace(rig, setup=replace(rig.setup, post=None))


def _dry(rig: Rig) -> Rig:
    return replace(rig, setup=replace(rig.setup, humidity_pct=10.0))


def _fine(rig: Rig) -> Rig:
    return replace(rig, setup=replace(rig.setup, output="us"))


SCALED = ("sound_speed", "clock_scale")
CAUSES = (
    Cause("sound_speed", SCALED, setup(temperature_c=lambda s, r: 19.0 + random_sign(r) * 10.0 * s)),
    Cause("clock_scale", SCALED, unit(clock_error=lambda s, r: random_sign(r) * 0.02 * s)),
    Cause("zero_offset", ("zero_offset",), setup(zero_m=lambda s, r: random_sign(r) * 0.015 * s)),
    Cause("dropped_reading", ("dropped_reading",), bus("dropped", 0.08)),
    Cause("stale_repeat", ("stale_repeat",), bus("lost_write", 0.12)),
    Cause("corrupted_byte", ("corrupted_byte",), bus("bit_flip", 0.06)),
    Cause("sensitivity", ("sensitivity",), _weaker),
    Cause("boresight", ("boresight",), unit(yaw=lambda s, r: np.deg2rad(random_sign(r) * 8.0 * s))),
    Cause("beam_width", ("beam_width",), unit(radius=lambda s, r: 6.55e-3 * (1.0 + 0.8 * s))),
    Cause(
        "background_reflector",
        ("background_reflector",),
        setup(post=lambda s, r: Post(0.03 * s, float(r.uniform(0.2, 0.5)))),
        _no_post,
    ),
    Cause(
        "fixed_clutter",
        ("fixed_clutter",),
        room(clutter=lambda s, r: (Scatterer((float(r.uniform(0.8, 1.8)), 0.15, 0.0), -22.0 + 6.0 * s),)),
    ),
    Cause("multipath", ("multipath", "fixed_clutter"), room(height=lambda s, r: 0.35 / s)),
    Cause(
        "previous_ping",
        ("previous_ping",),
        room(wall=lambda s, r: float(r.uniform(12.5, 14.0)), wall_factor=lambda s, r: min(1.0, 0.7 * s)),
        lambda rig: replace(rig, setup=replace(rig.setup, room=replace(rig.setup.room, wall=None))),
        (0.066, 0.09),
    ),
    Cause(
        "asynchronous_crosstalk",
        ("asynchronous_crosstalk",),
        setup(neighbour=lambda s, r: Neighbour(float(r.uniform(0.19, 0.4)), 0.0, 1.5, 10.0, -20.0 + 10.0 * s)),
    ),
    Cause("ring_down", ("ring_down",), _louder_leak),
    Cause("range_gate", ("range_gate",), setup(range_register=lambda s, r: round(105 - 38 * s))),
    Cause("quantisation", ("quantisation",), setup(output=lambda s, r: "cm" if s < 1.5 else "inch"), _fine),
    Cause("thermal_drift", ("thermal_drift",), setup(drift_c=lambda s, r: 3.0 * s, drift_tau_s=lambda s, r: 1500.0)),
    Cause("scintillation", ("scintillation",), setup(scintillation_db=lambda s, r: 5.0 * s)),
    Cause("air_absorption", ("air_absorption",), setup(humidity_pct=lambda s, r: min(60.0, 10.0 + 40.0 * s)), _dry),
    Cause("pivot_offset", ("pivot_offset",), setup(pivot_m=lambda s, r: random_sign(r) * 0.1 * s), turned=True),
    Cause("warm_up", ("warm_up",), unit(cold_s=lambda s, r: 120e-6 * s, warm_up_tau_s=lambda s, r: 400.0)),
    Cause("averaging", (), unit(averaging=lambda s, r: max(2, round(5 * s)))),
    Cause("sway", (), setup(sway_m=lambda s, r: 0.008 * s, sway_period_s=lambda s, r: float(r.uniform(0.9, 3.1)))),
    Cause("false_alarm", ("false_alarm",), setup(ambient=lambda s, r: Ambient(0.3, 5.0, 2.0 + 2.0 * s))),
)
BY_NAME = {cause.name: cause for cause in CAUSES}
