"""Bus between host and sensor: faults that do not depend on the echo."""

from __future__ import annotations

from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from acquisition.bench.laboratory.setup import Bus
from acquisition.ping import Ping


class Link(IntEnum):
    """Bus fault of a ping."""

    OK = 0
    NACK = 1
    ALL_ONES = 2
    LOST_WRITE = 3
    DROPPED = 4
    BIT_FLIP = 5
    RESET = 6


# in ascending order of precedence
RATES = {
    Link.BIT_FLIP: "bit_flip",
    Link.DROPPED: "dropped",
    Link.LOST_WRITE: "lost_write",
    Link.ALL_ONES: "all_ones",
    Link.NACK: "nack",
}


def draw_faults(bus: Bus, ping: Ping, rng: np.random.Generator) -> NDArray[np.uint8]:
    """Draw the bus fault of each ping, (n,) of `Link`; the later entry of `RATES` takes precedence."""
    out = np.full(len(ping), Link.OK, dtype=np.uint8)
    for link, name in RATES.items():
        out[two_state(getattr(bus, name), bus.dwell_s, ping, rng)] = link
    first = np.diff(ping.run, prepend=ping.run[:1] - 1) != 0
    out[first & (out == Link.LOST_WRITE)] = Link.OK  # registers are written at the start of a run
    return out


def draw_resets(bus: Bus, ping: Ping, rng: np.random.Generator) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Draw which pings the sensor resets before, and which are fired with the register values of a reset, (n,) each."""
    if bus.reset == 0.0:
        return np.zeros(len(ping), dtype=np.bool_), np.zeros(len(ping), dtype=np.bool_)
    down = rng.random(len(ping)) < bus.reset
    written = np.floor(ping.time / bus.rewrite_s) if bus.rewrite_s > 0.0 else np.arange(len(ping))
    fresh = (np.diff(written, prepend=-1.0) != 0) | (np.diff(ping.run, prepend=ping.run[:1] - 1) != 0)
    epoch = np.cumsum(fresh)
    fallen = np.cumsum(down)
    return down, fallen > np.concatenate([[0], (fallen - down)[fresh]])[epoch]


def two_state(rate: float, dwell_s: float, ping: Ping, rng: np.random.Generator) -> NDArray[np.bool_]:
    """Draw a two-state process that is on with probability `rate` and is redrawn after `dwell_s` on average, (n,)."""
    if rate == 0.0:
        return np.zeros(len(ping), dtype=np.bool_)
    drawn = rng.random(len(ping)) < rate
    step = np.diff(ping.time, prepend=-np.inf)
    keep = np.exp(-np.maximum(step, 0.0) / dwell_s) if dwell_s > 0 else np.zeros(len(ping))
    keep[np.diff(ping.run, prepend=ping.run[:1] - 1) != 0] = 0.0
    redrawn = rng.random(len(ping)) >= keep
    return drawn[np.maximum.accumulate(np.where(redrawn, np.arange(len(ping)), 0))]
