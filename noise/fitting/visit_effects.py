"""Pings that share a cell agree more than any law of single pings says: their likelihood.

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

from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from noise.effects import Effect, Parameter, Stage, State
from noise.effects.base import number
from noise.fitting.batch import Batch
from noise.physical import PhysicalLaw, PhysicalModel

WIDE = 4.0  # how much farther from its mark a carelessly placed target lies; ours
CARELESS = 0.1  # share of such cells; ours
LEAST_M = 5e-4  # nobody puts a target down better, whatever a few cells say; ours
BANKS = ((1.0, 1.0 - CARELESS), (WIDE, CARELESS))
FLOOR = 3e-4  # probability of an arbitrary reading, and of an arbitrary silence, in every law; ours
LEAST = 1e-250  # probability that is divided by
RARE = 1e-6  # probability of an echo, below which 1 - P(no echo) has lost its digits


class VisitEffects(Effect):
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


def prior_offset(cells: VisitEffects, batch: Batch, wider: float | Tensor = 1.0) -> tuple[Tensor, Tensor]:
    """Return mean and variance of a cell's offset before any of its readings, m and m^2, (n,) each or (banks, n)."""
    twin, known = batch.simulated_offset_tensors
    spread = (wider * cells.placement_m) ** 2 * (1.0 - (cells.link * known) ** 2) + (wider * LEAST_M) ** 2
    return cells.link * twin, spread


def predicted_offset(law: PhysicalLaw, cells: VisitEffects, batch: Batch) -> tuple[Tensor, Tensor]:
    """Return mean and variance of the offset that a cell's earlier readings predict, m and m^2, (banks, n) each."""
    middle, variance = direct_median(law)
    echo = torch.from_numpy(batch.reading.echo)
    error = torch.where(echo, torch.from_numpy(batch.reading.range) - middle, torch.zeros_like(middle))
    start, prior = prior_offset(cells, batch, number([wider for wider, _ in BANKS])[:, None])
    # a reading counts for the offset as far as it can be the direct path's: smoothly nothing beyond 4 deviations
    near = (error - start) ** 2 / (16.0 * (variance + prior))
    weight = torch.where(echo, 1.0 / (1.0 + near**4), torch.zeros_like(error)) / variance
    precision = 1.0 / prior + batch.before(weight)
    mean = (start / prior + batch.before(weight * error)) / precision
    known = torch.from_numpy(batch.count > 0)
    carried = torch.nn.functional.pad((cells.carry * (weight * variance) * (error - mean))[..., :-1], (1, 0))
    return mean + torch.where(known, carried, torch.zeros_like(mean)), 1.0 / precision


def shifted(law: PhysicalLaw, mean: Tensor, variance: Tensor) -> PhysicalLaw:
    """Return the law with its direct path moved by a mean and widened by a variance, (n,) or (banks, 1, n) each."""
    path = law.state.direct
    spread = torch.sqrt(path.spread**2 + variance + 1e-18)
    state = law.state.with_direct(replace(path, length=path.length + mean, spread=spread))
    return PhysicalLaw(state, law.distance, law.resolution, law.max_range)


def sequential(law: PhysicalLaw, cells: VisitEffects, batch: Batch) -> list[PhysicalLaw]:
    """Return the law of each ping given the readings before it in its cell, one a bank: carefully placed, or not."""
    return [shifted(law, *offset) for offset in zip(*predicted_offset(law, cells, batch), strict=True)]


def marginal(law: PhysicalLaw, cells: VisitEffects, batch: Batch) -> list[PhysicalLaw]:
    """Return the law of a ping in a cell that has not been heard of yet, one a bank."""
    return [shifted(law, *prior_offset(cells, batch, wider)) for wider, _ in BANKS]


def alone(law: PhysicalLaw, cells: VisitEffects, scale_sd: float = 0.0) -> PhysicalLaw:
    """Return one law of a single ping of whose cell nothing is known: what a simulator should sample.

    Args:
        law: of pings.
        cells: what pings of a cell share.
        scale_sd: of a factor of all distances that nobody knows either, such as what the air of the day makes of them.
    """
    middle, _ = direct_median(law)
    scatter = placement_scatter(1.0) * cells.placement_m
    return shifted(law, torch.zeros_like(middle), torch.zeros_like(middle) + scatter**2 + (scale_sd * middle) ** 2)


def log_weights(log_likelihood: Tensor, batch: Batch) -> Tensor:
    """Return the log probability of each bank given the readings before in the cell, of log likelihoods (banks, n)."""
    prior = torch.log(number([share for _, share in BANKS]))[:, None]
    return torch.log_softmax(prior + batch.before(log_likelihood), dim=0)


def together(law: PhysicalLaw, cells: VisitEffects, batch: Batch) -> PhysicalLaw:
    """Return the laws of `sequential` as one, whose `log_prob_tensor` is (banks, n): one pass through the physics."""
    mean, variance = predicted_offset(law, cells, batch)
    return shifted(law, mean[:, None], variance[:, None])


def by_bank(own: Tensor, cells: VisitEffects, batch: Batch, last_step: int) -> Tensor:
    """Return log probabilities with floor and urn in them, nats, (banks, n), of a law's own probabilities."""
    silent = torch.from_numpy(~batch.reading.echo).to(torch.float64)
    floor = FLOOR * torch.where(silent > 0, silent, number(1.0 / last_step))
    apart, often, none, seen = batch.look_back
    half = batch.resolution / 2.0
    upper = torch.special.ndtr((apart + half) / cells.kernel_m) - torch.special.ndtr((apart - half) / cells.kernel_m)
    repeats = cells.sharing * (torch.sparse.mm(often, upper[:, None])[:, 0] + none)
    return torch.log((1.0 - 2.0 * FLOOR) * own + floor + repeats) - torch.log1p(cells.sharing * seen)


def _own(law: PhysicalLaw, cells: VisitEffects, batch: Batch) -> Tensor:
    """Return probabilities under the laws of both banks, (banks, n), that of hearing as earlier pings have it."""
    both = together(law, cells, batch)
    echo, place = torch.from_numpy(batch.reading.echo), both.echo_tensor(both.step(batch.reading.range))
    expected, given = hearing(both, cells, batch)
    return torch.where(echo, place / torch.clamp(expected, min=LEAST), 1.0) * given


def hearing(law: PhysicalLaw, cells: VisitEffects, batch: Batch) -> tuple[Tensor, Tensor]:
    """Return the probability of what each ping was, echo or silence: alone, and given those before in its cell.

    Args:
        law: of each ping, whose probabilities are (n,) or (banks, n), as is what is returned.
        cells: how far a cell is heard as it was before.
        batch: readings.
    """
    echo, silent = torch.from_numpy(batch.reading.echo), law.no_echo_tensor()
    count, heard = batch.echo_counts
    expected = torch.where(echo, _heard(law, silent, echo), silent)
    before = torch.where(echo, heard, count - heard)
    return expected, (expected + cells.hearing * before) / (1.0 + cells.hearing * count)


def _heard(law: PhysicalLaw, silent: Tensor, echo: Tensor) -> Tensor:
    """Return the probability of an echo, of pings that brought one: where it is rare, exactly, which costs more."""
    likely = 1.0 - silent
    rare = echo & (likely < RARE)
    return torch.where(rare, law.heard_tensor(), likely) if bool(rare.any()) else likely


def log_prob(law: PhysicalLaw, cells: VisitEffects, batch: Batch) -> Tensor:
    """Return the prequential log probability of each reading, nats, (n,), differentiable."""
    own = _own(law, cells, batch)
    each = by_bank(own, cells, batch, law.last_step)
    return torch.logsumexp(log_weights(each, batch) + each, dim=0)


def bank_weights(law: PhysicalLaw, cells: VisitEffects, batch: Batch) -> NDArray[np.float64]:
    """Return the probability of each bank given the readings before in the cell, (banks, n)."""
    with torch.no_grad():
        own = _own(law, cells, batch)
        return torch.exp(log_weights(by_bank(own, cells, batch, law.last_step), batch)).numpy()


def placement_scatter(placement_m: float) -> float:
    """Return the standard deviation of where targets lie, careless ones included, m."""
    return placement_m * float(np.sqrt(sum(share * wider**2 for wider, share in BANKS)))


def shared_scatter(cells: VisitEffects, batch: Batch) -> float:
    """Return the standard deviation of what a batch's cells share, careless placement included, m."""
    with torch.no_grad():
        priors = [(share, *prior_offset(cells, batch, wider)) for wider, share in BANKS]
    variance = sum(float(share * spread.mean()) for share, _, spread in priors)
    return float(np.sqrt(variance + float(priors[0][1].var(correction=0))))


def law_of(model: PhysicalModel, batch: Batch) -> PhysicalLaw:
    """Return a model's law of a batch, on the batch's own register."""
    return PhysicalLaw(model.state(batch.conditions), batch.ping.distance, batch.resolution, model.max_range)
