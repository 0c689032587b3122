"""The ensemble of generators: `make_trial` draws a labelled trial of a family and a kind."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from acquisition import Ping, Recording, SettingError
from training.diagnosis.generators import beam, bursts, driving, fixed, rays, rig_causes, ruler
from training.diagnosis.generators.grammar import draw_fault
from training.diagnosis.generators.trial import Trial, TrueCause
from training.diagnosis.generators.world import Cause, Family, Rng, Surveys, World

_FAMILIES: dict[str, Family] = {
    "rig": rig_causes.FAMILY,
    "rays": rays.FAMILY,
    "beam": beam.FAMILY,
    "driving": driving.FAMILY,
    "ruler": ruler.FAMILY,
    "fixed": fixed.FAMILY,
    "bursts": bursts.FAMILY,
}
FAMILIES: tuple[str, ...] = tuple(_FAMILIES)
SAME, SINGLE, PAIR, UNMODELLED, SIMULATOR = KINDS = ("same", "single", "pair", "unmodelled", "simulator")
ODD = "odd"  # one or two known causes in sonars that share a fault which no law describes
SEVERAL = "several"  # three to five known causes, as where a recording is compared with a simple simulator
ALL_KINDS = (*KINDS, ODD, SEVERAL)
MOST_CAUSES = 5
SIZES = (0.12, 3.0)  # from barely visible to more than plain, evenly in the logarithm
MIN_PINGS = 20
SINGLES = 0.5  # share of the odd trials with one cause
DECOYS = 0.3  # share of the surveys laid out as another cause would require


def catalogue_of(family: str) -> tuple[str, ...]:
    """Return the ids of the causes of a family."""
    return tuple(cause.effect for cause in family_of(family).causes)


def kinds_of(family: str) -> tuple[str, ...]:
    """Return the kinds of trials of a family: all, but only a family with two simulators can compare them."""
    able = family_of(family).simulator is not None
    return tuple(kind for kind in ALL_KINDS if able or kind != SIMULATOR)


def make_trial(
    family: str, kind: str, rng: Rng, *, pings: int = 2000, cause: str | None = None, size: float | None = None
) -> Trial:
    """Draw a labelled trial.

    Args:
        family: one of `FAMILIES`.
        kind: one of `ALL_KINDS`: "same" (no difference), "single" and "pair" (one or two known causes), "unmodelled" (a
            fault of the grammar), "simulator" (a simulator of another kind; only family "rays"), "odd" (known causes,
            and a fault of the grammar that both sonars have), "several" (three to five known causes, or as many as a
            family has that go together).
        rng: source of all randomness.
        pings: approximate number of pings of each recording; a fresh one has a third.
        cause: id of the first cause; drawn by default.
        size: strength of each cause, 1 is plain to see; drawn by default.

    Raises:
        SettingError: unknown family, kind or cause, or too few pings.
    """
    _check(family, kind, pings, cause)
    seed = tuple(int(word) for word in rng.integers(2**32, size=4))
    own = np.random.default_rng(seed)
    return _made(family, kind, seed, own, pings, cause, size)


def family_of(name: str) -> Family:
    """Return a family by its name."""
    if name not in _FAMILIES:
        raise SettingError(f"{name!r} is not a family of generators; choose one of {', '.join(FAMILIES)}")
    return _FAMILIES[name]


def _check(family: str, kind: str, pings: int, cause: str | None) -> None:
    if kind not in kinds_of(family):
        raise SettingError(f"family {family} has no trials of kind {kind!r}; choose one of {kinds_of(family)}")
    if pings < MIN_PINGS:
        raise SettingError(f"pings must be at least {MIN_PINGS}, got {pings}")
    if cause is not None and cause not in catalogue_of(family):
        raise SettingError(f"family {family} has no cause {cause!r}; choose one of {', '.join(catalogue_of(family))}")


def _made(
    name: str, kind: str, seed: tuple[int, ...], rng: Rng, pings: int, cause: str | None, size: float | None
) -> Trial:
    family = family_of(name)
    chosen = _chosen(family, kind, rng, cause)
    surveys = _surveys(family, chosen, rng, pings)
    simulated = family.world(rng)
    real = family.another_day(simulated, rng)
    if kind == SIMULATOR and family.simulator is not None:
        simulated, real = family.simulator(simulated, rng)
    truths = []
    for each in chosen:
        simulated, real, truth = planted(each, simulated, real, _size(rng, size), rng)
        truths.append(truth)
    fault = ""
    if kind == ODD:  # of the conditions alone: the files have no time in common
        operators, _ = draw_fault(surveys.recorded, rng, _size(rng, size), without=("time",))
        simulated, real = (replace(each, operators=operators) for each in (simulated, real))
    if kind == UNMODELLED:
        operators, fault = draw_fault(surveys.recorded, rng, _size(rng, size))
        real = replace(real, operators=operators)
    if kind == SIMULATOR:
        fault = "a simulator of another kind"
    return Trial(name, kind, seed, tuple(truths), fault, *recordings_of(simulated, real, surveys, rng))


def _size(rng: Rng, size: float | None) -> float:
    drawn = float(np.exp(rng.uniform(*np.log(SIZES))))
    return drawn if size is None else size


def _chosen(family: Family, kind: str, rng: Rng, first: str | None) -> list[Cause]:
    """Return the causes of a trial; they differ in their effect and agree on the survey that they require."""
    if kind not in (SINGLE, PAIR, ODD, SEVERAL):
        return []
    by_effect = {cause.effect: cause for cause in family.causes}
    chosen = [by_effect[first] if first else family.causes[int(rng.integers(len(family.causes)))]]
    wanted = 1 if kind == SINGLE or (kind == ODD and rng.random() < SINGLES) else 2
    if kind == SEVERAL:
        wanted = int(rng.integers(3, MOST_CAUSES + 1))
    while len(chosen) < wanted:
        others = [other for other in family.causes if all(_go_together(other, one) for one in chosen)]
        if not others:
            break
        chosen.append(others[int(rng.integers(len(others)))])
    return chosen


def _go_together(other: Cause, one: Cause) -> bool:
    """Return whether two causes have different names and do not require the survey to be laid out in two ways."""
    named = other.effect == one.effect or other.effect in one.accepted or one.effect in other.accepted
    return not named and not (one.survey.keys() & other.survey.keys())


def _surveys(family: Family, chosen: list[Cause], rng: Rng, pings: int) -> Surveys:
    """Return surveys in which the causes can show and no column gives them away.

    A survey that some cause requires is also used for others, so that it tells nothing.
    """
    decoy = family.causes[int(rng.integers(len(family.causes)))].survey if rng.random() < DECOYS else {}
    drawn = family.surveys(rng, pings, {**decoy, **{k: v for cause in chosen for k, v in cause.survey.items()}})
    hidden = {name for cause in chosen for name in cause.hides}
    needed = {name for cause in chosen for name in cause.needs}

    def shown(ping: Ping) -> Ping:
        return replace(ping, covariates={k: v for k, v in ping.covariates.items() if k not in hidden})

    missing = tuple(name for name in drawn.missing if name not in needed)
    return Surveys(shown(drawn.simulated), shown(drawn.recorded), shown(drawn.fresh), missing)


def planted(cause: Cause, simulated: World, real: World, size: float, rng: Rng) -> tuple[World, World, TrueCause]:
    """Return the worlds after a cause, with the same random choices in both, and the answer."""
    seed = int(rng.integers(2**63))
    first = cause.plant(simulated, size, np.random.default_rng(seed))
    second = cause.plant(real, size, np.random.default_rng(seed))
    accepted = (cause.effect, *cause.accepted)
    region = {name: (float(low), float(high)) for name, (low, high) in second.region.items()}
    value = None if cause.parameter is None else second.value
    truth = TrueCause(cause.effect, accepted, size, cause.parameter, value, cause.aspects, region)
    return first.simulated, second.recorded, truth


def recordings_of(simulated: World, real: World, surveys: Surveys, rng: Rng) -> tuple[Recording, ...]:
    """Return the recordings in the order of the fields of `Trial`."""
    plan = (
        (simulated, surveys.simulated),
        (real, surveys.recorded),
        (real, surveys.fresh),
        (simulated, surveys.fresh),
        (real, surveys.fresh),
    )
    return tuple(
        world.record(ping, child, surveys.missing) for (world, ping), child in zip(plan, rng.spawn(5), strict=True)
    )
