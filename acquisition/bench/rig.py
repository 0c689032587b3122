"""Rig: a simulated sensor in a laboratory, which returns registers or a recording for given pings."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from acquisition.arguments import checked
from acquisition.arrays import Ints
from acquisition.bench.disturbances import disturbances
from acquisition.bench.firmware import ECHOES, smoothed, to_codes
from acquisition.bench.laboratory.air import Drift, Floats
from acquisition.bench.laboratory.interference import Ambient
from acquisition.bench.laboratory.setup import RANGE_STEP_MM, Setup, check_register
from acquisition.bench.laboratory.unit import DEG, Unit
from acquisition.bench.reception import DrawnPings, Reception, draw_flutter
from acquisition.bench.registers import Registers, TrueEchoes
from acquisition.bench.visits import TILT, Visits
from acquisition.bench.wire import Link, draw_faults, draw_resets, two_state
from acquisition.brief import brief
from acquisition.io.recording import Recording
from acquisition.ping import RANGE_RATE, TEMPERATURE, Ping

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class Rig:
    """Waveform-level simulation of a sonar in front of a reflector on a stand.

    >>> import numpy as np
    >>> rig = Rig(Unit.nominal(), Setup(gain=31, output="us", placement_m=0.0))
    >>> registers = rig.ping(Ping.of(distance=1.0, reflectance=0.9), np.random.default_rng(0))
    >>> bool(5_700 < registers.code[0, 0] < 5_900)
    True
    """

    __repr__ = brief

    unit: Unit = field(default_factory=Unit.nominal)
    setup: Setup = field(default_factory=Setup)

    def draw_drift(self, rng: np.random.Generator) -> Drift:
        """Draw the slow drift of the laboratory's air, in standard deviations."""
        return Drift.draw(1.0, self.setup.drift_tau_s, rng)

    @checked
    def ping(
        self,
        ping: Ping,
        rng: np.random.Generator,
        drift: Drift | None = None,
        progress: Progress | None = None,
        truth: bool = False,
    ) -> Registers:
        """Fire n pings and return the contents of the registers.

        One call with many conditions is faster than many calls.

        Args:
            ping: the conditions; consecutive pings of one condition in one run are one visit, with one placement of the
                reflector. Covariates `temperature_c`, `humidity_pct`, `gain` and `range_mm` override the setup's;
                `range_rate_mps` is the speed of reflector and stand away from the sensor.
            rng: source of all randomness.
            drift: drift of the air; None draws one.
            progress: called with the number of pings done and the total.
            truth: whether to return the true echoes as well; slower.
        """
        order = np.argsort(ping.run, kind="stable")
        registers = self._ping(ping[order], rng, drift, progress, truth)
        return registers if (np.diff(order) == 1).all() else registers[np.argsort(order)]

    def _ping(
        self, ping: Ping, rng: np.random.Generator, drift: Drift | None, progress: Progress | None, truth: bool
    ) -> Registers:
        """Fire pings whose runs are contiguous."""
        ping = self._completed(ping)
        down, lost = draw_resets(self.setup.bus, ping, rng)
        setting, setups = self._settings(ping, lost)
        drawn = self._draw(ping, self.draw_drift(rng) if drift is None else drift, setting, rng)
        time, true_echoes = self._echo_times(drawn, setting, setups, rng, progress, truth)
        time = time + (self.unit.cold_s * np.exp(-ping.time / self.unit.warm_up_tau_s))[:, None]
        code = to_codes(time, self.unit, self.setup.output, drawn.temperature_c)
        if self.unit.averaging > 1 or self.unit.deadband > 0.0:
            code = smoothed(code, ping.run, self.unit, self.setup.output)
        code[down] = 0
        code, fault = _through_wire(code, ping, self.setup, rng)
        answered = (fault != Link.NACK) & (fault != Link.ALL_ONES)
        fault = np.where(down & (fault == Link.OK), np.uint8(Link.RESET), fault)
        return Registers(code, answered, drawn.temperature_c, fault, drawn.humidity_pct, true_echoes)

    def _settings(self, ping: Ping, lost: NDArray[np.bool_]) -> tuple[Ints, list[Setup]]:
        """Return the number of each ping's register setting, (n,), and the laboratory with each setting.

        Args:
            ping: the conditions, (n,).
            lost: whether a reset has changed the registers, (n,).
        """
        reset, logged = self.setup.after_reset(), ping.covariates
        gain = np.where(lost, reset.gain, logged["gain"])
        code = np.where(lost, reset.range_register, np.rint(logged["range_mm"] / RANGE_STEP_MM) - 1.0)
        distinct, setting = np.unique(np.column_stack([gain, code]), axis=0, return_inverse=True)
        for own in distinct:
            check_register("Ping.gain", own[0], 31)
            check_register("register of Ping.range_mm", own[1], 255)
        setups = [replace(self.setup, gain=int(own[0]), range_register=int(own[1])) for own in distinct]
        return setting.reshape(-1), setups

    def _completed(self, ping: Ping) -> Ping:
        """Return pings with all covariates that the rig uses: as given, or those of the setup."""
        setup, given = self.setup, ping.covariates
        own = {TEMPERATURE: setup.temperature_c, "humidity_pct": setup.humidity_pct, TILT: 0.0, RANGE_RATE: 0.0}
        own |= {"gain": float(setup.gain), "range_mm": RANGE_STEP_MM * (setup.range_register + 1)}
        known = {name: given.get(name, np.full(len(ping), np.nan)) for name in own}
        known = {name: np.where(np.isnan(value), own[name], value) for name, value in known.items()}
        return replace(ping, covariates={**given, **known})

    def _draw(self, ping: Ping, drift: Drift, setting: Ints, rng: np.random.Generator) -> DrawnPings:
        """Draw all random quantities of n pings; `setting` is the number of each ping's register setting."""
        setup, deviation = self.setup, drift(ping.time)
        temperature = ping.covariates[TEMPERATURE] + setup.drift_c * deviation
        humidity = np.clip(ping.covariates["humidity_pct"] + setup.humidity_drift_pct * deviation, 0.0, 100.0)
        noise_rms = self.unit.noise * _noise_factor(setup.ambient, ping, rng)
        visits = Visits.of(ping, temperature, humidity, setting)
        placed = self.place(ping[visits.first], rng, visits.visit[visits.first])
        fluctuation = draw_flutter(ping, visits, setup.flutter_tau_s, rng)
        return DrawnPings(ping, temperature, humidity, noise_rms, visits, placed, fluctuation)

    def _echo_times(
        self,
        drawn: DrawnPings,
        setting: Ints,
        setups: list[Setup],
        rng: np.random.Generator,
        progress: Progress | None,
        truth: bool,
    ) -> tuple[Floats, TrueEchoes | None]:
        """Return the echo times of all pings, s, (n, 17), and the true echoes if requested."""
        order, times, true_echoes = [np.empty(0, dtype=np.int64)], [np.empty((0, ECHOES))], []
        for number, setup in enumerate(setups):
            for rows, segments in drawn.visits.batches(setting == number):
                batch = Reception(self.unit, setup, drawn, rows, segments)
                batch_times, batch_truth = batch.receive(disturbances(batch, rng), rng, truth)
                order, times = [*order, rows], [*times, batch_times]
                true_echoes += [] if batch_truth is None else [batch_truth]
                if progress is not None:
                    progress(sum(map(len, order)), len(setting))
        original = np.argsort(np.concatenate(order))
        return np.concatenate(times)[original], TrueEchoes.joined(true_echoes)[original] if true_echoes else None

    def record(self, ping: Ping, rng: np.random.Generator, progress: Progress | None = None) -> Recording:
        """Fire n pings and return them as a recording with the logged covariates."""
        registers = self.ping(ping, rng, progress=progress)
        return Recording.of(ping, registers.reading(self.setup), name="rig", **self.columns(ping, registers))

    def columns(self, ping: Ping, registers: Registers) -> dict[str, Floats]:
        """Return the logged covariates: temperature to 0.1 degC, humidity, gain and range gate."""
        known = self._completed(ping).covariates
        own = {name: known[name] for name in ("humidity_pct", "gain", "range_mm")}
        return {TEMPERATURE: registers.temperature_c.round(1), **own}

    def place(self, ping: Ping, rng: np.random.Generator, visit: NDArray[np.int64] | None = None) -> Ping:
        """Return the actual poses of the reflectors of n pings.

        Their covariate `tilt_back` is the tilt of the top towards the sensor, rad.

        Args:
            ping: nominal poses.
            rng: source of the placement errors.
            visit: visit of each ping, whose pings share one error; None makes each ping a visit.
        """
        setup = self.setup
        visit = np.arange(len(ping)) if visit is None else visit
        scatter = rng.standard_normal((int(visit.max(initial=-1)) + 1, 4))
        along, aside, turn, tilt = scatter[visit].T
        distance = ping.distance + setup.zero_m + setup.placement_m * along
        bearing = ping.angle + setup.placement_deg * DEG * aside
        facing = bearing - ping.incidence - setup.tilt_deg * DEG * turn
        centre = (distance + setup.pivot_m) * np.exp(1j * bearing) - setup.pivot_m * np.exp(1j * facing)
        lean = ping.covariates.get(TILT, np.zeros(len(ping))) + setup.tilt_deg * DEG * tilt
        return replace(
            ping,
            distance=np.maximum(np.abs(centre), 0.005),
            angle=np.angle(centre),
            incidence=np.angle(centre) - facing,
            covariates={**ping.covariates, TILT: lean},
        )


def _noise_factor(ambient: Ambient | None, ping: Ping, rng: np.random.Generator) -> Floats:
    """Return the factor on the receiver's noise in each ping, (n,)."""
    if ambient is None:
        return np.ones(len(ping))
    return np.where(two_state(ambient.share, ambient.dwell_s, ping, rng), ambient.factor, 1.0)


def _through_wire(
    code: NDArray[np.uint16], ping: Ping, setup: Setup, rng: np.random.Generator
) -> tuple[NDArray[np.uint16], NDArray[np.uint8]]:
    """Return the codes that the host reads and the bus fault of each ping; runs must be contiguous.

    After a lost write the registers hold the previous ping, whatever became of that one on its way to the host.
    """
    fault = draw_faults(setup.bus, ping, rng)
    lost = fault == Link.LOST_WRITE
    held = code[np.maximum.accumulate(np.where(lost, -1, np.arange(len(ping))))]
    read = np.where((fault == Link.DROPPED)[:, None], 0, held).astype(np.uint16)
    flipped = np.flatnonzero(fault == Link.BIT_FLIP)
    read[flipped, 0] ^= np.left_shift(1, rng.integers(0, 16, len(flipped))).astype(np.uint16)
    return read, fault
