"""The rig: a unit in a laboratory, asked for pings, giving registers or a recording."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from acquisition.bench.acoustics.air import Drift, Floats
from acquisition.bench.acoustics.interference import Ambient
from acquisition.bench.disturbances import others
from acquisition.bench.firmware import ECHOES, smoothed, to_codes
from acquisition.bench.reception import Conditions, Hearing, draw_flutter
from acquisition.bench.registers import Registers, Truth
from acquisition.bench.setup import Setup
from acquisition.bench.unit import DEG, Unit
from acquisition.bench.visits import Visits
from acquisition.bench.wire import Link, faults, present, reset
from acquisition.io.recording import Recording
from acquisition.ping import Ping

Progress = Callable[[int, int], None]


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
        """Draw how this laboratory's air will wander, in standard deviations."""
        return Drift.draw(1.0, self.setup.drift_tau_s, rng)

    def ping(
        self,
        ping: Ping,
        rng: np.random.Generator,
        drift: Drift | None = None,
        progress: Progress | None = None,
        truth: bool = False,
    ) -> Registers:
        """Fire n pings, any n, and return what they left in the registers.

        A simulator that asks for many conditions gets them fastest in one call.

        Args:
            ping: the conditions; consecutive pings of one condition in one run are one visit, for which the reflector
                is placed once. Covariates `temperature_c` and `humidity_pct` replace the setup's.
            rng: all randomness.
            drift: how the air wanders; drawn anew where it is not given.
            progress: called with pings done and pings in all.
            truth: whether to tell what really happened; slower.
        """
        order = np.argsort(ping.run, kind="stable")
        registers = self._ping(ping[order], rng, drift, progress, truth)
        return registers if (np.diff(order) == 1).all() else registers[np.argsort(order)]

    def _ping(
        self, ping: Ping, rng: np.random.Generator, drift: Drift | None, progress: Progress | None, truth: bool
    ) -> Registers:
        """Fire pings that stand run by run."""
        down, lost = reset(self.setup.bus, ping, rng)
        conditions = self._conditions(ping, self.draw_drift(rng) if drift is None else drift, lost, rng)
        time, told = self._heard(conditions, lost, rng, progress, truth)
        time = time + (self.unit.cold_s * np.exp(-ping.time / self.unit.warm_up_tau_s))[:, None]
        code = to_codes(time, self.unit, self.setup.output)
        if self.unit.averaging > 1 or self.unit.deadband > 0.0:
            code = smoothed(code, ping.run, self.unit, self.setup.output)
        code[down] = 0
        code, fault = _through_wire(code, ping, self.setup, rng)
        answered = (fault != Link.NACK) & (fault != Link.ALL_ONES)
        fault = np.where(down & (fault == Link.FINE), np.uint8(Link.RESET), fault)
        return Registers(code, answered, conditions.temperature_c, fault, conditions.humidity_pct, told)

    def _conditions(self, ping: Ping, drift: Drift, lost: NDArray[np.bool_], rng: np.random.Generator) -> Conditions:
        """Draw what n pings face; `lost` tells which find the registers as a reset left them."""
        setup, wander = self.setup, drift(ping.time)
        temperature = ping.covariates.get("temperature_c", setup.temperature_c) + setup.drift_c * wander
        humidity = ping.covariates.get("humidity_pct", setup.humidity_pct) + setup.humidity_drift_pct * wander
        humidity = np.clip(humidity, 0.0, 100.0)
        hiss = self.unit.noise * _loudness_of_noise(setup.ambient, ping, rng)
        visits = Visits.of(ping, temperature, humidity, lost)
        placed = self.place(ping[visits.first], rng, visits.visit[visits.first])
        moved = draw_flutter(ping, visits, setup.flutter_tau_s, rng)
        return Conditions(ping, temperature, humidity, hiss, visits, placed, moved)

    def _heard(
        self,
        all_: Conditions,
        lost: NDArray[np.bool_],
        rng: np.random.Generator,
        progress: Progress | None,
        truth: bool,
    ) -> tuple[Floats, Truth | None]:
        """Return the echo times of all pings, s, (n, 17), and what really happened where that is asked."""
        order, times, told = [np.empty(0, dtype=np.int64)], [np.empty((0, ECHOES))], []
        for which, setup in ((~lost, self.setup), (lost, self.setup.after_reset())):
            for rows, takes in all_.visits.batches(which):
                batch = Hearing(self.unit, setup, all_, rows, takes)
                heard, happened = batch.hear(others(batch, rng), rng, truth)
                order, times = [*order, rows], [*times, heard]
                told += [] if happened is None else [happened]
                if progress is not None:
                    progress(sum(map(len, order)), len(lost))
        back = np.argsort(np.concatenate(order))
        return np.concatenate(times)[back], Truth.joined(told)[back] if told else None

    def record(self, ping: Ping, rng: np.random.Generator, progress: Progress | None = None) -> Recording:
        """Fire n pings and return them as a recording, with what was logged beside them."""
        registers = self.ping(ping, rng, progress=progress)
        return Recording.of(ping, registers.reading(self.setup), name="rig", **self.columns(ping, registers))

    def columns(self, ping: Ping, registers: Registers) -> dict[str, Floats]:
        """Return the covariates that a laboratory logs: air to 0.1 degC and 1 %, settings of the sensor."""
        n = len(ping)
        return {
            "temperature_c": registers.temperature_c.round(1),
            "humidity_pct": ping.covariates.get("humidity_pct", np.full(n, self.setup.humidity_pct)),
            "gain": np.full(n, float(self.setup.gain)),
            "range_mm": np.full(n, 43.0 * (self.setup.range_register + 1)),
        }

    def place(self, ping: Ping, rng: np.random.Generator, visit: NDArray[np.int64] | None = None) -> Ping:
        """Return where the reflectors of n pings really stand; covariate `tilt_back` is their lean, rad.

        Args:
            ping: where they are meant to stand.
            rng: the scatter.
            visit: number of each ping's visit, whose scatter its pings share; each ping is one where it is not given.
        """
        setup = self.setup
        visit = np.arange(len(ping)) if visit is None else visit
        scatter = rng.standard_normal((int(visit.max(initial=-1)) + 1, 4))
        along, aside, turn, tilt = scatter[visit].T
        distance = ping.distance + setup.zero_m + setup.placement_m * along
        bearing = ping.angle + setup.placement_deg * DEG * aside
        facing = bearing - ping.incidence - setup.tilt_deg * DEG * turn
        centre = (distance + setup.pivot_m) * np.exp(1j * bearing) - setup.pivot_m * np.exp(1j * facing)
        lean = ping.covariates.get("tilt_back", np.zeros(len(ping))) + setup.tilt_deg * DEG * tilt
        return replace(
            ping,
            distance=np.maximum(np.abs(centre), 0.005),
            angle=np.angle(centre),
            incidence=np.angle(centre) - facing,
            covariates={**ping.covariates, "tilt_back": lean},
        )


def _loudness_of_noise(ambient: Ambient | None, ping: Ping, rng: np.random.Generator) -> Floats:
    """Return the factor on the receiver's noise in each ping, (n,)."""
    if ambient is None:
        return np.ones(len(ping))
    return np.where(present(ambient.share, ambient.dwell_s, ping, rng), ambient.factor, 1.0)


def _through_wire(
    code: NDArray[np.uint16], ping: Ping, setup: Setup, rng: np.random.Generator
) -> tuple[NDArray[np.uint16], NDArray[np.uint8]]:
    """Return what a host gets of the codes of pings that stand run by run, and what the wire did to each."""
    fault = faults(setup.bus, ping, rng)
    code = np.where((fault == Link.DROPPED)[:, None], 0, code).astype(np.uint16)
    flipped = np.flatnonzero(fault == Link.BIT_FLIP)
    code[flipped, 0] ^= np.left_shift(1, rng.integers(0, 16, len(flipped))).astype(np.uint16)
    lost = fault == Link.LOST_WRITE
    source = np.maximum.accumulate(np.where(lost, -1, np.arange(len(ping))))
    return code[source], fault
