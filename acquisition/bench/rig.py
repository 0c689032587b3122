"""The rig: a unit in a laboratory, asked for pings, giving registers or a recording."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from acquisition.bench.air import Drift, Floats, absorption_db, flutter, sound_speed
from acquisition.bench.firmware import averaged, first_echoes, to_codes
from acquisition.bench.interference import GHOST_S, Ambient, intervals, shifted
from acquisition.bench.receiver import Air, Sent, Waveform, crossings, loudness, voltages
from acquisition.bench.registers import Registers
from acquisition.bench.scene import BOUNCE, FACE, GROUPS, LEAK, POST, Arrivals, Pose, Scene
from acquisition.bench.setup import Setup
from acquisition.bench.transducer import OMEGA, PERIOD, Complexes, Piston, pulse_phases
from acquisition.bench.unit import DEG, Unit
from acquisition.bench.wire import Link, faults, present
from acquisition.ping import Ping
from acquisition.recording import Recording

BATCH = 256  # pings worked on at once: about 6 MB of waveforms
VISIT_C = 0.4  # degC; pings of a visit whose air differs more get waveforms of their own
# how far each group's way changes with the stand's swing, against the way to the reflector
SWAYING = np.array([{FACE: 1.0, BOUNCE: 2.0, POST: 1.0}.get(group, 0.0) for group in range(len(GROUPS))])
Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class Moment:
    """What differs between pings of one visit.

    Attributes:
        temperature_c: of the air, degC, (n,).
        flutter: level and delay of each group, unit variance, (n, groups, 2).
        noise: factor on the receiver's noise, (n,).
        interval: since the ping before it, s, (n,); infinite for the first of a run.
        before: what faced the ping before the visit, and its air; None where it is too long ago to matter.
    """

    temperature_c: Floats
    flutter: Floats
    noise: Floats
    interval: Floats
    before: tuple[Ping, Air] | None

    def after(self) -> NDArray[np.bool_]:
        """Tell which pings begin while the one before may still be under way, (n,)."""
        return self.interval < GHOST_S


@dataclass(frozen=True)
class Rig:
    """A sonar on a stand in front of a reflector on another, to the level of the waveform.

    >>> import numpy as np
    >>> rig = Rig(Unit.nominal(), Setup(gain=31, output="us", placement_m=0.0))
    >>> heard = rig.ping(Ping.of(distance=1.0, reflectance=0.9), np.random.default_rng(0))
    >>> bool(5_700 < heard.code[0, 0] < 5_900)
    True
    """

    unit: Unit = field(default_factory=Unit.nominal)
    setup: Setup = field(default_factory=Setup)

    def draw_drift(self, rng: np.random.Generator) -> Drift:
        """Draw how this laboratory's temperature will wander."""
        return Drift.draw(self.setup.drift_c, self.setup.drift_tau_s, rng)

    def ping(
        self, ping: Ping, rng: np.random.Generator, drift: Drift | None = None, progress: Progress | None = None
    ) -> Registers:
        """Fire n pings, any n, and return what they left in the registers.

        Args:
            ping: the conditions; consecutive pings of one condition in one run are one visit, for which the reflector
                is placed once. Covariates `temperature_c` and `humidity_pct` replace the setup's.
            rng: all randomness.
            drift: how the temperature wanders; drawn anew where it is not given.
            progress: called with pings done and pings in all.
        """
        drift = self.draw_drift(rng) if drift is None else drift
        temperature = ping.covariates.get("temperature_c", self.setup.temperature_c) + drift(ping.time)
        noise = _loudness_of_noise(self.setup.ambient, ping, rng)
        interval = intervals(ping)
        code = np.zeros((len(ping), 17), dtype=np.uint16)
        before = None
        for start, stop in _visits(ping):
            placed = self.place(ping[start : start + 1], rng)
            moved = _flutter(self.setup, ping.time[start:stop], rng)
            for rows in _alike(temperature[start:stop], start):
                first = before if rows[0] == start else None
                moment = Moment(temperature[rows], moved[rows - start], noise[rows], interval[rows], first)
                times = self._listen(placed, ping[rows], moment, rng) + self._cold(ping.time[rows])[:, None]
                code[rows] = to_codes(times, self.unit, self.setup.output)
            before = placed, self._air(float(temperature[stop - 1]), ping[stop - 1 : stop])
            if progress is not None:
                progress(stop, len(ping))
        if self.unit.averaging > 1:
            code = averaged(code, ping.run, self.unit.averaging)
        return _through_wire(code, ping, temperature, self.setup, rng)

    def record(self, ping: Ping, rng: np.random.Generator, progress: Progress | None = None) -> Recording:
        """Fire n pings and return them as a recording, with what was logged beside them."""
        registers = self.ping(ping, rng, progress=progress)
        return Recording.of(ping, registers.reading(self.setup), name="rig", **self.columns(ping, registers))

    def columns(self, ping: Ping, registers: Registers) -> dict[str, Floats]:
        """Return the covariates that a laboratory logs: air to 0.1, settings of the sensor."""
        n = len(ping)
        return {
            "temperature_c": registers.temperature_c.round(1),
            "humidity_pct": ping.covariates.get("humidity_pct", np.full(n, self.setup.humidity_pct)),
            "gain": np.full(n, float(self.setup.gain)),
            "range_mm": np.full(n, 43.0 * (self.setup.range_register + 1)),
        }

    def place(self, ping: Ping, rng: np.random.Generator) -> Ping:
        """Return where the reflector of a single ping really stands; covariate `tilt_back` is its lean, rad."""
        setup = self.setup
        along, aside, turn, tilt = rng.standard_normal(4)
        distance = ping.distance + setup.zero_m + setup.placement_m * along
        bearing = ping.angle + setup.placement_deg * DEG * aside
        facing = bearing - ping.incidence - setup.tilt_deg * DEG * turn
        centre = (distance + setup.pivot_m) * np.exp(1j * bearing) - setup.pivot_m * np.exp(1j * facing)
        return replace(
            ping,
            distance=np.maximum(np.abs(centre), 0.005),
            angle=np.angle(centre),
            incidence=np.angle(centre) - facing,
            covariates={**ping.covariates, "tilt_back": _lean(ping) + setup.tilt_deg * DEG * tilt},
        )

    def _listen(self, placed: Ping, ping: Ping, moment: Moment, rng: np.random.Generator) -> Floats:
        """Return the echo times of pings that share one placement and nearly one air, s, (n, 17)."""
        air = self._air(float(moment.temperature_c.mean()), ping)
        found = self.scene(placed, air.speed).groups()
        waves = [Waveform.of(self.unit, way, air, self._samples) for way in found.values()]
        groups, length = np.array(list(found)), np.array([wave.length for wave in waves])
        speed = sound_speed(moment.temperature_c, self._humidity(ping))
        late = self._late(length, speed, air.speed, moment.flutter[:, groups, 1])
        late += 2.0 * self._sway(ping.time)[:, None] * SWAYING[groups] / air.speed
        level = self.setup.scintillation_db * (length / 6.0) ** (11.0 / 12.0) * moment.flutter[:, groups, 0]
        factor = (10.0 ** (level / 20.0)).astype(np.complex128)
        factor[:, groups == LEAK], late[:, groups == LEAK] = 1.0, 0.0
        ghosts = self._ghosts(placed, air, moment)
        out = []
        for rows in (slice(k, k + BATCH) for k in range(0, len(ping), BATCH)):
            other = self._neighbour(ping.time[rows], air) + shifted(ghosts[rows], moment.interval[rows], self._samples)
            out.append(self._hear(waves, Sent(factor[rows], late[rows], moment.noise[rows], other), rng))
        return np.concatenate(out)

    @property
    def _samples(self) -> int:
        return int(np.ceil(self.setup.listening / PERIOD)) + 2

    def _ghosts(self, placed: Ping, air: Air, moment: Moment) -> list[Complexes | None]:
        """Return for each ping the waveform of the ping before it, where that may still be under way."""
        after = moment.after()
        if not after.any():
            return [None] * len(after)
        own = self._whole(placed, air)
        ghosts = [own if is_after else None for is_after in after]
        if moment.before is not None and after[0]:
            ghosts[0] = self._whole(*moment.before)
        return ghosts

    def _whole(self, placed: Ping, air: Air) -> Complexes:
        """Return the waveform of one ping for as long as it may disturb the next."""
        groups = self.scene(placed, air.speed).groups()
        ways = sum((way for name, way in groups.items() if name not in (LEAK, BOUNCE)), Arrivals.of())
        return Waveform.of(self.unit, ways, air, self._samples + round(GHOST_S / PERIOD) + 2).signal

    def _cold(self, time: Floats) -> Floats:
        return self.unit.cold_s * np.exp(-time / self.unit.warm_up_tau_s)

    def _late(self, length: Floats, speed: Floats, reference: float, moved: Floats) -> Floats:
        """Return by how much eddies and drift delay each group in each ping, s, (n, groups)."""
        drift = 2.0 * length * (1.0 / speed - 1.0 / reference)[:, None]
        return drift + 2.0 * self.setup.jitter_m * np.sqrt(length / 6.0) * moved / reference

    def _sway(self, time: Floats) -> Floats:
        return self.setup.sway_m * np.sin(2.0 * np.pi * time / self.setup.sway_period_s)

    def _neighbour(self, time: Floats, air: Air) -> Complexes:
        """Return what another sonar sends into pings at given times, (n, samples), or (1, samples) of nothing."""
        other = self.setup.neighbour
        if other is None:
            return np.zeros((1, self._samples), dtype=np.complex128)
        beam = Piston(OMEGA * self.unit.radius / air.speed)(np.array(other.bearing_deg * DEG))
        loss_db = other.strength_db - air.absorption_db * other.path_m
        level = loudness(self.unit) * float(beam) * 10.0 ** (loss_db / 20.0) / other.path_m
        phases = pulse_phases(self.unit, round(air.temperature_c))
        return other.waveforms(time, air.speed, level, phases, self._samples)

    def _hear(self, waves: list[Waveform], sent: Sent, rng: np.random.Generator) -> Floats:
        z, start = voltages(waves, sent, self.unit, self.setup, rng)
        ping, time = crossings(z, self.unit)
        listening = self.setup.listening / (1.0 + self.unit.clock_error)
        return first_echoes(ping, time + start * PERIOD, len(z), self.unit, listening)

    def _humidity(self, ping: Ping) -> float:
        given = ping.covariates.get("humidity_pct")
        return self.setup.humidity_pct if given is None else float(given[0])

    def _air(self, temperature: float, ping: Ping) -> Air:
        humidity = self._humidity(ping)
        return Air(temperature, float(sound_speed(temperature, humidity)), float(absorption_db(temperature, humidity)))

    def scene(self, ping: Ping, speed: float) -> Scene:
        """Return the geometry of one ping, as it is placed."""
        pose = Pose(float(ping.distance[0]), float(ping.angle[0]), float(ping.incidence[0]), float(_lean(ping)[0]))
        return Scene(self.unit, self.setup, pose, float(ping.reflectance[0]), speed)


def _lean(ping: Ping) -> Floats:
    return ping.covariates.get("tilt_back", np.zeros(len(ping)))


def _visits(ping: Ping) -> list[tuple[int, int]]:
    """Return first and last-plus-one of each stretch of pings of one condition in one run."""
    humidity = ping.covariates.get("humidity_pct", np.zeros(len(ping)))
    table = np.stack([ping.distance, ping.angle, ping.incidence, ping.reflectance, ping.run, humidity])
    new = np.flatnonzero((table[:, 1:] != table[:, :-1]).any(axis=0)) + 1
    edges = [0, *new.tolist(), len(ping)]
    return list(pairwise(edges)) if len(ping) else []


def _alike(temperature: Floats, start: int) -> list[NDArray[np.int64]]:
    """Return the pings of a visit in groups of nearly one temperature."""
    step = np.rint((temperature - temperature.mean()) / VISIT_C)
    return [start + np.flatnonzero(step == value) for value in np.unique(step)]


def _flutter(setup: Setup, time: Floats, rng: np.random.Generator) -> Floats:
    """Draw level and delay of each group in each ping, unit variance, (n, groups, 2)."""
    return flutter(time, setup.flutter_tau_s, 2 * len(GROUPS), rng).reshape(len(time), len(GROUPS), 2)


def _loudness_of_noise(ambient: Ambient | None, ping: Ping, rng: np.random.Generator) -> Floats:
    """Return the factor on the receiver's noise in each ping, (n,)."""
    if ambient is None:
        return np.ones(len(ping))
    return np.where(present(ambient.share, ambient.dwell_s, ping, rng), ambient.factor, 1.0)


def _through_wire(
    code: NDArray[np.uint16], ping: Ping, temperature: Floats, setup: Setup, rng: np.random.Generator
) -> Registers:
    fault = faults(setup.bus, ping, rng)
    answered = (fault != Link.NACK) & (fault != Link.ALL_ONES)
    code = np.where((fault == Link.DROPPED)[:, None], 0, code).astype(np.uint16)
    flipped = np.flatnonzero(fault == Link.BIT_FLIP)
    code[flipped, 0] ^= np.left_shift(1, rng.integers(0, 16, len(flipped))).astype(np.uint16)
    lost = fault == Link.LOST_WRITE
    source = np.maximum.accumulate(np.where(lost, -1, np.arange(len(ping))))
    return Registers(code[source], answered, temperature, fault)
