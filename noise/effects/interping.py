"""Inter-ping effects: sound of an earlier ping or of another sonar that is taken for the echo."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from scipy.fft import next_fast_len, rfft
from torch import Tensor

from acquisition import EchoStatus
from acquisition.arrays import Floats
from acquisition.ping import RANGE_RATE
from noise.effects.base import EchoSample, Effect, Parameter, Stage, modes, most_frequent
from noise.effects.medium import ASSUMED_SPEED
from noise.effects.state import LAG_STEP_S, LAGS_S, State, heard_level_db, new_path
from noise.effects.target import presence

INTERVAL = "interval_s"  # covariate: time since the previous ping of the run, s; 0 for the first ping
FARTHEST_M = 25.0  # half the path of the latest echo: 11.2 m within 65 ms, and what is read; chosen here
DEFAULT_INTERVAL_S = 0.065  # where no times are logged; recommended by Devantech
# offset, scale and walk of a sonar move readings by some centimetres, while single pings scatter by some millimetres
OWN_ERRORS_M = (0.0, -0.01, 0.01, -0.02, 0.02, -0.03, 0.03)


class PreviousPing(Effect):
    """The echo of the previous ping from farther away arrives during this ping: range far - c interval / 2.

    Far is `trips` times the distance of the target when that ping was fired, and `far_m`: another reflector with 0, the
    target itself or what stands behind it with 1, a further round trip to the target with 2 or 3. Within a burst, each
    ping is fired a fixed wait after the last echo, so that the reading is far - last reading - `wait_m`: each depends
    on the last. With `wait_m` = 0 the logged interval is used.
    """

    name = "previous_ping"
    stage = Stage.PATHS
    localised = True
    remembers = True
    summary = "A far echo of the previous ping is read as a near echo of the current ping"
    parameters = (
        presence(0.3),
        Parameter(
            "far_m", "m", 0.0, 0.0, FARTHEST_M, "c interval / 2 = 11.2 m at 65 ms, plus what is read", (9.0, 12.0, 15.0)
        ),
        Parameter("trips", "1", 0.0, 0.0, 3.0, "to the target; chosen here", (0.0,)),
        Parameter("wait_m", "m", 0.0, 0.0, 3.5, "bursts with waits of 2 to 20 ms as range; chosen here", (0.0,)),
    )
    presence: Tensor
    far_m: Tensor
    trips: Tensor
    wait_m: Tensor

    def apply(self, state: State) -> State:
        """Add the late echo; the time since the last ping is a lag, so that it does not depend on the temperature."""
        length = self.far_m + self.trips * self._distance_before(state)
        early, possible = self._since_last(state)
        possible = possible & (early < length)
        path = new_path("previous", length, heard_level_db(length), self.presence * possible.to(torch.float64))
        return state.with_path(replace(path, lag=-early))

    def _distance_before(self, state: State) -> Tensor:
        """Return the distance of the target when the previous ping was fired, m, (n,)."""
        c = state.conditions
        interval, rate = (c.covariates.get(name) for name in (INTERVAL, RANGE_RATE))
        return c.distance if interval is None or rate is None else torch.clamp(c.distance - rate * interval, min=0.0)

    def _since_last(self, state: State) -> tuple[Tensor, Tensor]:
        """Return the time since the last ping as range, m, and whether there was one, (n,) each."""
        c = state.conditions
        interval = c.covariates.get(INTERVAL)
        if interval is None:
            interval = torch.full_like(c.distance, DEFAULT_INTERVAL_S)
        waits, gap = self.wait_m > 0.0, ASSUMED_SPEED * interval / 2.0
        since = torch.where(waits, c.past_range + self.wait_m, gap)
        # the first ping of a burst has none: what is farther away than this is not heard
        fast = (c.past_status == EchoStatus.ECHO) & (gap < FARTHEST_M)
        return since, torch.where(waits, fast, interval > 0)

    @classmethod
    def guesses(cls, echoes: EchoSample) -> list[dict[str, float]]:
        """Return what explains most early readings: the second trip within bursts, or what is far or behind.

        Lengths read off readings have the sonar's own errors, so that others near them are tried too.
        """
        early, found = echoes.early, []
        if early.past is not None and (wait := most_frequent(2.0 * early.distance - early.range - early.past)) > 0.0:
            found += [{"far_m": 0.0, "trips": 2.0, "wait_m": max(wait + each, 0.0)} for each in OWN_ERRORS_M]
        if early.interval is not None and (early.interval > 0.0).any():
            length = early.range + np.where(early.interval > 0.0, ASSUMED_SPEED * early.interval / 2.0, np.nan)
            before = early.distance if early.before is None else early.before
            for trips, far_m in ((0.0, most_frequent(length)), (1.0, most_frequent(length - before))):
                found += [{"far_m": max(far_m + each, 0.0), "trips": trips, "wait_m": 0.0} for each in OWN_ERRORS_M]
        return [{"presence": 0.5, **guess} for guess in found]

    def statement(self) -> str:
        """Return a sentence with the distance of the far reflector."""
        v = self.values
        sources = f"a reflector at {v['far_m']:.2f} m", f"what is {v['far_m']:.2f} m behind the target"
        source = (*sources, "the target's second echo", "the target's third echo")[round(v["trips"])]
        read = f"is read as a near echo of the current ping, in {100 * v['presence']:.3g} % of pings"
        return f"A far echo of the previous ping, from {source}, {read}."


class Latency(Effect):
    """The reading is that of the logged pose a delay ago.

    That pose is interpolated in the log of the run. Where the log does not tell it, or the reading is newer than its
    pose, distance -> distance - delay * range rate; the range rate, m/s, is the change of the logged distance with time
    within a run. Without it there is no effect.
    """

    name = "latency"
    stage = Stage.CONDITION
    needs_time = True
    summary = "Readings lag behind the logged position of a moving sensor"
    parameters = (
        Parameter(
            "delay_s",
            "s",
            0.0,
            -1.0,
            1.0,
            "ranging 65 ms plus host loops; pose filters: chosen here",
            (0.1, 0.3),
            RANGE_RATE,
            0.05,
            typical=0.2,
            adds=True,
        ),
    )
    delay_s: Tensor

    def apply(self, state: State) -> State:
        """Move the reflector to where it was when the ping was fired."""
        rate = state.conditions.covariates.get(RANGE_RATE)
        if rate is None:
            return state
        c, moved = state.conditions, -self.delay_s * rate
        if c.earlier is None:
            return state.facing(replace(c, distance=torch.clamp(c.distance + moved, min=0.0)))
        weight = torch.clamp(1.0 - torch.abs(self.delay_s - torch.from_numpy(LAGS_S)) / LAG_STEP_S, min=0.0)
        back = (weight[:, None] * c.earlier).sum(dim=1) - c.earlier[:, 0]
        late = self.delay_s > 0.0
        distance = torch.clamp(c.distance + torch.where(late, back[0], moved), min=0.0)
        turned = [value + torch.where(late, each, 0.0) for value, each in ((c.angle, back[1]), (c.incidence, back[2]))]
        return state.facing(replace(c, distance=distance, angle=turned[0], incidence=turned[1]))

    def statement(self) -> str:
        """Return a sentence with the delay and the error at 0.5 m/s."""
        delay = self.values["delay_s"]
        sense = "lag behind" if delay >= 0 else "run ahead of"
        error = f"{500 * abs(delay):.0f} mm of error at 0.5 m/s"
        return f"Readings {sense} the logged position by {abs(delay):.2g} s: {error}."


class SynchronousCrosstalk(Effect):
    """Another sonar fires at the same time: its sound travels `other_m` to the reflector and d to this sensor."""

    name = "synchronous_crosstalk"
    stage = Stage.PATHS
    localised = True
    summary = "The echo of another sonar's ping is read, at the mean of both distances"
    parameters = (
        presence(0.3),
        Parameter("other_m", "m", 1.0, 0.05, 11.0, "(d1 + d2) / 2, Devantech FAQ on several sonars", (0.3, 1.0, 3.0)),
    )
    presence: Tensor
    other_m: Tensor

    def apply(self, state: State) -> State:
        """Add the path from the other sonar."""
        length = 0.5 * (state.conditions.distance + self.other_m)
        path = new_path("other sonar", length, heard_level_db(length), self.presence, state.conditions.angle)
        return state.with_path(path)

    @classmethod
    def guesses(cls, echoes: EchoSample) -> list[dict[str, float]]:
        """Return the distances of the other sonar that explain most readings away from the target, and how frequent."""
        off = echoes.off_target
        groups = modes(2.0 * off.range - off.distance)
        return [{"presence": len(g) / len(echoes.range), "other_m": float(np.median(g))} for g in groups]

    def statement(self) -> str:
        """Return a sentence with the distance of the other sonar."""
        v = self.values
        share = f"{100 * v['presence']:.3g} % of pings"
        return f"The echo of another sonar's ping, {v['other_m']:.2f} m from the reflector, is read in {share}."


TICK_S = 1e-3  # resolution at which times of pings are analysed
MAX_TICKS = 1 << 21
MARGIN_NATS = 5.0  # margin over the best fit of a clock by chance: 99 %
MIN_HZ, MAX_HZ = 0.5, 40.0  # of another sonar; chosen here
MIN_VARIANCE = 0.01  # of the phases of firing and delay: below it they are limited by the resolution; chosen here
MAX_CANDIDATES, CANDIDATE_SHARE = 8, 0.8  # peaks that are refined, and their height relative to the best; chosen here
DIVISORS, SUBHARMONIC_SHARE = range(2, 20), 0.97  # a subharmonic is preferred if it is as strong as this; chosen here


class AsynchronousCrosstalk(Effect):
    """Another sonar fires by its own clock: its burst arrives at first + k period, independently of this sonar.

    The range is c/2 ((first - t) mod period) and drifts from ping to ping with the difference of the two intervals. The
    burst competes with the echo, so that only earlier arrivals are observed. Without logged times it cannot be
    distinguished from false alarms.
    """

    name = "asynchronous_crosstalk"
    stage = Stage.PATHS
    needs_time = by_clock = True
    localised = True
    by_ping = True
    confused_with = ("false_alarm", "spike")
    summary = "The burst of another sonar with its own clock is taken for the echo"
    parameters = (
        presence(0.5),
        Parameter("period_s", "s", 0.1, 0.02, 2.0, "ranging 65 ms and host loops; wider: chosen here", (0.0713,)),
        Parameter("first_s", "s", 0.0, 0.0, 2.0, "phase of the other clock: chosen here", (0.0,)),
        Parameter("spread_m", "m", 0.05, 0.002, 0.5, "times logged to 1 ms are 0.17 m: chosen here", (0.1,)),
    )
    presence: Tensor
    period_s: Tensor
    first_s: Tensor
    spread_m: Tensor

    def apply(self, state: State) -> State:
        """Add the burst as a lag instead of a length, since a clock does not depend on the temperature of the air."""
        late = torch.remainder(self.first_s - state.conditions.time, self.period_s) * (ASSUMED_SPEED / 2.0)
        path = new_path("another clock", late, heard_level_db(late), self.presence)
        return state.with_path(replace(path, length=torch.zeros_like(late), lag=late, spread=self.spread_m))

    def statement(self) -> str:
        """Return a sentence with the period and the frequency of detection."""
        v = self.values
        share = f"for {100 * v['presence']:.3g} % of its bursts"
        return f"Another sonar, which fires every {1000 * v['period_s']:.2f} ms, is taken for the echo, {share}."

    @classmethod
    def ambiguous(cls, echoes: EchoSample) -> bool:
        """Return whether so few early readings would fit some clock by chance."""
        length = float(np.ptp(echoes.time)) if len(echoes.time) else 0.0
        return length == 0.0 or len(echoes.early.time) < np.log(max(length, 1.0) * MAX_HZ) + MARGIN_NATS

    @classmethod
    def guesses(cls, echoes: EchoSample) -> list[dict[str, float]]:
        """Return the clock that fits the arrivals of early readings best: the peak of their spectrum."""
        early = echoes.early
        if cls.ambiguous(echoes):
            return []
        delay = 2.0 * early.range / ASSUMED_SPEED
        period = 1.0 / _clock_frequency(early.time - early.time.min(), delay)
        turn = np.angle(np.exp(2j * np.pi * (early.time + delay) / period).sum()) / (2.0 * np.pi)
        return [{"presence": 0.5, "period_s": float(period), "first_s": float(turn % 1.0 * period), "spread_m": 0.1}]


def _clock_frequency(fired: Floats, delay: Floats) -> float:
    """Return the frequency of the clock that fits arrivals at `fired + delay` best, Hz.

    Frequencies with a high phase correlation differ by multiples of the sonar's own firing frequency; among them the
    coherence of the arrivals decides.
    """
    arrival = fired + delay
    length = float(fired.max() + delay.max()) + 1.0
    frequency, correlation, coherence = _phase_correlation(fired, delay, length)
    candidates = np.flatnonzero(correlation >= CANDIDATE_SHARE * correlation.max())
    best = candidates[np.argsort(coherence[candidates])[-MAX_CANDIDATES:]]
    peak_hz, peak = max((_refined_peak(f, arrival, length) for f in frequency[best]), key=lambda each: each[1])
    # arrivals that fit a clock also fit its harmonics: choose the slowest one, unless the firing itself fits that
    slower = [_refined_peak(peak_hz / k, arrival, length) for k in DIVISORS if peak_hz / k >= MIN_HZ]
    subharmonics = [f for f, value in slower if value > SUBHARMONIC_SHARE * peak and value > _coherent_sum(f, fired)]
    return max(min(subharmonics, default=peak_hz), MIN_HZ)


def _coherent_sum(frequency: float, time: Floats) -> float:
    return float(abs(np.exp(2j * np.pi * frequency * time).sum()))


def _phase_correlation(fired: Floats, delay: Floats, length: float) -> tuple[Floats, Floats, Floats]:
    """Return frequencies, Hz, the correlation of the phases of firing and delay, and the coherence of the arrivals.

    With a regular firing clock, any early reading appears periodic. The other clock shows as a correlation of both
    phases, which is computed at all frequencies by Fourier transforms.
    """
    tick = max(TICK_S, length / MAX_TICKS)
    size = next_fast_len(4 * (int(length / tick) + 1), real=True)
    arrival, firing, lag = (
        rfft(np.bincount(np.rint(t / tick).astype(np.int64), minlength=size)) / len(fired)
        for t in (fired + delay, fired, delay)
    )
    variance = (1.0 - np.abs(firing) ** 2) * (1.0 - np.abs(lag) ** 2)
    correlation = np.abs(arrival - firing * lag) / np.sqrt(np.maximum(variance, MIN_VARIANCE))
    frequency = np.arange(len(correlation)) / (size * tick)
    correlation[(frequency < MIN_HZ) | (frequency > MAX_HZ)] = 0.0
    return frequency, correlation, np.abs(arrival)


def _refined_peak(frequency: float, arrival: Floats, length: float) -> tuple[float, float]:
    """Return the frequency of the highest coherent sum near a given one, Hz, and the sum, at most that of arrivals."""
    near = frequency + np.linspace(-1.0, 1.0, 401) / (2.0 * length)
    value = np.abs(np.exp(2j * np.pi * near[:, None] * arrival).sum(axis=1))
    return float(near[np.argmax(value)]), float(value.max())
