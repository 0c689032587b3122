"""What differs, as a model that acts on the simulator's own readings.

A law that stands for a simulation is wrong by some millimetres under conditions that it was not fitted to, and so is a
law of the recording with the same base. In their difference these errors cancel, so that the simulator's own readings
with the causes applied to them may be closer to the recording than any law, where the simulator can be asked.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from noise.discrepancy.baseline.adjusted import Adjusted
from noise.discrepancy.baseline.forest import AnalogueForest, Grown
from noise.discrepancy.baseline.transport import Transport
from noise.discrepancy.judge.accepted import acting_on, applied
from noise.discrepancy.judge.correction import Options, offered
from noise.discrepancy.judge.held_out import Simulation, beyond_chance, crps_of_each, improves
from noise.discrepancy.judge.judged import Judged
from noise.discrepancy.judge.term import Term
from noise.discrepancy.name.search import Search
from noise.fitting.batch import Batch
from noise.model import SonarModel
from noise.replay import Replay

WORSE = "with it, your simulator's readings predict unseen visits worse"


def difference(
    judged: Judged, search: Search, options: Options, emulator: SonarModel, step_m: float
) -> tuple[SonarModel | None, dict[str, str]]:
    """Return the believed causes, acting on given readings.

    Args:
        judged: the hypothesis.
        search: readings and candidates.
        options: models that may be offered, with their scores on visits that they have not seen.
        emulator: law that describes the simulation.
        step_m: step of the recording's register.

    Returns:
        The model, and why some causes cannot act so, by effect. The model is None where the law with the causes
        predicts the recording no better than the emulator, in the mean CRPS or in the log score.
    """
    if not options.causes_gain:
        return None, {}
    register = search.common.resolution
    replay = Replay(emulator, register, max(register, step_m))
    return acting_on(replay, search.common, judged.final.single.stack, judged.believed)


def worsens(acting: SonarModel, simulation: Simulation, unseen: Batch, rng: np.random.Generator) -> bool:
    """Return whether causes that act on the simulator's readings make them predict the recording worse.

    Args:
        acting: the causes, acting on readings.
        simulation: the user's simulation; only conditions that both files have can show it.
        unseen: visits of the recording that no estimate used.
        rng: draws the readings.
    """
    if simulation.readings is None:
        return False
    applied = _applied(acting, simulation, rng)
    return not improves(applied.gain_on(simulation, unseen), applied.near.gain_on(simulation.near, unseen))


def transport(
    search: Search,
    options: Options,
    term: Term | None,
    corrected: SonarModel | None,
    acting: SonarModel | None,
    simulation: Simulation,
    forest: Grown | None,
    recorded: Batch,
    rng: np.random.Generator,
) -> Transport | None:
    """Return what carries readings of the simulation to the recording's law; None where the causes predict as well.

    The laws differ by the causes and by the empirical term alone, so that where a target begins to be heard, say, is
    the same in both. That of the recording must predict it better than that of the simulation. A forest of the
    recording says nothing of other conditions, under which readings are to be corrected too.

    Args:
        search: readings and candidates.
        options: models that may be offered.
        term: the empirical term; None where there is none.
        corrected: the corrected model; None where none is offered.
        acting: the causes, acting on given readings; None where there are none.
        simulation: the user's simulation.
        forest: of its readings; None where it has none.
        recorded: all readings of the recording.
        rng: draws the readings.
    """
    if simulation.readings is None or forest is None:
        return None
    if term is not None:
        own, law = offered(search.common, options.without.resolution), options.shared

        def cross_fitted(readings: Batch) -> Transport:
            return Transport(own, term.cross_fitted(law, readings, simulated=True))

        if is_carried(simulation, forest, acting, cross_fitted, recorded, rng, sure=options.is_sure_of_term):
            return Transport(own, term.on(law))
    if corrected is None or isinstance(corrected, AnalogueForest | Adjusted):
        return None
    carrying = Transport(options.without, corrected)
    better = is_carried(simulation, forest, acting, lambda _: carrying, search.folds.unseen, rng)
    return carrying if better else None


def is_carried(
    simulation: Simulation,
    forest: Grown,
    acting: SonarModel | None,
    carrying: Callable[[Batch], Transport],
    recorded: Batch,
    rng: np.random.Generator,
    sure: bool = False,
) -> bool:
    """Return whether readings carried from one law to the other predict better beyond chance than the causes do.

    Where no cause acts, and it is sure that the other law is better, it is enough that they do not predict worse beyond
    chance: readings of one place may have been made at other temperatures, say, in the other file. Without
    conditions that both files have, causes remain where they act; else a forest of the readings, before and after, says
    what these predict under other conditions.

    Args:
        simulation: the user's simulation.
        forest: of its readings.
        acting: the causes, acting on its readings; None where there are none, and the readings remain.
        carrying: of its readings, what carries them from the law of the simulation to that of the recording.
        recorded: visits of the recording that no estimate used for what is carried.
        rng: draws the readings.
        sure: whether a law has been found better than the same without the empirical term, beyond chance.
    """
    common = simulation.has_any_of(recorded)
    if simulation.readings is None or (acting is not None and not common):
        return False
    if common:
        known = simulation if acting is None else _applied(acting, simulation, rng)
        carried = _applied(carrying(simulation.readings), simulation, rng)
        gain, near = carried.gain_on(known, recorded), carried.near.gain_on(known.near, recorded)
    else:
        before, after = Simulation(forest.model), forest.of_others(applied(carrying(forest.batch), forest.batch, rng))
        scored = ((each, crps_of_each(after, recorded, each.tolerance)) for each in (before, before.near))
        gain, near = (each.gain((recorded, crps)) for each, crps in scored)
    worse = beyond_chance(-gain) or beyond_chance(-near)
    return not worse if sure and acting is None else beyond_chance(gain)


def _applied(model: SonarModel, simulation: Simulation, rng: np.random.Generator) -> Simulation:
    """Return a simulation with a model applied to its readings."""
    assert simulation.readings is not None
    return replace(simulation, readings=applied(model, simulation.readings, rng))
