"""Settings of sound from other sources: other sonars, moving objects, background noise, reverberation, mains hum."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from acquisition.arrays import Floats
from acquisition.errors import SettingError
from acquisition.ping import Ping

ECHO_OVERLAP_S = 0.15  # longest time between pings that overlap: 25 m of air and back attenuate by 65 dB


@dataclass(frozen=True)
class Neighbour:
    """Another sonar of the same kind with its own clock.

    Attributes:
        period_s: time between its pings, s; equal to this sonar's interval, it is synchronous.
        first_s: time of its first ping, s.
        path_m: length of the direct path from it to this sensor, m.
        bearing_deg: direction from which its sound arrives, off the beam's axis.
        strength_db: pressure emitted in this direction relative to that on its axis, dB.
        beside_m: lateral distance to this sensor when it faces the same way, m: every reflector then also returns its
            sound. None: direct path only.
    """

    period_s: float = 0.0713
    first_s: float = 0.0
    path_m: float = 2.0
    bearing_deg: float = 30.0
    strength_db: float = 0.0
    beside_m: float | None = None

    def __post_init__(self) -> None:
        """Raise SettingError for a period below 1 ms."""
        if self.period_s < 1e-3:
            raise SettingError(f"Neighbour.period_s must be at least 0.001 s, got {self.period_s:g} s")

    def firings(self, time: Floats, early: float, late: float) -> tuple[NDArray[np.int64], Floats]:
        """Return its pings near those of this sonar: index of the near ping, and how much later it fires, s.

        Args:
            time: times of this sonar's pings, s, (n,).
            early: longest lead, s.
            late: longest lag, s.
        """
        since = time - self.first_s
        first = np.maximum(np.ceil((since - early) / self.period_s), 0.0)
        count = np.maximum(np.floor((since + late) / self.period_s) - first + 1.0, 0.0).astype(np.int64)
        row = np.repeat(np.arange(len(time)), count)
        number = np.arange(len(row)) - np.repeat(np.cumsum(count) - count, count) + first[row]
        return row, number * self.period_s - since[row]


@dataclass(frozen=True)
class Mover:
    """Moving object or person.

    Attributes:
        waypoints: times, s, and positions (ahead, left, up), m; linear motion between them, at rest before and after.
        radius: radius of an upright cylinder that scatters as much, m; about 0.15 for a person.
        loop: whether the motion repeats, the last time being the first of the next cycle.
    """

    waypoints: tuple[tuple[float, float, float, float], ...]
    radius: float = 0.15
    loop: bool = False

    def __post_init__(self) -> None:
        """Raise SettingError for times that do not increase or a loop of a single point."""
        times = [point[0] for point in self.waypoints]
        if not times or any(b <= a for a, b in pairwise(times)) or (self.loop and len(times) < 2):
            raise SettingError(
                "Mover.waypoints must hold (time, x, y, z) at increasing times, and at least two points for a loop"
            )

    def positions(self, time: Floats) -> Floats:
        """Return its positions at times in s, m, (n, 3)."""
        table = np.array(self.waypoints)
        when = table[0, 0] + np.mod(time - table[0, 0], table[-1, 0] - table[0, 0]) if self.loop else time
        return np.stack([np.interp(when, table[:, 0], table[:, k]) for k in (1, 2, 3)], axis=-1)


@dataclass(frozen=True)
class Ambient:
    """Intermittent background noise in the sonar's band: compressed air, keys, a drill.

    Attributes:
        share: fraction of the time for which it is present.
        dwell_s: mean time after which its state is redrawn, s; 0 redraws it at each ping.
        factor: factor on the rms of the receiver's own noise while it is present.
    """

    share: float = 0.05
    dwell_s: float = 5.0
    factor: float = 3.0


@dataclass(frozen=True)
class Reverberation:
    """Diffuse reverberation after a burst: noise in the sonar's band with exponential decay.

    Attributes:
        level_db: rms pressure when the field becomes diffuse, relative to that at 1 m on the axis, dB.
        decay_db_s: decay rate; air of 1.29 dB/m alone gives 442 dB/s, walls add to it.
        mixed_s: time after the burst at which the field becomes diffuse, s.
    """

    level_db: float = -60.0
    decay_db_s: float = 500.0
    mixed_s: float = 0.010

    def power(self, since: Floats) -> Floats:
        """Return the mean square pressure at times since a burst, s, in their shape."""
        level = 10.0 ** ((self.level_db - self.decay_db_s * (since - self.mixed_s)) / 10.0)
        return np.where(since >= self.mixed_s, level, 0.0)


@dataclass(frozen=True)
class Hum:
    """Mains ripple on the comparator's reference.

    Attributes:
        frequency_hz: 100 behind a full-wave rectifier, 50 behind a half-wave one.
        depth: fraction of the threshold.
        phase_deg: phase at time 0.
    """

    frequency_hz: float = 100.0
    depth: float = 0.3
    phase_deg: float = 0.0

    def threshold(self, time: Floats) -> Floats:
        """Return the threshold relative to its nominal value at times in s, in their shape."""
        return 1.0 + self.depth * np.sin(2.0 * np.pi * (self.frequency_hz * time + self.phase_deg / 360.0))


def overlapping_pings(ping: Ping) -> tuple[NDArray[np.int64], NDArray[np.int64], Floats]:
    """Return pairs of pings (later, previous, lag in s) close enough for the later to receive sound of the previous.

    Pings of a run must be contiguous and in order of time.
    """
    later, previous, lags = [], [], []
    for back in range(1, len(ping)):
        lag = ping.time[back:] - ping.time[:-back]
        near = np.flatnonzero((ping.run[back:] == ping.run[:-back]) & (lag > 0.0) & (lag < ECHO_OVERLAP_S))
        if not len(near):
            break
        later.append(near + back)
        previous.append(near)
        lags.append(lag[near])
    if not lags:
        return np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64), np.empty(0)
    return np.concatenate(later), np.concatenate(previous), np.concatenate(lags)
