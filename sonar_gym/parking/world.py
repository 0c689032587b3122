"""View of one world of a fleet, for rendering and tests: street, car, cone hits and readings."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from acquisition import Reading
from sonar_gym.parking import step_kernel
from sonar_gym.parking.step_kernel import Worlds
from sonar_gym.parking.street import Street
from sonar_gym.parking.vehicle import Car, CarSettings
from sonar_gym.sensing.mounts import Mount
from sonar_gym.sensing.scene import Hits
from sonar_gym.sensing.sonar import SonarReadings


@dataclass(frozen=True)
class WorldView:
    """The present state of one world.

    Attributes:
        worlds: arrays of all worlds.
        row: row of this world.
        street: street of the episode.
        mounts: sonars on the car.
        car_settings: dimensions and dynamics of the car.
        sonar_name: name of the sonar model, for display.
        cause_names: names of the causes of readings, by number.
    """

    worlds: Worlds
    row: int
    street: Street
    mounts: tuple[Mount, ...]
    car_settings: CarSettings
    sonar_name: str
    cause_names: tuple[str, ...]

    @property
    def car(self) -> Car:
        """The car."""
        return Car(self.car_settings, self.worlds.car[self.row].copy())

    @property
    def steps(self) -> int:
        """Number of steps since the start of the episode."""
        return int(self.worlds.steps[self.row])

    @property
    def hits(self) -> Hits:
        """What the pings faced whose readings are observed."""
        ping = self.worlds.observed[self.row].T.copy()
        index = ping[step_kernel.OBJECT].astype(np.int64)
        point = ping[[step_kernel.X, step_kernel.Y]].T.copy()
        distance, bearing, incidence, reflectance = ping[: step_kernel.OBJECT]
        return Hits(distance, bearing, incidence, reflectance, index >= 0, index, point)

    @property
    def readings(self) -> SonarReadings:
        """The observed readings."""
        ping = self.worlds.observed[self.row].T
        reading = Reading(ping[step_kernel.RANGE].copy(), ping[step_kernel.STATUS].astype(np.uint8))
        credence = self.worlds.credence[self.row].astype(np.float64)
        return SonarReadings(reading, credence, ping[step_kernel.GIVEN_CONDITION].copy())

    @property
    def causes(self) -> tuple[str, ...]:
        """Name of the cause of each reading."""
        return tuple(self.cause_names[number] for number in self.worlds.cause[self.row])

    @property
    def parked(self) -> bool:
        """Whether the car stands in the gap."""
        return bool(self.worlds.ended[self.row, step_kernel.PARKED])

    @property
    def collision(self) -> bool:
        """Whether the car touches an obstacle."""
        return bool(self.worlds.ended[self.row, step_kernel.COLLISION])

    @property
    def left_street(self) -> bool:
        """Whether the car has left the street at its open end."""
        return bool(self.worlds.ended[self.row, step_kernel.LEFT_STREET])
