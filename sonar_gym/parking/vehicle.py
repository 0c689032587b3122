"""The miniature car at 1:10: a kinematic bicycle model with the rear axle as reference point."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from acquisition import SettingError
from sonar_gym.sensing import kernels

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class CarSettings:
    """Dimensions and dynamics of the car. The miniature cars of Esmi (2016) have a tenth of the size of a real car.

    Attributes:
        length, width: dimensions of the body, m.
        wheelbase: distance between the axles, m.
        rear_overhang: length of the body behind the rear axle, m.
        max_steering: maximum steering angle to either side, rad.
        max_speed: maximum speed forwards and backwards, m/s.
        steering_rate: maximum rate of the steering angle, rad/s.
        steering_lag: time constant of the servo, s.
        acceleration: maximum acceleration, m/s^2.
        speed_lag: time constant of the motor, s.
    """

    length: float = 0.45
    width: float = 0.20
    wheelbase: float = 0.26
    rear_overhang: float = 0.09
    max_steering: float = np.radians(30.0)
    max_speed: float = 0.5
    steering_rate: float = np.radians(240.0)
    steering_lag: float = 0.05
    acceleration: float = 2.0
    speed_lag: float = 0.05

    def __post_init__(self) -> None:
        """Raise SettingError for invalid dimensions."""
        for name in ("length", "width", "wheelbase", "max_steering", "max_speed", "steering_rate", "acceleration"):
            if not getattr(self, name) > 0.0:
                raise SettingError(f"CarSettings.{name} must be > 0, got {getattr(self, name):g}")
        if self.max_steering >= np.pi / 2:
            raise SettingError(f"CarSettings.max_steering must be < pi/2 rad, got {self.max_steering:g} rad")

    @property
    def turning_radius(self) -> float:
        """Least turning radius of the rear axle, m."""
        return float(self.wheelbase / np.tan(self.max_steering))

    @property
    def centre(self) -> float:
        """Distance from the rear axle forward to the centre of the body, m."""
        return 0.5 * self.length - self.rear_overhang

    @cached_property
    def body(self) -> Floats:
        """Rectangle of the body in the frame of the car: rear, right, front, left, m, (4,)."""
        front = self.length - self.rear_overhang
        return np.array([-self.rear_overhang, -0.5 * self.width, front, 0.5 * self.width])

    @cached_property
    def dynamics(self) -> Floats:
        """Parameters of the drive for the kernels: wheelbase, rates and lags, maximum steering and speed, (7,)."""
        follow = (self.steering_rate, self.steering_lag, self.acceleration, self.speed_lag)
        return np.array([self.wheelbase, *follow, self.max_steering, self.max_speed])


@dataclass(frozen=True)
class Car:
    """State of a car.

    Attributes:
        settings: its dimensions and dynamics.
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

    def drive(self, steering: float, speed: float, segments: Floats, dt: float, parts: int = 5) -> tuple[Car, int]:
        """Drive for dt s.

        Args:
            steering: command as a fraction of the maximum, -1 (right) to 1 (left).
            speed: command as a fraction of the maximum, -1 to 1.
            segments: obstacles, m, (m, 4).
            dt: duration, s.
            parts: number of equal parts after which collisions are checked.

        Returns:
            The car after dt, and the index of the segment it collided with, or -1.
        """
        s = self.settings
        state, hit = kernels.drive(
            self.state, steering * s.max_steering, speed * s.max_speed, s.dynamics, s.body, segments, dt, parts
        )
        return Car(s, state), hit

    def corners(self) -> Floats:
        """Return the corners of the body in the world: front left, rear left, rear right, front right, m, (4, 2)."""
        rear, right, front, left = self.settings.body
        local = np.array([[front, left], [rear, left], [rear, right], [front, right]])
        c, s = np.cos(self.state[2]), np.sin(self.state[2])
        return local @ np.array([[c, s], [-s, c]]) + self.state[:2]
