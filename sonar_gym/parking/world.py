"""One world of a fleet as pictures, tests and people want it: street, car, what the pings met and what was heard."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from acquisition import Reading
from sonar_gym.parking import step_kernel
from sonar_gym.parking.street import Street
from sonar_gym.parking.vehicle import Car
from sonar_gym.sensing.scene import Hits
from sonar_gym.sensing.sonar import Heard

if TYPE_CHECKING:
    from sonar_gym.parking.fleet import Fleet


class World:
    """One world of a fleet, as it is now.

    Args:
        fleet: it belongs to.
        row: its number.
    """

    def __init__(self, fleet: Fleet, row: int) -> None:
        self.fleet, self.worlds, self.row = fleet, fleet.worlds, row
        self.mounts, self.sonar_name, self.car_settings = fleet.mounts, fleet.sonar_name, fleet.car_settings

    @property
    def street(self) -> Street:
        """The street of this episode."""
        street = self.fleet.streets[self.row]
        assert street is not None
        return street

    @property
    def car(self) -> Car:
        """The car."""
        return Car(self.car_settings, self.worlds.car[self.row].copy())

    @property
    def steps(self) -> int:
        """Taken since the episode began; -1 before the first."""
        return int(self.worlds.steps[self.row])

    @property
    def hits(self) -> Hits:
        """What the pings met whose readings are shown."""
        ping = self.worlds.shown[self.row].T.copy()
        thing = ping[step_kernel.THING].astype(np.int64)
        point = ping[[step_kernel.X, step_kernel.Y]].T.copy()
        distance, bearing, incidence, reflectance = ping[: step_kernel.THING]
        return Hits(distance, bearing, incidence, reflectance, thing >= 0, thing, point)

    @property
    def heard(self) -> Heard:
        """What is shown of the sonars."""
        ping = self.worlds.shown[self.row].T
        reading = Reading(ping[step_kernel.RANGE].copy(), ping[step_kernel.STATUS].astype(np.uint8))
        credence = self.worlds.credence[self.row].astype(np.float64)
        return Heard(reading, credence, ping[step_kernel.GIVEN_CONDITION].copy())

    @property
    def causes(self) -> tuple[str, ...]:
        """Why each reading is what it is, by name."""
        names = self.fleet.causes
        return tuple(names[number] for number in self.worlds.cause[self.row])

    @property
    def parked(self) -> bool:
        """Whether the car stands in the gap."""
        return bool(self.worlds.ended[self.row, step_kernel.PARKED])

    @property
    def collision(self) -> bool:
        """Whether it touches anything."""
        return bool(self.worlds.ended[self.row, step_kernel.COLLISION])

    @property
    def left_street(self) -> bool:
        """Whether it has left by the open end."""
        return bool(self.worlds.ended[self.row, step_kernel.LEFT_STREET])
