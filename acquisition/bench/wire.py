"""The wire between host and sensor: what it does to a ping whatever was heard."""

from __future__ import annotations

from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from acquisition.bench.setup import Bus
from acquisition.ping import Ping


class Link(IntEnum):
    """What became of a ping on the wire."""

    FINE = 0
    NACK = 1
    ALL_ONES = 2
    LOST_WRITE = 3
    DROPPED = 4
    BIT_FLIP = 5
    RESET = 6


# in the order in which they overrule each other
RATES = {
    Link.BIT_FLIP: "bit_flip",
    Link.DROPPED: "dropped",
    Link.LOST_WRITE: "lost_write",
    Link.ALL_ONES: "all_ones",
    Link.NACK: "nack",
}


def faults(bus: Bus, ping: Ping, rng: np.random.Generator) -> NDArray[np.uint8]:
    """Draw what the wire does to each ping, (n,) of `Link`; where two faults meet, silence of the wire wins."""
    out = np.full(len(ping), Link.FINE, dtype=np.uint8)
    for link, name in RATES.items():
        out[present(getattr(bus, name), bus.dwell_s, ping, rng)] = link
    first = np.diff(ping.run, prepend=ping.run[:1] - 1) != 0
    out[first & (out == Link.LOST_WRITE)] = Link.FINE  # a run begins with registers of its own
    return out


def reset(bus: Bus, ping: Ping, rng: np.random.Generator) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Draw which pings the sensor's supply breaks down before, and which find its registers as it left them, (n,)."""
    if bus.reset == 0.0:
        return np.zeros(len(ping), dtype=np.bool_), np.zeros(len(ping), dtype=np.bool_)
    down = rng.random(len(ping)) < bus.reset
    written = np.floor(ping.time / bus.rewrite_s) if bus.rewrite_s > 0.0 else np.arange(len(ping))
    fresh = (np.diff(written, prepend=-1.0) != 0) | (np.diff(ping.run, prepend=ping.run[:1] - 1) != 0)
    epoch = np.cumsum(fresh)
    fallen = np.cumsum(down)
    return down, fallen > np.concatenate([[0], (fallen - down)[fresh]])[epoch]


def present(rate: float, dwell_s: float, ping: Ping, rng: np.random.Generator) -> NDArray[np.bool_]:
    """Draw a two-state process that is on with probability `rate` and keeps its state for about `dwell_s`."""
    if rate == 0.0:
        return np.zeros(len(ping), dtype=np.bool_)
    drawn = rng.random(len(ping)) < rate
    step = np.diff(ping.time, prepend=-np.inf)
    keep = np.exp(-np.maximum(step, 0.0) / dwell_s) if dwell_s > 0 else np.zeros(len(ping))
    keep[np.diff(ping.run, prepend=ping.run[:1] - 1) != 0] = 0.0
    anew = rng.random(len(ping)) >= keep
    return drawn[np.maximum.accumulate(np.where(anew, np.arange(len(ping)), 0))]
