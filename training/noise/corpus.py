"""Corpus of the shipped networks: many sensors on the waveform rig, each in many short sessions.

A session is one sensor in air of one temperature. In a survey, reflectors at random conditions are recorded for a few
pings each; in a drive, the distance changes at every ping. Reflectors are the thesis's plate and disc at various
angles, walls, and none or beyond the range gate.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from acquisition import Ping, Reading, Recording
from acquisition.arrays import Bits, Floats, Ints
from acquisition.bench import Rig, Setup, Unit
from acquisition.bench.front_ends import FRONT_ENDS, FrontEnd
from acquisition.bench.laboratory.setup import Bus
from acquisition.bench.laboratory.shapes import Wall
from acquisition.survey.plan import PLANS, SurveyPlan
from noise.model import steps
from training.common.workers import worker_processes

DEG = np.pi / 180.0
MIN_DISTANCE_M, MAX_DISTANCE_M, EMPTY_DISTANCE_M = 0.03, 6.0, 20.0  # the last is far beyond the range gate
STEP_S, MOVE_S = 0.1, 20.0  # s; between pings, and to place the next reflector
VISIT_PINGS = (1, 2, 4, 8, 16, 30)  # numbers of pings per visit
VISIT_PINGS_PROBABILITY = (0.35, 0.20, 0.15, 0.12, 0.10, 0.08)
MAX_GAIN = 31  # register at power-up
STAND, WALL, EMPTY = range(3)
SCENES = {
    STAND: Setup(gain=MAX_GAIN),
    WALL: Setup(gain=MAX_GAIN, reflector=Wall(), post=None),
    EMPTY: Setup(gain=MAX_GAIN, post=None),
}
SCENES_PROBABILITY = (0.82, 0.10, 0.08)
TEMPERATURE_C = (14.0, 26.0)
EDGE_PROBABILITY = 0.35  # of a reflector at the edge of the cone; 42 % of the faces that a driven car meets
EDGE_DEG = (20.0, 35.0)  # deg; bearings about the edge of a cone of 55 deg
EDGE_DISTANCE_M = (0.08, 4.0)
MAX_INCIDENCE_DEG = 85.0
SRF08_REGISTERS = ("gain", "range_mm")  # which other sensors do not have


@dataclass(frozen=True)
class Sessions:
    """Sessions to record.

    Attributes:
        units: serial numbers of the sensors.
        surveys, drives: number of sessions of each kind per sensor.
        visits: number of visits per survey.
        pings: number of pings per drive.
        faulty: whether sessions have a loose wire, a sensor that warms up, or both.
        gains: whether sessions have gains below that at power-up.
        seed: of all random draws.
        temperature_c: lowest and highest temperature of the air, degC.
        scenes: laboratory by scene.
        sensor: kind of the sensors, a name in `FRONT_ENDS`, which draws a room for each session; None is an SRF08.
    """

    units: tuple[int, ...]
    surveys: int = 18
    drives: int = 6
    visits: int = 40
    pings: int = 60
    faulty: bool = False
    gains: bool = False
    seed: int = 0
    temperature_c: tuple[float, float] = TEMPERATURE_C
    scenes: Mapping[int, Setup] = field(default_factory=lambda: SCENES)
    sensor: str | None = None

    @property
    def front_end(self) -> FrontEnd | None:
        """Front end of the sensors; None is that of an SRF08."""
        return None if self.sensor is None else FRONT_ENDS[self.sensor]


@dataclass(frozen=True)
class SessionCourse:
    """Conditions of one session: a `Ping`, and the scene of each, (n,)."""

    ping: Ping
    scene: Ints


def survey(visits: int, rng: np.random.Generator) -> SessionCourse:
    """Draw a session with reflectors at random conditions."""
    scene = rng.choice(len(SCENES), visits, p=SCENES_PROBABILITY)
    distance, bearing, incidence, reflectance = _draw_conditions(scene, rng)
    pings = rng.choice(VISIT_PINGS, visits, p=VISIT_PINGS_PROBABILITY)
    begin = MOVE_S * np.arange(visits) + STEP_S * (np.cumsum(pings) - pings)
    visit = np.repeat(np.arange(visits), pings)
    within = np.arange(len(visit)) - np.repeat(np.cumsum(pings) - pings, pings)
    ping = Ping.of(
        distance[visit], bearing[visit], incidence[visit], reflectance[visit], begin[visit] + STEP_S * within
    )
    return SessionCourse(ping, scene[visit])


def drive(pings: int, rng: np.random.Generator) -> SessionCourse:
    """Draw a session in which one reflector moves to and fro and turns, with a new condition at each ping."""
    scene = np.full(pings, rng.choice([STAND, WALL]))
    far_m = np.exp(rng.uniform(np.log(0.3), np.log(MAX_DISTANCE_M)))
    turns, phase = np.exp(rng.uniform(np.log(0.1), np.log(3.0))), rng.uniform(0.0, 1.0)
    position = np.abs(2.0 * ((turns * np.arange(pings) / pings + phase) % 1.0) - 1.0)  # to and fro
    distance = MIN_DISTANCE_M + (far_m - MIN_DISTANCE_M) * position
    at_edge = rng.random() < EDGE_PROBABILITY
    bearing = np.full(pings, rng.uniform(*EDGE_DEG) * DEG) if at_edge else _angle_sweep(30.0, pings, rng)
    incidence = _angle_sweep(MAX_INCIDENCE_DEG if at_edge else 40.0, pings, rng)
    incidence = np.where(scene == WALL, 0.0, incidence)
    return SessionCourse(Ping.of(distance, bearing, incidence, rng.uniform(0.1, 1.0), STEP_S * np.arange(pings)), scene)


def _angle_sweep(max_deg: float, pings: int, rng: np.random.Generator) -> Floats:
    """Draw the magnitude of an angle that changes linearly between two random values, rad, (pings,)."""
    begin, end = rng.uniform(-max_deg, max_deg, 2)
    return np.abs(np.linspace(begin, end, pings)) * DEG


def _draw_conditions(scene: Ints, rng: np.random.Generator) -> tuple[Floats, Floats, Floats, Floats]:
    """Draw distance, bearing, incidence and reflectance of v visits, each (v,)."""
    n = len(scene)
    uniform = rng.uniform(MIN_DISTANCE_M, MAX_DISTANCE_M, n)
    log_uniform = np.exp(rng.uniform(np.log(MIN_DISTANCE_M), np.log(MAX_DISTANCE_M), n))
    distance = np.where(rng.random(n) < 0.6, uniform, log_uniform)
    bearing = np.where(rng.random(n) < 0.15, 0.0, rng.uniform(0.0, 30.0, n))
    bearing = np.where(rng.random(n) < 0.1, rng.uniform(30.0, 45.0, n), bearing)
    turned = rng.choice(3, n, p=[0.35, 0.45, 0.20])  # parallel to the sensor's face, any orientation, facing the sensor
    incidence = np.choose(turned, [bearing, MAX_INCIDENCE_DEG * rng.random(n) ** 2, np.zeros(n)])
    at_edge = rng.random(n) < EDGE_PROBABILITY
    near = np.exp(rng.uniform(np.log(EDGE_DISTANCE_M[0]), np.log(EDGE_DISTANCE_M[1]), n))
    distance = np.where(at_edge, near, distance)
    bearing = np.where(at_edge, rng.uniform(*EDGE_DEG, n), bearing)
    incidence = np.where(at_edge, rng.uniform(0.0, MAX_INCIDENCE_DEG, n), incidence)
    incidence = np.where(scene == WALL, 0.0, incidence)
    thesis = rng.choice([0.1, 0.9], n)
    reflectance = np.where(rng.random(n) < 0.5, thesis, rng.uniform(0.1, 1.0, n))
    too_far, empty = (scene == EMPTY) & (rng.random(n) < 0.5), scene == EMPTY
    beyond = np.where(too_far, rng.uniform(MAX_DISTANCE_M + 0.2, EMPTY_DISTANCE_M, n), EMPTY_DISTANCE_M)
    distance = np.where(empty, beyond, distance)
    reflectance = np.where(empty & ~too_far, 0.0, reflectance)
    bearing, incidence = (np.where(empty & ~too_far, 0.0, value) for value in (bearing, incidence))
    return distance, bearing * DEG, incidence * DEG, reflectance


def _draw_laboratory(sessions: Sessions, unit: Unit, rng: np.random.Generator) -> tuple[Unit, dict[str, Any]]:
    """Draw the settings of a session: the air, a gain, and if `faulty` a loose wire, a cold sensor, or both."""
    settings: dict[str, Any] = {"temperature_c": float(rng.uniform(*sessions.temperature_c))}
    if sessions.front_end is not None:
        settings |= {**sessions.front_end.settings, "room": sessions.front_end.room(rng)}
    if sessions.gains:
        settings["gain"] = int(rng.integers(MAX_GAIN))
    kind = rng.choice(3) if sessions.faulty else -1
    if kind in (0, 2):
        nack, stale = rng.uniform(0.02, 0.2, 2)
        settings["bus"] = Bus(nack=float(nack), lost_write=float(stale), dwell_s=float(rng.uniform(0.2, 2.0)))
    if kind in (1, 2):
        unit = replace(unit, cold_s=float(rng.uniform(0.0, 300e-6)), warm_up_tau_s=float(rng.uniform(100.0, 900.0)))
    return unit, settings


def with_lead_in(course: SessionCourse, pings: int) -> tuple[SessionCourse, Bits]:
    """Return a course in which pings before each visit fill a sensor's filter, each visit a run; and which those are.

    Args:
        course: of a session.
        pings: number of pings before each visit.
    """
    begins = np.r_[True, np.diff(course.ping.time) > 2.0 * STEP_S]
    times = np.where(begins, 1 + pings, 1)
    rows = np.repeat(np.arange(len(times)), times)
    before = np.cumsum(times)[rows] - 1 - np.arange(len(rows))  # number of pings until the one of the course
    time = course.ping.time[rows] - STEP_S * before
    ping = replace(course.ping[rows], time=time, run=np.cumsum(begins)[rows] - 1)
    return SessionCourse(ping, course.scene[rows]), before > 0


def session(unit: Unit, course: SessionCourse, sessions: Sessions, name: str, rng: np.random.Generator) -> pd.DataFrame:
    """Record one session with the rig and return the recording's table."""
    unit, settings = _draw_laboratory(sessions, unit, rng)
    lead_in = np.zeros(len(course.scene), dtype=bool)
    if unit.averaging > 1:
        course, lead_in = with_lead_in(course, unit.averaging - 1)
    rigs = {scene: Rig(unit, replace(setup, **settings)) for scene, setup in sessions.scenes.items()}
    drift = rigs[STAND].draw_drift(rng)
    parts = []
    for scene in np.unique(course.scene):
        rows = np.flatnonzero(course.scene == scene)
        rig, ping = rigs[int(scene)], course.ping[rows]
        registers = rig.ping(ping, rng, drift)
        columns: dict[str, Any] = {**rig.columns(ping, registers), "session": name, "sensor": str(unit.serial)}
        reading = registers.reading(rig.setup)
        if sessions.front_end is not None:
            reading = rounded(reading, sessions.front_end.step_m)
            columns = {key: value for key, value in columns.items() if key not in SRF08_REGISTERS}
        table = Recording.of(ping, reading, "corpus", **columns).table
        parts.append(_first_echo_only(table)[~lead_in[rows]])
    return pd.concat(parts).sort_values("time_s", kind="stable")


def rounded(reading: Reading, step_m: float) -> Reading:
    """Return the first echoes in whole steps of a host that converts times, at least one step."""
    steps = np.maximum(np.rint(reading.range / step_m), 1.0)
    return Reading.of(np.where(reading.echo, steps * step_m, 0.0), reading.status)


def _first_echo_only(table: pd.DataFrame) -> pd.DataFrame:
    """Return a recording's table without the echoes after the first."""
    return table[[column for column in table.columns if not column.startswith("echo_")]]


def record_unit(sessions: Sessions, serial: int) -> pd.DataFrame:
    """Record all sessions of one sensor; the table depends only on the numbers in `sessions` and `serial`."""
    rng = np.random.default_rng([sessions.seed, serial, int(sessions.faulty)])
    unit = Unit.draw(serial) if sessions.front_end is None else sessions.front_end.unit(serial)
    tables = []
    for k in range(sessions.surveys + sessions.drives):
        course = survey(sessions.visits, rng) if k < sessions.surveys else drive(sessions.pings, rng)
        if sessions.faulty:  # a lost command repeats the previous ping, so all pings must be of one rig
            course = replace(course, scene=np.full(len(course.scene), STAND))
        tables.append(session(unit, course, sessions, f"{serial}-{k}", rng))
    return pd.concat(tables)


def no_progress(done: int, of: int) -> None:
    """Ignore progress."""


def record(sessions: Sessions, jobs: int = 1, progress: Callable[[int, int], None] = no_progress) -> Recording:
    """Record all sessions of all sensors."""
    tables = []
    for table in _tables(sessions, jobs):
        tables.append(table)
        progress(len(tables), len(sessions.units))
    return Recording(pd.concat(tables, ignore_index=True), "corpus")


def _tables(sessions: Sessions, jobs: int) -> Iterator[pd.DataFrame]:
    if jobs == 1:
        yield from (record_unit(sessions, serial) for serial in sessions.units)
        return
    with worker_processes(min(jobs, len(sessions.units))) as pool:
        yield from pool.map(record_unit, [sessions] * len(sessions.units), sessions.units)


def first_pings(recording: Recording, count: int) -> Bits:
    """Return a mask of the first `count` pings of each visit, (n,) bool."""
    visit = np.unique(np.stack([recording.run, recording.condition]), axis=1, return_inverse=True)[1].ravel()
    keep = np.zeros(len(recording), dtype=bool)
    for rows in steps(visit)[:count]:
        keep[rows] = True
    return keep


QUICK_PLAN = PLANS["quick"]
EVERY_THIRD_DISTANCE = QUICK_PLAN.distances_mm[::3]
INTERMEDIATE_PLAN = replace(  # conditions between those of the quick plan
    QUICK_PLAN, angles_deg=(1.0, 4.0, 10.0, 20.0), distances_mm=tuple(float(d) for d in range(300, 3001, 600)), pings=24
)
TRAINING_SENSORS, VALIDATION_SENSORS = tuple(range(1001, 1161)), tuple(range(1201, 1249))  # serial numbers
KNOWN_SENSORS, TEST_SENSORS = TRAINING_SENSORS[:80], tuple(range(201, 281))  # many, as sensors differ widely
# recordings by file name: sessions, or alternate conditions of a plan with its sensors and seed
RECORDINGS: dict[str, Sessions | tuple[SurveyPlan, tuple[int, ...], int]] = {
    "train": Sessions(TRAINING_SENSORS, surveys=8, drives=2),
    "validation": Sessions(VALIDATION_SENSORS, surveys=4, drives=1),
    "faulty": Sessions(TRAINING_SENSORS, surveys=2, drives=0, faulty=True),
    "faulty-validation": Sessions(VALIDATION_SENSORS, surveys=1, drives=0, faulty=True),
    "drives": Sessions(TRAINING_SENSORS, surveys=0, drives=8, seed=6),
    "gains": Sessions(TRAINING_SENSORS, surveys=3, drives=1, gains=True, seed=5),
    "gains-validation": Sessions(VALIDATION_SENSORS[:16], surveys=2, drives=1, gains=True, seed=5),
    "known": (replace(QUICK_PLAN, pings=6), KNOWN_SENSORS, 1),
    "conditions": (INTERMEDIATE_PLAN, KNOWN_SENSORS, 2),
    "sensors": (replace(QUICK_PLAN, distances_mm=EVERY_THIRD_DISTANCE, pings=24), TEST_SENSORS, 3),
    "fresh-conditions": Sessions(KNOWN_SENSORS, surveys=1, drives=1, seed=4),
    "fresh-sensors": Sessions(TEST_SENSORS, surveys=1, drives=1, seed=4),
}


def record_plan(plan: SurveyPlan, units: tuple[int, ...], seed: int) -> Recording:
    """Record alternate conditions of a plan with each sensor, the other half with the next sensor."""
    tables = []
    for serial in units:
        rng = np.random.default_rng([seed, serial])
        visits = [replace(plan, seed=seed + serial).ping(k) for k in range(serial % 2, len(plan), 2)]
        names = ("distance", "angle", "incidence", "reflectance", "time")
        ping = Ping.of(**{name: np.concatenate([getattr(visit, name) for visit in visits]) for name in names})
        table = Rig(Unit.draw(serial), SCENES[STAND]).record(ping, rng).table
        tables.append(_first_echo_only(table.assign(session=f"{seed}-{serial}", sensor=str(serial))))
    return Recording(pd.concat(tables, ignore_index=True), "survey")


def ensure_recorded(folder: Path, name: str, jobs: int = 1, progress: Callable[[int, int], None] = no_progress) -> Path:
    """Record an entry of `RECORDINGS` unless its file exists; returns the file."""
    path, what = folder / f"{name}.csv", RECORDINGS[name]
    if isinstance(what, Sessions):
        return record_session_file(path, what, jobs, progress)
    if not path.exists():
        record_plan(*what).save(path)
    return path


def record_session_file(
    path: Path, sessions: Sessions, jobs: int = 1, progress: Callable[[int, int], None] = no_progress
) -> Path:
    """Record sessions into a file unless it exists; returns the file."""
    if not path.exists():
        record(sessions, jobs, progress).save(path)
    return path
