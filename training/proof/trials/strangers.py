"""What is concealed in trials of strangers: causes outside the catalogue's families, of which "unknown" is right."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from acquisition import Ping
from acquisition.bench import Rig, Scatterer
from training.proof.trials.world import Floats, Rng, World, with_host, with_setup, with_unit

DEG = np.pi / 180.0


@dataclass(frozen=True)
class Stranger:
    """One thing that can be wrong, of which the catalogue does not know.

    Attributes:
        name: what it is.
        change: the world with it, given a size (1 is plain to see) and a generator.
    """

    name: str
    change: Callable[[World, float, Rng], World]


def smoothed(share: float) -> Callable[[Floats, Ping, Rng], Floats]:
    """Return a host that gives the running mean of echoes, each new one weighing `share`."""

    def change(value: Floats, ping: Ping, rng: Rng) -> Floats:
        out, last = value.copy(), 0.0
        for k in range(len(value)):
            if value[k] > 0:
                last = value[k] if last == 0.0 else last + share * (value[k] - last)
                out[k] = last
        return np.round(out, 3)

    return change


def dead_band(width_m: float) -> Callable[[Floats, Ping, Rng], Floats]:
    """Return a host that gives a new reading only when it differs from the last by more than `width_m`."""

    def change(value: Floats, ping: Ping, rng: Rng) -> Floats:
        out, last = value.copy(), 0.0
        for k in range(len(value)):
            if value[k] > 0 and abs(value[k] - last) > width_m:
                last = value[k]
            out[k] = last if value[k] > 0 else 0.0
        return out

    return change


def slew_limited(step_m: float) -> Callable[[Floats, Ping, Rng], Floats]:
    """Return a host whose readings move by no more than `step_m` from one to the next."""

    def change(value: Floats, ping: Ping, rng: Rng) -> Floats:
        out, last = value.copy(), 0.0
        for k in range(len(value)):
            if value[k] > 0:
                last = value[k] if last == 0.0 else last + float(np.clip(value[k] - last, -step_m, step_m))
                out[k] = last
        return np.round(out, 3)

    return change


def humming(amplitude_m: float, period_s: float) -> Callable[[Floats, Ping, Rng], Floats]:
    """Return a host whose readings swing with the mains, seen once a ping."""
    return lambda value, ping, rng: np.where(
        value > 0, np.round(value + amplitude_m * np.sin(2.0 * np.pi * ping.time / period_s), 4), 0.0
    )


def nearest_wins(limit_m: float) -> Callable[[Floats, Ping, Rng], Floats]:
    """Return a host that lifts short readings to the least it deems possible."""
    return lambda value, ping, rng: np.where(value > 0, np.maximum(value, limit_m), 0.0)


def clutter_that_moves(strength_db: float, seed: int) -> Callable[[Rig, float], Rig]:
    """Return a rig in whose room something is put somewhere else every few minutes."""

    def at(rig: Rig, time: float) -> Rig:
        rng = np.random.default_rng([seed, int(time // 240.0)])
        place = (float(rng.uniform(0.5, 2.5)), float(rng.uniform(-0.3, 0.3)), 0.0)
        room = replace(rig.setup.room, clutter=(Scatterer(place, strength_db),))
        return replace(rig, setup=replace(rig.setup, room=room))

    return at


def walker(strength_db: float, period_s: float) -> Callable[[Rig, float], Rig]:
    """Return a rig before which somebody walks to and fro."""

    def at(rig: Rig, time: float) -> Rig:
        ahead = 1.5 + 1.1 * np.sin(2.0 * np.pi * time / period_s)
        aside = 0.25 * np.cos(2.0 * np.pi * time / (1.7 * period_s))
        room = replace(rig.setup.room, clutter=(Scatterer((float(ahead), float(aside), 0.0), strength_db),))
        return replace(rig, setup=replace(rig.setup, room=room))

    return at


def fading_battery(loss_db_per_h: float) -> Callable[[Rig, float], Rig]:
    """Return a rig whose receiver hears less and less."""
    return lambda rig, time: replace(
        rig, unit=replace(rig.unit, sensitivity_db=rig.unit.sensitivity_db - loss_db_per_h * time / 3600.0)
    )


def bent_rail(amplitude_m: float, length_m: float) -> Callable[[Ping], Ping]:
    """Return where reflectors stand on a rail whose scale is wrong by a wave along its length."""
    return lambda ping: replace(
        ping, distance=ping.distance + amplitude_m * np.sin(2.0 * np.pi * ping.distance / length_m)
    )


def warm_far_end(share: float) -> Callable[[Ping], Ping]:
    """Return where reflectors seem to stand when the air grows warmer with distance: the way shrinks as its square."""
    return lambda ping: replace(ping, distance=ping.distance * (1.0 - share * ping.distance))


def mislabelled(turn_deg: float) -> Callable[[Ping], Ping]:
    """Return poses of a stand whose angle scale reads by a factor too little beyond one side."""
    turn = turn_deg * DEG
    return lambda ping: replace(ping, angle=np.where(ping.angle > 0, ping.angle + turn, ping.angle))


STRANGERS = (
    Stranger("firmware averaging", lambda w, s, r: with_unit(w, averaging=max(2, round(4 * s)))),
    Stranger("exponential smoothing", lambda w, s, r: with_host(w, smoothed(1.0 / (1.0 + 1.5 * s)))),
    Stranger("dead band", lambda w, s, r: with_host(w, dead_band(0.08 * s))),
    Stranger("slew limit", lambda w, s, r: with_host(w, slew_limited(0.12 / s))),
    Stranger(
        "swaying target",
        lambda w, s, r: with_setup(w, sway_m=0.008 * s, sway_period_s=float(r.uniform(0.9, 3.1))),
    ),
    Stranger("mains hum", lambda w, s, r: with_host(w, humming(0.006 * s, float(r.uniform(0.31, 2.9))))),
    Stranger(
        "moving furniture",
        lambda w, s, r: replace(w, at=clutter_that_moves(-20.0 + 6.0 * s, int(r.integers(2**31)))),
    ),
    Stranger("walking person", lambda w, s, r: replace(w, at=walker(-20.0 + 6.0 * s, float(r.uniform(90.0, 200.0))))),
    Stranger("fading battery", lambda w, s, r: replace(w, at=fading_battery(25.0 * s))),
    Stranger("wrong rail", lambda w, s, r: replace(w, stands=bent_rail(0.02 * s, float(r.uniform(0.6, 1.2))))),
    Stranger("temperature gradient", lambda w, s, r: replace(w, stands=warm_far_end(0.008 * s))),
    Stranger("angle scale", lambda w, s, r: replace(w, stands=mislabelled(9.0 * s))),
    Stranger("least reading", lambda w, s, r: with_host(w, nearest_wins(0.35 + 0.3 * s))),
)
BY_NAME = {stranger.name: stranger for stranger in STRANGERS}
