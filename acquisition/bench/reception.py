"""What a unit hears of the visits to it: batches of pings, from placed reflectors to the times of their echoes."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from acquisition.bench.acoustics.air import Air, Floats, flutter, sound_speed
from acquisition.bench.acoustics.arrivals import BOUNCE, FACE, GROUPS, LEAK, OTHER, POST, Arrivals, Complexes, Integers
from acquisition.bench.acoustics.interference import earlier
from acquisition.bench.acoustics.receiver import Alone, Mixture, Pulses, amplification, crossings, voltages, waveforms
from acquisition.bench.acoustics.room import arrivals
from acquisition.bench.acoustics.scene import Scene, loudness
from acquisition.bench.acoustics.transducer import PERIOD
from acquisition.bench.firmware import first_echoes
from acquisition.bench.registers import NOISE, Truth
from acquisition.bench.setup import Setup
from acquisition.bench.unit import Unit
from acquisition.bench.visits import Visits
from acquisition.ping import Ping

COUNT = len(GROUPS)
# how far each group's way changes with the stand's swing, against the way to the reflector
SWAYING = np.array([{FACE: 1.0, BOUNCE: 2.0, POST: 1.0}.get(group, 0.0) for group in range(COUNT)])
AUDIBLE = 0.3  # of the threshold; a group that is fainter than this tripped nothing


@dataclass(frozen=True)
class Conditions:
    """All that n pings face, chance included.

    Attributes:
        ping: as it was asked for, run by run.
        temperature_c, humidity_pct: of the air, (n,).
        hiss: rms of the noise at full gain over the threshold, (n,).
        visits: how the pings fall into visits and takes.
        placed: where the reflector of each take stands, (takes,).
        flutter: level and delay of each group, unit variance, (n, groups, 2).
    """

    ping: Ping
    temperature_c: Floats
    humidity_pct: Floats
    hiss: Floats
    visits: Visits
    placed: Ping
    flutter: Floats

    @cached_property
    def air(self) -> Air:
        """Of each take."""
        return Air.of(self.visits.temperature_c, self.visits.humidity_pct)

    @cached_property
    def echo(self) -> tuple[Integers, Integers, Floats]:
        """Which pings still hear which before them, and how many seconds lie between."""
        return earlier(self.ping)


def draw_flutter(ping: Ping, visits: Visits, tau: float, rng: np.random.Generator) -> Floats:
    """Draw level and delay of each group in each ping, unit variance, (n, groups, 2)."""
    return flutter(ping.time, visits.start, tau, 2 * COUNT, rng).reshape(-1, COUNT, 2)


@dataclass(frozen=True)
class Hearing:
    """A batch of m pings of some takes.

    Attributes:
        unit, setup: who hears, and where.
        all: what all pings face.
        rows: which pings these are, those of a take together, (m,).
        takes: their takes, in order, (t,).
    """

    unit: Unit
    setup: Setup
    all: Conditions
    rows: Integers
    takes: Integers

    @cached_property
    def samples(self) -> int:
        """Of a waveform."""
        return int(np.ceil(self.setup.listening / PERIOD)) + 2

    @cached_property
    def take(self) -> Integers:
        """Which of `takes` each ping belongs to, (m,)."""
        return np.searchsorted(self.takes, self.all.visits.take[self.rows])

    @cached_property
    def time(self) -> Floats:
        """When the pings are fired, s, (m,)."""
        return self.all.ping.time[self.rows]

    @cached_property
    def scene(self) -> Scene:
        """Of the takes."""
        return self.scene_of(self.takes)

    @cached_property
    def way(self) -> Arrivals:
        """Of the sound in the takes."""
        return arrivals(self.scene)

    @cached_property
    def pulses(self) -> Pulses:
        """What that is to the receiver; row is the take."""
        return self.pulses_of(self.way, self.scene.air)

    def scene_of(self, takes: Integers) -> Scene:
        """Return the scenes of some takes."""
        return Scene.of(self.unit, self.setup, self.all.placed[takes], self.all.air[takes])

    def pulses_of(self, way: Arrivals, air: Air) -> Pulses:
        """Return what ways through air are to the receiver."""
        path = np.hypot(way.length, 0.5 * self.unit.baseline)
        weight = loudness(self.unit, self.setup.supply) * air.loss(way.row, path) * way.amplitude
        return Pulses(way.row, air.delay(way.row, path, self.setup.gradient.ahead), weight)

    @cached_property
    def fluctuation(self) -> tuple[Floats, Floats]:
        """Level and delay, s, of each group in each ping, (m, groups) each."""
        setup, kind, air = self.setup, self.way.row * COUNT + self.way.group, self.scene.air
        share, total = np.abs(self.pulses.weight), len(self.takes) * COUNT
        mean = np.bincount(kind, share * self.way.length, total) / np.maximum(np.bincount(kind, share, total), 1e-300)
        length, moved = mean.reshape(-1, COUNT)[self.take], self.all.flutter[self.rows]
        level = setup.scintillation_db * (length / 6.0) ** (11.0 / 12.0) * moved[..., 0]
        speed = sound_speed(self.all.temperature_c[self.rows], self.all.humidity_pct[self.rows])
        reference = air.speed[self.take, None]
        late = 2.0 * length * (1.0 / speed[:, None] - 1.0 / reference)
        late += 2.0 * setup.jitter_m * np.sqrt(length / 6.0) * moved[..., 1] / reference
        sway = setup.sway_m * np.sin(2.0 * np.pi * self.time / setup.sway_period_s)
        late += 2.0 * sway[:, None] * SWAYING / reference
        factor = 10.0 ** (level / 20.0)
        factor[:, LEAK], late[:, LEAK] = 1.0, 0.0
        return factor, late

    def threshold(self, pings: slice | Integers = slice(None)) -> Floats | None:
        """Return the comparator's threshold over its usual one, (k, samples), or None where it is that."""
        hum = self.setup.hum
        return None if hum is None else hum.threshold(self.time[pings, None] + np.arange(self.samples) * PERIOD)

    def hear(self, others: list[Pulses], rng: np.random.Generator, truth: bool) -> tuple[Floats, Truth | None]:
        """Return the echo times of the pings, s, (m, 17), NaN for none, and what really happened where that is asked.

        Args:
            others: what is not of the pings themselves; row is the ping among these.
            rng: the noise.
            truth: whether to tell the truth.
        """
        if truth or len(self.takes) < len(self.rows):
            return self._together(others, rng, truth)
        factor, late = (part[self.way.row, self.way.group] for part in self.fluctuation)
        own = Pulses(self.pulses.row, self.pulses.delay + late, self.pulses.weight * factor)
        wave = waveforms(self.unit, self.scene.air.temperature_c, Pulses.joined([own, *others]), self.samples)
        return self._trips([Alone(wave)], slice(None), rng), None

    def _together(self, others: list[Pulses], rng: np.random.Generator, truth: bool) -> tuple[Floats, Truth | None]:
        """Hear many pings of each take, whose waveforms are worked out once, group by group."""
        voices, voice = np.unique(self.way.row * COUNT + self.way.group, return_inverse=True)
        of, group = np.divmod(voices, COUNT)
        shared = Pulses(voice, self.pulses.delay, self.pulses.weight)
        wave = waveforms(self.unit, self.scene.air.temperature_c[of], shared, self.samples)
        onset = np.full(len(voices), np.inf)
        np.minimum.at(onset, voice, self.pulses.delay)
        extra = None
        if others:
            air = self.scene.air.temperature_c[self.take]
            extra = waveforms(self.unit, air, Pulses.joined(others), self.samples)
        times, told = [], []
        for number in range(len(self.takes)):
            pings, here = np.flatnonzero(self.take == number), np.flatnonzero(of == number)
            factor, late = (part[pings][:, group[here]] for part in self.fluctuation)
            mixture, other = Mixture(wave[here], factor, late), None if extra is None else extra[pings]
            waves: list[Mixture | Alone] = [mixture] if other is None else [mixture, Alone(other)]
            times.append(self._trips(waves, pings, rng))
            if truth:
                told.append(self._truth(mixture, group[here], onset[here], other, times[-1][:, 0]))
        return np.concatenate(times), Truth.joined(told) if truth else None

    @cached_property
    def _gain(self) -> Floats:
        return amplification(self.unit, self.setup, self.samples)

    def _trips(self, waves: list[Mixture | Alone], pings: slice | Integers, rng: np.random.Generator) -> Floats:
        """Return the echo times of some of the pings, s, (k, 17)."""
        hiss = self.all.hiss[self.rows[pings]]
        z, start = voltages(waves, hiss, self._gain, self.threshold(pings), rng)
        ping, time = crossings(z, self.unit)
        listening = self.setup.listening / (1.0 + self.unit.clock_error)
        return first_echoes(ping, time + start * PERIOD, len(hiss), self.unit, listening)

    def _truth(self, mixture: Mixture, group: Integers, onset: Floats, other: Complexes | None, first: Floats) -> Truth:
        """Return what really happened in the pings of one take, whose first echoes came at `first`, s, (k,)."""
        level, count, rows = np.abs(mixture.voice) * self._gain, len(first), np.arange(len(first))
        begun, loudest = np.full((count, COUNT), np.nan), np.zeros((count, COUNT))
        begun[:, group], loudest[:, group] = onset + mixture.late, level.max(axis=1) * mixture.factor
        sample = np.clip(np.nan_to_num(first / PERIOD).astype(np.int64), 0, self.samples - 2)
        near = np.zeros((count, COUNT))
        # the crossing lies between two samples
        near[:, group] = np.maximum(level[:, sample], level[:, sample + 1]).T * mixture.factor
        if other is not None:
            strange = np.abs(other) * self._gain
            loudest[:, OTHER] = strange.max(axis=1)
            near[:, OTHER] = np.maximum(strange[rows, sample], strange[rows, sample + 1])
        heard = ~np.isnan(first) & (near.max(axis=1) >= AUDIBLE)
        cause = np.where(heard, near.argmax(axis=1), NOISE)
        since = np.nan_to_num(first - begun[rows, cause])
        with np.errstate(divide="ignore"):
            level_db = 20.0 * np.log10(loudest)
        return Truth(begun, level_db, cause, np.where(heard, since / PERIOD, 0.0).astype(np.int64))
