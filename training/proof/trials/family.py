"""Trials of the diagnosis's own family: an effect of the catalogue, drawn from its own law. Reported apart."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from acquisition import Ping, Reading, Recording
from noise import PhysicalModel
from noise.effects import CATALOGUE, Parameter
from noise.fitting.stack import JITTER
from training.proof.trials.surveys import Design
from training.proof.trials.world import Rng, visits

RESOLUTION_M = 0.001


def usual(rng: Rng) -> dict[str, dict[str, float]]:
    """Return what any sonar of the family has."""
    return {
        JITTER: {"sigma_m": float(rng.uniform(0.001, 0.003))},
        "sensitivity": {"loss_db": float(rng.uniform(34.0, 40.0))},
        "specular_loss": {"strength": 0.7},
        "beam_width": {"ka": float(rng.uniform(1.5, 2.5))},
    }


def drawn(name: str, size: float, held: dict[str, float], rng: Rng) -> dict[str, float]:
    """Return values of an effect, given a size: its first parameter away from what is held, the others anywhere."""
    out = {}
    for k, p in enumerate(CATALOGUE[name].parameters):
        if p.covariate:
            continue
        out[p.name] = _strength(p, size, held.get(p.name, p.null), rng) if k == 0 else _anywhere(p, rng)
    return out


def _strength(p: Parameter, size: float, held: float, rng: Rng) -> float:
    """Return a value some tenths of the way to a bound, or from the effect's own start."""
    step = (p.starts[0] - p.null if p.starts else 0.2 * (p.high - p.null)) * size
    if p.low < p.null < p.high:
        step *= float(rng.choice([-1.0, 1.0]))
    return float(np.clip(held + step, p.low, p.high))


def _anywhere(p: Parameter, rng: Rng) -> float:
    """Return a plausible value: one of the starts, or near the null."""
    choice = [*p.starts, p.null]
    value = float(rng.choice(choice))
    return float(np.clip(value * rng.uniform(0.8, 1.25), p.low, p.high))


def family_trial(rng: Rng, size: float) -> tuple[Recording, Recording, dict[str, Any]]:
    """Return both recordings and the answer."""
    names = [name for name in CATALOGUE if name != JITTER]
    name = str(rng.choice(names))
    base = usual(rng)
    values = drawn(name, size, base.get(name, {}), rng)
    changed = {**base, name: {**base.get(name, {}), **values}}
    design = Design(pings=int(rng.choice([10, 15, 20])), turned=True)
    recordings = [_recorded(stack, design, rng) for stack in (base, changed)]
    first = CATALOGUE[name].parameters[0]
    told = {"name": name, "size": size, "accepted": [name], "aspects": [], "values": values}
    answer = {"kind": "family", "causes": [{**told, "parameter": first.name, "value": values[first.name]}]}
    return recordings[0], recordings[1], {**answer, "same_grid": False}


def _recorded(values: dict[str, dict[str, float]], design: Design, rng: Rng) -> Recording:
    """Return a survey with reflectors put down a little off their marks, ping after ping as a memory asks."""
    model = PhysicalModel([CATALOGUE[name](**inner) for name, inner in values.items()], RESOLUTION_M)
    ping = design.survey(design.conditions(rng), rng)
    stands = replace(ping, distance=np.maximum(ping.distance + _misplaced(ping, rng), 0.02))
    if not model.remembers:
        return Recording.of(ping, model.law(stands).sample(rng), name="family")
    readings, past = [], Reading.of(0.0)
    for k in range(len(ping)):
        past = model.law(stands[k : k + 1], past).sample(rng)
        readings.append(float(past.range[0]))
    return Recording.of(ping, Reading.of(np.array(readings)), name="family")


def _misplaced(ping: Ping, rng: Rng) -> np.ndarray:
    starts = visits(ping)
    count = np.diff([*starts, len(ping)])
    return np.repeat(rng.normal(0.0, 0.003, len(starts)), count)
