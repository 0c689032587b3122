"""What else could explain it as well: rivals of each chosen effect, on the conditions that were actually measured.

For every effect chosen, every other effect of the catalogue takes its place and is fitted anew. Two numbers decide:
`observed`, by how many nats the data prefer the chosen one, and `expected`, N KL(chosen || rival) minimised over the
rival's parameters: by how many they could at all, on these conditions. The probability of preferring the right one of
a pair is about Phi(sqrt(D/2)): 5.4 nats for 95 %, 10.8 for 99 %.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import torch

from acquisition import Ping
from acquisition.arrays import Floats
from noise.discrepancy.common.rules import TIE
from noise.discrepancy.name.explanation import Explained
from noise.discrepancy.name.search import Crossed, Search
from noise.effects import CATALOGUE
from noise.fitting.batch import Batch
from noise.fitting.fit import Fit, Scales, highest, maximise
from noise.fitting.stack import NUISANCES, SPREAD, Key, Stack
from noise.fitting.starts import echoes_of
from noise.fitting.visit_effects import BANKS, law_of, prior_offset

SAME = 5.4  # nats: the right one of a pair is preferred with 95 %
SETTLED = 10.8  # nats: 99 %
NEAR = 20.0  # nats observed, beyond which a rival is lost whatever could be expected
CLOSE = 3.0  # nats behind the chosen effect on the grid, within which another is fitted too; ours


@dataclass(frozen=True)
class Rival:
    """Another explanation in the place of a chosen effect.

    Attributes:
        effect: id of the rival.
        replaces: the chosen effect.
        observed: nats by which the data prefer the chosen effect, parameters counted, or unseen cells do, if more.
        expected: nats by which they are expected to, on these conditions; nan where the rival is far off.
        stack: the rival explanation, fitted.
        more: parameters that it has beyond the chosen effect's.
    """

    effect: str
    replaces: str
    observed: float
    expected: float
    stack: Stack
    more: int = 0

    @property
    def alike(self) -> bool:
        """Whether these conditions could not tell the two apart."""
        return not np.isnan(self.expected) and self.expected < SAME and self.observed < SETTLED

    @property
    def survives(self) -> bool:
        """Whether the data do not exclude it."""
        return self.alike or self.observed < TIE


def replica(stack: Stack, batch: Batch, rng: np.random.Generator) -> Batch:
    """Return the batch with readings that a stack draws, every block at its own offset."""
    model, cells = stack.build()
    with torch.no_grad():
        middle, variance = (x.numpy()[batch.starts] for x in prior_offset(cells, batch))
    wider = rng.choice([wide for wide, _ in BANKS], batch.n_visits, p=[share for _, share in BANKS])
    offset = rng.normal(middle, wider * np.sqrt(variance))[batch.visit]
    ping: Ping = replace(batch.ping, distance=np.maximum(batch.ping.distance + offset, 1e-3))
    with torch.no_grad():
        moved = replace(batch, ping=ping)
        reading = law_of(model, moved).sample(rng)
    return replace(batch, reading=reading)


def rivals(search: Search, why: Explained, effect: str, rng: np.random.Generator) -> list[Rival]:
    """Return the rivals of one chosen effect, nearest first.

    Args:
        search: data and catalogue.
        why: the explanation.
        effect: the one to replace.
        rng: for the replicas.
    """
    chosen, stack = why.chosen, why.final.stack
    others = [name for name in chosen if name != effect]
    own = maximise(stack, (*search.keys(chosen), *SPREAD), search.screen, 25)
    out: dict[str, Rival] = {}
    for name, fitted in _near(search, stack, others, effect).items():
        more = len(search.keys([name])) - len(search.keys([effect]))
        out[name] = Rival(name, effect, own.nats - fitted.nats + more, np.nan, fitted.stack, more)
    close = {name: rival for name, rival in out.items() if rival.observed < NEAR}
    if close:
        contest = Contest.of(search, why, rng)
        out |= search.each(lambda one, _, rival: contest.against(one, rival, others), close)
    return sorted(out.values(), key=lambda rival: rival.observed)


def _near(search: Search, stack: Stack, others: Sequence[str], effect: str) -> dict[str, Fit]:
    """Return fits of what may take an effect's place: fitted there in the search, or starting as near as itself."""
    without, given = search.reset(stack, effect), tuple(others)
    fits, grids = dict(search.fits.get(given, {})), search.grids.get(given)
    if grids is None:
        open_ = [name for name in search.candidates() if name not in others]
        grids = search.each(lambda one, name, at: one.points(at, name), dict.fromkeys(open_, without))
    reach = grids[effect][0][0] - CLOSE
    order = sorted((name for name in grids if name != effect), key=lambda name: -grids[name][0][0])
    near = [name for k, name in enumerate(order) if grids[name][0][0] > reach or (not fits and k < search.rules.rivals)]
    fits |= search.climbs({name: grids[name] for name in near if name not in fits}, others)
    able = [name for name in search.candidates() if name not in (*others, effect)]
    return {name: fits[name] for name in able if name in fits}


@dataclass(frozen=True, eq=False)
class Contest:
    """One explanation against others, on all open data and on a replica of them that the explanation itself draws.

    What is the explanation's alone, its fit, the replica and its fit to that, is made once, and every rival meets the
    same replica.

    Attributes:
        cross, own: the explanation, cross-fitted and fitted to all open data.
        replica: readings that it draws; None where it remembers the readings before, which a replica cannot.
        again: its fit to them.
        scales: of nuisances, measured on them.
    """

    cross: Crossed
    own: Fit
    replica: Batch | None = None
    again: Fit | None = None
    scales: Scales = field(default_factory=dict)

    @classmethod
    def of(cls, search: Search, why: Explained, rng: np.random.Generator) -> Contest:
        """Put up an explanation; `rng` draws the replica."""
        own, scales = why.final.fits[0], dict[Key, float]()
        if own.stack.model.remembers:
            return cls(why.cross, own)
        drawn = replica(own.stack, search.both, rng)
        again = maximise(own.stack, (*search.keys(why.chosen), *NUISANCES), drawn, 30, scales=scales)
        return cls(why.cross, own, drawn, again, scales)

    def against(self, search: Search, rival: Rival, others: Sequence[str]) -> Rival:
        """Return a rival that was met on all open data: fitted there, and on unseen cells where it is no twin.

        Args:
            search: of the same data.
            rival: as it looked from afar.
            others: the effects that it shares with the explanation.
        """
        effects = [*others, rival.effect]
        free = (*search.keys(effects), *NUISANCES)
        other = self._fitted(search, rival, free)
        expected = self._expected(search, replace(rival, stack=other.stack), free)
        met = replace(rival, observed=self.own.nats - other.nats + rival.more, expected=expected, stack=other.stack)
        if met.alike or met.observed >= TIE:
            return met
        # what fits as well where it was fitted may only be the more pliant: unseen cells tell, if none of its summits
        # does as well on them
        crossed = (search.cross(other.stack, effects, near=near) for near in (self.cross, None))
        lost = min(float((self.cross.nats - each.nats).sum()) for each in crossed)
        return replace(met, observed=max(met.observed, lost))

    def _fitted(self, search: Search, rival: Rival, free: Sequence[Key]) -> Fit:
        """Return a rival's fit to all open data; one that loses begins once more where the explanation ended.

        Another summit among the nuisances would exclude a twin.
        """
        batch = search.both
        found = maximise(rival.stack, free, batch, 30, scales=search.scales(batch))
        if self.own.nats - found.nats + rival.more < TIE:
            return found
        beside = _instead(search, self.own.stack, rival)
        return highest((found, maximise(beside, free, batch, 30, scales=search.scales(batch))))

    def _expected(self, search: Search, rival: Rival, free: Sequence[Key]) -> float:
        """Return by how many nats the replica prefers the explanation; nan where there is none, or no law for it."""
        if self.replica is None or self.again is None or rival.stack.model.remembers:
            return np.nan
        best = maximise(_instead(search, self.again.stack, rival), free, self.replica, 30, scales=dict(self.scales))
        return max(self.again.nats - best.nats, 0.0)


def _instead(search: Search, stack: Stack, rival: Rival) -> Stack:
    """Return an explanation's stack with a rival in the place of the effect, at the rival's own values."""
    keys = search.keys([rival.effect])
    return search.reset(stack, rival.replaces).put(keys, [rival.stack.get(key) for key in keys])


def in_disguise(search: Search, names: Sequence[str], chosen: Sequence[str]) -> tuple[str, ...]:
    """Return effects that pass for one of some names, and that these readings are too few to tell from them.

    Args:
        search: its readings.
        names: an effect, and what cannot be told from it.
        chosen: effects of the explanation, which are named anyway.
    """
    seen = echoes_of(search.discover)
    able = [kind for name, kind in CATALOGUE.items() if name not in (*names, *chosen, *search.never)]
    return tuple(kind.name for kind in able if set(kind.confused_with) & set(names) and kind.ambiguous(seen))


def posterior(own: Sequence[Rival]) -> float:
    """Return the posterior probability of a chosen effect against its rivals, all equally likely before."""
    weights: Floats = np.exp(-np.array([0.0, *(max(r.observed, 0.0) for r in own)]))
    return float(1.0 / weights.sum())
