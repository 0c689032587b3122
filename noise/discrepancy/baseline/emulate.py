"""The law that stands for the simulation in the search: the given model itself, or an emulator fitted to its readings.

An emulator is a physical law with what sonars usually have, fitted to the simulation's own readings, plus a smooth
part without a cause (`noise.fitting.empirical`). It is checked on simulated cells it was not fitted to. Its readings
are their own null: an effect that also improves held-out *simulated* cells repairs the emulator and says nothing about
the real sonar.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from acquisition import ModelError, Ping, Reading, Recording
from acquisition.arrays import Floats
from noise.discrepancy.baseline.emulator import emulator
from noise.discrepancy.checks.company import company
from noise.discrepancy.checks.held import still
from noise.discrepancy.checks.remainder import remainder
from noise.discrepancy.checks.smooth import smooth
from noise.discrepancy.checks.trailing import trailing
from noise.discrepancy.common.rules import AIR, Attempt, Rules, spread_over_blocks
from noise.discrepancy.common.splits import Split
from noise.discrepancy.common.struck import more_struck
from noise.discrepancy.common.workers import ALONE, Workers
from noise.discrepancy.judge.rest import Usual
from noise.discrepancy.judge.verdict import BaselineCheck
from noise.discrepancy.locate.locate import ALARM
from noise.discrepancy.locate.matched import conditions_of
from noise.discrepancy.locate.residuals import residuals
from noise.discrepancy.locate.scan import Blocks, scan
from noise.discrepancy.name.search import Crossed, Search
from noise.fitting.batch import Batch
from noise.fitting.stack import VISITS, Stack
from noise.model import IdealModel, SonarModel, simulate
from noise.physical import PhysicalModel

Simulator = Callable[[Ping, np.random.Generator], Reading | Floats]
EMULATOR_PINGS = 1500
PEER_PINGS = 6000
MOST_ASKED = 6000
FEW_BY_CHANCE = 0.1  # of so many stays with strays, below which they count beside what is gained: four to none; ours
NONE_BY_CHANCE = 0.01  # the same, below which whatever is gained is enough: seven to none; ours
COUNTED_T = 1.5  # standard errors that are enough then: of five stays whose gains differ by as much as they are; ours
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

    def rules(self, batch: Batch) -> Rules:
        """Return when to believe: an emulator errs too, by as much as its own readings are few.

        Twice the log likelihood ratio of what is the same in both grows by 1 + (blocks recorded / blocks simulated).
        """
        plain = Rules()
        if self.own is None:
            return plain
        factor = 1.0 + batch.n_visits / max(self.own.both.n_visits, 1)
        by_chance = more_struck(batch, self.own.both)
        return replace(
            plain,
            least_nats=factor * plain.least_nats,
            least_t=float(np.sqrt(factor)) * plain.least_t,
            sweeping_nats=factor * plain.least_nats if by_chance < NONE_BY_CHANCE else plain.sweeping_nats,
            sweeping_t=COUNTED_T if by_chance < FEW_BY_CHANCE else plain.sweeping_t,
        )

    def with_twins(self, batch: Batch) -> Batch:
        """Return a batch whose cells know how far the simulation's readings lie from this law in the same condition."""
        if self.own is None:
            return batch
        found = _offsets(self.stack, self.own.whole)
        twin = np.array([found.get(key, np.nan) for key in conditions_of(batch.ping)])
        return batch if np.isnan(twin).all() else replace(batch, simulated_offset=twin)

    def untied(self, batch: Batch) -> Batch | None:
        """Return the simulation's readings where no position of a batch is held against them; None for a given law."""
        return self.own.whole if self.own is not None and batch.simulated_offset is None else None

    def peer(self, seed: int) -> Blocks | None:
        """Return how the simulation's own readings score under the law; None for a model that is used as it is."""
        if self.own is None:
            return None
        batch = self.own.whole.thin(PEER_PINGS)
        return Blocks(residuals(self.stack, batch, np.random.default_rng([seed, 8])), batch)

    def usual(self, seed: int, step: float) -> Usual:
        """Return what looks at the rest find in the simulation itself; nothing for a model that is used as it is.

        Args:
            seed: of draws.
            step: of the recording's register, m: on a coarser one than its own the simulation changes less.
        """
        if self.own is None:
            return Usual()
        whole = self.own.whole
        learned = remainder(self.stack, whole.thin(EMULATOR_PINGS), np.random.default_rng([seed, 11]))
        unmoved = still(whole, max(step, whole.resolution))
        own = company(self.stack, whole).usual, smooth(self.stack, whole)
        return Usual(learned, *own, unmoved, trailing(self.stack, whole))

    def without_repairs(
        self, search: Search, chosen: list[str], cross: Crossed, plain: Crossed
    ) -> tuple[list[str], Crossed]:
        """Drop effects that gain on held-out simulated readings about as much as on the recording, and no more beyond.

        Beside other effects livelier air is dropped too, unless it gains more than another day or a law's misfit may.

        Args:
            search: of the recording.
            chosen: effects of the explanation.
            cross: the explanation.
            plain: the law without any of them, from whose nuisances the others are fitted anew where one is dropped.
        """
        if self.own is None or not chosen:
            return chosen, cross
        null = Search(self.stack, self.own.discover, self.own.confirm, self.own.both, search.seed, search.rules)
        for name in list(chosen):
            gain, without = search.contribution(chosen, cross, name)
            if self._repaired(null, search, chosen, cross, name, gain):
                told = "gains as much on the simulation itself: repairs the emulator"
                search.never = (*search.never, name)  # nor is it a rival of anything
            elif not search.rules.believes(name, gain, first=len(chosen) == 1):
                told = "not more than chance without what repaired the emulator"
            elif len(chosen) > 1 and gain.sum() < AIR.get(name, 0.0):
                told = "no more than another day's air changes by itself"
            else:
                continue
            chosen = [other for other in chosen if other != name]
            nats, error = float(gain.sum()), spread_over_blocks(gain)
            search.attempts.append(Attempt(name, tuple(chosen), np.nan, nats, error, told))
            afresh = search.cross(cross.first.stack, chosen, near=plain)
            cross = max(without, afresh, key=lambda each: float(each.nats.sum()))
        return chosen, cross

    def _repaired(
        self, null: Search, search: Search, chosen: list[str], cross: Crossed, name: str, gain: Floats
    ) -> bool:
        """Tell whether an effect mends this law as much as it mends it for the recording.

        Where it gains on the simulation's readings too, only what it gains on the recording beyond the values that the
        simulation asks for counts: a law that is off by 5 mm one way hides no offset of 20 mm the other way.
        """
        keys = null.keys([name])
        start = self.stack.put(keys, [cross.first.stack.get(key) for key in keys])
        own, with_it = null.cross(self.stack, []), null.cross(start, [name])
        if float((with_it.nats - own.nats).sum()) / len(own.nats) <= 0.5 * gain.sum() / len(gain):
            return False
        asked = [0.5 * (with_it.first.stack.get(key) + with_it.second.stack.get(key)) for key in keys]
        mended = search.cross(cross.first.stack.put(keys, asked), [other for other in chosen if other != name])
        beyond = cross.nats - mended.nats
        return not search.rules.believes(name, beyond, first=len(chosen) == 1)


def _offsets(stack: Stack, batch: Batch) -> dict[tuple[float, ...], float]:
    """Return by condition how far echoes of the target lie from the law's, as a median, m."""
    error = batch.reading.range - stack.direct(batch)[0]
    frame = pd.DataFrame({"condition": conditions_of(batch.ping), "error": error, "near": batch.is_target(error)})
    mostly = frame.groupby("condition")["near"].mean() > 0.5
    median = frame[frame["near"]].groupby("condition")["error"].median()
    return {key: value for key, value in zip(median.index, median.to_list(), strict=True) if mostly[key]}


def baseline_of(
    model: SonarModel | Simulator,
    recording: Recording,
    simulated: Recording | None,
    seed: int,
    workers: Workers = ALONE,
) -> Baseline:
    """Return the law that stands for a model, for a simulator's readings, or for a simulator that can be asked."""
    if simulated is not None:
        return emulated(simulated, None, seed, workers)
    if not isinstance(model, SonarModel):
        return emulated(asked(model, recording, seed), None, seed, workers)
    if isinstance(model, IdealModel):
        physical = PhysicalModel((), model.resolution, model.max_range)
        return Baseline(Stack.of(physical), model, BaselineCheck(True, 1.0, "the ideal sonar is used as it is"))
    if isinstance(model, PhysicalModel):
        return Baseline(Stack.of(model), model, BaselineCheck(True, 1.0, "the given physical model is used as it is"))
    return emulated(sampled(model, recording, seed), model, seed, workers)


def asked(simulator: Simulator, recording: Recording, seed: int) -> Recording:
    """Return fresh readings of a simulator under a recording's own pings, at most `MOST_ASKED` of them.

    Raises:
        ModelError: it returned something else than one reading a ping.
    """
    batch = Batch.of(recording).thin(MOST_ASKED)
    order = np.argsort(batch.ping.time, kind="stable")
    ping = batch.ping[order]
    answer = simulator(ping, np.random.default_rng([seed, 9]))
    if not isinstance(answer, Reading):
        ranges = np.asarray(answer, dtype=np.float64)
        if ranges.shape != (len(ping),) or not np.isfinite(ranges).all() or (ranges < 0).any():
            raise ModelError(
                f"the simulator must return {len(ping)} ranges in m, one a ping and 0 for no echo, or a Reading; "
                f"it returned {type(answer).__name__} of shape {ranges.shape}"
            )
        answer = Reading.of(ranges)
    if len(answer) != len(ping):
        raise ModelError(f"the simulator returned {len(answer)} readings for {len(ping)} pings; return one a ping")
    name = getattr(simulator, "__name__", type(simulator).__name__)
    return Recording.of(ping, answer, name=f"{name} asked")


def sampled(model: SonarModel, recording: Recording, seed: int) -> Recording:
    """Return readings of a model on a recording's own conditions."""
    rows = np.unique(recording.condition, return_index=True)[1]
    rng = np.random.default_rng([seed, 5])
    if len(rows) > MOST_CONDITIONS:
        rows = np.sort(rng.choice(rows, MOST_CONDITIONS, replace=False))
    ping = recording.ping[np.repeat(rows, REPEATS)]
    ping = replace(ping, time=np.arange(len(ping), dtype=np.float64), run=np.zeros(len(ping), dtype=np.int64))
    bare = Ping(ping.distance, ping.angle, ping.incidence, ping.reflectance, ping.time, ping.run, {})
    return Recording.of(bare, simulate(model, ping, rng), name=f"{type(model).__name__} sampled")


def emulated(simulated: Recording, raw: SonarModel | None, seed: int, workers: Workers = ALONE) -> Baseline:
    """Return an emulator of a simulation, checked on cells it was not fitted to."""
    split = Split.of(Batch.of(simulated), np.random.default_rng([seed, 6]))
    stack = emulator(split.both.thin(EMULATOR_PINGS), seed, workers)
    plain = PhysicalModel([stack.known[n](**v) for n, v in stack.values.items() if n != VISITS], simulated.resolution)
    return Baseline(stack, raw or plain, checked(stack, split.vault, np.random.default_rng([seed, 7])), split)


def checked(stack: Stack, unseen: Batch, rng: np.random.Generator) -> BaselineCheck:
    """Return whether a law describes readings of a simulation that it was not fitted to.

    A law that misses only how those of one position scatter and hang together still says where echoes are read, and
    whether they are heard at all.
    """
    scanned = scan(residuals(stack, unseen, rng), unseen, rng)
    p, p_any = (each.p_value(each.best) for each in (scanned.lasting, scanned))
    good, wholly = p >= ALARM, p_any >= ALARM
    words = "describes" if good else "does not fully describe"
    but = "" if wholly or not good else ", but for how those of one position hang together"
    note = f"a stand-in with a smooth part {words} the simulation's own held-out readings{but}"
    return BaselineCheck(good, p, note, good and wholly)
