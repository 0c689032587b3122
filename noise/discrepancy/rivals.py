"""What else could explain it as well: rivals of each chosen effect, on the conditions that were actually measured.

For every effect chosen, every other effect of the catalogue takes its place and is fitted anew. Two numbers decide:
`observed`, by how many nats the data prefer the chosen one, and `expected`, N KL(chosen || rival) minimised over the
rival's parameters: by how many they could at all, on these conditions. The probability of preferring the right one of
a pair is about Phi(sqrt(D/2)): 5.4 nats for 95 %, 10.8 for 99 %.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from acquisition import Ping
from noise.cells import BANKS, Batch, law_of, prior_offset
from noise.discrepancy.search import Search
from noise.fit import Fit, Scales, maximise
from noise.law import Floats
from noise.stack import NUISANCES, SPREAD, Stack

SAME = 5.4  # nats: the right one of a pair is preferred with 95 %
SETTLED = 10.8  # nats: 99 %
NEAR = 20.0  # nats observed, beyond which a rival is lost whatever could be expected
TIE = 3.0  # nats observed: less does not exclude anything


@dataclass(frozen=True)
class Rival:
    """Another explanation in the place of a chosen effect.

    Attributes:
        effect: id of the rival.
        replaces: the chosen effect.
        observed: nats by which the data prefer the chosen effect, parameters counted.
        expected: nats by which they are expected to, on these conditions; nan where the rival is far off.
        stack: the rival explanation, fitted.
    """

    effect: str
    replaces: str
    observed: float
    expected: float
    stack: Stack

    @property
    def survives(self) -> bool:
        """Whether the data do not exclude it."""
        alike = not np.isnan(self.expected) and self.expected < SAME and self.observed < SETTLED
        return alike or self.observed < TIE


def replica(stack: Stack, batch: Batch, rng: np.random.Generator) -> Batch:
    """Return the batch with readings that a stack draws, every block at its own offset."""
    model, cells = stack.build()
    with torch.no_grad():
        middle, variance = (x.numpy()[np.unique(batch.first)] for x in prior_offset(cells, batch))
    wider = rng.choice([wide for wide, _ in BANKS], batch.blocks, p=[share for _, share in BANKS])
    offset = rng.normal(middle, wider * np.sqrt(variance))[batch.block]
    ping: Ping = replace(batch.ping, distance=np.maximum(batch.ping.distance + offset, 1e-3))
    with torch.no_grad():
        moved = replace(batch, ping=ping)
        reading = law_of(model, moved).sample(rng)
    return replace(batch, reading=reading)


def rivals(search: Search, stack: Stack, chosen: Sequence[str], effect: str, rng: np.random.Generator) -> list[Rival]:
    """Return the rivals of one chosen effect, nearest first.

    Args:
        search: data and catalogue.
        stack: the explanation, fitted.
        chosen: its effects.
        effect: the one to replace.
        rng: for the replicas.
    """
    others = [name for name in chosen if name != effect]
    search.reset(stack, effect)
    fits = search.fits.get(tuple(others)) or _fitted(search, search.reset(stack, effect), others, chosen)
    own = maximise(stack, (*search.keys(chosen), *SPREAD), search.screen, 25)
    out = []
    for name, fitted in fits.items():
        if name in chosen:
            continue
        more = len(search.keys([name])) - len(search.keys([effect]))
        observed = own.nats - fitted.nats + more
        if observed < NEAR:
            observed, expected, best = _compare(search, stack, chosen, fitted.stack, [*others, name], rng)
            out.append(Rival(name, effect, observed + more, expected, best))
        else:
            out.append(Rival(name, effect, observed, np.nan, fitted.stack))
    return sorted(out, key=lambda rival: rival.observed)


def _fitted(search: Search, without: Stack, others: Sequence[str], chosen: Sequence[str]) -> dict[str, Fit]:
    """Return fits of the effects that come nearest in the place of one."""
    grids = {name: search.points(without, name) for name in search.candidates() if name not in chosen}
    near = sorted(grids, key=lambda name: -grids[name][0][0])[: search.rules.rivals]
    return {name: search.climbed(grids[name], others, name) for name in near}


def _compare(
    search: Search, stack: Stack, chosen: Sequence[str], rival: Stack, others: Sequence[str], rng: np.random.Generator
) -> tuple[float, float, Stack]:
    """Return observed and expected nats between an explanation and a rival on all open data, and the rival's fit."""
    batch = search.both
    scales = search.scales(batch)
    own = maximise(stack, (*search.keys(chosen), *NUISANCES), batch, 30, scales=scales)
    other = maximise(rival, (*search.keys(others), *NUISANCES), batch, 30, scales=scales)
    if stack.model.remembers or rival.model.remembers:
        return own.nats - other.nats, np.nan, other.stack
    drawn = replica(own.stack, batch, rng)
    again: Scales = {}
    same = maximise(own.stack, (*search.keys(chosen), *NUISANCES), drawn, 30, scales=again)
    best = maximise(other.stack, (*search.keys(others), *NUISANCES), drawn, 30, scales=again)
    return own.nats - other.nats, max(same.nats - best.nats, 0.0), other.stack


def posterior(own: Sequence[Rival]) -> float:
    """Return the posterior probability of a chosen effect against its rivals, all equally likely before."""
    weights: Floats = np.exp(-np.array([0.0, *(max(r.observed, 0.0) for r in own)]))
    return float(1.0 / weights.sum())
