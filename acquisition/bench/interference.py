"""Sound that is not the ping's own: the ping before, another sonar nearby, and noise that comes and goes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from acquisition.bench.air import Floats
from acquisition.bench.transducer import FINE, OMEGA, PERIOD, Complexes
from acquisition.errors import SettingError
from acquisition.ping import Ping

GHOST_S = 0.15  # pings further apart than this cannot hear each other: 25 m of air and back take 65 dB


@dataclass(frozen=True)
class Neighbour:
    """Another sonar of the same kind, firing by a clock of its own.

    Attributes:
        period_s: from one of its pings to the next; this sonar's own interval makes it synchronous.
        first_s: when it first fires.
        path_m: how far its sound goes until it is here.
        bearing_deg: where its sound comes from, off the beam's axis.
        strength_db: pressure that it sends this way, against that of a sonar on its axis.
    """

    period_s: float = 0.0713
    first_s: float = 0.0
    path_m: float = 2.0
    bearing_deg: float = 30.0
    strength_db: float = 0.0

    def __post_init__(self) -> None:
        """Refuse a clock that stands still."""
        if self.period_s < 1e-3:
            raise SettingError(f"Neighbour.period_s must be at least 0.001 s, got {self.period_s:g} s")

    def arrivals(self, time: float, speed: float, window: float, tail: float) -> Floats:
        """Return when its bursts begin to arrive after this sonar's own at `time`, s; those under way included."""
        since = time - self.first_s - self.path_m / speed
        first = np.ceil((since - tail) / self.period_s)
        last = np.floor((since + window) / self.period_s)
        number = np.arange(max(first, 0.0), last + 1.0)
        return number * self.period_s - since

    def waveforms(self, time: Floats, speed: float, level: float, phases: Complexes, samples: int) -> Complexes:
        """Return what m pings at `time`, s, hear of it, (m, samples), its bursts being of amplitude `level`."""
        length = phases.shape[1]
        out = np.zeros((len(time), length + samples + length), dtype=np.complex128)
        for row, moment in zip(out, time, strict=True):
            for delay in self.arrivals(float(moment), speed, samples * PERIOD, length * PERIOD - PERIOD):
                step = round(delay / PERIOD * FINE)
                start = length + step // FINE
                row[start : start + length] += level * np.exp(-1j * OMEGA * delay) * phases[step % FINE]
        return out[:, length : length + samples]


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


def intervals(ping: Ping) -> Floats:
    """Return the time since the ping before in the same run, s, (n,); infinite where there is none."""
    step = np.diff(ping.time, prepend=-np.inf)
    same = np.diff(ping.run, prepend=ping.run[:1] - 1) == 0
    return np.where(same & (step > 0.0), step, np.inf)


def shifted(ghosts: list[Complexes | None], interval: Floats, samples: int) -> Complexes:
    """Return what is left of earlier waveforms an interval later, (n, samples), or (1, samples) of nothing.

    A part of a period turns the carrier and moves the pulse along its slope.
    """
    if all(ghost is None for ghost in ghosts):
        return np.zeros((1, samples), dtype=np.complex128)
    out = np.zeros((len(ghosts), samples), dtype=np.complex128)
    for row, ghost, wait in zip(out, ghosts, interval, strict=True):
        if ghost is not None:
            start = round(wait / PERIOD)
            rest = wait - start * PERIOD
            part = ghost[start : start + samples + 1]
            row[:] = np.exp(1j * OMEGA * rest) * (part[:-1] + rest / PERIOD * np.diff(part))
    return out
