"""Pings that share a cell agree more than any law of single pings says: the batch they form, and its likelihood.

A target is put down once a cell, a few millimetres from where the log says; pings seconds apart meet the same air and
the same interference of paths. Counted as independent, one misplaced cell of 50 pings is worth hundreds of nats. So
every likelihood here is *prequential*: each reading is predicted from its condition and from the readings before it
in its cell, and what the neighbours already told counts no more. The sum is what is called effective nats.

The prediction is, in this order:
1. a normal offset shared by the cell (`placement_m`), known ever better as readings come, by the rules of a Kalman
   filter, and what is carried over from one ping to the next (`carry`); where a simulation was asked under the very
   same condition, its own offset there is where this one begins (`link`). One cell in ten is taken to be put down
   far less carefully (`WIDE`), and which one it is shows as its readings come;
2. whether it is heard at all, which near the edge of hearing is settled by how the target was put down rather than from
   ping to ping (`hearing`): a beta-binomial, in which the law's probability meets what was heard so far;
3. a Polya urn over the cell's last readings (`sharing`, `kernel_m`), which makes anything else that a cell keeps
   repeating (silence, another reflector) count about once a cell;
4. a floor of arbitrary readings and silences, so that no single reading is worth more than about 17 nats.
Any such prediction from the past makes a proper joint likelihood, whether the cell behaves like it or not.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from acquisition import Ping, Reading, Recording, RecordingError, previous
from noise.effects import Conditions, Effect, Parameter, Stage, State
from noise.effects.base import number, reach
from noise.physical import PhysicalLaw, PhysicalModel
from noise.stays import cells_of, last_echo

MEMORY = 12  # readings of a cell that the urn looks back on; ours: past that a cell tells nothing new
WIDE = 4.0  # how much farther from its mark a carelessly placed target lies; ours
CARELESS = 0.1  # share of such cells; ours
LEAST_M = 5e-4  # nobody puts a target down better, whatever a few cells say; ours
BANKS = ((1.0, 1.0 - CARELESS), (WIDE, CARELESS))
STANDS_M = 0.01  # by which the logged distance of a target that stands may change; ours
FLOOR = 3e-4  # probability of an arbitrary reading, and of an arbitrary silence, in every law; ours
LEAST = 1e-9  # probability that is divided by


class CellNuisance(Effect):
    """What pings of one cell share beyond their condition. It leaves the law of a single ping alone."""

    name = "cells"
    stage = Stage.SEQUENCE
    summary = "Pings of one cell share an offset"
    parameters = (
        # never nothing: its slope is zero there, and no climb would lead back
        Parameter("placement_m", "m", 2e-4, 2e-4, 0.1, "ruler and mount, 1 to 5 mm; wider: ours", (0.003,)),
        Parameter("carry", "1", 0.0, 0.0, 0.98, "correlation from ping to ping: ours", (0.1,)),
        Parameter("sharing", "1", 0.0, 0.0, 5.0, "weight of one earlier reading against the law: ours", (0.02,)),
        Parameter("kernel_m", "m", 0.004, 0.0003, 0.05, "width of what a cell repeats: ours", (0.004,)),
        Parameter("hearing", "1", 0.0, 0.0, 5.0, "weight of one earlier ping, heard or not, against it: ours", (0.05,)),
        Parameter("link", "1", 0.0, 0.0, 0.999, "correlation with the simulation's offset in a cell: ours", (0.5,)),
    )
    placement_m: Tensor
    carry: Tensor
    sharing: Tensor
    kernel_m: Tensor
    hearing: Tensor
    link: Tensor

    def apply(self, state: State) -> State:
        """Leave the state as it is."""
        return state


@dataclass(frozen=True, eq=False)
class Batch:
    """Answered pings in the order of their cells, time running inside each.

    Attributes:
        ping: conditions, (n,).
        past: the reading before each ping in its run, whatever its cell, (n,).
        reading: (n,).
        block: the uninterrupted stay in one cell that a ping belongs to, ascending, (n,).
        cell: the cell of each ping, for splits, (n,).
        resolution: step of the register, m.
        last: latest echo before each ping in its run, and how far off its target stood, m, nan where there was none,
            (n, 2).
        timed: whether the time of each ping was logged.
        twin: offset of the simulation's readings under the same condition, m, nan where it was not asked, (n,).
    """

    ping: Ping
    past: Reading
    reading: Reading
    block: NDArray[np.int64]
    cell: NDArray[np.int64]
    resolution: float
    last: NDArray[np.float64]
    timed: bool = True
    twin: NDArray[np.float64] | None = None

    @classmethod
    def of(cls, recording: Recording) -> Batch:
        """Sort a recording into cells; rows without an answer are left out (they are faults, not readings).

        Raises:
            RecordingError: nothing was answered.
        """
        answered = recording.reading.answered
        if not answered.any():
            raise RecordingError(f"{recording.name}: no ping was answered, so there is nothing to compare: check wires")
        cell, block = cells_of(recording)
        order = np.lexsort((np.arange(len(recording)), block))
        order = order[answered[order]]
        past = previous(recording.reading, recording.run)
        ping, reading = recording.ping[order], recording.reading[order]
        label = np.unique(block[order], return_inverse=True)[1]
        last, timed = last_echo(recording)[order], recording.has("time_s")
        return cls(ping, past[order], reading, label, cell[order], recording.resolution, last, timed)

    def __len__(self) -> int:
        """Return the number of pings."""
        return len(self.reading)

    def select(self, mask: NDArray[np.bool_]) -> Batch:
        """Return the pings at a mask; whole blocks or their beginnings, so that the past stays right."""
        block = np.unique(self.block[mask], return_inverse=True)[1]
        return replace(
            self,
            ping=self.ping[mask],
            past=self.past[mask],
            reading=self.reading[mask],
            block=block,
            cell=self.cell[mask],
            last=self.last[mask],
            twin=None if self.twin is None else self.twin[mask],
        )

    def thin(self, n: int) -> Batch:
        """Return at most about n pings: the first few of every block, and if need be every k-th block."""
        if len(self) <= n:
            return self
        stride = -(-2 * self.blocks // n)
        # the first pings of a cell carry most of what it can tell, so blocks are shortened before any is left out
        most = max(2, n * stride // self.blocks)
        return self.select((self.block % stride == 0) & (self.count < most))

    @cached_property
    def blocks(self) -> int:
        """Number of blocks."""
        return int(self.block[-1]) + 1

    @cached_property
    def first(self) -> NDArray[np.int64]:
        """Row at which each ping's block begins, (n,)."""
        return np.searchsorted(self.block, self.block)

    @cached_property
    def starts(self) -> NDArray[np.int64]:
        """Row at which each block begins, (blocks,)."""
        return np.unique(self.first)

    @property
    def stays(self) -> list[NDArray[np.int64]]:
        """Rows of each block."""
        return np.split(np.arange(len(self)), self.starts[1:])

    @property
    def stops(self) -> list[NDArray[np.int64]]:
        """Rows of each block in which the target stood."""
        return [rows for rows, stood in zip(self.stays, self.standing, strict=True) if stood]

    @cached_property
    def standing(self) -> NDArray[np.bool_]:
        """Whether the target stood through each block, rather than moved or was passed by, (blocks,)."""
        distance = self.ping.distance
        way = np.maximum.reduceat(distance, self.starts) - np.minimum.reduceat(distance, self.starts)
        return way <= STANDS_M

    @cached_property
    def count(self) -> NDArray[np.int64]:
        """Number of pings before each in its block, (n,)."""
        return np.arange(len(self)) - self.first

    @cached_property
    def conditions(self) -> Conditions:
        """Conditions and past as tensors."""
        return Conditions.of(self.ping, self.past)

    @cached_property
    def twins(self) -> tuple[Tensor, Tensor]:
        """Offset of the simulation in each ping's cell, m, 0 where unknown, and whether it is known (0 or 1), (n,)."""
        twin = np.full(len(self), np.nan) if self.twin is None else self.twin
        return torch.as_tensor(np.nan_to_num(twin)), torch.as_tensor((~np.isnan(twin)).astype(np.float64))

    @cached_property
    def error(self) -> NDArray[np.float64]:
        """Reading minus true distance, m, (n,); 0 where there was no echo."""
        return np.where(self.reading.echo, self.reading.range - self.ping.distance, 0.0)

    @cached_property
    def urn(self) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Look-back over the block, of `MEMORY` readings at most.

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
    def heard(self) -> tuple[Tensor, Tensor]:
        """Number of pings before each in its block, and of those with an echo, (n,) each."""
        echo = torch.from_numpy(self.reading.echo.astype(np.float64))
        return torch.from_numpy(self.count.astype(np.float64)), _before(echo, self)

    @property
    def reach(self) -> NDArray[np.float64]:
        """How far from where it is expected an echo may lie and be the target's, m, (n,)."""
        return reach(self.ping.distance)

    def near(self, error: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Tell which echoes are the target's, by how far they lie from where it is expected, m, (n,)."""
        return self.reading.echo & (np.abs(error) < self.reach)

    def astray(self, error: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Tell which echoes are not the target's, by how far they lie from where it is expected, m, (n,)."""
        return self.reading.echo & ~self.near(error)

    def per_block(self, value: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return sums of a (n,) or (n, k) array over the blocks, (blocks,) or (blocks, k)."""
        return np.add.reduceat(value, self.starts, axis=0)


def direct_median(law: PhysicalLaw) -> tuple[Tensor, Tensor]:
    """Return where the direct path's reading lies and how far it scatters in one cell, m, (n,) each."""
    state, path = law.state, law.state.direct
    weight = torch.exp(state.log_weight - torch.logsumexp(state.log_weight, dim=0))
    slip = (path.slip_m * path.slip_weight).sum()
    slip_variance = (path.slip_m**2 * path.slip_weight).sum() - slip**2
    lag = (weight * path.lag).sum(dim=0) if path.lag.ndim == 2 else path.lag
    middle = (path.length + lag + slip) * state.scale + state.offset
    grid = max(law.resolution, state.step)
    variance = path.spread**2 + torch.clamp(slip_variance, min=0.0) + grid**2 / 12.0
    return middle, torch.broadcast_to(variance, middle.shape)


def _before(value: Tensor, batch: Batch) -> Tensor:
    """Return sums over the pings before each in its block, (..., n)."""
    total = torch.cumsum(value, dim=-1) - value
    return total - total[..., torch.from_numpy(batch.first)]


def prior_offset(cells: CellNuisance, batch: Batch, wider: float | Tensor = 1.0) -> tuple[Tensor, Tensor]:
    """Return mean and variance of a cell's offset before any of its readings, m and m^2, (n,) each or (banks, n)."""
    twin, known = batch.twins
    spread = (wider * cells.placement_m) ** 2 * (1.0 - (cells.link * known) ** 2) + (wider * LEAST_M) ** 2
    return cells.link * twin, spread


def predicted_offset(law: PhysicalLaw, cells: CellNuisance, batch: Batch) -> tuple[Tensor, Tensor]:
    """Return mean and variance of the offset that a cell's earlier readings predict, m and m^2, (banks, n) each."""
    middle, variance = direct_median(law)
    echo = torch.from_numpy(batch.reading.echo)
    error = torch.where(echo, torch.from_numpy(batch.reading.range) - middle, torch.zeros_like(middle))
    start, prior = prior_offset(cells, batch, number([wider for wider, _ in BANKS])[:, None])
    # a reading counts for the offset as far as it can be the direct path's: smoothly nothing beyond 4 deviations
    near = (error - start) ** 2 / (16.0 * (variance + prior))
    weight = torch.where(echo, 1.0 / (1.0 + near**4), torch.zeros_like(error)) / variance
    precision = 1.0 / prior + _before(weight, batch)
    mean = (start / prior + _before(weight * error, batch)) / precision
    known = torch.from_numpy(batch.count > 0)
    carried = torch.nn.functional.pad((cells.carry * (weight * variance) * (error - mean))[..., :-1], (1, 0))
    return mean + torch.where(known, carried, torch.zeros_like(mean)), 1.0 / precision


def shifted(law: PhysicalLaw, mean: Tensor, variance: Tensor) -> PhysicalLaw:
    """Return the law with its direct path moved by a mean and widened by a variance, (n,) or (banks, 1, n) each."""
    path = law.state.direct
    spread = torch.sqrt(path.spread**2 + variance + 1e-18)
    state = law.state.with_direct(replace(path, length=path.length + mean, spread=spread))
    return PhysicalLaw(state, law.distance, law.resolution, law.max_range)


def sequential(law: PhysicalLaw, cells: CellNuisance, batch: Batch) -> list[PhysicalLaw]:
    """Return the law of each ping given the readings before it in its cell, one a bank: carefully placed, or not."""
    return [shifted(law, *offset) for offset in zip(*predicted_offset(law, cells, batch), strict=True)]


def marginal(law: PhysicalLaw, cells: CellNuisance, batch: Batch) -> list[PhysicalLaw]:
    """Return the law of a ping in a cell that has not been heard of yet, one a bank."""
    return [shifted(law, *prior_offset(cells, batch, wider)) for wider, _ in BANKS]


def alone(law: PhysicalLaw, cells: CellNuisance) -> PhysicalLaw:
    """Return one law of a single ping of whose cell nothing is known: what a simulator should sample."""
    middle, _ = direct_median(law)
    scatter = placement_scatter(1.0) * cells.placement_m
    return shifted(law, torch.zeros_like(middle), torch.zeros_like(middle) + scatter**2)


def log_weights(log_likelihood: Tensor, batch: Batch) -> Tensor:
    """Return the log probability of each bank given the readings before in the cell, of log likelihoods (banks, n)."""
    prior = torch.log(number([share for _, share in BANKS]))[:, None]
    return torch.log_softmax(prior + _before(log_likelihood, batch), dim=0)


def together(law: PhysicalLaw, cells: CellNuisance, batch: Batch) -> PhysicalLaw:
    """Return the laws of `sequential` as one, whose `log_prob_tensor` is (banks, n): one pass through the physics."""
    mean, variance = predicted_offset(law, cells, batch)
    return shifted(law, mean[:, None], variance[:, None])


def by_bank(own: Tensor, cells: CellNuisance, batch: Batch, last_step: int) -> Tensor:
    """Return log probabilities with floor and urn in them, nats, (banks, n), of a law's own probabilities."""
    silent = torch.from_numpy(~batch.reading.echo).to(torch.float64)
    floor = FLOOR * torch.where(silent > 0, silent, number(1.0 / last_step))
    apart, often, none, seen = batch.urn
    half = batch.resolution / 2.0
    upper = torch.special.ndtr((apart + half) / cells.kernel_m) - torch.special.ndtr((apart - half) / cells.kernel_m)
    repeats = cells.sharing * (torch.sparse.mm(often, upper[:, None])[:, 0] + none)
    return torch.log((1.0 - 2.0 * FLOOR) * own + floor + repeats) - torch.log1p(cells.sharing * seen)


def _own(law: PhysicalLaw, cells: CellNuisance, batch: Batch) -> Tensor:
    """Return probabilities under the laws of both banks, (banks, n), that of hearing as earlier pings have it."""
    both = together(law, cells, batch)
    silent, place = both.no_echo_tensor(), both.echo_tensor(both.step(batch.reading.range))
    expected, given = hearing(silent, cells, batch)
    told = given / torch.clamp(expected, min=LEAST)
    return torch.where(torch.from_numpy(batch.reading.echo), place, silent) * told


def hearing(silent: Tensor, cells: CellNuisance, batch: Batch) -> tuple[Tensor, Tensor]:
    """Return the probability of what each ping was, echo or silence: alone, and given those before in its cell.

    Args:
        silent: probability of no echo, (n,) or (banks, n), as is what is returned.
        cells: how far a cell is heard as it was before.
        batch: readings.
    """
    echo = torch.from_numpy(batch.reading.echo)
    count, heard = batch.heard
    expected = torch.where(echo, 1.0 - silent, silent)
    before = torch.where(echo, heard, count - heard)
    return expected, (expected + cells.hearing * before) / (1.0 + cells.hearing * count)


def log_prob(law: PhysicalLaw, cells: CellNuisance, batch: Batch) -> Tensor:
    """Return the prequential log probability of each reading, nats, (n,), differentiable."""
    own = _own(law, cells, batch)
    each = by_bank(own, cells, batch, law.last_step)
    return torch.logsumexp(log_weights(each, batch) + each, dim=0)


def bank_weights(law: PhysicalLaw, cells: CellNuisance, batch: Batch) -> NDArray[np.float64]:
    """Return the probability of each bank given the readings before in the cell, (banks, n)."""
    with torch.no_grad():
        own = _own(law, cells, batch)
        return torch.exp(log_weights(by_bank(own, cells, batch, law.last_step), batch)).numpy()


def placement_scatter(placement_m: float) -> float:
    """Return the standard deviation of where targets lie, careless ones included, m."""
    return placement_m * float(np.sqrt(sum(share * wider**2 for wider, share in BANKS)))


def shared_scatter(cells: CellNuisance, batch: Batch) -> float:
    """Return the standard deviation of what a batch's cells share, careless placement included, m."""
    with torch.no_grad():
        priors = [(share, *prior_offset(cells, batch, wider)) for wider, share in BANKS]
    variance = sum(float(share * spread.mean()) for share, _, spread in priors)
    return float(np.sqrt(variance + float(priors[0][1].var(correction=0))))


def silence(batch: Batch) -> float:
    """Return the share of answered pings without an echo."""
    return float(np.mean(~batch.reading.echo))


def law_of(model: PhysicalModel, batch: Batch) -> PhysicalLaw:
    """Return a model's law of a batch, on the batch's own register."""
    return PhysicalLaw(model.state(batch.conditions), batch.ping.distance, batch.resolution, model.max_range)
