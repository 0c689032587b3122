"""The law that stands for the simulation in the search: the given model itself, or an emulator fitted to its readings.

An emulator is a physical law found by the same search on the simulation's own readings, plus a smooth part without a
cause (`noise.empirical`). It is checked on simulated cells it was not fitted to. Its readings are their own null: an
effect that also improves held-out *simulated* cells repairs the emulator and says nothing about the real sonar.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from acquisition import Ping, Recording
from noise.cells import Batch
from noise.discrepancy.rest import scan_p
from noise.discrepancy.search import Attempt, Crossed, Rules, Search, spread_over_blocks
from noise.discrepancy.splits import Split
from noise.discrepancy.verdict import BaselineCheck
from noise.empirical import Flexible
from noise.fit import NUISANCES, SPREAD, Key, Stack, maximise, nuisance_start
from noise.model import IdealModel, SonarModel, simulate
from noise.physical import PhysicalModel

EMULATOR_RULES = Rules(fitted=8, crossed=3, most_effects=3, full_pings=2000)
REPEATS = 4  # readings a condition that are drawn from a model to be emulated
MOST_CONDITIONS = 600


@dataclass(frozen=True)
class Baseline:
    """What the search starts from.

    Attributes:
        stack: the law and its nuisances.
        raw: the model whose readings are shown as "before".
        check: whether the law describes the simulation.
        own: the simulation's readings, searched beside the recording; None for a model that is used as it is.
    """

    stack: Stack
    raw: SonarModel
    check: BaselineCheck
    own: Split | None = None

    def without_repairs(self, search: Search, chosen: list[str], cross: Crossed) -> tuple[list[str], Crossed]:
        """Drop effects that gain on held-out simulated readings about as much as on the recording."""
        if self.own is None or not chosen:
            return chosen, cross
        null = Search(self.stack, self.own.discover, self.own.confirm, self.own.both, search.seed, search.rules)
        for name in list(chosen):
            share = self._gain_on_own(null, name, cross)
            gain = (
                cross.nats - search.cross(search.reset(cross.first.stack, name), [n for n in chosen if n != name]).nats
            )
            if share > 0.5 * gain.sum() / len(gain):
                chosen = [other for other in chosen if other != name]
                nats, error = float(gain.sum()), spread_over_blocks(gain)
                told = "gains as much on the simulation itself: repairs the emulator"
                search.attempts.append(Attempt(name, tuple(chosen), np.nan, nats, error, told))
                cross = search.cross(search.reset(cross.first.stack, name), chosen)
        return chosen, cross

    def _gain_on_own(self, null: Search, name: str, cross: Crossed) -> float:
        """Return the cross-fitted gain of an effect on the simulation's readings, nats a block."""
        own = null.cross(self.stack, [])
        start = self.stack.put(null.keys([name]), [cross.first.stack.get(key) for key in null.keys([name])])
        gain = null.cross(start, [name]).nats - own.nats
        return float(gain.sum()) / len(gain)


def baseline_of(model: SonarModel, recording: Recording, simulated: Recording | None, seed: int) -> Baseline:
    """Return the law that stands for a model, or for a simulator's readings."""
    if simulated is not None:
        return emulated(simulated, None, seed)
    if isinstance(model, IdealModel):
        physical = PhysicalModel((), model.resolution, model.max_range)
        return Baseline(Stack.of(physical), model, BaselineCheck(True, 1.0, "the ideal sonar is used as it is"))
    if isinstance(model, PhysicalModel):
        return Baseline(Stack.of(model), model, BaselineCheck(True, 1.0, "the given physical model is used as it is"))
    return emulated(sampled(model, recording, seed), model, seed)


def sampled(model: SonarModel, recording: Recording, seed: int) -> Recording:
    """Return readings of a model on a recording's own conditions."""
    rows = np.unique(recording.cell, return_index=True)[1]
    rng = np.random.default_rng([seed, 5])
    if len(rows) > MOST_CONDITIONS:
        rows = np.sort(rng.choice(rows, MOST_CONDITIONS, replace=False))
    ping = recording.ping[np.repeat(rows, REPEATS)]
    ping = replace(ping, time=np.arange(len(ping), dtype=np.float64), run=np.zeros(len(ping), dtype=np.int64))
    bare = Ping(ping.distance, ping.angle, ping.incidence, ping.reflectance, ping.time, ping.run, {})
    return Recording.of(bare, simulate(model, ping, rng), name=f"{type(model).__name__} sampled")


def emulated(simulated: Recording, raw: SonarModel | None, seed: int) -> Baseline:
    """Return an emulator of a simulation, checked on cells it was not fitted to."""
    split = Split.of(Batch.of(simulated), np.random.default_rng([seed, 6]))
    start = nuisance_start(Stack.of(PhysicalModel((), simulated.resolution)), split.discover)
    start = maximise(start, NUISANCES, split.discover.thin(2000), 60).stack
    search = Search(start, split.discover, split.confirm, split.both, seed, EMULATOR_RULES)
    chosen, _, cross = search.run()
    stack = _smoothed(search, chosen, cross)
    p = scan_p(stack, split.vault, np.random.default_rng([seed, 7]))
    good = p >= 0.01
    words = "describes" if good else "does not fully describe"
    note = f"an emulator ({', '.join(chosen) or 'no effect'}, and a smooth part) {words} the simulation's own readings"
    plain = PhysicalModel([stack.known[n](**v) for n, v in stack.values.items() if n != "cells"], simulated.resolution)
    return Baseline(stack, raw or plain, BaselineCheck(good, p, note), split)


def _smoothed(search: Search, chosen: Sequence[str], cross: Crossed) -> Stack:
    """Return the explanation with a smooth part, where that gains on cells it was not fitted to."""
    stack = replace(cross.first.stack, extra={Flexible.name: Flexible})
    wider = replace(search, base=replace(search.base, extra=stack.extra))
    fine: tuple[Key, ...] = tuple((Flexible.name, p.name) for p in Flexible.parameters)
    free = (*search.keys(chosen), *SPREAD, *fine)
    fitted = maximise(stack.put(fine, [0.0] * len(fine)), free, search.both, 60)
    with_smooth = wider.cross(fitted.stack, [*chosen, Flexible.name])
    gain = with_smooth.nats - cross.nats
    if gain.sum() > search.rules.least_nats and gain.sum() > search.rules.least_t * spread_over_blocks(gain):
        return maximise(fitted.stack, (*free, *NUISANCES), search.both, 40).stack
    return maximise(cross.first.stack, (*search.keys(chosen), *NUISANCES), search.both, 60).stack
