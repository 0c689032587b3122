"""Inter-ping effects: sound of another ping, or of another sonar, taken for this one's."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.fft import next_fast_len, rfft
from torch import Tensor

from noise.effects.base import Effect, Parameter, Seen, Stage, State, new_path, wall_level_db
from noise.effects.medium import ASSUMED_SPEED
from noise.effects.target import presence

INTERVAL = "interval_s"  # covariate: time since the previous ping of the run, s; 0 where there was none
USUAL_INTERVAL = 0.065  # s; Devantech's advice, taken where no times were logged


class PreviousPing(Effect):
    """The previous ping's echo from a reflector at `far_m` comes back during this one: range far - c interval / 2.

    Shows as a mode that moves one to one with the interval between pings, and not at all with the distance.
    """

    name = "previous_ping"
    stage = Stage.PATHS
    strikes = True
    summary = "A far echo of the previous ping is read as a near one of this"
    parameters = (
        presence(0.3),
        Parameter(
            "far_m", "m", 12.0, 3.0, 25.0, "c interval / 2 = 11.2 m at 65 ms, plus what is read", (9.0, 12.0, 15.0)
        ),
    )
    presence: Tensor
    far_m: Tensor

    def apply(self, state: State) -> State:
        """Add the late echo; what the interval takes off is time, not way, so warm air does not stretch it."""
        interval = state.conditions.covariates.get(INTERVAL)
        if interval is None:
            interval = torch.full_like(state.conditions.distance, USUAL_INTERVAL)
        length = self.far_m + torch.zeros_like(interval)
        early = ASSUMED_SPEED * interval / 2.0
        possible = ((interval > 0) & (early < length)).to(torch.float64)
        path = new_path("previous", length, wall_level_db(length), self.presence * possible)
        return state.with_path(replace(path, lag=-early))

    def statement(self) -> str:
        """Return where the far reflector stands."""
        v = self.values
        often = f"{100 * v['presence']:.3g} % of pings"
        return f"A far echo of the previous ping, from {v['far_m']:.2f} m, is read as a near one of this, in {often}."


class SynchronousCrosstalk(Effect):
    """Another sonar fires at the same moment: its sound reaches the reflector over `other_m` and comes back over d."""

    name = "synchronous_crosstalk"
    stage = Stage.PATHS
    strikes = True
    summary = "Another sonar's ping is read, half as far as both distances together"
    parameters = (
        presence(0.3),
        Parameter("other_m", "m", 1.0, 0.05, 11.0, "(d1 + d2) / 2, Devantech FAQ on several sonars", (0.3, 1.0, 3.0)),
    )
    presence: Tensor
    other_m: Tensor

    def apply(self, state: State) -> State:
        """Add the way from the other sonar."""
        length = 0.5 * (state.conditions.distance + self.other_m)
        path = new_path("other sonar", length, wall_level_db(length), self.presence, state.conditions.angle)
        return state.with_path(path)

    def statement(self) -> str:
        """Return the other sonar's distance."""
        v = self.values
        often = f"{100 * v['presence']:.3g} % of pings"
        return f"Another sonar's ping is read, over a way {v['other_m']:.2f} m long to the reflector, in {often}."


TICK_S = 1e-3  # times of pings are logged no finer
MOST_TICKS = 1 << 21
SURE_NATS = 5.0  # by which arrivals must keep to a clock better than to any by chance: 99 %
SLOWEST_HZ, FASTEST_HZ = 0.5, 40.0  # of another sonar; ours
LEAST_SPREAD = 0.01  # of the phases of asking and delay, squared: less is how coarsely both are logged; ours
MOST_CLOCKS, NEARLY = 8, 0.8  # that are looked at closely, and how near they come to the best; ours
SLOWER, ALL_OF = range(2, 20), 0.97  # times as slow a clock, if it is kept to by as many; ours


class AsynchronousCrosstalk(Effect):
    """Another sonar fires by a clock of its own: its burst arrives at first + k period, whatever this one does.

    Range c/2 ((first - t) mod period): drifts from ping to ping by the difference of both intervals, and competes with
    the echo, so that only earlier readings are seen. Without the time of each ping it is a false alarm like any other.
    """

    name = "asynchronous_crosstalk"
    stage = Stage.PATHS
    strikes = True
    by_ping = True
    passes_for = ("false_alarm", "spike")
    summary = "Another sonar, firing by its own clock, is taken for the echo"
    parameters = (
        presence(0.5),
        Parameter("period_s", "s", 0.1, 0.02, 2.0, "ranging 65 ms and host loops; wider: ours", (0.0713,)),
        Parameter("first_s", "s", 0.0, 0.0, 2.0, "phase of the other clock: ours", (0.0,)),
        Parameter("spread_m", "m", 0.05, 0.002, 0.5, "times logged to 1 ms are 0.17 m: ours", (0.1,)),
    )
    presence: Tensor
    period_s: Tensor
    first_s: Tensor
    spread_m: Tensor

    def apply(self, state: State) -> State:
        """Add its burst; what the clock says is time, not way, so warm air does not stretch it."""
        late = torch.remainder(self.first_s - state.conditions.time, self.period_s) * (ASSUMED_SPEED / 2.0)
        path = new_path("another clock", late, wall_level_db(torch.ones_like(late)), self.presence)
        return state.with_path(replace(path, length=torch.zeros_like(late), lag=late, spread=self.spread_m))

    def statement(self) -> str:
        """Return its period."""
        v = self.values
        often = f"{100 * v['presence']:.3g} % of its bursts"
        return f"Another sonar, firing every {1000 * v['period_s']:.2f} ms, is taken for the echo, by {often}."

    @classmethod
    def hidden(cls, seen: Seen) -> bool:
        """Tell whether early readings keep to some clock by chance, so few they are among so many clocks."""
        length = float(np.ptp(seen.time)) if len(seen.time) else 0.0
        return length == 0.0 or len(seen.early.time) < np.log(max(length, 1.0) * FASTEST_HZ) + SURE_NATS

    @classmethod
    def guesses(cls, seen: Seen) -> list[dict[str, float]]:
        """Return the clock to which the arrivals of early readings keep best: the peak of their spectrum."""
        early = seen.early
        if len(early.time) < 8:
            return []
        late = 2.0 * early.range / ASSUMED_SPEED
        period = 1.0 / _beat(early.time - early.time.min(), late)
        turn = np.angle(np.exp(2j * np.pi * (early.time + late) / period).sum()) / (2.0 * np.pi)
        return [{"presence": 0.5, "period_s": float(period), "first_s": float(turn % 1.0 * period), "spread_m": 0.1}]


def _beat(since: NDArray[np.float64], late: NDArray[np.float64]) -> float:
    """Return the frequency of the clock to which arrivals `since + late` keep, Hz.

    Of those that the delay goes by, which differ by the clock of the asking and tell nearly the same, the arrivals
    themselves choose.
    """
    arrival = since + late
    length = float(since.max() + late.max()) + 1.0
    frequency, alike, arrived = _going_along(since, late, length)
    able = np.flatnonzero(alike >= NEARLY * alike.max())
    best = able[np.argsort(arrived[able])[-MOST_CLOCKS:]]
    top, most = max((_sharpened(f, arrival, length) for f in frequency[best]), key=lambda each: each[1])
    # what keeps to a clock keeps to every faster one that beats in between: unless the asking does, it is the slowest
    slower = [_sharpened(top / k, arrival, length) for k in SLOWER if top / k >= SLOWEST_HZ]
    kept = [f for f, much in slower if much > ALL_OF * most and much > abs(np.exp(2j * np.pi * f * since).sum())]
    return max(min(kept, default=top), SLOWEST_HZ)


def _going_along(
    since: NDArray[np.float64], late: NDArray[np.float64], length: float
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return frequencies, Hz, how far delays go by the moment of asking at each, and how far arrivals keep to it.

    Whoever asks by a clock of his own makes anything keep to it that comes soon after. What tells the other clock is
    the correlation of both phases, at all frequencies at once.
    """
    tick = max(TICK_S, length / MOST_TICKS)
    size = next_fast_len(4 * (int(length / tick) + 1), real=True)
    arrived, asked, lag = (
        rfft(np.bincount(np.rint(t / tick).astype(np.int64), minlength=size)) / len(since)
        for t in (since + late, since, late)
    )
    spread = (1.0 - np.abs(asked) ** 2) * (1.0 - np.abs(lag) ** 2)
    alike = np.abs(arrived - asked * lag) / np.sqrt(np.maximum(spread, LEAST_SPREAD))
    frequency = np.arange(len(alike)) / (size * tick)
    alike[(frequency < SLOWEST_HZ) | (frequency > FASTEST_HZ)] = 0.0
    return frequency, alike, np.abs(arrived)


def _sharpened(frequency: float, arrival: NDArray[np.float64], length: float) -> tuple[float, float]:
    """Return the frequency near one given to which arrivals keep best, Hz, and how well they do, 0 to their number."""
    near = frequency + np.linspace(-1.0, 1.0, 401) / (2.0 * length)
    kept = np.abs(np.exp(2j * np.pi * near[:, None] * arrival).sum(axis=1))
    return float(near[np.argmax(kept)]), float(kept.max())
