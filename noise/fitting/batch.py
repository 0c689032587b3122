"""Answered pings in the order of their cells: what every likelihood and every look at readings is given."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from acquisition import Ping, Reading, Recording, RecordingError, previous
from noise.effects import Conditions
from noise.effects.base import reach
from noise.fitting.visits import last_echo, visits_of

MEMORY = 12  # readings of a condition that an look_back looks back on; ours: past that a condition tells nothing new
STANDS_M = 0.01  # by which the logged distance of a target that stands may change; ours


@dataclass(frozen=True, eq=False)
class Batch:
    """Answered pings in the order of their cells, time running inside each.

    Attributes:
        ping: conditions, (n,).
        past: the reading before each ping in its run, whatever its condition, (n,).
        reading: (n,).
        visit: the uninterrupted stay in one condition that a ping belongs to, ascending, (n,).
        condition: the condition of each ping, for splits, (n,).
        resolution: step of the register, m.
        last: latest echo before each ping in its run, and how far off its target stood, m, nan where there was none,
            (n, 2).
        timed: whether the time of each ping was logged.
        simulated_offset: offset of the simulation's readings under the same condition, m, nan where it was not asked, (n,).
    """

    ping: Ping
    past: Reading
    reading: Reading
    visit: NDArray[np.int64]
    condition: NDArray[np.int64]
    resolution: float
    last: NDArray[np.float64]
    timed: bool = True
    simulated_offset: NDArray[np.float64] | None = None

    @classmethod
    def of(cls, recording: Recording) -> Batch:
        """Sort a recording into cells; rows without an answer are left out (they are faults, not readings).

        Raises:
            RecordingError: nothing was answered.
        """
        answered = recording.reading.answered
        if not answered.any():
            raise RecordingError(f"{recording.name}: no ping was answered, so there is nothing to compare: check wires")
        condition, visit = visits_of(recording)
        order = np.lexsort((np.arange(len(recording)), visit))
        order = order[answered[order]]
        past = previous(recording.reading, recording.run)
        ping, reading = recording.ping[order], recording.reading[order]
        label = np.unique(visit[order], return_inverse=True)[1]
        last, timed = last_echo(recording)[order], recording.has("time_s")
        return cls(ping, past[order], reading, label, condition[order], recording.resolution, last, timed)

    def __len__(self) -> int:
        """Return the number of pings."""
        return len(self.reading)

    def select(self, mask: NDArray[np.bool_]) -> Batch:
        """Return the pings at a mask; whole n_visits or their beginnings, so that the past visit_rows right."""
        visit = np.unique(self.visit[mask], return_inverse=True)[1]
        return replace(
            self,
            ping=self.ping[mask],
            past=self.past[mask],
            reading=self.reading[mask],
            visit=visit,
            condition=self.condition[mask],
            last=self.last[mask],
            simulated_offset=None if self.simulated_offset is None else self.simulated_offset[mask],
        )

    def thin(self, n: int) -> Batch:
        """Return at most about n pings: the first few of every visit, and if need be every k-th visit."""
        if len(self) <= n:
            return self
        stride = -(-2 * self.n_visits // n)
        # the first pings of a condition carry most of what it can tell, so n_visits are shortened before any is left out
        most = max(2, n * stride // self.n_visits)
        return self.select((self.visit % stride == 0) & (self.count < most))

    @cached_property
    def n_visits(self) -> int:
        """Number of n_visits."""
        return int(self.visit[-1]) + 1

    @cached_property
    def first(self) -> NDArray[np.int64]:
        """Row at which each ping's visit begins, (n,)."""
        return np.searchsorted(self.visit, self.visit)

    @cached_property
    def starts(self) -> NDArray[np.int64]:
        """Row at which each visit begins, (n_visits,)."""
        return np.unique(self.first)

    @property
    def visit_rows(self) -> list[NDArray[np.int64]]:
        """Rows of each visit."""
        return np.split(np.arange(len(self)), self.starts[1:])

    @property
    def stationary_rows(self) -> list[NDArray[np.int64]]:
        """Rows of each visit in which the target stood."""
        return [rows for rows, stood in zip(self.visit_rows, self.stationary, strict=True) if stood]

    @cached_property
    def stationary(self) -> NDArray[np.bool_]:
        """Whether the target stood through each visit, rather than moved or was passed by, (n_visits,)."""
        distance = self.ping.distance
        way = np.maximum.reduceat(distance, self.starts) - np.minimum.reduceat(distance, self.starts)
        return way <= STANDS_M

    @cached_property
    def count(self) -> NDArray[np.int64]:
        """Number of pings before each in its visit, (n,)."""
        return np.arange(len(self)) - self.first

    @cached_property
    def conditions(self) -> Conditions:
        """Conditions and past as tensors."""
        return Conditions.of(self.ping, self.past)

    @cached_property
    def simulated_offset_tensors(self) -> tuple[Tensor, Tensor]:
        """Offset of the simulation in each ping's condition, m, 0 where unknown, and whether it is known (0 or 1), (n,)."""
        simulated_offset = np.full(len(self), np.nan) if self.simulated_offset is None else self.simulated_offset
        return torch.as_tensor(np.nan_to_num(simulated_offset)), torch.as_tensor(
            (~np.isnan(simulated_offset)).astype(np.float64)
        )

    @cached_property
    def error(self) -> NDArray[np.float64]:
        """Reading minus true distance, m, (n,); 0 where there was no echo."""
        return np.where(self.reading.echo, self.reading.range - self.ping.distance, 0.0)

    @cached_property
    def look_back(self) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Look-back over the visit, of `MEMORY` readings at most.

        How far echoes lie from earlier ones, each distance once, m, (k,), and how many earlier ones lie so far from
        each ping's, sparse (n, k); before silent pings, the number of silent ones, (n,); number of earlier ones, (n,).
        """
        lag = np.arange(1, MEMORY + 1)[:, None]
        valid = lag <= self.count
        row = np.maximum(np.arange(len(self)) - lag, 0)
        echo = self.reading.echo
        both = valid & echo & echo[row]
        silent = valid & ~echo & ~echo[row]
        apart = np.abs(self.error - self.error[row])[both]
        # a register has few steps within reach: distances come again and again, but for rounding
        once, which = np.unique(np.round(apart, 9), return_inverse=True)
        at, tensor = np.stack([np.nonzero(both)[1], which]), torch.as_tensor
        ones, shape = np.ones(at.shape[1]), (len(self), len(once))
        often = torch.sparse_coo_tensor(tensor(at), tensor(ones), shape, check_invariants=True)
        return (
            tensor(once),
            often.coalesce(),
            tensor(silent.sum(axis=0).astype(np.float64)),
            tensor(valid.sum(axis=0).astype(np.float64)),
        )

    @cached_property
    def echo_counts(self) -> tuple[Tensor, Tensor]:
        """Number of pings before each in its visit, and of those with an echo, (n,) each."""
        echo = torch.from_numpy(self.reading.echo.astype(np.float64))
        return torch.from_numpy(self.count.astype(np.float64)), self.before(echo)

    @property
    def reach(self) -> NDArray[np.float64]:
        """How far from where it is expected an echo may lie and be the target's, m, (n,)."""
        return reach(self.ping.distance)

    def is_target(self, error: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Tell which echoes are the target's, by how far they lie from where it is expected, m, (n,)."""
        return self.reading.echo & (np.abs(error) < self.reach)

    def is_outlier(self, error: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Tell which echoes are not the target's, by how far they lie from where it is expected, m, (n,)."""
        return self.reading.echo & ~self.is_target(error)

    def visit_sums(self, value: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return sums of a (n,) or (n, k) array over the n_visits, (n_visits,) or (n_visits, k)."""
        return np.add.reduceat(value, self.starts, axis=0)

    @cached_property
    def repeats(self) -> NDArray[np.bool_]:
        """Whether each echo is repeats to the digit with the reading before it in its run, (n,)."""
        same = np.abs(self.reading.range - self.past.range) < 0.5 * self.resolution
        return same & self.reading.echo & self.past.echo

    def before(self, value: Tensor) -> Tensor:
        """Return sums over the pings before each in its visit, (..., n)."""
        total = torch.cumsum(value, dim=-1) - value
        return total - total[..., torch.from_numpy(self.first)]


def silence(batch: Batch) -> float:
    """Return the share of answered pings without an echo."""
    return float(np.mean(~batch.reading.echo))
