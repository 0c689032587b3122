"""One world of a fleet for display and tests: street, car, conditions of the pings and their readings."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from acquisition import Reading
from sonar_gym.parking import step_kernel
from sonar_gym.parking.step_kernel import WorldArrays
from sonar_gym.sensing import paths, records
from sonar_gym.sensing.mounts import Mount
from sonar_gym.sensing.records import PingArrays
from sonar_gym.sensing.scene import Box, Hits
from sonar_gym.street.street import Street
from sonar_gym.street.vehicle import Car, CarSettings


@dataclass(frozen=True)
class SonarReadings:
    """Readings of s sonars.

    Attributes:
        reading: the readings.
        credence: probability that each reading is right, given the reading, 0..1, (s,); 0 without an echo.
    """

    reading: Reading
    credence: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class WorldView:
    """The current state of one world.

    Attributes:
        arrays: arrays of all worlds.
        pings: pings of all worlds.
        row: number of the world.
        street: street of this episode.
        car_settings: measures of the car.
        mounts: sonars on the car.
        sonar_name: name of the sonar model.
        cause_names: names of the causes of readings, by number.
    """

    arrays: WorldArrays
    pings: PingArrays
    row: int
    street: Street
    car_settings: CarSettings
    mounts: tuple[Mount, ...]
    sonar_name: str
    cause_names: tuple[str, ...]

    @property
    def car(self) -> Car:
        """The car."""
        return Car(self.car_settings, self.arrays.car[self.row].copy())

    @property
    def obstacles(self) -> tuple[Box, ...]:
        """The further obstacles where they are now."""
        count, boxes = len(self.street.obstacles), self.street.obstacles
        corners = self.arrays.segments[self.row, : self.arrays.counts[self.row], :2]
        centres = corners[len(corners) - 4 * count :].reshape(count, 4, 2).mean(axis=1).tolist()
        return tuple(replace(box, x=x, y=y) for box, (x, y) in zip(boxes, centres, strict=True))

    @property
    def mount_poses(self) -> NDArray[np.float64]:
        """Poses of the sonars of this episode in the frame of the car, m, m, rad, (s, 3)."""
        return self.arrays.mounts[self.row].copy()

    @property
    def steps(self) -> int:
        """Number of steps in this episode."""
        return int(self.arrays.steps[self.row])

    @property
    def hits(self) -> Hits:
        """Points that the readings shown come from, or that the sonars face."""
        ping = self.pings.of_shown(self.row).T.copy()
        obstacle = ping[paths.OBSTACLE].astype(np.int64)
        point = ping[[paths.X, paths.Y]].T.copy()
        distance, bearing, incidence, reflectance = ping[: paths.OBSTACLE]
        return Hits(distance, bearing, incidence, reflectance, obstacle >= 0, obstacle, point)

    @property
    def readings(self) -> SonarReadings:
        """The readings shown."""
        ping = self.pings.of_shown(self.row).T
        reading = Reading(ping[records.RANGE].copy(), ping[records.STATUS].astype(np.uint8))
        return SonarReadings(reading, self.pings.credence[self.row].astype(np.float64))

    @property
    def causes(self) -> tuple[str, ...]:
        """Name of the cause of each reading."""
        return tuple(self.cause_names[number] for number in self.pings.cause[self.row])

    @property
    def parked(self) -> bool:
        """Whether the car stands in the gap."""
        return bool(self.arrays.ended[self.row, step_kernel.PARKED])

    @property
    def collision(self) -> bool:
        """Whether the car touches an obstacle."""
        return bool(self.arrays.ended[self.row, step_kernel.COLLISION])

    @property
    def left_street(self) -> bool:
        """Whether the car has left the street by the open end."""
        return bool(self.arrays.ended[self.row, step_kernel.LEFT_STREET])
