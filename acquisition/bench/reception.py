"""Reception of batches of pings: from placed reflectors to the times of their echoes."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from acquisition.arrays import Floats, Ints
from acquisition.bench.acoustics.arrivals import BOUNCE, FACE, GROUPS, LEAK, OTHER, POST, Arrivals, Complexes
from acquisition.bench.acoustics.geometry import PathGeometry, amplitude_scale
from acquisition.bench.acoustics.receiver import (
    Pulses,
    SeparateWaveforms,
    SharedWaveforms,
    amplification,
    crossings,
    voltages,
    waveforms,
)
from acquisition.bench.acoustics.room import arrivals
from acquisition.bench.acoustics.transducer import PERIOD
from acquisition.bench.firmware import first_echoes
from acquisition.bench.laboratory.air import Air, flutter, sound_speed
from acquisition.bench.laboratory.interference import overlapping_pings
from acquisition.bench.laboratory.setup import Setup
from acquisition.bench.laboratory.unit import Unit
from acquisition.bench.registers import NOISE, TrueEchoes
from acquisition.bench.visits import Visits
from acquisition.ping import RANGE_RATE, Ping

N_GROUPS = len(GROUPS)
# change of each group's path length with the stand's sway, relative to the path to the reflector
SWAY_FACTOR = np.array([{FACE: 1.0, BOUNCE: 2.0, POST: 1.0}.get(group, 0.0) for group in range(N_GROUPS)])
MIN_CAUSE_LEVEL = 0.3  # relative to the threshold; weaker groups are not the cause of a crossing


@dataclass(frozen=True)
class DrawnPings:
    """n pings with all random quantities drawn for them.

    Attributes:
        ping: nominal conditions, run by run.
        temperature_c, humidity_pct: of the air, (n,).
        noise_rms: at full gain relative to the threshold, (n,).
        visits: assignment of pings to visits and segments.
        placed: actual pose of the reflector in each segment, (segments,).
        flutter: fluctuation of level and delay of each group, unit variance, (n, groups, 2).
    """

    ping: Ping
    temperature_c: Floats
    humidity_pct: Floats
    noise_rms: Floats
    visits: Visits
    placed: Ping
    flutter: Floats

    @cached_property
    def air(self) -> Air:
        """Air of each segment."""
        return Air.of(self.visits.temperature_c, self.visits.humidity_pct)

    @cached_property
    def overlaps(self) -> tuple[Ints, Ints, Floats]:
        """Pairs of pings of which the later receives sound of the previous, and the lag, s."""
        return overlapping_pings(self.ping)


def draw_flutter(ping: Ping, visits: Visits, tau: float, rng: np.random.Generator) -> Floats:
    """Draw the fluctuations of level and delay of each group in each ping, unit variance, (n, groups, 2)."""
    return flutter(ping.time, visits.start, tau, 2 * N_GROUPS, rng).reshape(-1, N_GROUPS, 2)


@dataclass(frozen=True)
class Reception:
    """Batch of m pings of some segments.

    Attributes:
        unit: the sensor.
        setup: the laboratory.
        drawn: all pings of the call.
        rows: indices of these pings, grouped by segment, (m,).
        segments: their segments, in order, (t,).
    """

    unit: Unit
    setup: Setup
    drawn: DrawnPings
    rows: Ints
    segments: Ints

    @cached_property
    def samples(self) -> int:
        """Number of samples of a waveform."""
        return int(np.ceil(self.setup.listening / PERIOD)) + 2

    @cached_property
    def segment(self) -> Ints:
        """Index into `segments` of each ping, (m,)."""
        return np.searchsorted(self.segments, self.drawn.visits.segment[self.rows])

    @cached_property
    def time(self) -> Floats:
        """Times of the pings, s, (m,)."""
        return self.drawn.ping.time[self.rows]

    @cached_property
    def geometry(self) -> PathGeometry:
        """Geometry of the segments."""
        return self.geometry_of(self.segments)

    @cached_property
    def paths(self) -> Arrivals:
        """Echo paths of the segments."""
        return arrivals(self.geometry)

    @cached_property
    def pulses(self) -> Pulses:
        """Pulses of the echo paths at the receiver; row is the segment."""
        return self.pulses_of(self.paths, self.geometry.air)

    def geometry_of(self, segments: Ints) -> PathGeometry:
        """Return the geometry of some segments."""
        return PathGeometry.of(self.unit, self.setup, self.drawn.placed[segments], self.drawn.air[segments])

    def pulses_of(self, paths: Arrivals, air: Air) -> Pulses:
        """Return the pulses at the receiver of paths through air."""
        path = np.hypot(paths.length, 0.5 * self.unit.baseline)
        weight = amplitude_scale(self.unit, self.setup.supply) * air.loss(paths.row, path) * paths.amplitude
        return Pulses(paths.row, air.delay(paths.row, path, self.setup.gradient.ahead), weight)

    @cached_property
    def fluctuation(self) -> tuple[Floats, Floats]:
        """Level factor and delay, s, of each group in each ping, (m, groups) each."""
        setup, kind, air = self.setup, self.paths.row * N_GROUPS + self.paths.group, self.geometry.air
        share, total = np.abs(self.pulses.weight), len(self.segments) * N_GROUPS
        mean = np.bincount(kind, share * self.paths.length, total) / np.maximum(np.bincount(kind, share, total), 1e-300)
        length, fluctuation = mean.reshape(-1, N_GROUPS)[self.segment], self.drawn.flutter[self.rows]
        level = setup.scintillation_db * (length / 6.0) ** (11.0 / 12.0) * fluctuation[..., 0]
        speed = sound_speed(self.drawn.temperature_c[self.rows], self.drawn.humidity_pct[self.rows])
        reference = air.speed[self.segment, None]
        delay = 2.0 * length * (1.0 / speed[:, None] - 1.0 / reference)
        delay += 2.0 * setup.jitter_m * np.sqrt(length / 6.0) * fluctuation[..., 1] / reference
        sway = setup.sway_m * np.sin(2.0 * np.pi * self.time / setup.sway_period_s)
        moved = sway[:, None] + length * self._rate[:, None] / reference  # while the sound is on its way there
        delay += 2.0 * moved * SWAY_FACTOR / reference
        factor = 10.0 ** (level / 20.0)
        factor[:, LEAK], delay[:, LEAK] = 1.0, 0.0
        return factor, delay

    @property
    def _rate(self) -> Floats:
        """Speed of the reflector and its stand away from the sensor, m/s, (m,)."""
        return self.drawn.ping.covariates[RANGE_RATE][self.rows]

    def threshold(self, pings: slice | Ints = slice(None)) -> Floats | None:
        """Return the comparator's threshold relative to its nominal value, (k, samples), or None if constant."""
        hum = self.setup.hum
        return None if hum is None else hum.threshold(self.time[pings, None] + np.arange(self.samples) * PERIOD)

    def receive(self, others: list[Pulses], rng: np.random.Generator, truth: bool) -> tuple[Floats, TrueEchoes | None]:
        """Return the echo times of the pings, s, (m, 17), NaN for none, and the true echoes if requested.

        Args:
            others: sound from other sources; row is the ping in the batch.
            rng: source of the noise.
            truth: whether to return the true echoes.
        """
        if truth or (len(self.segments) < len(self.rows) and not self._moves):
            return self._receive_shared(others, rng, truth)
        ping, pulse = self._pulses_of_pings()
        factor, delay = (part[ping, self.paths.group[pulse]] for part in self.fluctuation)
        own = Pulses(ping, self.pulses.delay[pulse] + delay, self.pulses.weight[pulse] * factor)
        air = self.geometry.air.temperature_c[self.segment]
        wave = waveforms(self.unit, air, Pulses.joined([own, *others]), self.samples)
        return self._comparator_echoes([SeparateWaveforms(wave)], slice(None), rng), None

    @property
    def _moves(self) -> bool:
        """Whether the reflector moves within a visit: by more than a shared waveform can be shifted, 5 mm."""
        return bool(self.setup.sway_m > 0.0 or self._rate.any())

    def _pulses_of_pings(self) -> tuple[Ints, Ints]:
        """Return pairs of a ping and a pulse of its segment, (k,) each, by ping."""
        order = np.argsort(self.pulses.row, kind="stable")
        count = np.bincount(self.pulses.row, minlength=len(self.segments))
        first, n = (np.cumsum(count) - count)[self.segment], count[self.segment]
        ping = np.repeat(np.arange(len(self.rows)), n)
        return ping, order[np.arange(len(ping)) + np.repeat(first - np.cumsum(n) + n, n)]

    def _receive_shared(
        self, others: list[Pulses], rng: np.random.Generator, truth: bool
    ) -> tuple[Floats, TrueEchoes | None]:
        """Receive many pings per segment, whose waveforms are computed once for each group."""
        components, component = np.unique(self.paths.row * N_GROUPS + self.paths.group, return_inverse=True)
        of, group = np.divmod(components, N_GROUPS)
        pulses = Pulses(component, self.pulses.delay, self.pulses.weight)
        wave = waveforms(self.unit, self.geometry.air.temperature_c[of], pulses, self.samples)
        onset = np.full(len(components), np.inf)
        np.minimum.at(onset, component, self.pulses.delay)
        extra = None
        if others:
            air = self.geometry.air.temperature_c[self.segment]
            extra = waveforms(self.unit, air, Pulses.joined(others), self.samples)
        times, true_echoes = [], []
        for number in range(len(self.segments)):
            pings, here = np.flatnonzero(self.segment == number), np.flatnonzero(of == number)
            factor, delay = (part[pings][:, group[here]] for part in self.fluctuation)
            shared_waves, other = SharedWaveforms(wave[here], factor, delay), None if extra is None else extra[pings]
            waves: list[SharedWaveforms | SeparateWaveforms] = (
                [shared_waves] if other is None else [shared_waves, SeparateWaveforms(other)]
            )
            times.append(self._comparator_echoes(waves, pings, rng))
            if truth:
                true_echoes.append(self._truth(shared_waves, group[here], onset[here], other, times[-1][:, 0]))
        return np.concatenate(times), TrueEchoes.joined(true_echoes) if truth else None

    @cached_property
    def _gain(self) -> Floats:
        return amplification(self.unit, self.setup, self.samples)

    def _comparator_echoes(
        self, waves: list[SharedWaveforms | SeparateWaveforms], pings: slice | Ints, rng: np.random.Generator
    ) -> Floats:
        """Return the echo times of some of the pings, s, (k, 17)."""
        noise_rms = self.drawn.noise_rms[self.rows[pings]]
        z, start = voltages(waves, noise_rms, self._gain, self.threshold(pings), rng)
        ping, time = crossings(z, self.unit)
        listening = self.setup.listening / (1.0 + self.unit.clock_error)
        return first_echoes(ping, time + start * PERIOD, len(noise_rms), self.unit, listening)

    def _truth(
        self, shared_waves: SharedWaveforms, group: Ints, onset: Floats, other: Complexes | None, first: Floats
    ) -> TrueEchoes:
        """Return the true echoes of the pings of one segment with first echoes at `first`, s, (k,)."""
        level, count, rows = np.abs(shared_waves.component) * self._gain, len(first), np.arange(len(first))
        begun, loudest = np.full((count, N_GROUPS), np.nan), np.zeros((count, N_GROUPS))
        begun[:, group], loudest[:, group] = onset + shared_waves.delay, level.max(axis=1) * shared_waves.level
        sample = np.clip(np.nan_to_num(first / PERIOD).astype(np.int64), 0, self.samples - 2)
        near = np.zeros((count, N_GROUPS))
        # the crossing lies between two samples
        near[:, group] = np.maximum(level[:, sample], level[:, sample + 1]).T * shared_waves.level
        if other is not None:
            other_level = np.abs(other) * self._gain
            loudest[:, OTHER] = other_level.max(axis=1)
            near[:, OTHER] = np.maximum(other_level[rows, sample], other_level[rows, sample + 1])
        has_cause = ~np.isnan(first) & (near.max(axis=1) >= MIN_CAUSE_LEVEL)
        cause = np.where(has_cause, near.argmax(axis=1), NOISE)
        since = np.nan_to_num(first - begun[rows, cause])
        with np.errstate(divide="ignore"):
            level_db = 20.0 * np.log10(loudest)
        return TrueEchoes(begun, level_db, cause, np.where(has_cause, since / PERIOD, 0.0).astype(np.int64))
