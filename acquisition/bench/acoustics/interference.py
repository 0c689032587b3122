"""What is not the ping's own doing: other sonars, people who walk about, noise that comes and goes, the mains."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from acquisition.bench.acoustics.air import Floats
from acquisition.errors import SettingError
from acquisition.ping import Ping

GHOST_S = 0.15  # pings further apart than this cannot hear each other: 25 m of air and back take 65 dB


@dataclass(frozen=True)
class Neighbour:
    """Another sonar of the same kind, firing by a clock of its own.

    Attributes:
        period_s: from one of its pings to the next; this sonar's own interval makes it synchronous.
        first_s: when it first fires.
        path_m: how far its sound goes straight until it is here.
        bearing_deg: where that sound comes from, off the beam's axis.
        strength_db: pressure that it sends this way, against that of a sonar on its axis.
        beside_m: how far beside this sonar it stands, looking the same way, so that everything that returns this one's
            sound returns its own as well; None where only the straight way matters.
    """

    period_s: float = 0.0713
    first_s: float = 0.0
    path_m: float = 2.0
    bearing_deg: float = 30.0
    strength_db: float = 0.0
    beside_m: float | None = None

    def __post_init__(self) -> None:
        """Refuse a clock that stands still."""
        if self.period_s < 1e-3:
            raise SettingError(f"Neighbour.period_s must be at least 0.001 s, got {self.period_s:g} s")

    def firings(self, time: Floats, early: float, late: float) -> tuple[NDArray[np.int64], Floats]:
        """Return its pings around those of this sonar at `time`, s, (n,): whose they are near, and how much later, s.

        Only those that come at most `early` before and at most `late` after.
        """
        since = time - self.first_s
        first = np.maximum(np.ceil((since - early) / self.period_s), 0.0)
        count = np.maximum(np.floor((since + late) / self.period_s) - first + 1.0, 0.0).astype(np.int64)
        row = np.repeat(np.arange(len(time)), count)
        number = np.arange(len(row)) - np.repeat(np.cumsum(count) - count, count) + first[row]
        return row, number * self.period_s - since[row]


@dataclass(frozen=True)
class Mover:
    """A thing or a person that is not always in the same place.

    Attributes:
        way: times, s, and places (ahead, to the left, up), m; in between it goes straight and evenly, before and after
            it stands still. Two places a moment apart: somebody moved it.
        radius: of an upright cylinder that scatters as it does, m; about 0.15 for a person.
        again: whether it walks the way again and again, its last time being the first of the next round.
    """

    way: tuple[tuple[float, float, float, float], ...]
    radius: float = 0.15
    again: bool = False

    def __post_init__(self) -> None:
        """Refuse a way that leads nowhere or back in time."""
        times = [point[0] for point in self.way]
        if not times or any(b <= a for a, b in pairwise(times)) or (self.again and len(times) < 2):
            raise SettingError(
                "Mover.way must hold (time, x, y, z) at growing times, and two at least to be walked again"
            )

    def places(self, time: Floats) -> Floats:
        """Return where it is at times in s, m, (n, 3)."""
        table = np.array(self.way)
        when = table[0, 0] + np.mod(time - table[0, 0], table[-1, 0] - table[0, 0]) if self.again else time
        return np.stack([np.interp(when, table[:, 0], table[:, k]) for k in (1, 2, 3)], axis=-1)


@dataclass(frozen=True)
class Ambient:
    """Noise in the sonar's band that comes and goes: compressed air, keys, a drill.

    Attributes:
        share: of the time that it is there.
        dwell_s: after how long on average its state is drawn anew, s; 0 does so each ping.
        factor: on the rms of the receiver's own noise while it is there.
    """

    share: float = 0.05
    dwell_s: float = 5.0
    factor: float = 3.0


@dataclass(frozen=True)
class Reverberation:
    """What is left of a burst when the room has mixed it: noise in the sonar's own band that dies away.

    Attributes:
        level_db: its rms pressure when it is mixed, against that at 1 m on the axis, dB.
        decay_db_s: how fast it dies away; air of 1.29 dB/m alone takes 442 dB/s, walls take more.
        mixed_s: after the burst, when single ways can no longer be told apart.
    """

    level_db: float = -60.0
    decay_db_s: float = 500.0
    mixed_s: float = 0.010

    def power(self, since: Floats) -> Floats:
        """Return its mean square pressure at times since a burst, s, in their shape."""
        level = 10.0 ** ((self.level_db - self.decay_db_s * (since - self.mixed_s)) / 10.0)
        return np.where(since >= self.mixed_s, level, 0.0)


@dataclass(frozen=True)
class Hum:
    """A ripple of the mains on the comparator's reference: thresholds rise and fall by the clock on the wall.

    Attributes:
        frequency_hz: 100 behind a full-wave rectifier, 50 behind a half-wave one.
        depth: share of the threshold.
        phase_deg: at time 0.
    """

    frequency_hz: float = 100.0
    depth: float = 0.3
    phase_deg: float = 0.0

    def threshold(self, time: Floats) -> Floats:
        """Return the threshold against its usual one at times in s, in their shape."""
        return 1.0 + self.depth * np.sin(2.0 * np.pi * (self.frequency_hz * time + self.phase_deg / 360.0))


def earlier(ping: Ping) -> tuple[NDArray[np.int64], NDArray[np.int64], Floats]:
    """Return pairs of pings of which the second still hears the first: their numbers, and the seconds between them.

    Pings of a run must stand together, in order of time.
    """
    later, sooner, lags = [], [], []
    for back in range(1, len(ping)):
        lag = ping.time[back:] - ping.time[:-back]
        near = np.flatnonzero((ping.run[back:] == ping.run[:-back]) & (lag > 0.0) & (lag < GHOST_S))
        if not len(near):
            break
        later.append(near + back)
        sooner.append(near)
        lags.append(lag[near])
    if not lags:
        return np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64), np.empty(0)
    return np.concatenate(later), np.concatenate(sooner), np.concatenate(lags)
