"""The miniature car: a kinematic bicycle model about the rear axle, at a scale of 1:10."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Annotated

import numpy as np

from acquisition.arrays import Floats
from acquisition.limits import Limit, check_settings


@dataclass(frozen=True)
class CarSettings:
    """Measures of the car; the miniature cars of Esmi (2016) are about a tenth of the size of a real car.

    Attributes:
        length, width: length and width of the body, m.
        wheelbase: distance between the axles, m.
        rear_overhang: length of the body behind the rear axle, m.
        max_steering: maximum steering angle to either side, rad.
        max_speed: maximum speed forwards and backwards, m/s.
        steering_rate: maximum rate of the steering angle, rad/s.
        steering_lag: time constant of the servo, s.
        acceleration: maximum acceleration, m/s^2.
        speed_lag: time constant of the motor, s.
    """

    length: Annotated[float, Limit(0.0, 100.0, "m", open_low=True)] = 0.45
    width: Annotated[float, Limit(0.0, 100.0, "m", open_low=True)] = 0.20
    wheelbase: Annotated[float, Limit(0.0, 100.0, "m", open_low=True)] = 0.26
    rear_overhang: Annotated[float, Limit(-100.0, 100.0, "m")] = 0.09
    max_steering: Annotated[float, Limit(0.01, np.pi / 2, "rad", open_high=True)] = np.radians(30.0)
    max_speed: Annotated[float, Limit(0.0, 100.0, "m/s", open_low=True)] = 0.5
    steering_rate: Annotated[float, Limit(0.0, 1e12, "rad/s", open_low=True)] = np.radians(240.0)
    steering_lag: Annotated[float, Limit(0.0, 60.0, "s")] = 0.05
    acceleration: Annotated[float, Limit(0.0, 1e12, "m/s^2", open_low=True)] = 2.0
    speed_lag: Annotated[float, Limit(0.0, 60.0, "s")] = 0.05

    def __post_init__(self) -> None:
        """Raise SettingError for invalid measures."""
        check_settings(self)

    @property
    def turning_radius(self) -> float:
        """Minimum radius of the path of the rear axle, m."""
        return float(self.wheelbase / np.tan(self.max_steering))

    @property
    def centre(self) -> float:
        """Distance of the centre of the body before the rear axle, m."""
        return 0.5 * self.length - self.rear_overhang

    @cached_property
    def body(self) -> Floats:
        """Rectangle of the body in the frame of the car: rear, right, front, left, m, (4,)."""
        front = self.length - self.rear_overhang
        return np.array([-self.rear_overhang, -0.5 * self.width, front, 0.5 * self.width], dtype=np.float64)

    @cached_property
    def dynamics(self) -> Floats:
        """Wheelbase, steering rate, steering lag, acceleration, speed lag, maximum steering and speed, (7,)."""
        lags = (self.steering_rate, self.steering_lag, self.acceleration, self.speed_lag)
        return np.array([self.wheelbase, *lags, self.max_steering, self.max_speed], dtype=np.float64)


@dataclass(frozen=True)
class Car:
    """State of a car.

    Attributes:
        settings: measures of the car.
        state: x, y, heading of the rear axle, speed, steering angle: m, m, rad, m/s, rad, (5,).
    """

    settings: CarSettings
    state: Floats

    @classmethod
    def at(cls, settings: CarSettings, x: float, y: float, heading: float) -> Car:
        """Return a car at rest with straight wheels."""
        return cls(settings, np.array([x, y, heading, 0.0, 0.0]))

    @property
    def pose(self) -> Floats:
        """x, y, heading of the rear axle: m, m, rad, (3,)."""
        return self.state[:3]

    @property
    def speed(self) -> float:
        """Speed, positive forwards, m/s."""
        return float(self.state[3])

    @property
    def steering(self) -> float:
        """Steering angle, positive to the left, rad."""
        return float(self.state[4])
