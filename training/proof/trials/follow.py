"""What was asked for next is measured: the real world of a trial records it, and as many pings anywhere beside it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from acquisition import Ping, Recording
from acquisition.bench.acoustics.receiver import GAINS
from training.proof.trials.mix import Trial
from training.proof.trials.surveys import MOVE_S, Design
from training.proof.trials.world import Rng, World, with_setup

MOST_PINGS = 400  # of a measurement; who is asked for more has measured so many
LONGEST_REGISTER = 255
START_S = "start_s"  # how long the sensor has been on when a measurement begins
AGAIN_S = "interval_s"  # a measurement that changes it needs two pings of each visit, of which the later one counts


def measure(trial: Trial, asked: Sequence[dict[str, Any]], folder: Path, rng: Rng) -> dict[str, Path]:
    """Record what is asked for, and the same number of pings anywhere; return the files by what they are.

    Args:
        trial: whose real world is asked.
        asked: entries of a verdict's `next_settings` that name conditions.
        folder: the trial's.
        rng: for the noise, and for where anywhere is.
    """
    assert trial.real is not None
    assert trial.design is not None
    files = {}
    for k, entry in enumerate(asked):
        n, also = min(entry["pings"], MOST_PINGS), entry["also"]
        there = _conditions(entry["conditions"])
        wanted = there[np.resize(np.arange(len(there)), n)]
        for name, cells, world, how in (
            (f"measured-{k}", wanted, changed(trial.real, also), also),
            (f"anywhere-{k}", trial.design.conditions(rng, n), trial.real, {}),
        ):
            recording = _visited(world, cells, trial.design, how, rng)
            files[name] = recording.save(folder / f"{name}.csv")
    return files


def changed(world: World, also: dict[str, float]) -> World:
    """Return a world whose sensor is set as asked."""
    setup = world.rig.setup
    if "gain_db" in also:
        wanted = GAINS[setup.gain] * 10.0 ** (also["gain_db"] / 20.0)
        world = with_setup(world, gain=int(np.argmin(np.abs(np.log(np.array(GAINS) / wanted)))))
    if "range_m" in also:
        world = with_setup(world, range_register=LONGEST_REGISTER)
    return world


def _conditions(rows: Sequence[dict[str, float]]) -> Ping:
    angle, incidence = (np.deg2rad([row[name] for row in rows]) for name in ("angle_deg", "incidence_deg"))
    return Ping.of(distance=np.array([row["distance_mm"] for row in rows]) / 1000.0, angle=angle, incidence=incidence)


def _visited(world: World, cells: Ping, design: Design, also: dict[str, float], rng: Rng) -> Recording:
    """Return a recording in which the target is put down anew for every ping that counts."""
    more, start = also.get(AGAIN_S), also.get(START_S, 0.0)
    each = 1 if more is None else 2
    ping = cells[np.repeat(np.arange(len(cells)), each)]
    wait = np.full(len(ping), design.interval_s[0] + (more or 0.0))
    wait[::each] = MOVE_S
    wait[0] += start
    # two visits of one condition would be one visit: a run of its own keeps them apart
    run = np.repeat(np.arange(len(cells)), each)
    recording = world.record(replace(ping, time=np.round(np.cumsum(wait) - MOVE_S, 3), run=run), rng)
    return recording.select(np.arange(len(ping)) % each == each - 1)
