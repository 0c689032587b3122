"""Answered pings sorted by visit, the input of every likelihood and every residual check."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from acquisition import Ping, Reading, Recording, RecordingError, previous
from noise.effects import Conditions
from noise.effects.base import target_tolerance
from noise.fitting.visits import is_moving, last_echo, movement, visits_of, with_range_rate

MAX_LAG = 12  # earlier readings of a visit that `look_back` covers; more add no information; chosen here
OFF_STEP_M = 5e-5  # by which logs in 0.1 mm round a reading
MIN_RUNS = 10  # of a robot that are the units of a split and of a standard error; chosen here
MAX_STATIONARY_M = 0.01  # change of the logged distance of a stationary target; chosen here


@dataclass(frozen=True, eq=False)
class Batch:
    """Answered pings sorted by visit and, within a visit, as in the recording.

    Attributes:
        ping: pings, (n,).
        past: reading before each ping in its run, under any condition, (n,).
        reading: readings, (n,).
        visit: index of the visit of each ping, ascending, (n,).
        condition: index of the condition of each ping, for splits, (n,).
        resolution: step of the register, m.
        last: range and true distance of the last echo before each ping in its run, m, nan where none, (n, 2).
        moved: change of the true distance since the ping before in its run, m, (n,).
        timed: whether the time of each ping was logged.
        simulated_offset: mean error of the simulation under the same condition, m, nan where unknown, (n,).
        grid_m: step of the grid on which all readings lie, m: the register's own, or a coarser one; 0 where unknown.
        origin: range of step 0 of that grid, m, in (-`grid_m`, 0].
        by_run: whether runs are the independent units: pieces of one run of a robot share the error of its pose.
        row: of each ping in the recording, (n,); None where they are in its order.
    """

    ping: Ping
    past: Reading
    reading: Reading
    visit: NDArray[np.int64]
    condition: NDArray[np.int64]
    resolution: float
    last: NDArray[np.float64]
    moved: NDArray[np.float64]
    timed: bool = True
    simulated_offset: NDArray[np.float64] | None = None
    grid_m: float = 0.0
    origin: float = 0.0
    by_run: bool = False
    row: NDArray[np.int64] | None = None

    @classmethod
    def of(cls, recording: Recording) -> Batch:
        """Sort a recording by visit; pings without an answer are faults, not readings, and are omitted.

        Raises:
            RecordingError: no ping was answered.
        """
        answered = recording.reading.answered
        if not answered.any():
            raise RecordingError(f"{recording.name}: no ping was answered, so there are no readings; check the wires")
        condition, visit = visits_of(recording)
        order = np.lexsort((np.arange(len(recording)), visit))
        order = order[answered[order]]
        past = previous(recording.reading, recording.run)
        ping, reading = with_range_rate(recording)[order], recording.reading[order]
        label = np.unique(visit[order], return_inverse=True)[1]
        last, moved = last_echo(recording)[order], movement(recording)[order]
        timed, (step, origin) = recording.has("time_s"), recording.grid
        by_run = is_moving(recording) and len(np.unique(ping.run)) >= MIN_RUNS
        return cls(
            ping, past[order], reading, label, condition[order], step, last, moved, timed,
            grid_m=step, origin=origin, by_run=by_run, row=order,
        )  # fmt: skip

    def __len__(self) -> int:
        """Return the number of pings."""
        return len(self.reading)

    def moved_to(self, step: float) -> Batch | None:
        """Return the readings on a register with given steps, m, that begin anywhere; None where most are on none.

        Readings from elsewhere, such as a program that fills gaps, may lie between the steps.
        """
        place = np.sort(self.reading.range[self.reading.echo] % step)
        if not len(place):
            return None
        around = np.concatenate([place, place + step])
        n_alike = np.searchsorted(around, place + 2.0 * OFF_STEP_M, side="right") - np.arange(len(place))
        first = int(n_alike.argmax())
        middle = float(np.median(around[first : first + n_alike[first]]))
        if n_alike[first] <= 0.5 * len(place):
            return None
        return replace(self, resolution=step, grid_m=step, origin=-(-middle % step))

    def select(self, mask: NDArray[np.bool_]) -> Batch:
        """Return the pings at a mask of whole visits or of their beginnings, so that `past` remains valid."""
        visit = np.unique(self.visit[mask], return_inverse=True)[1]
        return replace(
            self,
            ping=self.ping[mask],
            past=self.past[mask],
            reading=self.reading[mask],
            visit=visit,
            condition=self.condition[mask],
            last=self.last[mask],
            moved=self.moved[mask],
            row=None if self.row is None else self.row[mask],
            simulated_offset=None if self.simulated_offset is None else self.simulated_offset[mask],
        )

    def thin(self, n: int) -> Batch:
        """Return about n pings at most: the first pings of every visit or, if necessary, of every k-th visit."""
        return self if len(self) <= n else self.select(self.beginnings(n))

    def beginnings(self, n: int) -> NDArray[np.bool_]:
        """Return the mask of the first pings of every visit or, if necessary, of every k-th; about n are set."""
        if len(self) <= n:
            return np.ones(len(self), dtype=bool)
        # the first pings of a visit carry most of its information, so visits are shortened before any is omitted
        stride = max(-(-int((self.count < 2).sum()) // n), 1)
        kept = self.visit % stride == 0
        earlier = np.cumsum(np.bincount(self.count[kept]))  # pings with so many before them in their visit
        n_each = max(2, int(np.searchsorted(earlier, n, side="right")))
        return kept & (self.count < n_each)

    @cached_property
    def n_visits(self) -> int:
        """Number of visits."""
        return int(self.visit[-1]) + 1

    @cached_property
    def first(self) -> NDArray[np.int64]:
        """First row of the visit of each ping, (n,)."""
        return np.searchsorted(self.visit, self.visit)

    @cached_property
    def starts(self) -> NDArray[np.int64]:
        """First row of each visit, (n_visits,)."""
        return np.unique(self.first)

    @property
    def visit_rows(self) -> list[NDArray[np.int64]]:
        """Rows of each visit."""
        return np.split(np.arange(len(self)), self.starts[1:])

    @cached_property
    def stationary(self) -> NDArray[np.bool_]:
        """Whether the target was stationary in each visit, (n_visits,)."""
        distance = self.ping.distance
        travel = np.maximum.reduceat(distance, self.starts) - np.minimum.reduceat(distance, self.starts)
        return travel <= MAX_STATIONARY_M

    @cached_property
    def count(self) -> NDArray[np.int64]:
        """Number of earlier pings in the visit, (n,)."""
        return np.arange(len(self)) - self.first

    @cached_property
    def conditions(self) -> Conditions:
        """Conditions and previous readings as tensors."""
        return Conditions.of(self.ping, self.past)

    @cached_property
    def simulated_offset_tensors(self) -> tuple[Tensor, Tensor]:
        """`simulated_offset`, m, 0 where unknown, and whether it is known (0 or 1), (n,) each."""
        offset = np.full(len(self), np.nan) if self.simulated_offset is None else self.simulated_offset
        return torch.as_tensor(np.nan_to_num(offset)), torch.as_tensor((~np.isnan(offset)).astype(np.float64))

    @cached_property
    def misplaced(self) -> tuple[Tensor, Tensor]:
        """Variance, m^2, of an arbitrary offset of the target, and whether each ping's echo may be its, (n,) each."""
        return torch.as_tensor((0.5 * self.reach) ** 2), torch.from_numpy(self.is_target(self.error))

    @cached_property
    def error(self) -> NDArray[np.float64]:
        """Reading minus true distance, m, (n,); 0 without an echo."""
        return np.where(self.reading.echo, self.reading.range - self.ping.distance, 0.0)

    @cached_property
    def look_back(self) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
        """Comparison of each reading with at most `MAX_LAG` earlier readings of its visit.

        The unique absolute differences between echoes, m, (k,); for each pair of echoes, the later ping, (pairs,), and
        the index of its difference, (pairs,); for pings without an echo, the number of earlier pings without an echo,
        (n,); the number of earlier pings, (n,).
        """
        lag = np.arange(1, MAX_LAG + 1)[:, None]
        valid = lag <= self.count
        row = np.maximum(np.arange(len(self)) - lag, 0)
        echo = self.reading.echo
        both = valid & echo & echo[row]
        silent = valid & ~echo & ~echo[row]
        difference = np.abs(self.error - self.error[row])[both]
        # readings lie on the steps of the register, so that differences repeat up to rounding
        unique, which = np.unique(np.round(difference, 9), return_inverse=True)
        tensor = torch.as_tensor
        return (
            tensor(unique),
            tensor(np.nonzero(both)[1]),
            tensor(which.ravel()),
            tensor(silent.sum(axis=0).astype(np.float64)),
            tensor(valid.sum(axis=0).astype(np.float64)),
        )

    @cached_property
    def echo_counts(self) -> tuple[Tensor, Tensor]:
        """Number of earlier pings in the visit, and of earlier echoes, (n,) each."""
        echo = torch.from_numpy(self.reading.echo.astype(np.float64))
        return torch.from_numpy(self.count.astype(np.float64)), self.before(echo)

    @property
    def reach(self) -> NDArray[np.float64]:
        """Largest error of an echo that is attributed to the target, m, (n,)."""
        return target_tolerance(self.ping.distance)

    def is_target(self, error: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return which echoes are attributed to the target, given their errors, m, (n,)."""
        return self.reading.echo & (np.abs(error) < self.reach)

    def is_outlier(self, error: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return which echoes are not attributed to the target, given their errors, m, (n,)."""
        return self.reading.echo & ~self.is_target(error)

    def visit_sums(self, value: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the sum of an (n,) or (n, k) array over each visit, (n_visits,) or (n_visits, k)."""
        return np.add.reduceat(value, self.starts, axis=0)

    @cached_property
    def unit(self) -> NDArray[np.int64]:
        """Index of the independent unit of each ping, its visit or its run, (n,)."""
        return np.unique(self.ping.run if self.by_run else self.visit, return_inverse=True)[1].ravel()

    def unit_sums(self, value: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the sum of an (n,) array over each independent unit, (units,)."""
        return np.bincount(self.unit, value).astype(np.float64)

    @cached_property
    def guesses(self) -> dict[str, list[dict[str, float]]]:
        """Initial parameter values of effects estimated from these readings, by effect id; filled on first use."""
        return {}

    @cached_property
    def follows(self) -> NDArray[np.bool_]:
        """Whether the ping before each in the recording was the one before it in its visit, (n,)."""
        row = np.arange(len(self)) if self.row is None else self.row
        return (self.count >= 1) & (np.diff(row, prepend=-1) == 1)

    @cached_property
    def repeats(self) -> NDArray[np.bool_]:
        """Whether each echo equals the reading before it in its run, (n,)."""
        same = np.abs(self.reading.range - self.past.range) < 0.5 * self.resolution
        return same & self.reading.echo & self.past.echo

    def before(self, value: Tensor) -> Tensor:
        """Return sums over the earlier pings of the visit, (..., n)."""
        total = torch.cumsum(value, dim=-1) - value
        return total - total[..., torch.from_numpy(self.first)]


def share_without_echo(batch: Batch) -> float:
    """Return the share of pings without an echo."""
    return float(np.mean(~batch.reading.echo))
