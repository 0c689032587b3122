"""What a recording is made in: a rig, perhaps one that changes with time, a log that may err, and what a host adds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from acquisition import EchoStatus, Ping, Reading, Recording
from acquisition.arrays import Floats
from acquisition.bench import Rig

Rng = np.random.Generator
Host = Callable[[Floats, Ping, Rng], Floats]
# the columns that would give the cause away; the diagnosis sees what a usual log holds
HIDDEN = ["temperature_c", "humidity_pct", "gain", "range_mm"]


@dataclass(frozen=True)
class World:
    """Where pings are fired.

    Attributes:
        rig: at the beginning.
        at: the rig at a time, s, where it changes from visit to visit.
        stands: where reflectors truly are, given where the log has them.
        host: what the computer does to the readings, m with 0 for silence, given the log.
    """

    rig: Rig
    at: Callable[[Rig, float], Rig] | None = None
    stands: Callable[[Ping], Ping] | None = None
    host: tuple[Host, ...] = ()

    def record(self, ping: Ping, rng: Rng) -> Recording:
        """Return what is logged of pings, without the columns that would tell."""
        reading = self._heard(ping if self.stands is None else self.stands(ping), rng)
        value = reading.range
        for change in self.host:
            value = change(value, ping, rng)
        status = np.where(value > 0, EchoStatus.ECHO, EchoStatus.NO_ECHO)
        status = np.where(reading.answered, status, EchoStatus.NO_ANSWER)
        return _bare(Recording.of(ping, Reading.of(np.where(reading.answered, value, 0.0), status), name="rig"))

    def _heard(self, ping: Ping, rng: Rng) -> Reading:
        if self.at is None:
            return self.rig.ping(ping, rng).reading(self.rig.setup)
        drift, parts = self.rig.draw_drift(rng), []
        starts = visits(ping)
        for start, stop in zip(starts, [*starts[1:], len(ping)], strict=True):
            rig = self.at(self.rig, float(ping.time[start]))
            parts.append(rig.ping(ping[start:stop], rng, drift).reading(rig.setup))
        return Reading.of(np.concatenate([p.range for p in parts]), np.concatenate([p.status for p in parts]))


def _bare(recording: Recording) -> Recording:
    table = recording.table
    return replace(recording, table=table.drop(columns=[name for name in HIDDEN if name in table.columns]))


def visits(ping: Ping) -> list[int]:
    """Return the rows at which another condition begins."""
    condition = np.stack([ping.distance, ping.angle, ping.incidence, ping.reflectance, ping.run])
    new = np.any(condition[:, 1:] != condition[:, :-1], axis=0)
    return [0, *(np.flatnonzero(new) + 1).tolist()]


def with_setup(world: World, **change: Any) -> World:
    """Return a world whose laboratory differs."""
    return replace(world, rig=replace(world.rig, setup=replace(world.rig.setup, **change)))


def with_unit(world: World, **change: Any) -> World:
    """Return a world whose electronics differ."""
    return replace(world, rig=replace(world.rig, unit=replace(world.rig.unit, **change)))


def with_room(world: World, **change: Any) -> World:
    """Return a world whose room differs."""
    return with_setup(world, room=replace(world.rig.setup.room, **change))


def with_bus(world: World, **change: Any) -> World:
    """Return a world whose wire differs."""
    return with_setup(world, bus=replace(world.rig.setup.bus, **change))


def with_host(world: World, change: Host) -> World:
    """Return a world whose computer does one more thing to the readings."""
    return replace(world, host=(*world.host, change))
