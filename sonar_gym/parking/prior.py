"""Credence given a reading on the street, from the conditions that a driven car meets.

A sonar that points along the street mostly faces kerbs at the edge of its cone; one that points sideways faces boxes at
normal incidence; and a car that parks meets other conditions than one that drives at random. So streets like those of
the task are driven by a driver of each kind with ideal sonars, and the model's readings at these poses are counted.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from functools import lru_cache, partial
from importlib import import_module
from typing import Any, NamedTuple, cast

import gymnasium
import numpy as np

from acquisition import Ping, SettingError
from acquisition.arrays import Floats, Ints
from noise import CredenceTable, SonarModel, listener
from noise.law import CREDENCE_TOLERANCE
from sonar_gym.parking.stored import stored
from sonar_gym.parking.street import StreetSettings
from sonar_gym.parking.vehicle import CarSettings
from sonar_gym.sensing import paths
from sonar_gym.sensing.crosstalk import add_crosstalk
from sonar_gym.sensing.detection import detection_table, has_beam
from sonar_gym.sensing.kernels import mounted
from sonar_gym.sensing.mounts import Mount, mount_arrays
from sonar_gym.sensing.paths import MAX_PATHS, N_PATH, cast_paths
from sonar_gym.sensing.scene import EMPTY_M, Scene
from sonar_gym.sensing.sonar import BINS, Sonar, bin_edges, broad_table

SEED = 2016  # fixed, so that the prior is the same in every environment
ROUNDS = 1
STREETS, STEPS = 128, 240  # cars driven at once, and observations of each; episodes that end are followed by others
EVERY, SAMPLED_ONLY_EVERY = 3, 48  # observations used; a model that can only be sampled takes long
BROAD_WEIGHT = 0.01  # weight of the broad prior, for readings that the sample never gives
# Drivers of n cars by kind: functions that return `act(observation, begun)`, (n, 2); imported on demand, since they are
# built on the environment
DRIVERS = {
    "agent": "sonar_gym.agent:drive_by_agent",
    "scripted": "sonar_gym.control.driver:drive_by_script",
    "random": "sonar_gym.parking.prior:drive_at_random",
}
ActMany = Callable[[dict[str, Any], Ints], Floats]


def driver_of(name: str) -> Callable[[int], ActMany]:
    """Return the function that makes drivers of a kind.

    Raises:
        SettingError: no such kind.
    """
    if name not in DRIVERS:
        raise SettingError(f"credence_driver {name!r}: no such kind of driver; expected {', '.join(DRIVERS)}")
    module, function = DRIVERS[name].split(":")
    return cast(Callable[[int], ActMany], getattr(import_module(module), function))


def drive_at_random(count: int) -> ActMany:
    """Return a driver of n cars whose actions are uniform and independent."""
    rng = np.random.default_rng(SEED)
    return lambda observation, begun: rng.uniform(-1.0, 1.0, (count, 2))


class DrivenPoses(NamedTuple):
    """Poses of driven cars, at k observations of n cars.

    Attributes:
        poses: x, y, heading of the rear axle, m, m, rad, (k, n, 3).
        scenes: the street of each car, by observation, k lists of n.
        steps: number of steps in the episode, (k, n); 0 where one begins.
    """

    poses: Floats
    scenes: list[list[Scene]]
    steps: Ints


@lru_cache(maxsize=8)
def driven_poses(sonar: Any, streets: StreetSettings, car: CarSettings, driver: str, rounds: int) -> DrivenPoses:
    """Return the poses of cars driven on such streets with eight sonars; computed once per choice.

    Args:
        sonar: name or model of the sonars.
        streets: settings of the streets.
        car: measures of the car.
        driver: kind of driver.
        rounds: 0: the driver observes credence under the broad prior; else that of the round before.
    """
    # by its id, because the environment itself uses this module
    choice = {"sonar": sonar, "street": streets, "car": car, "credence_driver": None, "threads": 1}
    envs: Any = gymnasium.make_vec("SonarParking-v0", STREETS, **choice)
    act, fleet = driver_of(driver)(STREETS), envs.fleet
    if rounds > 0:
        key = streets, car, fleet.mounts, fleet.sonar.max_range, driver, True, rounds - 1
        fleet.sonar.tables[:] = [table.values for table in _street_credence(sonar, *key)]
    observation, begun = envs.reset(seed=SEED)[0], np.ones(STREETS, dtype=np.bool_)
    poses, scenes, steps = [], [], []
    for _ in range(STEPS):
        poses.append(fleet.worlds.car[:, :3].copy())
        scenes.append([fleet.world(i).street.scene for i in range(STREETS)])
        steps.append(fleet.worlds.steps.copy())
        observation = envs.step(act(observation, np.flatnonzero(begun)))[0]
        begun = fleet.worlds.steps == 0
    envs.close()
    return DrivenPoses(np.array(poses), scenes, np.array(steps))


def street_credence(
    model: SonarModel,
    streets: StreetSettings,
    car: CarSettings,
    mounts: tuple[Mount, ...],
    max_range: float,
    driver: str | None,
    crosstalk: bool = False,
) -> tuple[CredenceTable, ...]:
    """Return the credence given a reading for each sonar of a car on such streets; computed once per model.

    Args:
        model: model of the sonars.
        streets: settings of the streets.
        car: measures of the car.
        mounts: sonars on the car.
        max_range: maximum range, m.
        driver: kind of driver, a key of `DRIVERS`; None for the broad prior, without driving.
        crosstalk: whether the sonars hear each other's bursts; see `crosstalk.add_crosstalk`.
    """
    model = getattr(model, "assumed", model)  # what a driver expects of a sonar that differs from its model
    broad = broad_table(model, max_range)
    if driver is not None:
        driver_of(driver)  # an unknown kind is an error for every model
    if driver is None or np.all(broad.values[broad.share > 0.0] == 1.0):  # a sonar without noise needs no prior
        return (broad,) * len(mounts)
    # what a driver does depends on the credence that it observes, but two rounds agree
    return _street_credence(cast(Hashable, model), streets, car, mounts, max_range, driver, crosstalk, ROUNDS)


@lru_cache(maxsize=16)
def _street_credence(
    model: Any,
    streets: StreetSettings,
    car: CarSettings,
    mounts: tuple[Mount, ...],
    max_range: float,
    driver: str,
    crosstalk: bool,
    rounds: int,
) -> tuple[CredenceTable, ...]:
    edges = bin_edges(max_range)
    key = model, streets, car, mounts, max_range, driver, crosstalk, rounds
    values, share = stored(key, partial(_counted, *key))
    return tuple(CredenceTable(edges, v, s) for v, s in zip(values, share, strict=True))


def _counted(
    model: Any,
    streets: StreetSettings,
    car: CarSettings,
    mounts: tuple[Mount, ...],
    max_range: float,
    driver: str,
    crosstalk: bool,
    rounds: int,
) -> Floats:
    """Return the credence of each sonar's readings and the probability of each bin, (2, s, BINS)."""
    sampled_only = not listener(model).law(Ping.of(1.0)).has_probabilities
    open_loop = sampled_only or driver == "random"
    driven = driven_poses("ideal" if open_loop else model, streets, car, driver, 0 if open_loop else rounds)
    edges, broad = bin_edges(max_range), broad_table(model, max_range)
    sonars = Sonar(model, len(mounts), max_range, tables=[broad] * len(mounts), copies=STREETS)
    for copy in range(STREETS):
        sonars.seed(SEED + copy, copy)
    detection, (local, half) = detection_table(model, max_range), mount_arrays(mounts)
    # without cross-talk, as if the sonars fired one second after the other
    sent = np.array([mount.phase_s if crosstalk and has_beam(detection) else s for s, mount in enumerate(mounts)])
    right, total = np.zeros((2, len(mounts), BINS))
    before = driven.steps[0]
    for k in range(0, STEPS, SAMPLED_ONLY_EVERY if sampled_only else 1 if model.remembers else EVERY):
        begun = np.flatnonzero(driven.steps[k] < before)
        before = driven.steps[k]
        if len(begun):
            sonars.clear_memory(begun)
        faced = [_faced(pose, scene, local, half, max_range, detection, sent)
                 for pose, scene in zip(driven.poses[k], driven.scenes[k], strict=True)]  # fmt: skip
        _count(sonars, faced, 0.1 * driven.steps[k], edges, right, total)
    share = total / np.maximum(total.sum(axis=1, keepdims=True), 1.0)
    value = np.divide(right, total, out=np.zeros_like(total), where=total > 0.0)
    own = (CredenceTable(edges, v, s).mixed(broad, BROAD_WEIGHT) for v, s in zip(value, share, strict=True))
    return np.array([(table.values, table.share) for table in own]).swapaxes(0, 1)


def _faced(
    pose: Floats, scene: Scene, local: Floats, half: Floats, limit: float, detection: Floats, sent: Floats
) -> tuple[Floats, Ints]:
    """Return the paths of pings of each sonar of a car, sent at times (s,), and their numbers, (s,)."""
    out, counts = np.empty((len(half), MAX_PATHS, N_PATH)), np.empty(len(half), np.int64)
    sensors, fired = mounted(local, pose), np.ones(len(half), np.bool_)
    for s, (x, y, heading) in enumerate(sensors):
        counts[s] = cast_paths(
            x, y, heading, half[s], scene.segments, scene.surface, scene.owner, limit, detection, out[s]
        )
    faces = scene.segments, scene.surface, scene.owner
    add_crosstalk(sensors, fired, sent, *faces, limit, detection, out, counts)
    return out, counts


def _count(
    sonars: Sonar, faced: list[tuple[Floats, Ints]], time_s: Floats, edges: Floats, right: Floats, total: Floats
) -> None:
    """Draw the readings of all cars at times (n,), and count the right ones and all by bin, (s, BINS), in place."""
    counts = np.concatenate([count for _, count in faced])
    every = np.concatenate([path for path, _ in faced])[np.arange(MAX_PATHS) < counts[:, None]]
    in_cone, first = every[:, paths.OBSTACLE] >= 0.0, np.cumsum(counts) - counts
    index = np.arange(len(counts))
    distance, bearing, incidence, reflectance = every[:, :4].T.copy()
    ping = Ping(
        np.where(in_cone, distance, EMPTY_M), bearing, incidence, reflectance,
        np.repeat(time_s[index // sonars.count], counts), np.repeat(index, counts),
    )  # fmt: skip
    faces = every[:, paths.FACE].astype(np.int64)
    cars, numbers = np.arange(STREETS), [int(count.sum()) for _, count in faced]
    drawn = sonars.draw(ping, cars, numbers, index, first, faces, shift=every[:, paths.SHIFT])
    truth = np.where(every[drawn.path, paths.SOURCE] > 0.0, first + counts - 1, drawn.path)
    echo, reading = drawn.reading.echo, drawn.reading.range
    off = np.abs(reading - distance[truth]) <= CREDENCE_TOLERANCE * distance[truth]
    place = np.minimum(np.searchsorted(edges, reading, side="right") - 1, BINS - 1)
    np.add.at(total, (index[echo] % sonars.count, place[echo]), 1.0)
    hit = echo & off & in_cone[truth]
    np.add.at(right, (index[hit] % sonars.count, place[hit]), 1.0)
