"""Air: speed of sound, absorption, slow drift and turbulence."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from acquisition.arrays import Bits, Floats, Ints
from acquisition.ping import CELSIUS

PRESSURE = 101_325.0  # Pa
CARBON_DIOXIDE = 4.0e-4  # mole fraction in a room
CARRIER = 40e3  # Hz, carrier frequency of the SRF08's burst

# Cramer, J. Acoust. Soc. Am. 93 (1993) 2510, table III
CRAMER = (
    (331.5024, 0.603055, -0.000528),
    (51.471935, 0.1495874, -0.000782),
    (-1.82e-7, 3.73e-8, -2.93e-10),
    (-85.20931, -0.228525, 5.91e-5),
)
CRAMER_SQUARES = (-2.835149, -2.15e-13, 29.179762, 0.000486)
DRIFT_COMPONENTS = 48  # number of terms in the harmonic series of the slow drift


def _water(t: Floats, humidity_pct: ArrayLike) -> Floats:
    """Return the mole fraction of water vapour (Cramer 1993, eq. A1 to A3)."""
    kelvin = t + CELSIUS
    saturation = np.exp(1.2811805e-5 * kelvin**2 - 1.9509874e-2 * kelvin + 34.04926034 - 6.3536311e3 / kelvin)
    enhancement = 1.00062 + 3.14e-8 * PRESSURE + 5.6e-7 * t**2
    return np.asarray(humidity_pct, dtype=np.float64) / 100.0 * enhancement * saturation / PRESSURE


def sound_speed(temperature_c: ArrayLike, humidity_pct: ArrayLike = 50.0) -> Floats:
    """Return the speed of sound, m/s (Cramer 1993).

    >>> round(float(sound_speed(19.0, 50.0)), 1)
    343.4
    """
    t = np.asarray(temperature_c, dtype=np.float64)
    water = _water(t, humidity_pct)
    dry, wet, pressed, carbonated = (a + b * t + c * t**2 for a, b, c in CRAMER)
    first = dry + wet * water + pressed * PRESSURE + carbonated * CARBON_DIOXIDE
    a, b, c, d = CRAMER_SQUARES
    second = a * water**2 + b * PRESSURE**2 + c * CARBON_DIOXIDE**2 + d * water * PRESSURE * CARBON_DIOXIDE
    return np.asarray(first + second)


def absorption_db(temperature_c: ArrayLike, humidity_pct: ArrayLike = 50.0, frequency: float = CARRIER) -> Floats:
    """Return the absorption, dB/m (ISO 9613-1, eq. 3 to 5, at one atmosphere).

    >>> round(float(absorption_db(19.0, 50.0)), 2)
    1.29
    """
    kelvin = np.asarray(temperature_c, dtype=np.float64) + CELSIUS
    ratio = kelvin / 293.15
    water_pct = np.asarray(humidity_pct) * 10.0 ** (4.6151 - 6.8346 * (273.16 / kelvin) ** 1.261)
    oxygen = 24.0 + 4.04e4 * water_pct * (0.02 + water_pct) / (0.391 + water_pct)
    nitrogen = ratio**-0.5 * (9.0 + 280.0 * water_pct * np.exp(-4.170 * (ratio ** (-1.0 / 3.0) - 1.0)))
    relaxation = 0.01275 * np.exp(-2239.1 / kelvin) / (oxygen + frequency**2 / oxygen)
    relaxation += 0.1068 * np.exp(-3352.0 / kelvin) / (nitrogen + frequency**2 / nitrogen)
    return 8.686 * frequency**2 * (1.84e-11 * ratio**0.5 + ratio**-2.5 * relaxation)


@dataclass(frozen=True)
class Drift:
    """Slow stationary random process, a deterministic function of time, so that a session can be continued.

    A harmonic series whose frequencies are drawn from a Lorentzian has the covariance sigma^2 exp(-|dt|/tau).
    """

    frequency: Floats
    phase: Floats
    sigma: float

    @classmethod
    def draw(cls, sigma: float, tau: float, rng: np.random.Generator) -> Drift:
        """Draw one process of standard deviation `sigma` and correlation time `tau`, s."""
        return cls(rng.standard_cauchy(DRIFT_COMPONENTS) / tau, rng.uniform(0.0, 2.0 * np.pi, DRIFT_COMPONENTS), sigma)

    def __call__(self, time: Floats) -> Floats:
        """Return the process at times in s, (n,)."""
        if self.sigma == 0.0:
            return np.zeros(len(time))
        waves = np.cos(time[:, None] * self.frequency + self.phase)
        return self.sigma * np.sqrt(2.0 / DRIFT_COMPONENTS) * waves.sum(axis=1)


def flutter(time: Floats, start: Bits, tau: float, count: int, rng: np.random.Generator) -> Floats:
    """Draw independent Ornstein-Uhlenbeck processes of unit variance at given times, (n, count).

    Args:
        time: s, (n,).
        start: whether a ping starts a new, independent series, (n,).
        tau: correlation time, s.
        count: number of processes.
        rng: source of all randomness.
    """
    white = rng.standard_normal((len(time), count))
    keep = np.exp(-np.abs(np.diff(time, prepend=time[:1])) / tau) if tau > 0 else np.zeros(len(time))
    keep[start] = 0.0
    rank = np.arange(len(time)) - np.maximum.accumulate(np.where(start, np.arange(len(time)), 0))
    order = np.argsort(rank, kind="stable")
    for current in np.split(order, np.flatnonzero(np.diff(rank[order])) + 1)[1:]:
        memory = keep[current, None]
        white[current] = memory * white[current - 1] + np.sqrt(1.0 - memory**2) * white[current]
    return white


@dataclass(frozen=True)
class Air:
    """Air of n segments.

    Attributes:
        temperature_c: at the sensor, degC, (n,).
        speed: speed of sound at the sensor, m/s, (n,).
        absorption_db: dB/m, (n,).
    """

    temperature_c: Floats
    speed: Floats
    absorption_db: Floats

    @classmethod
    def of(cls, temperature_c: ArrayLike, humidity_pct: ArrayLike = 50.0) -> Air:
        """Compute the properties of air at temperatures and humidities, (n,) each."""
        temperature, humidity = np.broadcast_arrays(np.atleast_1d(temperature_c), np.atleast_1d(humidity_pct))
        temperature = np.asarray(temperature, dtype=np.float64)
        return cls(temperature, sound_speed(temperature, humidity), absorption_db(temperature, humidity))

    def __getitem__(self, pick: NDArray[np.generic]) -> Air:
        """Return the air of some segments."""
        return Air(self.temperature_c[pick], self.speed[pick], self.absorption_db[pick])

    def with_extra_absorption(self, extra_db: float) -> Air:
        """Return air with additional absorption, dB/m."""
        return replace(self, absorption_db=self.absorption_db + extra_db) if extra_db else self

    def loss(self, row: Ints, path: Floats) -> Floats:
        """Return the pressure factor of a two-way path of half length `path`, m, in segments `row`."""
        return np.exp(-np.log(10.0) / 10.0 * self.absorption_db[row] * path)

    def delay(self, row: Ints, path: Floats, ahead: float = 0.0) -> Floats:
        """Return the two-way travel time, s, over half length `path`, m, in segments `row`.

        Args:
            row: segment of each path, (k,).
            path: half of the path length, m, (k,).
            ahead: temperature gradient along the path, K/m.
        """
        if ahead == 0.0:
            return 2.0 * path / self.speed[row]
        # speed is proportional to the root of the absolute temperature, averaged over the path
        relative_change = 0.5 * ahead * path / (self.temperature_c[row] + CELSIUS)
        return 2.0 * path / (self.speed[row] * np.sqrt(np.maximum(1.0 + relative_change, 0.01)))


@dataclass(frozen=True)
class Gradient:
    """Temperature gradient of the air, K/m.

    Attributes:
        up: bends sound towards the colder side, by 0.1 degrees per metre for 1 K/m.
        ahead: makes the range error grow with the square of the distance.
    """

    up: float = 0.0
    ahead: float = 0.0

    def bend(self, air: Air) -> Floats:
        """Return the downward curvature of a horizontal ray, 1/m, (n,)."""
        return 0.5 * self.up / (air.temperature_c + CELSIUS)
