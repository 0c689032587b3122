"""State of an LSTM over the pings of several sensors: its weights, its hidden state and features of earlier pings."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from acquisition import EchoStatus, Ping, Reading
from acquisition.arrays import Floats
from noise.learned.mixture import UNIT_M

N_ANCHORS = 2  # the last echo shifted with the reflector, and the last reading
N_HISTORY_FEATURES = 12  # features of the earlier pings


@dataclass
class PingHistory:
    """Summary of the earlier pings of n sensors.

    Attributes:
        known: whether there was an earlier ping, (n,) bool.
        condition: distance, angle, incidence, reflectance and time of the last ping, (5, n).
        run: run of the last ping, (n,).
        range, status: reading of the last ping, (n,).
        error: range error of the last echo, m, (n,); 0 without an earlier echo.
        has_echo: whether there was an earlier echo, (n,) bool.
    """

    known: NDArray[np.bool_]
    condition: Floats
    run: NDArray[np.int64]
    range: Floats
    status: NDArray[np.uint8]
    error: Floats
    has_echo: NDArray[np.bool_]

    @classmethod
    def empty(cls, n: int) -> PingHistory:
        """Return the history of n sensors without earlier pings."""
        no = np.zeros(n, dtype=bool)
        return cls(no, np.zeros((5, n)), np.zeros(n, np.int64), np.zeros(n), np.zeros(n, np.uint8), np.zeros(n), no)

    @classmethod
    def of_recording(cls, ping: Ping, reading: Reading) -> PingHistory:
        """Return the history before each ping of a recording, (n,), given the earlier pings of its run."""
        order = np.argsort(ping.run, kind="stable")
        run, place = ping.run[order], np.arange(len(ping))
        first = np.r_[True, run[1:] != run[:-1]]
        start = np.maximum.accumulate(np.where(first, place, 0))
        last_echo = np.maximum.accumulate(np.where(reading.echo[order], place, -1))
        last_echo = np.r_[-1, last_echo[:-1]]
        known, has_echo = ~first, (last_echo >= start) & ~first
        one_before = order[np.maximum(place - 1, 0)]
        echoed = order[np.maximum(last_echo, 0)]
        error = np.where(has_echo, reading.range[echoed] - ping.distance[echoed], 0.0)
        in_order = cls(
            known, condition_of(ping)[:, one_before], ping.run[one_before],
            np.where(known, reading.range[one_before], 0.0), reading.status[one_before], error, has_echo,
        )  # fmt: skip
        return in_order[np.argsort(order)]

    def __getitem__(self, rows: Any) -> PingHistory:
        """Return the history of some of the sensors."""
        return PingHistory(*(getattr(self, f.name)[..., rows] for f in fields(self)))

    def updated(self, condition: Floats, run: NDArray[np.int64], reading: Reading) -> PingHistory:
        """Return the history after one more ping of each sensor, with its condition, (5, n), and run."""
        echo = reading.echo
        error = np.where(echo, reading.range - condition[0], self.error)
        every = np.ones(len(run), dtype=bool)
        return PingHistory(every, condition, run, reading.range, reading.status, error, self.has_echo | echo)

    def cleared(self, rows: NDArray[np.bool_]) -> PingHistory:
        """Return the history with that of some sensors cleared."""
        keep = ~rows
        known, has_echo = self.known & keep, self.has_echo & keep
        return replace(self, known=known, error=self.error * keep, has_echo=has_echo)

    def features(self, ping: Ping) -> Floats:
        """Return the features of the history, (n, N_HISTORY_FEATURES); all zero before the first ping."""
        step = condition_of(ping) - self.condition
        rows = [
            np.ones(len(ping)),
            np.log1p(np.clip(step[4], 0.0, 100.0)) / 4.0,
            np.arcsinh(step[0] / UNIT_M) / 7.0,
            *np.tanh(20.0 * step[1:4]),
            *(self.status == kind for kind in EchoStatus),
            np.arcsinh(self.error / UNIT_M) / 7.0,
            np.clip(self.error / 0.05, -1.0, 1.0),
            self.has_echo,
        ]
        return (np.stack(rows) * self.known).T

    def anchors(self, distance: Floats) -> Floats:
        """Return the ranges about which the anchored components lie, m, (N_ANCHORS, n)."""
        repeated = self.known & (self.status == EchoStatus.ECHO)
        return np.stack([distance + self.error, np.where(repeated, self.range, distance)])


def condition_of(ping: Ping) -> Floats:
    """Return distance, angle, incidence, reflectance and time of pings, (5, n)."""
    return np.stack([ping.distance, ping.angle, ping.incidence, ping.reflectance, ping.time])


@dataclass
class LstmState:
    """State of n sensors.

    Attributes:
        history: earlier pings before the last ping of each sensor.
        condition, run: condition and run of the last ping, (5, n) and (n,).
        fired: whether there was a last ping, (n,) bool.
        hidden, cell: hidden and cell state of the LSTM, (hidden, n).
    """

    history: PingHistory
    condition: Floats
    run: NDArray[np.int64]
    fired: NDArray[np.bool_]
    hidden: Floats
    cell: Floats

    @classmethod
    def empty(cls, n: int, hidden: int) -> LstmState:
        """Return the state of n sensors before their first ping."""
        zero = np.zeros((2, hidden, n))
        return cls(PingHistory.empty(n), np.zeros((5, n)), np.zeros(n, np.int64), np.zeros(n, dtype=bool), *zero)

    def __len__(self) -> int:
        return len(self.run)

    def __getitem__(self, rows: Any) -> LstmState:
        """Return the state of some of the sensors."""
        return LstmState(self.history[rows], *(getattr(self, f.name)[..., rows] for f in fields(self)[1:]))

    def put(self, rows: NDArray[np.int64], other: LstmState) -> None:
        """Replace the state of some of the sensors in place."""
        for mine, new in ((self.history, other.history), (self, other)):
            for f in fields(mine):
                if f.name != "history":
                    getattr(mine, f.name)[..., rows] = getattr(new, f.name)

    def after(self, past: Reading, run: NDArray[np.int64] | None) -> LstmState:
        """Return the state after the last reading of each sensor; it is cleared for sensors that start a new run."""
        anew = ~self.fired if run is None else ~self.fired | (self.run != run)
        history = self.history.updated(self.condition, self.run, past).cleared(anew)
        return replace(self, history=history, hidden=self.hidden * ~anew, cell=self.cell * ~anew)


@dataclass(frozen=True)
class LstmCell:
    """Weights of an LSTM (Hochreiter and Schmidhuber 1997); gates in the order of torch: input, forget, cell, output.

    Attributes:
        on_input: (4 hidden, in).
        on_hidden: (4 hidden, hidden).
        bias: (4 hidden,).
    """

    on_input: Floats
    on_hidden: Floats
    bias: Floats

    @property
    def hidden(self) -> int:
        """Width of the state."""
        return self.on_hidden.shape[1]

    def step(self, x: Floats, hidden: Floats, cell: Floats) -> tuple[Floats, Floats]:
        """Return the hidden and cell state after one more input, (n, in)."""
        z = x @ self.on_input.T + hidden @ self.on_hidden.T + self.bias
        take, keep, new, show = np.split(z, 4, axis=1)
        cell = expit(keep) * cell + expit(take) * np.tanh(new)
        return expit(show) * np.tanh(cell), cell
