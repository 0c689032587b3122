"""Credence given a reading on the street, from the conditions that a driven car meets.

A sonar that points along the street mostly faces kerbs at the edge of its cone; one that points sideways faces boxes at
normal incidence; and a car that parks meets other conditions than one that drives at random. So streets like those of
the task are driven by a driver of each kind, the model's readings from these places are drawn, and the right ones are
counted. Tables of `gaussian` and the SRF08's learned models on the registered streets are shipped; others are counted
when needed.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from importlib import import_module
from typing import Any, NamedTuple, cast

import gymnasium
import numpy as np

from acquisition.arrays import Floats, Ints
from acquisition.limits import check_choice
from noise import SonarModel, load_model
from noise.law import CREDENCE_TOLERANCE
from sonar_gym.parking import step_kernel
from sonar_gym.parking.stored import shipped, stored
from sonar_gym.sensing import paths, records
from sonar_gym.sensing.detection import detection_table, has_beam, listening_table
from sonar_gym.sensing.laws.general import GeneralLaw
from sonar_gym.sensing.mounts import Mount, heights, mount_arrays
from sonar_gym.sensing.records import PingArrays
from sonar_gym.sensing.scene import EMPTY_M
from sonar_gym.sensing.sonar import BINS, Sonar, broad_table
from sonar_gym.street.street import StreetSettings
from sonar_gym.street.vehicle import CarSettings

SEED = 2016  # fixed, so that the prior is the same in every environment
GENERAL_EVERY, SAMPLED_ONLY_EVERY = 8, 48  # for models that are not compiled, and for those that can only be sampled
STAND_IN = "srf08-mlp"  # drives in place of these, since what a driver meets hardly depends on the model
BROAD_WEIGHT = 0.01  # weight of the broad prior, for readings that the sample never gives
# Drivers of n cars by kind: functions that return `act(observation, begun)`, (n, 2); imported on demand, since they are
# built on the environment
DRIVERS = {
    "agent": "sonar_gym.agent:drive_by_agent",
    "scripted": "sonar_gym.control.driver:drive_by_script",
    "random": "sonar_gym.parking.prior:drive_at_random",
}


class Sample(NamedTuple):
    """How a kind of driver is sampled.

    Attributes:
        streets: cars driven at once.
        steps: observations of each; episodes that end are followed by others.
        every: interval of the observations at which readings are counted; in between the cars hardly move.
        sees: whether what the driver does depends on the sonars.
    """

    streets: int
    steps: int
    every: int
    sees: bool


# A car that is driven at random leaves its start slowly, so more streets and whole episodes are needed
SAMPLES = {
    "agent": Sample(128, 240, 3, True),
    "scripted": Sample(128, 240, 3, True),
    "random": Sample(512, 400, 20, False),
}
ActMany = Callable[[dict[str, Any], Ints], Floats]


def driver_of(name: str) -> Callable[[int], ActMany]:
    """Return the function that makes drivers of a kind.

    Raises:
        SettingError: no such kind.
    """
    check_choice("credence_driver", name, list(DRIVERS))
    module, function = DRIVERS[name].split(":")
    return cast(Callable[[int], ActMany], getattr(import_module(module), function))


def drive_at_random(count: int) -> ActMany:
    """Return a driver of n cars whose actions are uniform and independent."""
    rng = np.random.default_rng(SEED)
    return lambda observation, begun: rng.uniform(-1.0, 1.0, (count, 2))


@dataclass(frozen=True)
class Task:
    """What the conditions of a car's pings depend on.

    Attributes:
        streets: settings of the streets.
        car: measures of the car.
        mounts: sonars on the car.
        max_range: maximum range, m.
        driver: kind of driver, a key of `DRIVERS`.
        crosstalk: whether the sonars hear each other's bursts; see `crosstalk.add_crosstalk`.
    """

    streets: StreetSettings
    car: CarSettings
    mounts: tuple[Mount, ...]
    max_range: float
    driver: str
    crosstalk: bool


def street_credence(
    model: SonarModel,
    streets: StreetSettings,
    car: CarSettings,
    mounts: tuple[Mount, ...],
    max_range: float,
    driver: str | None,
    crosstalk: bool = False,
) -> Floats:
    """Return the credence given a reading for each sonar of a car on such streets, on `bin_edges`, (s, BINS).

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
        return np.tile(broad.values, (len(mounts), 1))
    return _street_credence(cast(Hashable, model), Task(streets, car, mounts, max_range, driver, crosstalk))


@lru_cache(maxsize=64)
def _street_credence(model: Any, task: Task) -> Floats:
    found = shipped(model, task)
    return stored((model, task), lambda: counted(model, task)[0]) if found is None else found


def counted(model: Any, *tasks: Task) -> list[Floats]:
    """Return the credence of each sonar's readings, (s, BINS), for tasks that differ in the sonars' mounts only."""
    ears, driver = [Ears(model, task) for task in tasks], tasks[0].driver
    if not SAMPLES[driver].sees:
        return count(ears, "ideal", None)
    if not ears[0].closed_loop:
        return count(ears, STAND_IN, shipped(load_model(STAND_IN), tasks[0]))
    # what a driver does depends on the credence that it observes, but two rounds agree
    first = count(ears[:1], model, None)[0]
    return count([Ears(model, task) for task in tasks], model, first)


def count(ears: Sequence[Ears], driving: Any, observed: Floats | None) -> list[Floats]:
    """Drive on streets, and return the credence of the readings of some sonars, (s, BINS) each.

    Args:
        ears: the sonars.
        driving: name or model of the sonars by which the cars are driven.
        observed: credence that the driver observes, (s, BINS); None for that under the broad prior.
    """
    task, sample = ears[0].task, ears[0].sample
    # by its id, because the environment itself uses this module
    choice = {"sonar": driving, "street": task.streets, "car": task.car, "credence_driver": None, "threads": 1}
    envs: Any = gymnasium.make_vec("SonarParking-v0", sample.streets, **choice)
    fleet, act = envs.fleet, driver_of(task.driver)(sample.streets)
    if observed is not None and observed.shape == fleet.sonar.tables.shape:
        fleet.sonar.tables[:] = observed
    observation, begun = envs.reset(seed=SEED)[0], np.ones(sample.streets, dtype=np.bool_)
    for k in range(sample.steps):
        for each in ears:
            each.hear(fleet, k, np.flatnonzero(begun))
        observation = envs.step(act(observation, np.flatnonzero(begun)))[0]
        begun = fleet.worlds.steps == 0
    envs.close()
    return [each.credence() for each in ears]


class Ears:
    """Sonars of a model on driven cars, whose right readings are counted.

    Args:
        model: model of the sonars.
        task: what they face.
    """

    def __init__(self, model: Any, task: Task) -> None:
        self.task, self.sample, self._model = task, SAMPLES[task.driver], model
        count = self.sample.streets
        self._sonar = Sonar(model, len(task.mounts), task.max_range, copies=count, persists=False)
        for copy in range(count):
            self._sonar.seed(SEED + copy, copy)
        self._pings = PingArrays.of(count, len(task.mounts), 1, count)
        self._pings.fired[:] = True
        self._local, self._half = mount_arrays(task.mounts)
        self._heights = heights(task.mounts)
        self._counts = np.zeros((2, len(task.mounts), BINS))  # right readings and all
        self.closed_loop = not isinstance(self._sonar.law, GeneralLaw)

    def hear(self, fleet: Any, k: int, begun: Ints) -> None:
        """Count the readings at the k-th observation of a fleet, in which some episodes have begun."""
        if len(begun):
            self._sonar.clear_memory(begun)
        if k % self._every == 0:
            self._add(self._records(fleet, k * fleet.constants.dt))

    @property
    def _every(self) -> int:
        """Interval of the observations at which readings are counted."""
        if not self._sonar.has_credence:
            return SAMPLED_ONLY_EVERY
        return 1 if self._sonar.model.remembers else self.sample.every if self.closed_loop else GENERAL_EVERY

    def _records(self, fleet: Any, time_s: float) -> Floats:
        """Return the records of pings of all sonars where the cars stand, at a time and their phases, (n, N_RECORD)."""
        detection, p = detection_table(self._model, self.task.max_range), self._pings
        crosstalk = self.task.crosstalk and has_beam(detection)
        constants = fleet.constants._replace(
            half_angles=self._half,
            heights=self._heights,
            detection=detection,
            listening=listening_table(self._model) if crosstalk else detection,
            crosstalk=crosstalk,
        )
        rows = np.arange(self.sample.streets)
        worlds = fleet.worlds._replace(mounts=np.repeat(self._local[None], len(rows), axis=0))
        phase, period = (np.array([getattr(m, name) for m in self.task.mounts]) for name in ("phase_s", "period_s"))
        for cycle in (1.0, 0.0) if crosstalk and np.ptp(phase) > 0.0 else (0.0,):  # the previous bursts are heard, too
            p.sent[:] = time_s + phase - cycle * period
            step_kernel.measure(rows, worlds, constants, p)
        return self._sonar.draw(rows, records.gather(rows, EMPTY_M, p))

    def _add(self, heard: Floats) -> None:
        """Count the right readings and all."""
        right, total = self._counts
        sonar, reading, true = np.arange(len(heard)) % len(right), heard[:, records.RANGE], heard[:, paths.DISTANCE]
        echo = heard[:, records.STATUS] == 1
        good = echo & (np.abs(reading - true) <= CREDENCE_TOLERANCE * true) & (heard[:, paths.OBSTACLE] >= 0.0)
        place = np.minimum(np.searchsorted(self._sonar.edges, reading, side="right") - 1, BINS - 1)
        np.add.at(total, (sonar[echo], place[echo]), 1.0)
        np.add.at(right, (sonar[good], place[good]), 1.0)

    def credence(self) -> Floats:
        """Return the share of right readings by sonar and bin, (s, BINS), with a small weight of the broad prior."""
        right, total = self._counts
        broad = broad_table(self._model, self.task.max_range)
        weight = BROAD_WEIGHT * np.maximum(total.sum(axis=1, keepdims=True), 1.0) * broad.share
        mixed = (1.0 - BROAD_WEIGHT) * total + weight
        hit = (1.0 - BROAD_WEIGHT) * right + weight * broad.values
        return np.divide(hit, mixed, out=np.zeros_like(hit), where=mixed > 0.0)
