"""What is concealed in which trial: a shuffled deck, so that the number of a trial tells nothing."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from acquisition import Recording
from acquisition.bench import Rig, Setup, Unit
from training.proof.trials import causes, strangers
from training.proof.trials.causes import Cause
from training.proof.trials.family import family_trial
from training.proof.trials.surveys import Design, marginals, matching
from training.proof.trials.world import Rng, World, with_setup

NULL, EFFECT, PAIR, STRANGER, MATCHED, CONFOUNDED, FAMILY = (
    "null",
    "effect",
    "pair",
    "stranger",
    "matched",
    "confounded",
    "family",
)
# of every 25 trials: a fifth nothing, three in ten strangers
DECK = (NULL,) * 5 + (STRANGER,) * 8 + (EFFECT,) * 5 + (PAIR,) * 2 + (MATCHED,) * 2 + (CONFOUNDED,) + (FAMILY,) * 2
DECKS: dict[str, tuple[tuple[str, str | None], ...]] = {
    "mixed": tuple((kind, None) for kind in DECK),
    "effects": tuple((EFFECT, cause.name) for cause in causes.CAUSES),
    "strangers": tuple((STRANGER, stranger.name) for stranger in strangers.STRANGERS),
    "nulls": ((NULL, None),),
}
SMALLEST, LARGEST = 0.12, 3.0  # of the ladder of sizes, evenly in the logarithm
# designs under which causes are the same thing, by what is not varied
CONFOUNDING: tuple[tuple[str, dict[str, float]], ...] = (
    ("sound_speed", {}),
    ("clock_scale", {}),
    ("sensitivity", {"reflectance": 0.9}),
    ("boresight", {"angle_deg": 10.0}),
    ("zero_offset", {"distance_m": 1.0}),
    ("sound_speed", {"distance_m": 1.5}),
)
# whose trace is in where echoes come from: pooled readings can be made to look alike
HIDEABLE = (
    "sound_speed",
    "clock_scale",
    "zero_offset",
    "thermal_drift",
    "boresight",
    "pivot_offset",
    "sensitivity",
    "warm_up",
    "specular_loss",
    "beam_width",
    "range_gate",
)
NEVER_PAIRED = ("specular_loss", "reflectance_loss")  # they change what the log says of every cell


@dataclass(frozen=True)
class Trial:
    """Two recordings, the answer, and where more can be recorded: the real world, None of a law's own family."""

    simulated: Recording
    recorded: Recording
    answer: dict[str, Any]
    real: World | None = None
    design: Design | None = None


def card_of(trial: int, deck: str, block: Callable[[int], Rng]) -> tuple[str, str | None]:
    """Return the kind of a trial, and what is concealed in it where the deck says so: its place in a shuffled deck.

    Args:
        trial: its number.
        deck: name of the deck.
        block: generator of a block of trials, by the block's number.
    """
    cards = DECKS[deck]
    number, place = divmod(trial, len(cards))
    return cards[block(number).permutation(len(cards))[place]]


def make(kind: str, rng: Rng, name: str | None = None, size: float | None = None) -> Trial:
    """Make a trial of a kind; of an effect or a stranger, of this name and size where they are given."""
    if kind in NAMED:
        return NAMED[kind](rng, name, size)
    return MAKERS[kind](rng)


def world_of(rng: Rng) -> World:
    """Return a laboratory like any other: its sensor, gain, air and care are drawn."""
    serial = int(rng.integers(1, 2**31))
    rig = Rig(Unit.draw(serial), Setup.draw(serial + 1, gain=int(rng.integers(18, 30)), output="us"))
    return with_setup(World(rig), temperature_c=float(rng.uniform(15.0, 24.0)))


def another_day(world: World, rng: Rng) -> World:
    """Return the same laboratory on another day: reflectors put down with other care, air that moves otherwise."""
    return with_setup(
        world,
        placement_m=float(rng.uniform(0.001, 0.005)),
        flutter_tau_s=float(np.exp(rng.uniform(np.log(0.5), np.log(20.0)))),
    )


def size_of(rng: Rng) -> float:
    """Return a rung of the ladder."""
    return float(np.exp(rng.uniform(np.log(SMALLEST), np.log(LARGEST))))


def design_of(rng: Rng, cause: Cause | None = None, **fixed: float) -> Design:
    """Return how a trial's surveys are laid out."""
    return Design(
        cells=int(rng.choice([48, 72, 96])),
        pings=int(rng.choice([10, 15, 20])),
        runs=int(rng.integers(2, 5)),
        turned=cause.turned if cause else bool(rng.random() < 0.3),
        interval_s=cause.interval_s if cause else (0.1, 0.1),
        **fixed,
    )


def surveyed(
    design: Design, simulator: World, real: World, rng: Rng, matched: bool = False
) -> tuple[Recording, Recording, bool]:
    """Return simulated and recorded surveys, and whether they share their conditions."""
    cells = design.conditions(rng)
    simulated = simulator.record(design.survey(cells, rng), rng)
    same = not matched and bool(rng.random() < 0.4)
    if matched:
        cells = matching(design, simulated, real, rng)
    elif not same:
        cells = design.conditions(rng)
    return simulated, real.record(design.survey(cells, rng), rng), same


def null_trial(rng: Rng) -> Trial:
    """Nothing is concealed: the same sensor in the same laboratory, on another day."""
    world, design = world_of(rng), design_of(rng)
    simulated, recorded, same = surveyed(design, world, another_day(world, rng), rng)
    return Trial(simulated, recorded, {"kind": NULL, "causes": [], "same_grid": same})


def effect_trial(rng: Rng, name: str | None = None, size: float | None = None) -> Trial:
    """One cause that the catalogue knows."""
    cause = causes.BY_NAME[name] if name else causes.CAUSES[int(rng.integers(len(causes.CAUSES)))]
    return _concealed(EFFECT, [cause], design_of(rng, cause), rng, size=size)


def pair_trial(rng: Rng) -> Trial:
    """Two causes at once."""
    able = [c for c in causes.CAUSES if c.name not in NEVER_PAIRED and c.interval_s == (0.1, 0.1)]
    first, second = (able[k] for k in rng.choice(len(able), 2, replace=False))
    design = replace(design_of(rng, first), turned=first.turned or second.turned)
    return _concealed(PAIR, [first, second], design, rng)


def matched_trial(rng: Rng) -> Trial:
    """One cause, under conditions chosen so that pooled readings look as simulated."""
    cause = causes.BY_NAME[str(rng.choice(HIDEABLE))]
    return _concealed(MATCHED, [cause], design_of(rng, cause), rng, matched=True)


def confounded_trial(rng: Rng) -> Trial:
    """One cause, under conditions that do not tell it from another."""
    name, fixed = CONFOUNDING[int(rng.integers(len(CONFOUNDING)))]
    cause = causes.BY_NAME[name]
    return _concealed(CONFOUNDED, [cause], design_of(rng, cause, **fixed), rng)


def stranger_trial(rng: Rng, name: str | None = None, size: float | None = None) -> Trial:
    """One cause of which the catalogue does not know."""
    stranger = strangers.BY_NAME[name] if name else strangers.STRANGERS[int(rng.integers(len(strangers.STRANGERS)))]
    world, drawn, design = world_of(rng), size_of(rng), design_of(rng)
    size = drawn if size is None else size
    real = stranger.change(another_day(world, rng), size, rng)
    simulated, recorded, same = surveyed(design, world, real, rng)
    told = [{"name": stranger.name, "size": size}]
    return Trial(simulated, recorded, {"kind": STRANGER, "causes": told, "same_grid": same})


def _concealed(
    kind: str, chosen: list[Cause], design: Design, rng: Rng, matched: bool = False, size: float | None = None
) -> Trial:
    simulator, sizes = world_of(rng), [size_of(rng) if size is None else size for _ in chosen]
    for cause, size in zip(chosen, sizes, strict=True):
        simulator = cause.before(simulator, size, rng)
    real = another_day(simulator, rng)
    for cause, size in zip(chosen, sizes, strict=True):
        real = cause.change(real, size, rng)
    simulated, recorded, same = surveyed(design, simulator, real, rng, matched)
    told = [_told(cause, size, simulator, real) for cause, size in zip(chosen, sizes, strict=True)]
    answer: dict[str, Any] = {"kind": kind, "causes": told, "same_grid": same}
    if matched:
        answer["marginals"] = marginals(simulated, recorded)
    before, after = (world.rig.setup.temperature_c for world in (simulator, real))
    return Trial(simulated, recorded, {**answer, "warmer_k": after - before}, real, design)


def _told(cause: Cause, size: float, simulator: World, real: World) -> dict[str, Any]:
    out: dict[str, Any] = {"name": cause.name, "size": size, "accepted": [cause.name, *cause.accepted]}
    out["aspects"] = list(cause.aspects)
    if cause.parameter is not None:
        out["parameter"], out["value"] = cause.parameter[0], float(cause.parameter[1](simulator, real))
    if cause.region is not None:
        column, low, high = cause.region(real)
        out["region"] = {column: [low, high]}
    return out


NAMED: dict[str, Callable[[Rng, str | None, float | None], Trial]] = {EFFECT: effect_trial, STRANGER: stranger_trial}
MAKERS: dict[str, Callable[[Rng], Trial]] = {
    NULL: null_trial,
    PAIR: pair_trial,
    MATCHED: matched_trial,
    CONFOUNDED: confounded_trial,
    FAMILY: lambda rng: Trial(*family_trial(rng, size_of(rng))),
}
