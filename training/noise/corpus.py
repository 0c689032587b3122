"""What the shipped networks learn from: many sensors on the waveform rig, each in many short sessions.

A session is one sensor in air of one temperature. Most are surveys: reflectors are set up one after the other, by lot,
and each is met for a few pings. Some are drives: the reflector comes and goes, and no ping meets what the one before
met. Reflectors are the thesis's plate and disc, turned to and fro; walls; and nothing at all, or too far away.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from acquisition import Ping, Recording
from acquisition.bench import Rig, Setup, Unit
from acquisition.bench.acoustics.shapes import Wall
from acquisition.bench.setup import Bus
from acquisition.survey.plan import PLANS, Plan
from noise.model import steps

Floats = NDArray[np.float64]
DEG = np.pi / 180.0
NEAR, FAR, EMPTY_M = 0.03, 6.0, 20.0  # m; what is farther than the range gate is silent wherever it stands
STEP_S, MOVE_S = 0.1, 20.0  # s; from ping to ping, and to set up the next reflector
PINGS = (1, 2, 4, 8, 16, 30)  # a visit, and how often each
PINGS_SHARE = (0.35, 0.20, 0.15, 0.12, 0.10, 0.08)
STAND, WALL, NOTHING = range(3)
SCENES = {
    STAND: Setup(gain=31),
    WALL: Setup(gain=31, reflector=Wall(), post=None),
    NOTHING: Setup(gain=31, post=None),
}
SCENES_SHARE = (0.82, 0.10, 0.08)
TEMPERATURE_C = (14.0, 26.0)


@dataclass(frozen=True)
class Sessions:
    """Which sessions to record.

    Attributes:
        units: serial numbers of the sensors.
        surveys, drives: number of sessions of each kind with each sensor.
        visits: of a survey.
        pings: of a drive.
        faulty: whether wires are loose and sensors are cold, in one session in two each.
        seed: of everything.
    """

    units: tuple[int, ...]
    surveys: int = 18
    drives: int = 6
    visits: int = 40
    pings: int = 60
    faulty: bool = False
    seed: int = 0


@dataclass(frozen=True)
class Course:
    """The conditions of one session: a `Ping`, and the scene of each, (n,)."""

    ping: Ping
    scene: NDArray[np.int64]


def survey(visits: int, rng: np.random.Generator) -> Course:
    """Draw a session in which reflectors are set up by lot."""
    scene = rng.choice(len(SCENES), visits, p=SCENES_SHARE)
    distance, bearing, incidence, reflectance = _conditions(scene, rng)
    pings = rng.choice(PINGS, visits, p=PINGS_SHARE)
    begin = MOVE_S * np.arange(visits) + STEP_S * (np.cumsum(pings) - pings)
    visit = np.repeat(np.arange(visits), pings)
    within = np.arange(len(visit)) - np.repeat(np.cumsum(pings) - pings, pings)
    ping = Ping.of(
        distance[visit], bearing[visit], incidence[visit], reflectance[visit], begin[visit] + STEP_S * within
    )
    return Course(ping, scene[visit])


def drive(pings: int, rng: np.random.Generator) -> Course:
    """Draw a session in which one reflector comes, goes and turns, a new condition at each ping."""
    scene = np.full(pings, rng.choice([STAND, WALL]))
    far = np.exp(rng.uniform(np.log(0.3), np.log(FAR)))
    turns, phase = rng.uniform(0.5, 3.0), rng.uniform(0.0, 1.0)
    way = np.abs(2.0 * ((turns * np.arange(pings) / pings + phase) % 1.0) - 1.0)  # to and fro
    distance = NEAR + (far - NEAR) * way
    bearing = _turning(30.0, pings, rng)
    incidence = _turning(40.0, pings, rng)
    incidence = np.where(scene == WALL, 0.0, incidence)
    return Course(Ping.of(distance, bearing, incidence, rng.uniform(0.1, 1.0), STEP_S * np.arange(pings)), scene)


def _turning(most_deg: float, pings: int, rng: np.random.Generator) -> Floats:
    """Draw an angle that goes evenly from one side towards another, without its sign, rad, (pings,)."""
    begin, end = rng.uniform(-most_deg, most_deg, 2)
    return np.abs(np.linspace(begin, end, pings)) * DEG


def _conditions(scene: NDArray[np.int64], rng: np.random.Generator) -> tuple[Floats, Floats, Floats, Floats]:
    """Draw distance, bearing, incidence and reflectance of v visits, each (v,)."""
    n = len(scene)
    even, near_more = rng.uniform(NEAR, FAR, n), np.exp(rng.uniform(np.log(NEAR), np.log(FAR), n))
    distance = np.where(rng.random(n) < 0.6, even, near_more)
    bearing = np.where(rng.random(n) < 0.15, 0.0, rng.uniform(0.0, 30.0, n))
    bearing = np.where(rng.random(n) < 0.1, rng.uniform(30.0, 45.0, n), bearing)
    turned = rng.choice(3, n, p=[0.35, 0.45, 0.20])  # parallel to the sensor's face, any way, facing it
    incidence = np.choose(turned, [bearing, 85.0 * rng.random(n) ** 2, np.zeros(n)])
    incidence = np.where(scene == WALL, 0.0, incidence)
    thesis = rng.choice([0.1, 0.9], n)
    reflectance = np.where(rng.random(n) < 0.5, thesis, rng.uniform(0.1, 1.0, n))
    too_far, nothing = (scene == NOTHING) & (rng.random(n) < 0.5), scene == NOTHING
    distance = np.where(nothing, np.where(too_far, rng.uniform(FAR + 0.2, EMPTY_M, n), EMPTY_M), distance)
    reflectance = np.where(nothing & ~too_far, 0.0, reflectance)
    bearing, incidence = (np.where(nothing & ~too_far, 0.0, value) for value in (bearing, incidence))
    return distance, bearing * DEG, incidence * DEG, reflectance


def _laboratory(faulty: bool, unit: Unit, rng: np.random.Generator) -> tuple[Unit, dict[str, Any]]:
    """Draw what holds for a session: the air, and where faults are wanted a loose wire, a cold sensor, or both."""
    settings: dict[str, Any] = {"temperature_c": float(rng.uniform(*TEMPERATURE_C))}
    kind = rng.choice(3) if faulty else -1
    if kind in (0, 2):
        nack, stale = rng.uniform(0.02, 0.2, 2)
        settings["bus"] = Bus(nack=float(nack), lost_write=float(stale), dwell_s=float(rng.uniform(0.2, 2.0)))
    if kind in (1, 2):
        unit = replace(unit, cold_s=float(rng.uniform(0.0, 300e-6)), warm_up_tau_s=float(rng.uniform(100.0, 900.0)))
    return unit, settings


def session(unit: Unit, course: Course, faulty: bool, name: str, rng: np.random.Generator) -> pd.DataFrame:
    """Record one session with the rig; returns a recording's table."""
    unit, settings = _laboratory(faulty, unit, rng)
    rigs = {scene: Rig(unit, replace(setup, **settings)) for scene, setup in SCENES.items()}
    drift = rigs[STAND].draw_drift(rng)
    parts = []
    for scene in np.unique(course.scene):
        rows = np.flatnonzero(course.scene == scene)
        rig, ping = rigs[int(scene)], course.ping[rows]
        registers = rig.ping(ping, rng, drift)
        columns: dict[str, Any] = {**rig.columns(ping, registers), "session": name, "sensor": str(unit.serial)}
        table = Recording.of(ping, registers.reading(rig.setup), "corpus", **columns).table
        parts.append(_slim(table))
    return pd.concat(parts).sort_values("time_s", kind="stable")


def _slim(table: pd.DataFrame) -> pd.DataFrame:
    """Return a recording's table without the echoes after the first."""
    return table[[column for column in table.columns if not column.startswith("echo_")]]


def record_unit(sessions: Sessions, serial: int) -> pd.DataFrame:
    """Record all sessions of one sensor; the same numbers give the same table in every process."""
    rng = np.random.default_rng([sessions.seed, serial, int(sessions.faulty)])
    unit, tables = Unit.draw(serial), []
    for k in range(sessions.surveys + sessions.drives):
        course = survey(sessions.visits, rng) if k < sessions.surveys else drive(sessions.pings, rng)
        if sessions.faulty:  # a wire that loses commands repeats the ping before, so all pings must be of one rig
            course = replace(course, scene=np.full(len(course.scene), STAND))
        tables.append(session(unit, course, sessions.faulty, f"{serial}-{k}", rng))
    return pd.concat(tables)


def nothing(done: int, of: int) -> None:
    """Report no progress."""


def record(sessions: Sessions, jobs: int = 1, progress: Callable[[int, int], None] = nothing) -> Recording:
    """Record all sessions of all sensors."""
    tables = []
    for table in _each(sessions, jobs):
        tables.append(table)
        progress(len(tables), len(sessions.units))
    return Recording(pd.concat(tables, ignore_index=True), "corpus")


def _each(sessions: Sessions, jobs: int) -> Iterator[pd.DataFrame]:
    if jobs == 1:
        yield from (record_unit(sessions, serial) for serial in sessions.units)
        return
    with ProcessPoolExecutor(jobs, get_context("spawn")) as pool:
        yield from pool.map(record_unit, [sessions] * len(sessions.units), sessions.units)


def thinned(recording: Recording, most: int) -> NDArray[np.bool_]:
    """Return the first few pings of each visit of a condition, (n,) bool."""
    visit = np.unique(np.stack([recording.run, recording.condition]), axis=1, return_inverse=True)[1].ravel()
    keep = np.zeros(len(recording), dtype=bool)
    for rows in steps(visit)[:most]:
        keep[rows] = True
    return keep


QUICK = PLANS["quick"]
THIRD = QUICK.distances_mm[::3]
BETWEEN = replace(  # conditions between those of the quick plan
    QUICK, angles_deg=(1.0, 4.0, 10.0, 20.0), distances_mm=tuple(float(d) for d in range(300, 3001, 600)), pings=24
)
LEARNED, CHOOSING = tuple(range(1001, 1161)), tuple(range(1201, 1249))  # serial numbers
KNOWN, HELD_OUT = LEARNED[:80], tuple(range(201, 281))  # sensors differ so much that a few tell little of the others
# what is recorded, by name: sessions to learn from, and surveys of half a plan with some sensors each, with their seeds
RECORDINGS: dict[str, Sessions | tuple[Plan, tuple[int, ...], int]] = {
    "train": Sessions(LEARNED, surveys=8, drives=2),
    "validation": Sessions(CHOOSING, surveys=4, drives=1),
    "faulty": Sessions(LEARNED, surveys=2, drives=0, faulty=True),
    "faulty-validation": Sessions(CHOOSING, surveys=1, drives=0, faulty=True),
    "known": (replace(QUICK, pings=6), KNOWN, 1),
    "cells": (BETWEEN, KNOWN, 2),
    "units": (replace(QUICK, distances_mm=THIRD, pings=24), HELD_OUT, 3),
    "fresh-cells": Sessions(KNOWN, surveys=1, drives=1, seed=4),
    "fresh-units": Sessions(HELD_OUT, surveys=1, drives=1, seed=4),
}


def by_plan(plan: Plan, units: tuple[int, ...], seed: int) -> Recording:
    """Record every second condition of a plan with each of some sensors, the others with the next sensor."""
    tables = []
    for serial in units:
        rng = np.random.default_rng([seed, serial])
        cells = [replace(plan, seed=seed + serial).ping(k) for k in range(serial % 2, len(plan), 2)]
        names = ("distance", "angle", "incidence", "reflectance", "time")
        ping = Ping.of(**{name: np.concatenate([getattr(cell, name) for cell in cells]) for name in names})
        table = Rig(Unit.draw(serial), SCENES[STAND]).record(ping, rng).table
        tables.append(_slim(table.assign(session=f"{seed}-{serial}", sensor=str(serial))))
    return Recording(pd.concat(tables, ignore_index=True), "survey")


def written(folder: Path, name: str, jobs: int = 1, progress: Callable[[int, int], None] = nothing) -> Path:
    """Record what `RECORDINGS` has under a name, unless it is there already; returns the file."""
    path, what = folder / f"{name}.csv", RECORDINGS[name]
    if not path.exists():
        recording = record(what, jobs, progress) if isinstance(what, Sessions) else by_plan(*what)
        recording.save(path)
    return path
