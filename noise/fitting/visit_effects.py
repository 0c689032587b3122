"""Prequential likelihood of pings that share a visit.

A target is placed once per visit, with an error of a few millimetres, and pings seconds apart share the air and the
interference of paths. Counted as independent, 50 pings of one misplaced target contribute hundreds of nats. Each
reading is therefore predicted from its condition and from the earlier readings of its visit; the sum of the log
probabilities is a proper joint log-likelihood, whatever the true dependence (Dawid 1984, prequential statistics).

The prediction combines, in this order:
1. a normal offset shared by the visit (`placement_m`), estimated by a Kalman filter, with a correlation from ping to
   ping (`ping_correlation`); where a simulation has the same condition, the prior mean is the simulation's own offset
   times `simulation_correlation`. A bank of three filters allows for a share `CARELESS` of visits with an offset `WIDE`
   times as large, and for an arbitrary one of probability `FLOOR`, which limits what a misplaced target costs;
2. a normal deviation of the level shared by the visit (`level_sd_db`): close to the detection threshold the placement
   of the target decides, not each ping, so that a visit is heard or missed as a whole; it is integrated over nodes, and
   two more of probability `FLOOR`, always heard and never heard, limit what a visit against all odds costs;
3. a Polya urn over the last readings of the visit (`urn_weight`, `urn_width_m`), so that anything else that repeats
   within a visit (silence, another reflector) counts about once per visit;
4. a floor for arbitrary readings and silences, which limits a single reading to about 17 nats.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import torch
from scipy.stats import norm
from torch import Tensor

from noise.effects import Effect, Parameter, Stage, State
from noise.effects.state import number
from noise.fitting.batch import Batch
from noise.physical import PhysicalLaw, PhysicalModel

WIDE = 4.0  # placement error of a carelessly placed target, as a multiple of `placement_m`; chosen here
CARELESS = 0.1  # share of visits with such a target; chosen here
MIN_PLACEMENT_M = 5e-4  # smallest placement error, whatever a few visits suggest; chosen here
BANKS = ((1.0, 1.0 - CARELESS), (WIDE, CARELESS))
FLOOR = 3e-4  # probability of an arbitrary reading, and of an arbitrary silence, in every law; chosen here
MIN_PROBABILITY = 1e-150  # smallest divisor, whose square, in the gradient, is a number
RARE_ECHO = 1e-6  # probability of an echo below which 1 - P(no echo) has lost its digits
N_LEVELS = 9  # nodes of the level of a visit: a quarter of its deviation apart in the middle


def _level_nodes() -> Tensor:
    """Return equally likely nodes of a standard normal variable, scaled to unit variance, (nodes,)."""
    nodes = norm.ppf((np.arange(N_LEVELS) + 0.5) / N_LEVELS)
    return torch.from_numpy(nodes / nodes.std())


LEVEL_NODES = _level_nodes()
CERTAIN_DB = torch.tensor([1e3, -1e3], dtype=torch.float64)  # levels that are always and never heard


class VisitEffects(Effect):
    """Nuisance parameters that pings of one visit share. The law of a single ping is unchanged."""

    name = "visits"
    stage = Stage.SEQUENCE
    summary = "Pings of one visit share an offset"
    parameters = (
        # the lower bound is positive because the gradient vanishes at zero
        Parameter("placement_m", "m", 2e-4, 2e-4, 0.1, "ruler and mount, 1 to 5 mm; bounds chosen here", (0.003,)),
        Parameter("ping_correlation", "1", 0.0, 0.0, 0.98, "from one ping to the next; chosen here", (0.1,)),
        Parameter("urn_weight", "1", 0.0, 0.0, 5.0, "of an earlier reading relative to the law; chosen here", (0.02,)),
        Parameter("urn_width_m", "m", 0.004, 0.0003, 0.05, "scatter of a repeated reading; chosen here", (0.004,)),
        Parameter("level_sd_db", "dB", 0.0, 0.0, 15.0, "turn of the target and air of a visit; chosen here", (1.0,)),
        Parameter("simulation_correlation", "1", 0.0, 0.0, 0.999, "of offsets in a visit; chosen here", (0.5,)),
    )
    placement_m: Tensor
    ping_correlation: Tensor
    urn_weight: Tensor
    urn_width_m: Tensor
    level_sd_db: Tensor
    simulation_correlation: Tensor
    one_level: bool  # whether all visits have the same level, and will have: its scatter is fixed at zero

    def _set(self, values: Mapping[str, float | Tensor]) -> None:
        super()._set(values)
        scatter = values.get("level_sd_db", 0.0)
        self.one_level = not isinstance(scatter, Tensor) and scatter == 0.0

    def apply(self, state: State) -> State:
        """Return the state unchanged."""
        return state


def direct_median(law: PhysicalLaw) -> tuple[Tensor, Tensor]:
    """Return median, m, and variance, m^2, of the direct path's reading within one visit, (n,) each."""
    state, path = law.state, law.state.direct
    weight = torch.exp(state.log_weight - torch.logsumexp(state.log_weight, dim=0))
    slip = (path.slip_m * path.slip_weight).sum()
    slip_variance = (path.slip_m**2 * path.slip_weight).sum() - slip**2
    lag = (weight * path.lag).sum(dim=0) if path.lag.ndim == 2 else path.lag
    middle = (path.length + lag + slip) * state.scale + state.offset
    grid = max(law.resolution, state.step)
    variance = path.spread**2 + torch.clamp(slip_variance, min=0.0) + grid**2 / 12.0
    return middle, torch.broadcast_to(variance, middle.shape)


def prior_offset(visits: VisitEffects, batch: Batch, walk: Tensor, wider: Tensor) -> tuple[Tensor, Tensor]:
    """Return prior mean, m, (n,), and variance, m^2, (banks, n), of a visit's offset.

    Args:
        visits: visit effects.
        batch: readings.
        walk: of the direct path, m/dB, by which the level of a visit offsets its readings.
        wider: factors of the placement error, (banks, 1).
    """
    simulated, known = batch.simulated_offset_tensors
    correlation = visits.simulation_correlation
    variance = (wider * visits.placement_m) ** 2 * (1.0 - (correlation * known) ** 2) + (wider * MIN_PLACEMENT_M) ** 2
    return correlation * simulated, variance + (walk * visits.level_sd_db) ** 2


def predicted_offset(law: PhysicalLaw, visits: VisitEffects, batch: Batch) -> tuple[Tensor, Tensor]:
    """Return mean, m, and variance, m^2, of the offset given the earlier readings of the visit, (banks, n) each."""
    middle, variance = direct_median(law)
    echo = torch.from_numpy(batch.reading.echo)
    error = torch.where(echo, torch.from_numpy(batch.reading.range) - middle, torch.zeros_like(middle))
    wider = number([wider for wider, _ in BANKS])[:, None]
    start, prior = prior_offset(visits, batch, law.state.direct.walk, wider)
    arbitrary, possible = batch.misplaced
    prior = torch.cat([prior, arbitrary[None]])
    # robust weight: readings beyond 4 standard deviations are hardly the direct path's
    near = (error - start) ** 2 / (16.0 * (variance + prior))
    heard = torch.stack([*[echo] * len(BANKS), possible])
    weight = torch.where(heard, 1.0 / (1.0 + near**4), torch.zeros_like(error)) / variance
    precision = 1.0 / prior + batch.before(weight)
    mean = (start / prior + batch.before(weight * error)) / precision
    innovation = visits.ping_correlation * (weight * variance) * (error - mean)
    carried = torch.nn.functional.pad(innovation[..., :-1], (1, 0))
    return mean + torch.where(torch.from_numpy(batch.count > 0), carried, torch.zeros_like(mean)), 1.0 / precision


def shifted(law: PhysicalLaw, mean: Tensor, variance: Tensor) -> PhysicalLaw:
    """Return a law with its direct path shifted by a mean, m, and widened by a variance, m^2, (n,) or (banks, 1, n)."""
    path = law.state.direct
    return _with_state(law, widened(law.state.with_direct(replace(path, length=path.length + mean)), variance))


def _with_state(law: PhysicalLaw, state: State) -> PhysicalLaw:
    return PhysicalLaw(state, law.distance, law.resolution, law.max_range, law.origin)


def visit_errors(visits: VisitEffects, batch: Batch, rng: np.random.Generator) -> tuple[Tensor, Tensor]:
    """Return random errors of each visit at its pings: placement, careful or careless, m, and level, dB, (n,) each."""
    wider, share = np.transpose(BANKS)
    sd = float(visits.placement_m) * rng.choice(wider, batch.n_visits, p=share)
    offset, louder = (rng.normal(0.0, each, batch.n_visits)[batch.visit] for each in (sd, float(visits.level_sd_db)))
    return torch.from_numpy(offset), torch.from_numpy(louder)


def in_visits(law: PhysicalLaw, offset: Tensor, louder: Tensor) -> PhysicalLaw:
    """Return the law of pings with errors of their visits: placement, m, and level, dB, (n,) each."""
    path = law.state.direct
    length = path.length + offset - path.walk * louder
    return _with_state(law, law.state.with_direct(replace(path, length=length, level_db=path.level_db + louder)))


def widened(state: State, variance: Tensor, level_variance: Tensor | None = None) -> State:
    """Return a state whose direct path scatters more in length and in level, as pings of different visits do.

    The level only has to cross a threshold of normal width, so a normal deviation of the level widens that; and it
    makes the echo earlier or later by the time walk.

    Args:
        state: state of a single visit.
        variance: added to that of the length, m^2.
        level_variance: of the level, dB^2.
    """
    path = state.direct
    if level_variance is not None:
        variance = variance + path.walk**2 * level_variance
        path = replace(path, level_db=path.level_db / torch.sqrt(1.0 + level_variance / state.width_db**2))
    return state.with_direct(path.widened(variance))


def single_ping_law(law: PhysicalLaw, visits: VisitEffects, scale_sd: float = 0.0) -> PhysicalLaw:
    """Return the law of a ping whose visit has no other readings, which is what a simulator samples.

    Args:
        law: law of pings without visit effects.
        visits: visit effects.
        scale_sd: standard deviation of an unknown factor of all distances, such as that of the air on the day.
    """
    middle, _ = direct_median(law)
    scatter = placement_scatter(1.0) * visits.placement_m
    variance = torch.zeros_like(middle) + scatter**2 + (scale_sd * middle) ** 2
    return _with_state(law, widened(law.state, variance, visits.level_sd_db**2))


def log_weights(log_likelihood: Tensor, batch: Batch) -> Tensor:
    """Return the log probability of each bank given the earlier readings of the visit, (banks, n)."""
    prior = torch.log(number([*((1.0 - FLOOR) * share for _, share in BANKS), FLOOR]))[:, None]
    return torch.log_softmax(prior + batch.before(log_likelihood), dim=0)


def all_banks(law: PhysicalLaw, visits: VisitEffects, batch: Batch) -> PhysicalLaw:
    """Return the law of each bank as one law with a batch dimension, (banks, n), for a single evaluation."""
    mean, variance = predicted_offset(law, visits, batch)
    return shifted(law, mean[:, None], variance[:, None])


def with_floor_and_urn(own: Tensor, visits: VisitEffects, batch: Batch, last_step: int) -> Tensor:
    """Return log probabilities, nats, (banks, n), of a law's probabilities mixed with the floor and the urn."""
    silent = torch.from_numpy(~batch.reading.echo).to(torch.float64)
    floor = FLOOR * torch.where(silent > 0, silent, number(1.0 / last_step))
    difference, later, which, n_silent, n_earlier = batch.look_back
    half, width = batch.resolution / 2.0, visits.urn_width_m
    kernel = torch.special.ndtr((difference + half) / width) - torch.special.ndtr((difference - half) / width)
    n_alike = torch.zeros_like(n_silent).index_add(0, later, kernel[which])
    repeats = visits.urn_weight * (n_alike + n_silent)
    return torch.log((1.0 - 2.0 * FLOOR) * own + floor + repeats) - torch.log1p(visits.urn_weight * n_earlier)


def _own(law: PhysicalLaw, visits: VisitEffects, batch: Batch, exact: bool) -> Tensor:
    """Return the probability of each reading under each bank, (banks, n), given the echoes before it in its visit."""
    banks = all_banks(law, visits, batch)
    echo, place = torch.from_numpy(batch.reading.echo), banks.echo_tensor(banks.step(batch.reading.range))
    # 1 where there is no echo: what is not used there would still make the gradient NaN
    likely = torch.where(echo, torch.clamp(outcome_probability(banks, batch, exact), min=MIN_PROBABILITY), 1.0)
    return torch.where(echo, place / likely, 1.0) * outcome_given_visit(law, visits, batch, exact)


def outcome_probability(law: PhysicalLaw, batch: Batch, exact: bool = False) -> Tensor:
    """Return the probability of each ping's outcome, echo or no echo, under a law, (n,) or (banks, n).

    Args:
        law: law of the pings.
        batch: readings.
        exact: whether the exact, slower form is used for every echo, not only where one is rare.
    """
    echo, silent = torch.from_numpy(batch.reading.echo), law.no_echo_tensor()
    likely = 1.0 - silent
    if exact or bool((echo & (likely < RARE_ECHO)).any()):
        likely = torch.where(likely < RARE_ECHO, law.any_echo_tensor(), likely)
    return torch.where(echo, likely, silent)


def outcome_given_visit(law: PhysicalLaw, visits: VisitEffects, batch: Batch, exact: bool = False) -> Tensor:
    """Return the probability of each ping's outcome, echo or no echo, given the earlier ones of its visit, (n,)."""
    sd = visits.level_sd_db
    if visits.one_level:
        return outcome_probability(law, batch, exact)
    silent = _silent_by_level(law, sd * LEVEL_NODES)
    always, never = torch.zeros_like(silent[:1]), torch.ones_like(silent[:1])
    silent = torch.cat([silent, always, never])
    own = torch.where(torch.from_numpy(batch.reading.echo), 1.0 - silent, silent)
    prior = number([*[(1.0 - 2.0 * FLOOR) / N_LEVELS] * N_LEVELS, FLOOR, FLOOR])
    before = batch.before(torch.log((1.0 - 2.0 * FLOOR) * own + FLOOR))
    return (torch.softmax(torch.log(prior)[:, None] + before, dim=0) * own).sum(dim=0)


def _silent_by_level(law: PhysicalLaw, change_db: Tensor) -> Tensor:
    """Return the probability of no echo, (k, n), with the level of the direct path changed by k amounts.

    It is linear in the probability that the direct path is missed, and known where it always or never is.
    """
    path, width = law.state.direct, law.state.width_db
    certain = replace(path, level_db=CERTAIN_DB[:, None, None] + torch.zeros_like(path.level_db))
    heard, missed = _with_state(law, law.state.with_direct(certain)).no_echo_tensor()
    weight = torch.softmax(law.state.log_weight, dim=0)
    miss = (weight * torch.special.ndtr(-(path.level_db + change_db[:, None, None]) / width)).sum(dim=-2)
    return heard + (missed - heard) * miss


def log_prob(law: PhysicalLaw, visits: VisitEffects, batch: Batch, exact: bool = False) -> Tensor:
    """Return the prequential log probability of each reading, nats, (n,), differentiable.

    Args:
        law: law of a single ping.
        visits: what the pings of a visit share.
        batch: readings.
        exact: whether no step depends on the values, as batched evaluation requires.
    """
    own = _own(law, visits, batch, exact)
    each = with_floor_and_urn(own, visits, batch, law.last_step)
    return torch.logsumexp(log_weights(each, batch) + each, dim=0)


def placement_scatter(placement_m: float) -> float:
    """Return the standard deviation of the position of targets, m, carelessly placed ones included."""
    return placement_m * float(np.sqrt(sum(share * wider**2 for wider, share in BANKS)))


def law_of(model: PhysicalModel, batch: Batch) -> PhysicalLaw:
    """Return a model's law of a batch, on the register of the batch."""
    state = model.state(batch.conditions)
    return PhysicalLaw(state, batch.ping.distance, batch.resolution, model.max_range, batch.origin)
