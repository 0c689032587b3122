"""What both files have alike: the law of the simulation in the light of the recording."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from acquisition.arrays import Floats
from noise.discrepancy.locate.trend import UNCOMPENSATED
from noise.discrepancy.name.candidates import as_in
from noise.discrepancy.thresholds import SPREAD_TOLERANCE
from noise.effects import CATALOGUE, Parameter, Stage
from noise.effects.medium import TEMPERATURE
from noise.fitting.batch import Batch
from noise.fitting.fit import highest, maximise
from noise.fitting.likelihood import log_likelihood
from noise.fitting.stack import NUISANCES, PLACEMENT, SIMULATION_CORRELATION, SPREAD, Key, Stack

STEPS = np.array([0.0, 0.25, 0.5, 0.75, 1.0])  # from the simulation to the recording, where a common value is sought
ITERATIONS = 40
ENOUGH = 3.0  # nats: odds of 20 to 1


def with_nuisances(
    common: Stack, keys: Sequence[Key], recorded: Sequence[Stack], parts: Sequence[Batch], simulated: Batch
) -> Stack:
    """Return the law of the simulation at that of two maxima which both files together prefer.

    Readings of a visit that agree follow from slow noise, from repeated readings, or from a register that is stale, and
    a fit ends at one of these. Where the two files ended at different ones, they would seem to differ.

    Args:
        common: law of the simulation.
        keys: parameters in which the recording differs.
        recorded: the same law with these and with the nuisance parameters of each part of the recording.
        parts: of the recording.
        simulated: readings of the simulation.
    """
    if min(stack.log_nuisance_prior() for stack in recorded) > -ENOUGH:
        return common
    shared = [key for key in NUISANCES if key != SIMULATION_CORRELATION]
    start = common.put(shared, np.mean([[stack.get(key) for key in shared] for stack in recorded], axis=0))
    late = [name for name in common.effects if CATALOGUE[name].stage is Stage.SEQUENCE]
    free = (*shared, *((name, p.name) for name in late for p in _parameters(name)))
    found = maximise(replace(start, familiar={}), free, simulated, ITERATIONS).stack
    gain = _nats(found, simulated) - _nats(common, simulated)
    for stack, part in zip(recorded, parts, strict=True):
        as_common = common.put(keys, [stack.get(key) for key in keys])
        gain += _nats(stack, part) - _nats(maximise(as_common, (*keys, *SPREAD), part, ITERATIONS, ENOUGH).stack, part)
    return replace(found, familiar=common.familiar) if gain > ENOUGH else common


def scatters_alike(recorded: Sequence[Stack], common: Stack, parts: Sequence[Batch]) -> bool:
    """Return whether single pings of a recording scatter as those of the simulation do, as far as sensors do.

    Args:
        recorded: stacks with the scatter of the recording, fitted to each part.
        common: law of the simulation.
        parts: of the recording.
    """
    scatter = [key for key in SPREAD if key != PLACEMENT]
    own = np.concatenate([stack.direct(part)[1] for stack, part in zip(recorded, parts, strict=True)])
    like = {key: common.get(key) for key in scatter}
    held = np.concatenate([stack.at(like).direct(part)[1] for stack, part in zip(recorded, parts, strict=True)])
    return bool(abs(np.log(np.median(own / held))) < 2.0 * np.log1p(SPREAD_TOLERANCE))


def acts_on_target(name: str, recorded: Sequence[Stack], common: Stack, parts: Sequence[Batch]) -> bool:
    """Return whether an effect of a recording moves or scatters the echo of the target.

    Args:
        name: effect id.
        recorded: stacks with the effect, fitted to each part of the recording.
        common: law of the simulation.
        parts: of the recording.
    """
    pairs = [
        (stack.direct(part), as_in(stack, common, name).direct(part))
        for stack, part in zip(recorded, parts, strict=True)
    ]
    return not all(np.allclose(own, without, rtol=1e-9, atol=0.0) for own, without in pairs)


def _nats(stack: Stack, batch: Batch) -> float:
    return float(log_likelihood(stack, batch).sum())


def with_compensation(common: Stack, keys: Sequence[Key], recorded: Sequence[Stack], simulated: Batch) -> Stack | None:
    """Return the law of the simulation with the recording's compensation for temperature; None where it tells its own.

    Where both files log the temperature, and the simulation's readings are as likely with the share of the logged
    temperature that the recording's show, that share is no difference.

    Args:
        common: law of the simulation.
        keys: parameters in which the recording differs; the compensation may be one of them.
        recorded: stacks with these, fitted to each part of the recording.
        simulated: readings of the simulation.
    """
    if UNCOMPENSATED not in keys or UNCOMPENSATED[0] in common.values or TEMPERATURE not in simulated.ping.covariates:
        return None
    law = common.at({UNCOMPENSATED: float(np.mean([stack.get(UNCOMPENSATED) for stack in recorded]))})
    return law if _nats(law, simulated) > _nats(common, simulated) - ENOUGH else None


def in_simulation(
    common: Stack, keys: Sequence[Key], recorded: Sequence[Stack], simulated: Batch
) -> tuple[Stack, float]:
    """Return the law of the simulation with an effect as its own readings have it, and what these gain, nats.

    Args:
        common: law of the simulation.
        keys: parameters of the effect.
        recorded: stacks with the effect, fitted to each part of the recording.
        simulated: readings of the simulation.
    """
    # from where the recording has it, and from where the simulation does: a reflector that has moved may be far away
    starts = (common.put(keys, _mean(keys, recorded)), common)
    own = highest(maximise(start, (*keys, *SPREAD), simulated, ITERATIONS, 1.0) for start in starts)
    return own.stack, own.nats - maximise(common, SPREAD, simulated, ITERATIONS, 1.0).nats


@dataclass(frozen=True, eq=False)
class Pooled:
    """The law of the simulation with an effect as both files have it.

    Attributes:
        law: the law.
        apart: what separate values gain in both files, nats.
        lost: what the readings of the simulation alone lose, nats.
    """

    law: Stack
    apart: float
    lost: float


def pooled(
    own: Stack, keys: Sequence[Key], recorded: Sequence[Stack], parts: Sequence[Batch], simulated: Batch
) -> Pooled:
    """Return the law of the simulation with an effect as both files have it.

    Args:
        own: law of the simulation with the effect as its own readings have it.
        keys: parameters of the effect.
        recorded: stacks with the effect, fitted to each part of the recording.
        parts: of the recording.
        simulated: readings of the simulation.
    """
    there, here = _mean(keys, recorded), np.array([own.get(key) for key in keys])
    both = []
    for step in STEPS:
        values = here + step * (there - here)
        pairs = [*zip((s.put(keys, values) for s in recorded), parts, strict=True)]
        pairs.append((own.put(keys, values), simulated))
        both.append([_nats(stack, part) for stack, part in pairs])
    nats = np.array(both)
    best = int(np.argmax(nats.sum(axis=1)))
    separate = nats[:, :-1].sum(axis=1).max() + nats[:, -1].max()
    law = own.put(keys, here + STEPS[best] * (there - here))
    return Pooled(law, float(separate - nats[best].sum()), float(nats[0, -1] - nats[best, -1]))


def with_others(law: Stack, keys: Sequence[Key], simulated: Batch) -> Stack:
    """Return a law of the simulation fitted anew beside an effect that it lacked.

    What stood for the effect so far is no longer needed, and would differ from the recording's.
    """
    joined = {key[0] for key in keys}
    others = [name for name in law.effects if CATALOGUE[name].localised and name not in joined]
    free = ((name, p.name) for name in others for p in _parameters(name))
    return maximise(law, (*free, *NUISANCES), simulated, ITERATIONS).stack


def _mean(keys: Sequence[Key], stacks: Sequence[Stack]) -> Floats:
    return np.asarray(np.mean([[stack.get(key) for key in keys] for stack in stacks], axis=0))


def _parameters(name: str) -> tuple[Parameter, ...]:
    return CATALOGUE[name].parameters
