"""What is concealed in trials of the catalogue: changes of a rig, and what may be said of them.

Sizes run over a ladder; 1 is plain to see in most surveys. None of the numbers is taken from the effects' own classes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from acquisition import Ping
from acquisition.bench import Ambient, Neighbour, Post, Scatterer
from training.proof.trials.world import Floats, Rng, World, with_bus, with_host, with_room, with_setup, with_unit

Change = Callable[[World, float, Rng], World]
Truth = Callable[[World, World], float]
ZERO_C = 273.15
ASSUMED_C = 22.766  # of the law that stands for a simulation, see `sound_speed`


def _same(world: World, size: float, rng: Rng) -> World:
    return world


@dataclass(frozen=True)
class Cause:
    """One thing that can be wrong, of which the catalogue knows.

    Attributes:
        name: effect id.
        change: the world with it, given a size and a generator.
        accepted: ids that name it rightly beside its own: what is the same on any data (computed classes aside).
        before: what the simulation lacks besides.
        aspects: of residuals, by which it should be located.
        parameter: the effect's parameter whose true value is known, and the value given both worlds.
        region: column and least and greatest value, in its unit, of where it acts; None for everywhere.
        interval_s: from ping to ping.
        turned: whether reflectors stay parallel to the sensor's face.
    """

    name: str
    change: Change
    accepted: tuple[str, ...] = ()
    before: Change = _same
    aspects: tuple[str, ...] = ()
    parameter: tuple[str, Truth] | None = None
    region: Callable[[World], tuple[str, float, float]] | None = None
    interval_s: tuple[float, float] = (0.1, 0.1)
    turned: bool = False


def sign(rng: Rng) -> float:
    """Return a sign."""
    return float(rng.choice([-1.0, 1.0]))


def _warmer(simulated: World, real: World) -> float:
    ratio = (ZERO_C + real.rig.setup.temperature_c) / (ZERO_C + simulated.rig.setup.temperature_c)
    return (ZERO_C + ASSUMED_C) * ratio - ZERO_C


def _clock(simulated: World, real: World) -> float:
    # a clock that runs fast by e counts e more ticks: readings are long by e
    return (1.0 + real.rig.unit.clock_error) / (1.0 + simulated.rig.unit.clock_error) - 1.0


def _ignored_incidence(ping: Ping) -> Ping:
    return replace(ping, incidence=np.zeros(len(ping)))


def _all_mirrors(ping: Ping) -> Ping:
    return replace(ping, reflectance=np.full(len(ping), 0.9))


def _facing(world: World, size: float, rng: Rng) -> World:
    return replace(world, stands=_ignored_incidence)


def _as_logged(world: World, size: float, rng: Rng) -> World:
    return replace(world, stands=None)


def spikes(share: float) -> Callable[[Floats, Ping, Rng], Floats]:
    """Return a host that replaces a share of the readings by any on the scale."""
    return lambda value, ping, rng: np.where(
        rng.random(len(value)) < share, np.round(rng.uniform(0.03, 11.0, len(value)), 3), value
    )


def bursts(share: float, sigma_m: float) -> Callable[[Floats, Ping, Rng], Floats]:
    """Return a host that scatters a share of the readings."""
    return lambda value, ping, rng: np.where(
        (rng.random(len(value)) < share) & (value > 0),
        np.maximum(np.round(value + rng.normal(0.0, sigma_m, len(value)), 4), 0.03),
        value,
    )


def frozen(share: float, at_m: float) -> Callable[[Floats, Ping, Rng], Floats]:
    """Return a host that gives one and the same reading now and then."""
    return lambda value, ping, rng: np.where(rng.random(len(value)) < share, at_m, value)


def stepped(step_m: float, down: bool) -> Callable[[Floats, Ping, Rng], Floats]:
    """Return a host that rounds, or cuts, readings to steps."""
    cut = np.floor if down else np.rint
    return lambda value, ping, rng: np.where(value > 0, np.maximum(cut(value / step_m + 1e-9), 1.0) * step_m, 0.0)


def less_sensitive(decibels: float) -> Change:
    """Return a change of the receiver's sensitivity, in dB a size."""
    return lambda w, s, r: with_unit(w, sensitivity_db=w.rig.unit.sensitivity_db - decibels * s)


SILENT = ("detection",)
CAUSES = (
    Cause(
        "sound_speed",
        lambda w, s, r: with_setup(w, temperature_c=w.rig.setup.temperature_c + sign(r) * 9.0 * s),
        aspects=("scale", "bias"),
        parameter=("temperature_c", _warmer),
    ),
    Cause(
        "clock_scale",
        lambda w, s, r: with_unit(w, clock_error=sign(r) * 0.016 * s),
        aspects=("scale", "bias"),
        parameter=("error", _clock),
    ),
    Cause(
        "zero_offset",
        lambda w, s, r: with_setup(w, zero_m=sign(r) * 0.012 * s),
        aspects=("bias", "scale"),
        parameter=("offset_m", lambda a, b: b.rig.setup.zero_m - a.rig.setup.zero_m),
    ),
    Cause(
        "thermal_drift",
        lambda w, s, r: with_setup(w, drift_c=4.0 * s, drift_tau_s=2500.0),
        aspects=("scale", "bias", "time_correlation", "spread", "rhythm"),
    ),
    Cause(
        "air_absorption",
        lambda w, s, r: with_setup(w, humidity_pct=min(70.0, 12.0 + 30.0 * s)),
        ("sensitivity",),
        before=lambda w, s, r: with_setup(w, humidity_pct=12.0),
        aspects=SILENT,
    ),
    Cause("scintillation", lambda w, s, r: with_setup(w, scintillation_db=4.0 * s + 1.0), aspects=(*SILENT, "spread")),
    Cause("beam_width", lambda w, s, r: with_unit(w, radius=6.55e-3 * (1.0 + 0.7 * s)), aspects=SILENT),
    Cause("boresight", lambda w, s, r: with_unit(w, yaw=np.deg2rad(sign(r) * 7.0 * s)), aspects=(*SILENT, "bias")),
    Cause(
        "pivot_offset",
        lambda w, s, r: with_setup(w, pivot_m=sign(r) * 0.12 * s),
        aspects=("bias", "scale", *SILENT),
        turned=True,
    ),
    Cause(
        "reflectance_loss",
        _as_logged,
        ("sensitivity", "specular_loss"),
        before=lambda w, s, r: replace(w, stands=_all_mirrors),
        aspects=(*SILENT, "bias"),
    ),
    Cause(
        "specular_loss",
        _as_logged,
        ("perpendicular_foot", "edge_diffraction", "beam_width"),
        before=_facing,
        aspects=(*SILENT, "bias"),
        turned=True,
    ),
    Cause(
        "background_reflector",
        lambda w, s, r: with_setup(w, post=Post(0.03 * s, float(r.uniform(0.18, 0.45)))),
        before=lambda w, s, r: with_setup(w, post=None),
        aspects=("extra_mode", *SILENT, "skew"),
        parameter=("behind_m", lambda a, b: b.rig.setup.post.behind if b.rig.setup.post else 0.0),
    ),
    Cause(
        "fixed_clutter",
        lambda w, s, r: with_room(w, clutter=(Scatterer((float(r.uniform(0.8, 2.0)), 0.12, 0.0), -24.0 + 6.0 * s),)),
        aspects=("extra_mode", "bias", *SILENT, "scale"),
        parameter=("range_m", lambda a, b: float(np.linalg.norm(b.rig.setup.room.clutter[0].position_m))),
        region=lambda w: ("distance_mm", 1000.0 * w.rig.setup.room.clutter[0].position_m[0], 4000.0),
    ),
    Cause(
        "multipath",
        lambda w, s, r: with_room(w, height=0.30 / np.sqrt(s)),
        ("fixed_clutter",),
        aspects=("extra_mode", "bias", *SILENT, "skew"),
    ),
    Cause("sensitivity", less_sensitive(10.0), aspects=(*SILENT, "bias")),
    Cause(
        "ring_down",
        lambda w, s, r: with_unit(w, leak_db=-24.0 + 6.0 * s, blanking=150e-6),
        ("fixed_clutter",),
        before=lambda w, s, r: with_unit(w, q_tx=58.0, q_rx=58.0),
        aspects=("extra_mode", "bias", *SILENT, "scale"),
    ),
    Cause(
        "false_alarm",
        lambda w, s, r: with_setup(w, ambient=Ambient(0.3, 5.0, 2.0 + 1.6 * s)),
        aspects=("extra_mode", "skew", "bias", *SILENT),
    ),
    Cause(
        "quantisation",
        lambda w, s, r: with_host(w, stepped(0.0254 * s, down=False)),
        ("truncation",),
        aspects=("spread", "bias", "time_correlation", "skew"),
    ),
    Cause(
        "truncation",
        lambda w, s, r: with_host(w, stepped(0.0254 * s, down=True)),
        ("quantisation",),
        aspects=("bias", "spread", "scale"),
    ),
    Cause(
        "range_gate",
        lambda w, s, r: with_setup(w, range_register=round(75 - 30 * min(s, 2.0))),
        aspects=SILENT,
        parameter=("listen_m", lambda a, b: 0.043 * (b.rig.setup.range_register + 1)),
        region=lambda w: ("distance_mm", 43.0 * (w.rig.setup.range_register + 1), 4000.0),
    ),
    Cause(
        "warm_up",
        lambda w, s, r: with_unit(w, cold_s=sign(r) * 90e-6 * s, warm_up_tau_s=300.0),
        aspects=("bias", "time_correlation", "spread"),
    ),
    Cause(
        "previous_ping",
        lambda w, s, r: with_room(w, wall=float(r.uniform(11.6, 13.5)), wall_factor=min(1.0, 0.6 * s)),
        ("fixed_clutter",),
        before=lambda w, s, r: with_room(w, wall=None),
        aspects=("extra_mode", "bias", *SILENT),
        interval_s=(0.066, 0.085),
    ),
    Cause(
        "synchronous_crosstalk",
        lambda w, s, r: with_setup(
            w, neighbour=Neighbour(0.1, float(r.uniform(0.006, 0.012)), 1.5, 10.0, 10.0 * s - 18.0)
        ),
        ("fixed_clutter",),
        aspects=("extra_mode", "bias", *SILENT, "scale"),
    ),
    Cause(
        "asynchronous_crosstalk",
        lambda w, s, r: with_setup(
            w, neighbour=Neighbour(float(r.uniform(0.11, 0.35)), 0.0, 1.5, 10.0, 10.0 * s - 18.0)
        ),
        aspects=("extra_mode", "bias", *SILENT, "skew"),
    ),
    Cause(
        "dropped_reading",
        lambda w, s, r: with_bus(w, dropped=min(0.5, 0.06 * s)),
        aspects=SILENT,
        parameter=("probability", lambda a, b: b.rig.setup.bus.dropped),
    ),
    Cause(
        "stale_repeat",
        lambda w, s, r: with_bus(w, lost_write=min(0.5, 0.10 * s)),
        aspects=("extra_mode", "bias", *SILENT, "time_correlation"),
        parameter=("probability", lambda a, b: b.rig.setup.bus.lost_write),
    ),
    Cause(
        "corrupted_byte",
        lambda w, s, r: with_bus(w, bit_flip=min(0.4, 0.05 * s)),
        ("spike",),
        aspects=("extra_mode", "skew", "bias"),
        parameter=("probability", lambda a, b: b.rig.setup.bus.bit_flip),
    ),
    Cause(
        "spike",
        lambda w, s, r: with_host(w, spikes(min(0.4, 0.04 * s))),
        aspects=("extra_mode", "skew", "bias"),
    ),
    Cause(
        "noise_burst",
        lambda w, s, r: with_host(w, bursts(min(0.5, 0.10 * s), float(r.uniform(0.04, 0.12)))),
        aspects=("extra_mode", "spread", "skew"),
    ),
    Cause(
        "stuck",
        lambda w, s, r: with_host(w, frozen(min(0.5, 0.05 * s), float(np.round(r.uniform(0.3, 3.0), 2)))),
        aspects=("extra_mode", "bias", "skew"),
    ),
)
BY_NAME = {cause.name: cause for cause in CAUSES}
