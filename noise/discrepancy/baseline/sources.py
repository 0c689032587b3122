"""The simulation to be compared: readings in a file, a model that is used or sampled, or a function that is asked."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from acquisition import ModelError, Ping, Reading, Recording
from acquisition.arrays import Floats
from acquisition.ping import MAX_RANGE
from noise.discrepancy.baseline.emulator import emulate
from noise.discrepancy.baseline.forest import Grown, grown
from noise.fitting.batch import Batch
from noise.fitting.stack import Stack
from noise.model import IdealModel, SonarModel, simulate
from noise.physical import PhysicalModel

Simulator = Callable[[Ping, np.random.Generator], Reading | Floats]
MAX_ASKED = 6000  # pings that a simulator is asked for
REPEATS = 4  # readings of each condition that are drawn from a model; its readings are independent
MAX_CONDITIONS = 600  # for which readings are drawn
HELD_OUT = 5  # one condition of so many is not used in the fit


@dataclass(frozen=True, eq=False)
class Baseline:
    """The simulation as a law.

    Attributes:
        law: describes the simulation, with the nuisance parameters of visits.
        readings: of the simulation; None where the law is known exactly.
        before: the user's own simulation: the given model, or a forest of its readings.
        emulator: `law` as a model of single pings, which can be saved; the given model where the law is known exactly.
        held_out: readings under conditions that the law was not fitted to; None where it is known exactly.
        forest: of the readings; None where the law is known exactly.
    """

    law: Stack
    readings: Batch | None
    before: SonarModel
    emulator: SonarModel
    held_out: Batch | None
    forest: Grown | None = None


def baseline_of(
    model: SonarModel | Simulator, recorded: Recording, simulated: Recording | None, rng: np.random.Generator
) -> Baseline:
    """Return the law of a simulation.

    Args:
        model: the simulation; unused where its readings are given.
        recorded: the recording; conditions of its pings are simulated where no readings are given.
        simulated: readings of the simulation.
        rng: samples the model, and fits the emulator.

    Raises:
        ModelError: the simulator returned something other than one reading for each ping.
        RecordingError: no simulated ping was answered.
    """
    if simulated is not None:
        return emulated(simulated, None, rng)
    if not isinstance(model, SonarModel):
        return emulated(asked(model, recorded, rng), None, rng)
    if isinstance(model, IdealModel):
        physical = PhysicalModel((), model.resolution, model.max_range)
        return Baseline(Stack.of(physical), None, model, model, None)
    if isinstance(model, PhysicalModel):
        return Baseline(Stack.of(model), None, model, model, None)
    return emulated(sampled(model, recorded, rng), model, rng)


def emulated(simulated: Recording, model: SonarModel | None, rng: np.random.Generator) -> Baseline:
    """Return the emulator of a simulation's readings, fitted to four fifths of its conditions."""
    readings = Batch.of(simulated)
    conditions, which = np.unique(readings.condition, return_inverse=True)
    unseen = (rng.permutation(np.arange(len(conditions)) % HELD_OUT) == 0)[which]
    held_out = readings.select(unseen) if len(conditions) > 1 else None
    law = emulate(readings.select(~unseen) if held_out is not None else readings, rng)
    forest = grown(readings, rng, law.max_range)
    return Baseline(law, readings, model or forest.model, law.single_ping_model, held_out, forest)


def asked(simulator: Simulator, recorded: Recording, rng: np.random.Generator) -> Recording:
    """Return readings of a simulator under a recording's own pings, at most `MAX_ASKED` of them.

    Raises:
        ModelError: it returned something other than one reading for each ping.
    """
    batch = Batch.of(recorded).thin(MAX_ASKED)
    ping = batch.ping[np.argsort(batch.ping.time, kind="stable")]
    answer = simulator(ping, rng)
    reading = answer if isinstance(answer, Reading) else _reading(answer, len(ping))
    if len(reading) != len(ping):
        raise ModelError(f"the simulator returned {len(reading)} readings for {len(ping)} pings; return one each")
    return Recording.of(ping, reading, name=getattr(simulator, "__name__", type(simulator).__name__))


def _reading(answer: object, n: int) -> Reading:
    """Return ranges as readings.

    Raises:
        ModelError: they are not n ranges from 0 to `MAX_RANGE`.
    """
    expected = f"the simulator must return a Reading, or {n} ranges in m, one for each ping and 0 for no echo"
    try:
        ranges = np.asarray(answer, dtype=np.float64)
    except (TypeError, ValueError):
        raise ModelError(f"{expected}; it returned a {type(answer).__name__}") from None
    if ranges.shape != (n,):
        raise ModelError(f"{expected}; it returned a {type(answer).__name__} of shape {ranges.shape}")
    wrong = ranges[~((ranges >= 0) & (ranges <= MAX_RANGE))]
    if len(wrong):
        raise ModelError(f"{expected}; it returned a range of {wrong[0]:g} m")
    return Reading.of(ranges)


def sampled(model: SonarModel, recorded: Recording, rng: np.random.Generator) -> Recording:
    """Return readings of a model under a recording's own conditions."""
    rows = np.unique(recorded.condition, return_index=True)[1]
    if len(rows) > MAX_CONDITIONS:
        rows = np.sort(rng.choice(rows, MAX_CONDITIONS, replace=False))
    ping = recorded.ping[np.repeat(rows, REPEATS)]
    n = len(ping)
    ping = replace(ping, time=np.arange(n, dtype=np.float64), run=np.zeros(n, dtype=np.int64))
    return Recording.of(ping, simulate(model, ping, rng), name=f"{type(model).__name__} sampled")
